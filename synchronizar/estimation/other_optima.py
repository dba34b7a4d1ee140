"""Optima beside one with measured weights that a search may have left out: other heights, other places of one user."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from synchronizar.arrays import Array
from synchronizar.estimation.initialisation import Candidate, extend
from synchronizar.estimation.mirror_images import height_mirrors
from synchronizar.geometry import difference
from synchronizar.graph.em_weights import EmWeights
from synchronizar.graph.pose_graph import LocalOptimum, PoseGraph
from synchronizar.graph.states import SCALE, States

_FIRST_ROUNDS = 2
_ROUNDS = 8
_MOST_PLACES = 3  # of one user beside all the others that are optimised
_ELSEWHERE = 0.3  # m and rad: by so much they differ from where it is
_DRAWN_SIGMAS = (2.0, 4.0)  # of heights: from priors so many times as wide
_DRAWN_STEPS, _DRAWN_GAIN = 8, 0.1
_PINNED_STEPS = 3
_SAME_HEIGHT = 0.1  # m
_UNUSUAL = 2.0  # sigmas of usual heights
_SEED = 20  # a fixed draw: the same ranges give the same answer


def other_heights(optimum: LocalOptimum, begun: Sequence[Array] = ()) -> list[LocalOptimum]:
    """Optima beside one with measured weights that differ from it in heights; `begun` (k,) m are some found before.

    At given walks, scales and biases an optimum's own heights are often the only ones: these have taken up what other
    heights would explain. So SLAM's own heights begin anew, and a few steps are made with all that is free.
    """
    graph, states, em_weights = optimum.graph, optimum.states, optimum.em_weights
    begin = _with_slam_heights(optimum)
    found: list[LocalOptimum] = []
    known = [states.anchor_poses[graph.free, 2]]
    for frames in _begun_heights(optimum, begun):
        # A height far from the others' is one that the prior holds but loosely.
        near = graph.optimised(
            begin._replace(anchor_poses=frames), states.anchor_poses, em_weights, 1.0, _DRAWN_STEPS, _DRAWN_GAIN
        )
        heights = near.anchor_poses[graph.free, 2]
        if any(np.abs(heights - others).max() < _SAME_HEIGHT for others in known):
            continue
        known.append(heights)
        found.append(graph.run_em(near, em_weights, _FIRST_ROUNDS))
    return found


def is_at_other_heights(optimum: LocalOptimum, other: LocalOptimum) -> bool:
    """Whether mirror images of another optimum have not the heights of this one."""
    off = (optimum.states.anchor_poses - other.states.anchor_poses)[optimum.graph.free, 2]
    return bool((np.abs(off) > _SAME_HEIGHT).any())


def _with_slam_heights(optimum: LocalOptimum) -> States:
    """The states with the walks' own heights as SLAM has them."""
    walks = [
        np.column_stack([at[:, :2], of_user.place[:, 2], at[:, 3]])
        for at, of_user in zip(optimum.states.keyframe_poses, optimum.graph.keyframes, strict=True)
    ]
    return optimum.states._replace(keyframe_poses=walks)


def otherwise_held(optimum: LocalOptimum) -> Iterator[LocalOptimum]:
    """Optima beside one with measured weights in which one device is held as usual and is not in that, or the reverse.

    Each device that is held as usual is put as much higher, and lower, as others are. Where ranges exclude that, all
    else at its best, it is not looked at any further. Where it lies higher or lower than usual already it may be held
    otherwise just there: that it is half a metre lower excludes that it is a metre lower. All of whom that is so may be
    held otherwise at once: while the others are held as usual, none of them gains by it. Where it lies is asked of its
    walk's end, since what its height explains may have passed for a slip of its SLAM.
    """
    begin = _with_slam_heights(optimum)
    graph, frames = optimum.graph, optimum.states.anchor_poses
    level = graph.mean_height(frames, optimum.em_weights.height_weight)
    those = [u for u in graph.active_users if graph.other_height_sigma[u] > graph.height_sigma[u]]
    if len(those) <= 2 and graph.reference in those:  # which of the two it is makes no difference
        those.remove(graph.reference)
    at_last = frames[:, 2] + np.exp(optimum.states.calibration[:, SCALE]) * np.array(
        [
            own[-1, 2] - of_slam[-1, 2]
            for own, of_slam in zip(optimum.states.keyframe_poses, begin.keyframe_poses, strict=True)
        ]
    )
    far = np.abs(at_last - level) > _UNUSUAL * graph.height_sigma
    others = graph.held_as_usual & far & np.isin(np.arange(len(far)), those)
    if np.count_nonzero(others) > 1:
        held, heights = graph.with_held_as_usual(graph.held_as_usual & ~others), frames[:, 2].copy()
        heights[others] = at_last[others]
        near, weights = _begun_at(optimum, held, begin, heights)
        yield held.run_em(near, weights, _FIRST_ROUNDS)
    for u in those:
        usual = graph.held_as_usual.copy()
        usual[u] = not usual[u]
        held, sigma = graph.with_held_as_usual(usual), float(graph.other_height_sigma[u])
        moved = [v for v in those if v != u] if u == graph.reference else [u]
        here = (float(at_last[u]) - level,) if far[u] else ()
        known: list[LocalOptimum] = []
        for above in (0.0,) if usual[u] else (*here, sigma, -sigma):
            heights = frames[:, 2].copy()
            heights[u] = level + above
            near, weights = _begun_at(optimum, held, begin, heights)
            if abs(above) == sigma:
                pinned = held.with_pinned_heights(near.anchor_poses[:, 2], moved)
                near = pinned.optimised(near, frames, weights, 1.0, _PINNED_STEPS, _DRAWN_GAIN)
                if held.e_step(near, weights)[1] > optimum.cost + graph.parameters.integrity.cost_excluded_nlos:
                    continue
            other = held.run_em(near, weights, _FIRST_ROUNDS)
            if not any(np.abs(other.frames - one.frames)[graph.free, 2].max() < _SAME_HEIGHT for one in known):
                known.append(other)
        yield from known


def _begun_at(optimum: LocalOptimum, held: PoseGraph, begin: States, heights: Array) -> tuple[States, EmWeights]:
    """States to begin from with origins at heights (k,) m, and the optimum's weights as the graph `held` has them."""
    there = optimum.states.anchor_poses.copy()
    there[:, 2] = heights - heights[held.reference]
    height_weight, _ = held.height_weights(there)
    return begin._replace(anchor_poses=there), replace(optimum.em_weights, height_weight=height_weight)


def _begun_heights(optimum: LocalOptimum, begun: Sequence[Array]) -> Iterator[Array]:
    """Frames (k, 4) with other heights: those `begun`, static radios mirrored one by one, and draws, each both ways."""
    graph, frames = optimum.graph, optimum.states.anchor_poses
    for heights in begun:
        relative = heights - heights[graph.reference]
        if np.abs(relative - frames[:, 2])[graph.free].max() > _SAME_HEIGHT:
            yield np.column_stack([frames[:, :2], relative, frames[:, 3]])
    static = np.array([user.static for user in graph.users])
    surveyed = graph.problem.surveyed
    mirrored = height_mirrors(graph.to_rigid_ranges(optimum.states), frames, graph.reference, surveyed)
    for u in graph.free:
        if static[u] and not surveyed[u]:
            yield mirrored[graph.active_users.index(u)]
    if static[graph.free].all():
        return
    random = np.random.default_rng(_SEED)
    for sigmas in _DRAWN_SIGMAS:
        drawn = sigmas * graph.height_sigma * random.standard_normal(len(static))
        level = 0.0
        if surveyed.any():  # a survey's zero is where it is, and so is the level of all who move
            drawn[graph.reference], level = 0.0, graph.mean_height(frames, optimum.em_weights.height_weight)
        for heights in (drawn, -drawn):
            out = frames.copy()
            out[:, 2] = np.where(static, frames[:, 2], level + heights) - heights[graph.reference]
            yield out


def other_places(optimum: LocalOptimum) -> list[LocalOptimum]:
    """Optima beside one with measured weights in which one user is somewhere else.

    Among NLOS ranges the search, with wide sigmas and SLAM's own walks, may have left out where one of them is. Each is
    looked for anew beside all the others, as these are at the optimum.
    """
    graph, states, em_weights = optimum.graph, optimum.states, optimum.em_weights
    begin = replace(em_weights, nlos_odds=graph.measurements.nlos_odds)
    rigid = graph.rigid_problem(states)
    found: list[LocalOptimum] = []
    known = [optimum.frames]
    for user in graph.free:
        others = states.anchor_poses.copy()
        others[user] = np.nan
        for candidate in extend(rigid, [Candidate(others, 0.0)], user)[:_MOST_PLACES]:
            off = difference(candidate.frames[user], states.anchor_poses[user])
            if np.linalg.norm(off[:3]) < _ELSEWHERE and abs(off[3]) < _ELSEWHERE:
                continue
            near = graph.run_em(states._replace(anchor_poses=candidate.frames), begin, _FIRST_ROUNDS)
            if near.cost > optimum.cost + graph.parameters.search.hopeless_cost or near.graph.is_known(
                near.states, known
            ):
                continue
            other = near.graph.run_em(near.states, near.em_weights, _ROUNDS, known=known)
            known.append(other.frames)
            if other.cost < optimum.cost + graph.parameters.integrity.cost_excluded_nlos:
                found.append(other)
    return found
