"""The solver's optimisation in one call, for maximum likelihood from a start at the truth."""

from __future__ import annotations

import gtsam

from synchronizar.cooperative import finish
from synchronizar.graph.optimization import optimizing
from synchronizar.graph.range_factors import PoseCache


def optimize(
    factors: gtsam.NonlinearFactorGraph, start: gtsam.Values, ordering: gtsam.Ordering, iterations: int, gain: float
) -> gtsam.Values:
    """Values at a local minimum: at most so many steps, until one gains less than `gain` (negative log likelihood)."""
    return finish(optimizing(factors, start, ordering, iterations, gain, PoseCache()))
