"""Mirror images of a local optimum: where else the frames may lie, and the optima there."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from synchronizar.arrays import Array
from synchronizar.estimation.comparing import held_surveyed
from synchronizar.estimation.mirror_images import height_mirrors, reflections
from synchronizar.graph.pose_graph import LocalOptimum
from synchronizar.graph.rigid_graph import RigidGraph
from synchronizar.graph.states import States

_MOST_IMAGES = 6  # of one optimum that are optimised
_ROUNDS = 2


def mirror_states(optimum: LocalOptimum, found: list[LocalOptimum]) -> Iterator[States]:
    """States at which mirror images of an optimum may explain the ranges as well, likeliest first.

    Users on one level leave the signs of heights open, users on a line the side of it. Heights that one of the optima
    `found` has are not tried again.
    """
    graph, states = optimum.graph, optimum.states
    rigid, nlos_odds = _rigid(optimum)
    parameters = graph.parameters
    flat = graph.to_rigid_ranges(states)
    range_weight = float(optimum.em_weights.range_weight.mean())
    here = rigid.cost(states.anchor_poses, nlos_odds)
    sigma = np.sqrt(rigid.covariances(states.anchor_poses, nlos_odds)[:, 2, 2] / range_weight)

    def above(frames: Array, most: float) -> float:
        return range_weight * (rigid.cost(frames, nlos_odds, here + most / range_weight) - here)

    heights = rigid.other_heights(
        states.anchor_poses, nlos_odds, parameters.integrity.cost_excluded_nlos / range_weight
    )
    heights += height_mirrors(flat, states.anchor_poses, graph.reference, held_surveyed(optimum))
    near, free = parameters.search.mirror_sigmas * sigma[graph.free], graph.free
    known = np.array([s.states.anchor_poses[free, 2] for s in (optimum, *found)])
    apart = [f for f in heights if (np.abs(f[free, 2] - known) > near).any(axis=1).all()]
    most = parameters.search.hopeless_cost
    images = [(cost, frames) for frames in apart if (cost := above(frames, most)) < most]
    most += parameters.search.mirror_cost_per_range * range_weight * len(flat)
    images += [
        (cost, frames)
        for frames in reflections(flat, states.anchor_poses, graph.reference, graph.problem.linked(flat))
        if (cost := above(frames, most)) < most
    ]
    likely = [frames for _, frames in sorted(images, key=lambda image: image[0])[:_MOST_IMAGES]]
    for n, frames in enumerate(likely):
        if not any(np.array_equal(frames, before, equal_nan=True) for before in likely[:n]):
            yield states._replace(anchor_poses=frames)


def images(optimum: LocalOptimum) -> list[LocalOptimum]:
    """Mirror images of an optimum with measured weights, which explain the ranges by the same heights as it does."""
    out: list[LocalOptimum] = []
    most = optimum.cost + optimum.graph.parameters.search.hopeless_cost
    for states in mirror_states(optimum, [optimum]):
        known = [other.frames for other in (optimum, *out)]
        image = optimum.graph.run_em(states, optimum.em_weights, _ROUNDS)
        if image.cost < most and not image.graph.is_known(image.states, known):
            out.append(image)
    return out


def _rigid(optimum: LocalOptimum) -> tuple[RigidGraph, Array]:
    """The graph in which the frames alone are free at these walks, and the NLOS odds (n,) of its ranges."""
    graph = optimum.graph
    if isinstance(graph, RigidGraph):
        return graph, optimum.em_weights.nlos_odds
    rigid = RigidGraph(graph.rigid_problem(optimum.states), np.zeros((len(graph.users), 3)))
    return rigid, rigid.measurements.nlos_odds
