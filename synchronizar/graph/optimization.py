"""Gauss-Newton with line search on gtsam graphs.

gtsam's own optimisers copy their Values for every call of a CustomFactor: with n keyframes a step costs n^2. When the
graph is linearised from Python, the factors see the Values that Python holds, and none is copied.
"""

from __future__ import annotations

import gtsam
import numpy as np

from synchronizar.arrays import Array
from synchronizar.cooperative import Cooperative
from synchronizar.graph import keys
from synchronizar.graph.range_factors import PoseCache

_SUFFICIENT = 1e-4  # of the gain that the linear model predicts (Armijo's condition)
_SHORTER = 0.4  # factor on the step length at each attempt
_SHORTEST = 1e-3  # of the full step


def optimizing(
    factors: gtsam.NonlinearFactorGraph,
    start: gtsam.Values,
    ordering: gtsam.Ordering,
    iterations: int,
    gain: float,
    pose_cache: PoseCache,
) -> Cooperative[gtsam.Values]:
    """Values at a local minimum of the cost, by Gauss-Newton with a backtracking line search.

    Stops after `iterations` steps, or when a step gains less than `gain` (negative log likelihood). Range blocks are
    positive semidefinite models with the exact gradient, so every step starts downhill. `pose_cache` is the one that
    the factors share. A cooperative task: it yields about once per evaluation of all factors.
    """
    pose_cache.hold(start)
    try:
        return (yield from _optimizing(factors, start, ordering, iterations, gain, pose_cache))
    finally:
        pose_cache.hold(None)


def _optimizing(
    factors: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    ordering: gtsam.Ordering,
    iterations: int,
    gain: float,
    pose_cache: PoseCache,
) -> Cooperative[gtsam.Values]:
    cost = factors.error(values)
    for _ in range(iterations):
        yield
        pose_cache.hold(values)
        linear = factors.linearize(values)
        yield
        try:
            step = linear.optimize(ordering)
        except RuntimeError:  # singular: the covariance will show it
            return values
        predicted = linear.error(gtsam.VectorValues.Zero(step)) - linear.error(step)
        if predicted < gain:
            break
        length = 1.0
        while True:
            candidate = values.retract(step if length == 1.0 else step.scale(length))
            pose_cache.hold(candidate)
            candidate_cost = factors.error(candidate)
            if cost - candidate_cost > _SUFFICIENT * length * predicted:
                break
            length *= _SHORTER
            if length < _SHORTEST:
                return values
            yield
        gained = cost - candidate_cost
        values, cost = candidate, candidate_cost
        if gained < gain:
            break
    return values


def reduced(linear: gtsam.GaussianFactorGraph, others: list[int], kept: list[int]) -> Array:
    """The Jacobian of a linear system by the `kept` keys, with the `others` eliminated.

    Raises RuntimeError where the system is too near to singular for gtsam's Cholesky.
    """
    if others:
        _, linear = linear.eliminatePartialSequential(keys.ordering(others))
    jacobian, _ = linear.jacobian(keys.ordering(kept))
    return np.asarray(jacobian)
