"""Gauss-Newton on gtsam's graphs.

gtsam's own optimisers hand a CustomFactor their own Values, which are copied for every single call: with n keyframes
a step costs n^2. Linearised from here, the factors see the Values that Python holds.
"""

from __future__ import annotations

import gtsam
import numpy as np

from synchronizar.arrays import Array
from synchronizar.cooperative import Cooperative, finish
from synchronizar.graph import keys
from synchronizar.graph.range_factors import PoseCache

Values = gtsam.Values

_SUFFICIENT = 1e-4  # of the gain that the linear model promises (Armijo)
_SHORTER = 0.4
_SHORTEST = 1e-3


def optimize(
    factors: gtsam.NonlinearFactorGraph,
    start: gtsam.Values,
    ordering: gtsam.Ordering,
    iterations: int,
    gain: float,
    pose_cache: PoseCache | None = None,
) -> gtsam.Values:
    """A minimum: full steps, or as much of them as lowers the cost; until a step gains less than `gain`.

    Our blocks are positive semidefinite models with the exact gradient, so a step never leads uphill at first.
    `pose_cache` is what the factors share.
    """
    return finish(optimizing(factors, start, ordering, iterations, gain, pose_cache or PoseCache()))


def optimizing(
    factors: gtsam.NonlinearFactorGraph,
    start: gtsam.Values,
    ordering: gtsam.Ordering,
    iterations: int,
    gain: float,
    pose_cache: PoseCache,
) -> Cooperative[gtsam.Values]:
    """`optimize` in portions, each as long as one look at all factors."""
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
        except RuntimeError:  # no step is told from another: where it leads is for the covariance to say
            return values
        promised = linear.error(gtsam.VectorValues.Zero(step)) - linear.error(step)
        if promised < gain:
            break
        length = 1.0
        while True:
            tried = values.retract(step if length == 1.0 else step.scale(length))
            pose_cache.hold(tried)
            tried_cost = factors.error(tried)
            if cost - tried_cost > _SUFFICIENT * length * promised:
                break
            length *= _SHORTER
            if length < _SHORTEST:
                return values
            yield
        gained = cost - tried_cost
        values, cost = tried, tried_cost
        if gained < gain:
            break
    return values


def reduced(linear: gtsam.GaussianFactorGraph, others: list[int], kept: list[int]) -> Array:
    """The Jacobian by the keys that are kept of a linear system, the others eliminated.

    Raises RuntimeError, as gtsam does, where that is too near to singular for its Cholesky.
    """
    if others:
        _, linear = linear.eliminatePartialSequential(keys.ordering(others))
    jacobian, _ = linear.jacobian(keys.ordering(kept))
    return np.asarray(jacobian)


def levenberg_marquardt(
    factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, iterations: int, gain: float
) -> gtsam.Values:
    """Gtsam's own optimiser, until a step gains less than `gain`."""
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(iterations)
    parameters.setAbsoluteErrorTol(gain)
    parameters.setRelativeErrorTol(0.0)
    parameters.setlambdaInitial(1e-3)
    return gtsam.LevenbergMarquardtOptimizer(factors, values, parameters).optimize()
