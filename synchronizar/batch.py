"""All users at once: every joint placement that explains the ranges, settled in one graph."""

from __future__ import annotations

from typing import NamedTuple

import gtsam
import numpy as np

from synchronizar.arrays import Array
from synchronizar.graph import RigidGraph
from synchronizar.initialise import Hypothesis
from synchronizar.model import Model


class Settled(NamedTuple):
    """A joint placement at a minimum of the cost."""

    frames: Array
    """(k, 4) x, y, z, yaw: common_from_user; NaN where it is not placed."""
    cost: float
    """Negative log likelihood, up to a constant that all placements share."""
    values: gtsam.Values


def settle_all(graph: RigidGraph, hypotheses: list[Hypothesis], corners: Array, model: Model) -> list[Settled]:
    """Each hypothesis settled jointly, best first; those that end in the same place once.

    `corners` (k, c, 3) are points of each user's walk in its own frame: placements that move none of them by more than
    `model.largest_error` are the same.
    """
    settled = sorted((_settle(graph, h.frames, model) for h in hypotheses), key=lambda s: s.cost)
    kept: list[Settled] = []
    for s in settled:
        if not any(np.nanmax(moved(s.frames, k.frames, corners)) < model.largest_error for k in kept):
            kept.append(s)
    return [s for s in kept if s.cost <= kept[0].cost + model.cost_alive]


def moved(frames: Array, others: Array, corners: Array) -> Array:
    """(k,) m: how far two joint placements (k, 4) lie apart for each user, at the corner (k, c, 3) where it is most."""
    return np.asarray(np.linalg.norm(_places(frames, corners) - _places(others, corners), axis=2).max(axis=1))


def _places(frames: Array, corners: Array) -> Array:
    x, y, z, yaw = (column[:, None] for column in frames.T)
    c, s = np.cos(yaw), np.sin(yaw)
    px, py, pz = np.moveaxis(corners, 2, 0)
    return np.stack([x + c * px - s * py, y + s * px + c * py, z + pz], axis=2)


def _settle(graph: RigidGraph, frames: Array, model: Model) -> Settled:
    values = graph.values(frames)
    *wide, last = model.annealing
    for stage in wide:
        optimizer = gtsam.LevenbergMarquardtOptimizer(graph.factors(stage), values, _parameters(iterations=3))
        values = optimizer.optimize()
    factors = graph.factors(last)
    values = gtsam.LevenbergMarquardtOptimizer(factors, values, _parameters(iterations=100)).optimize()
    return Settled(graph.frames(values), factors.error(values), values)


def _parameters(iterations: int) -> gtsam.LevenbergMarquardtParams:
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(iterations)
    # In units of log likelihood: a step that gains a thousandth changes nothing that could be measured.
    parameters.setAbsoluteErrorTol(1e-3)
    parameters.setRelativeErrorTol(0.0)
    parameters.setlambdaInitial(1e-3)
    return parameters
