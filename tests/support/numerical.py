"""Derivatives of gtsam factors by differences."""

from __future__ import annotations

from collections.abc import Callable

import gtsam
import numpy as np

from synchronizar.arrays import Array


def moved(values: gtsam.Values, key: int, step: Array) -> gtsam.Values:
    """Values with one variable moved in its tangent space."""
    delta = gtsam.VectorValues()
    delta.insert(key, step)
    return values.retract(delta)


def derivative(of: Callable[[gtsam.Values], Array], values: gtsam.Values, keys: list[int], h: float = 1e-4) -> Array:
    """(m, n) of a function by the tangents of some variables, by differences of fourth order."""
    columns, dims = [], values.zeroVectors()
    for key in keys:
        for axis in np.eye(len(dims.at(key))):
            at = [np.asarray(of(moved(values, key, k * h * axis))) for k in (-2, -1, 1, 2)]
            columns.append((at[0] - 8.0 * at[1] + 8.0 * at[2] - at[3]) / (12.0 * h))
    return np.array(columns).T
