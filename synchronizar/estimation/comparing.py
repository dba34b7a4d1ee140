"""How local optima compare: their cost, how many ranges they leave unexplained, and which their cost excludes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.geometry import difference
from synchronizar.graph.pose_graph import LocalOptimum
from synchronizar.graph.priors import calibration_sigmas
from synchronizar.graph.states import BIAS

BETTER = 1.0
"""Log likelihood: a smaller difference does not rank two optima."""
_MOST_COMPARED = 6  # optima: the others cost more than these
_ROUNDS = 2


def by_cost(optimum: LocalOptimum) -> float:
    """Sort key, best first."""
    return optimum.cost


def nlos_share(optimum: LocalOptimum) -> float:
    """The share of ranges that are more likely NLOS, or outliers, than inliers."""
    _, inlier_probability = optimum.graph.inlier_probability(optimum.states, optimum.em_weights)
    return float((inlier_probability < 0.5).mean()) if len(inlier_probability) else 0.0


def held_surveyed(optimum: LocalOptimum) -> Mask:
    """(k,) surveyed radios whose entries the ranges do not contradict, neither by places nor by biases instead."""
    graph = optimum.graph
    off = np.linalg.norm(optimum.states.anchor_poses[:, :3] - graph.problem.survey, axis=1)
    limits = graph.parameters.integrity
    least = np.maximum(limits.survey_contradicted, limits.height_contradicted * graph.survey_sigma)
    own, common = calibration_sigmas(graph.parameters)
    bias = np.abs(optimum.states.calibration[:, BIAS]) / np.hypot(own, common)[BIAS]
    return np.asarray(graph.problem.surveyed & (off < least) & (bias < limits.height_contradicted))


def compare(
    found: list[LocalOptimum], best: LocalOptimum, others_in_height: Sequence[LocalOptimum] = ()
) -> list[LocalOptimum]:
    """The optima that explain the ranges: the refined `best`, then those of the others not excluded by their cost.

    `best` is `found[0]` refined. Costs are compared at the keyframes of `found`, with the range weights measured at the
    best one.
    """
    if len(found) == 1 and not others_in_height:
        return [best]
    likely = [s for s in found if s.cost < found[0].cost + best.graph.parameters.search.hopeless_cost][:_MOST_COMPARED]
    compared = []
    for s in (*likely, *others_in_height):
        em_weights = replace(s.em_weights, range_weight=best.em_weights.range_weight)
        compared.append(s.graph.with_sigma_of(best.graph).run_em(s.states, em_weights, _ROUNDS))
    first, *others = compared
    return [best._replace(cost=first.cost), *sorted(not_excluded(first, others), key=by_cost)]


def not_excluded(best: LocalOptimum, others: Sequence[LocalOptimum]) -> list[LocalOptimum]:
    """Those of the others, of the same ranges and range weights as the best one, that their cost does not exclude.

    Where people walk straight lines, ranges do not distinguish a placement from its mirror image: what drift has bent
    favours one or the other, as the ranges' noise will have it. The difference of the two costs is then normal about 0,
    with the norm of the difference of their whitened residuals e as standard deviation: a cost's derivative by the
    ranges' noise is -e (envelope theorem). An optimum is excluded where the difference is no such chance. Of optima
    that differ in heights alone no walk is a mirror image, and the evidence decides.
    """
    limits = best.graph.parameters.integrity
    nlos = nlos_share(best) > best.graph.parameters.search.doubtful_share
    least = limits.cost_excluded_nlos if nlos else limits.cost_excluded
    own = _scores(best)
    root = np.sqrt(best.em_weights.range_weight)
    by_chance = [float(np.linalg.norm(root * (_scores(s) - own))) for s in others]
    here, out = best.frames, []
    for s, sigma in zip(others, by_chance, strict=True):
        off = np.abs(difference(s.frames, here))
        level = np.nanmax(np.hypot(off[:, 0], off[:, 1])) < limits.largest_error
        level = level and np.nanmax(off[:, 3]) < limits.largest_yaw_error
        if s.cost - best.cost <= (limits.cost_excluded if level else max(least, limits.cost_excluded_sigmas * sigma)):
            out.append(s)
    return out


def _scores(optimum: LocalOptimum) -> Array:
    """(n,) derivative of the cost of each range, at weight 1, by its whitened residual."""
    graph = optimum.graph
    weight, _ = graph.inlier_probability(optimum.states, optimum.em_weights)
    return weight * graph.residuals(optimum.states) / graph.sigma
