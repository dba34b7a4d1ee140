"""Noise of each device's SLAM steps, estimated from the ranges by expectation maximisation.

Shumway and Stoffer (J. Time Series Analysis 3, 1982): the expected square of a step's error is the square at the most
likely states plus its posterior variance, in the graph linearised at some states. Steps are Gaussian here, and slips
are left out; with the graph's weights of Student's t, ordinary steps would get too small a noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.graph.pose_graph import EmWeights, PoseGraph
from synchronizar.graph.states import States, steps
from synchronizar.graph.walks import Walks

PLACE, HEADING = range(2)
"""Columns of the noise."""

_ROUNDS = 10
_MOST_KEYFRAMES = 400  # of a longer walk only the middle is used


def step_noise(
    graph: PoseGraph, states: States, em_weights: EmWeights, before: Array, weight: float, rounds: int = _ROUNDS
) -> Array:
    """(k, 2): factor on each user's step sigmas in position and heading, relative to `parameters.slam`.

    `before` (k, 2) are those that the graph's keyframes have. 1 where ranges carry no information on it: the prior
    counts as `weight` steps with factor 1.
    """
    out = np.ones((len(graph.users), 2))
    if not len(graph.measurements):
        return before
    walks, weights, counted = graph.walks, list(em_weights.step_weight), []
    for u in walks.users:
        ordinary = _ordinary(graph, states, u)
        weights[u] = np.where(ordinary, 1.0, weights[u])
        counted += [False, *ordinary.tolist()]
    out[walks.users] = walks.solver.step_noise(
        walks.places(states),
        states.calibration[walks.users],
        graph.walk_noise(states.anchor_poses, replace(em_weights, step_weight=weights)),
        graph.loss,
        _middle(graph, walks),
        np.array(counted),
        weight,
        1.0 / before[walks.users],
        rounds,
    )
    return before * out


def _ordinary(graph: PoseGraph, states: States, user: int) -> Array:
    """(m - 1,) whether a step is SLAM's own: neither rebuilt nor a slip."""
    frames = graph.keyframes[user]
    squared_error = (steps(states.keyframe_poses[user], frames) ** 2).sum(axis=1)
    return np.asarray(~frames.rebuilt & (squared_error < graph.parameters.slam.slip_sigmas**2))


def _middle(graph: PoseGraph, walks: Walks) -> Mask:
    """(m,) the middle `_MOST_KEYFRAMES` keyframes by time, and the only one of whoever has one."""
    t = np.concatenate([graph.keyframes[u].t for u in walks.users])
    alone = np.repeat(np.diff(walks.first) == 1, np.diff(walks.first))
    by_time = np.sort(t[~alone])
    excess = max(len(by_time) - _MOST_KEYFRAMES, 0)
    if not excess:
        return np.ones(len(t), dtype=bool)
    begin, end = by_time[excess // 2], by_time[excess // 2 + _MOST_KEYFRAMES - 1]
    return np.asarray(alone | ((t >= begin) & (t <= end)))
