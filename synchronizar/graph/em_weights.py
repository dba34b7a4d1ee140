"""What expectation maximisation re-estimates between optimisations: weights of ranges, steps and priors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from synchronizar.arrays import Array


@dataclass(frozen=True)
class EmWeights:
    """EM weights: fixed while optimising, re-estimated after."""

    nlos_odds: Array
    """(n,) P(NLOS) / P(not NLOS) of each range given its neighbours in time; its own residual does not count."""
    own_probability: Array
    """(n,) that each range is of its two devices, and not foreign, given all residuals of its pair."""
    range_weight: Array
    """(n,) composite-likelihood weight: the number of independent ranges that each counts as. Not a robust weight."""
    step_weight: list[Array]
    """Of each user (m - 1,): weight of each SLAM step, from Student's t as a scale mixture of normals."""
    calibration_weight: Array
    """(k + 1, 3): the same weight of each device's deviation from the shared log scale, bias and clock offset; the last
    row is that of the shared calibration's deviation from zero."""
    height_weight: Array
    """(k,): the same weight of each origin's height about the mean level, and of each surveyed radio's place."""
    level_weight: Array
    """(k,): the same weight of how far each device strays from the height at which it is carried."""


def student(squares: Array, freedom: Array | float, dimension: Array | float) -> tuple[Array, float]:
    """Weights of Student's t as a scale mixture of normals at squared whitened errors, and its negative log likelihood.

    With f = freedom + dimension the weight is f / (f + e^2), the cost 0.5 f log(1 + e^2 / f). Its curvature at 0 is
    that of the unit normal: errors of optimised variables are smaller than the noise, which must not be taken for
    less noise.
    """
    f = freedom + dimension
    return f / (f + squares), float((0.5 * f * np.log1p(squares / f)).sum())
