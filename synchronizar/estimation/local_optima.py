"""Minima of an anchored graph: those that the search's placements lead to, and their mirror images."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.estimation.hypotheses import SAME
from synchronizar.estimation.mirror_images import height_mirrors, reflections
from synchronizar.estimation.slips import relaid
from synchronizar.geometry import difference
from synchronizar.graph.pose_graph import EmWeights, PoseGraph
from synchronizar.graph.rigid_graph import RigidGraph, blocks_of
from synchronizar.graph.states import States, interpolated
from synchronizar.parameters import Parameters

_ANNEALING = (4.0, 2.0)
_FIRST_ROUNDS = 2
_ROUNDS = 8
_MEASURING_ROUNDS = (4, 2)
_REFINING_ROUNDS = 4
_MOST_IMAGES = 6  # that are followed of one minimum
_MOST_COMPARED = 6
BETTER = 1.0  # of log likelihood: less does not tell two minima apart


class LocalOptimum(NamedTuple):
    """A minimum of an anchored graph."""

    graph: PoseGraph
    states: States
    em_weights: EmWeights
    cost: float
    """Negative log likelihood, up to a constant that all minima of the same samples and worth share."""

    @property
    def frames(self) -> Array:
        """(k, 4) x, y, z, yaw: where each user's last keyframe is, and how SLAM's axes lie there."""
        return self.graph.last_poses(self.states)


def by_cost(optimum: LocalOptimum) -> float:
    """For sorting: best first."""
    return optimum.cost


def find_optima(graph: PoseGraph, starts: list[States], parameters: Parameters) -> list[LocalOptimum]:
    """The minima that some walks and their mirror images lead to, best first."""
    found: list[LocalOptimum] = []
    for states in starts:
        _follow(graph, states, found, _ANNEALING)
    best = min(found, key=by_cost)
    while graph.free:
        for states in chain(relaid(graph, best.states, parameters), _images(best, parameters)):
            _follow(graph, states, found, ())
        better = min(found, key=by_cost)
        if better.cost > best.cost - BETTER:
            break
        best = better  # and may have images of its own
    return sorted(found, key=by_cost)


def approach(graph: PoseGraph, states: States, annealing: float) -> LocalOptimum:
    """Walks that have come near to a minimum: enough to go on from."""
    states, em_weights, _ = graph.run_em(states, _undecided(graph.initial_em_weights()), _FIRST_ROUNDS, annealing)
    return LocalOptimum(graph, *graph.run_em(states, em_weights, _FIRST_ROUNDS))


def _follow(graph: PoseGraph, states: States, found: list[LocalOptimum], annealing: tuple[float, ...]) -> None:
    """Add the minimum that some walks lead to, unless it is known."""
    em_weights = _undecided(graph.initial_em_weights())
    for wide in annealing:
        states, em_weights, _ = graph.run_em(states, em_weights, 3, wide)
    optimum = LocalOptimum(graph, *graph.run_em(states, em_weights, _FIRST_ROUNDS))
    if found and optimum.cost > min(found, key=by_cost).cost + graph.parameters.search.hopeless_cost:
        return
    optimum = LocalOptimum(graph, *graph.run_em(optimum.states, optimum.em_weights, _ROUNDS))
    frames = optimum.frames
    if not any(np.nanmax(np.abs(difference(frames, known.frames))) < SAME for known in found):
        found.append(optimum)


def _undecided(em_weights: EmWeights) -> EmWeights:
    """Ranges worth the geometric mean of what they are by themselves and at worst: which of both holds shows later.

    With the least of it, half a walk of ranges that pass for late would be cheaper than one slip of SLAM.
    """
    return replace(em_weights, range_weight=np.sqrt(em_weights.range_weight))


def _images(optimum: LocalOptimum, parameters: Parameters) -> Iterator[States]:
    """Walks that might explain the ranges as well, likeliest first: what levels and lines cannot tell apart."""
    graph, states = optimum.graph, optimum.states
    flat = graph.to_rigid_ranges(states)
    rigid = RigidGraph(blocks_of(flat), graph.users, graph.active_users, graph.reference, parameters).about(
        states.anchor_poses
    )
    range_weight = float(optimum.em_weights.range_weight.mean())
    values = rigid.values(states.anchor_poses)
    sigma = np.sqrt(rigid.covariances(values)[:, 2, 2] / range_weight)

    def above(frames: Array) -> float:
        return range_weight * (rigid.cost(rigid.values(frames)) - rigid.cost(values))

    heights = rigid.other_heights(states.anchor_poses, parameters.integrity.cost_excluded_nlos / range_weight)
    heights += height_mirrors(flat, states.anchor_poses, graph.reference)
    apart = [
        f
        for f in heights
        if (np.abs(f[:, 2] - states.anchor_poses[:, 2]) > parameters.search.mirror_sigmas * sigma)[graph.free].any()
    ]
    images = [(cost, frames) for frames in apart if (cost := above(frames)) < parameters.search.hopeless_cost]
    most = parameters.search.hopeless_cost + parameters.search.mirror_cost_per_range * range_weight * len(flat)
    images += [
        (cost, frames)
        for frames in reflections(flat, states.anchor_poses, graph.reference)
        if (cost := above(frames)) < most
    ]
    for _, frames in sorted(images, key=lambda image: image[0])[:_MOST_IMAGES]:
        yield states._replace(anchor_poses=frames)


def with_measured_weights(coarse: LocalOptimum) -> LocalOptimum:
    """The same minimum, what ranges are worth measured on what is left of them."""
    graph = coarse.graph
    states, em_weights = coarse.states, coarse.em_weights
    for rounds in _MEASURING_ROUNDS:
        states, em_weights, cost = graph.run_em(states, graph.with_range_weights(states, em_weights), rounds)
    return LocalOptimum(graph, states, em_weights, cost)


def refine(coarse: LocalOptimum, graph: PoseGraph) -> LocalOptimum:
    """The same placement at the keyframes of another graph."""
    states, em_weights, _ = coarse.graph.run_em(coarse.states, coarse.em_weights, _REFINING_ROUNDS)
    states = interpolated(states, coarse.graph.keyframes, graph.keyframes)
    first = replace(graph.initial_em_weights(), range_weight=em_weights.range_weight)
    states, em_weights, _ = graph.run_em(states, first, _REFINING_ROUNDS)
    return LocalOptimum(graph, *graph.run_em(states, graph.with_range_weights(states, em_weights), _REFINING_ROUNDS))


def compare(found: list[LocalOptimum], best: LocalOptimum, parameters: Parameters) -> list[LocalOptimum]:
    """The best of them as it is refined, then those others that explain the ranges too, likeliest first.

    All costs are those that the minima found have with ranges worth what the best one's residuals say.
    """
    if len(found) == 1:
        return [best]
    likely = [s for s in found if s.cost < found[0].cost + parameters.search.hopeless_cost][:_MOST_COMPARED]
    compared = []
    for s in likely:
        em_weights = replace(s.em_weights, range_weight=best.em_weights.range_weight)
        compared.append(LocalOptimum(s.graph, *s.graph.run_em(s.states, em_weights, _FIRST_ROUNDS)))
    _, inlier_probability = best.graph.inlier_probability(best.states, best.em_weights)
    late = len(inlier_probability) > 0 and float((inlier_probability < 0.5).mean()) > parameters.search.doubtful_share
    # What drift bends a straight walk by speaks for it or for its mirror image by chance: the sum of a term for each
    # device whose SLAM may drift, which grows with the root of how many there are.
    drifting = max(sum(len(k.step_sigma) > 0 for k in best.graph.keyframes), 1)
    excluded = max(
        parameters.integrity.cost_excluded_nlos if late else 0.0, parameters.integrity.cost_excluded * np.sqrt(drifting)
    )
    first, *others = compared
    others = [s for s in others if s.cost <= first.cost + excluded]
    return [best._replace(cost=first.cost), *sorted(others, key=by_cost)]
