"""Where a device may have been all the while, should its SLAM have slipped: a start that no single step betrays.

A heading that slips by 100 degrees in seconds, or a tracker that was lost, leaves walks that no one frame can lay, and
a minimum in which half of the ranges pass for late. So each device is laid anew, piece by piece, beside where
the others are; pieces that fit much better elsewhere are moved there, and the graph decides, by its heavy-tailed steps,
whether and where SLAM slipped.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from synchronizar._core import mixture_terms
from synchronizar.arrays import Array, Indices
from synchronizar.data.jump import Jump
from synchronizar.data.track import Track
from synchronizar.estimation.initialisation import Candidate, extend
from synchronizar.geometry import apply_frames, relative_to, wrap_angle
from synchronizar.graph.pose_graph import PoseGraph
from synchronizar.graph.rigid_graph import nlos_mixture
from synchronizar.graph.states import CLOCK, SCALE, States, steps
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import RangeMeasurements

_MOST_TRIED = 3


def relaid(graph: PoseGraph, states: States, parameters: Parameters) -> Iterator[States]:
    """The same walks with pieces of one device's moved to where they fit much better, what gains most first."""
    flat = graph.to_rigid_ranges(states)
    wide = replace(flat, sigma=np.hypot(flat.sigma, parameters.search.sigma))
    moving = [u for u in graph.active_users if not graph.users[u].static]
    moved = [
        _moved(graph, states, wide, user, pieces, parameters)
        for pieces in parameters.search.slip_pieces
        for user in moving
    ]
    likely = sorted(((gain, elsewhere) for gain, elsewhere in moved if gain > 0.0), key=lambda m: -m[0])
    yield from (elsewhere for _, elsewhere in likely[:_MOST_TRIED])


def _moved(
    graph: PoseGraph, states: States, wide: RangeMeasurements, user: int, pieces: int, parameters: Parameters
) -> tuple[float, States]:
    """What moving some pieces of a user's walk gains (log likelihood, of ranges alone), and the walks then."""
    mine = np.flatnonzero((wide.i == user) | (wide.j == user)).astype(np.int32)
    begin, end = wide.t[mine].min(), wide.t[mine].max()
    bounds = np.linspace(begin, end, pieces + 1)
    laid, gained = np.tile(states.anchor_poses[user], (pieces, 1)), 0.0
    for piece in range(pieces):
        inside = mine[(wide.t[mine] >= bounds[piece]) & (wide.t[mine] <= bounds[piece + 1])]
        if len(inside) >= parameters.search.slip_least_ranges:
            gain, there = _best(graph, states, wide[inside], user, parameters)
            if gain > parameters.search.slip_gain:
                laid[piece], gained = there, gained + gain
    stamps = graph.keyframes[user].t - states.calibration[user, CLOCK]
    which = np.clip(np.searchsorted(bounds[1:-1], stamps), 0, pieces - 1).astype(np.int32)
    return gained, _with(graph, states, user, laid, which)


def _best(
    graph: PoseGraph, states: States, measurements: RangeMeasurements, user: int, parameters: Parameters
) -> tuple[float, Array]:
    """The frame (4,) by which a device's samples fit best, and what it gains against where the device is."""
    here = states.anchor_poses[user]
    others = states.anchor_poses.copy()
    others[user] = np.nan
    found = extend(measurements, [Candidate(others, 0.0)], graph.users, user, parameters)
    if not found:
        return 0.0, here
    there = found[0].frames[user]
    return _cost(states.anchor_poses, measurements, user, here, parameters) - _cost(
        states.anchor_poses, measurements, user, there, parameters
    ), there


def _cost(frames: Array, measurements: RangeMeasurements, user: int, frame: Array, parameters: Parameters) -> float:
    frames = frames.copy()
    frames[user] = frame
    q_i, q_j = (
        apply_frames(frames[measurements.i], measurements.p_i),
        apply_frames(frames[measurements.j], measurements.p_j),
    )
    whitened = (np.linalg.norm(q_i - q_j, axis=1) - measurements.distance) / measurements.sigma
    return float(mixture_terms(whitened, measurements.sigma, measurements.nlos_odds, nlos_mixture(parameters))[0].sum())


def _with(graph: PoseGraph, states: States, user: int, laid: Array, which: Indices) -> States:
    """The walks with each keyframe of a user laid by the frame (4,) of its piece; its first keyframe stays pinned."""
    keyframe_poses, scale = states.keyframe_poses[user], float(np.exp(states.calibration[user, SCALE]))
    place = apply_frames(laid[which], scale * keyframe_poses[:, :3])
    yaw = keyframe_poses[:, 3] + laid[which, 3]

    frames = states.anchor_poses.copy()
    first = np.array([*place[0, :2], place[0, 2] - scale * keyframe_poses[0, 2], yaw[0] - keyframe_poses[0, 3]])
    frames[user] = first
    c, s = np.cos(first[3]), np.sin(first[3])
    dx, dy = (place[:, :2] - first[:2]).T
    about = np.column_stack([c * dx + s * dy, -s * dx + c * dy, place[:, 2] - first[2]]) / scale
    of_all = list(states.keyframe_poses)
    of_all[user] = np.column_stack([about, wrap_angle(yaw - first[3])])
    return states._replace(anchor_poses=relative_to(frames, graph.reference), keyframe_poses=of_all)


def slips(states: States, graph: PoseGraph, user: int, track: Track) -> tuple[Jump, ...]:
    """Where a user's SLAM slipped: steps that the ranges did not believe, those that follow each other as one."""
    frames, keyframe_poses = graph.keyframes[user], states.keyframe_poses[user]
    away = steps(keyframe_poses, frames)
    slipped = (away**2).sum(axis=1) > graph.parameters.slam.slip_sigmas**2
    if not slipped.any():
        return ()
    begins = np.flatnonzero(slipped & ~np.concatenate([[False], slipped[:-1]]))
    ends = np.flatnonzero(slipped & ~np.concatenate([slipped[1:], [False]]))
    lengths = away * frames.step_sigma[:, [0, 0, 1, 2]]
    out = []
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        x, y, z, turn = lengths[begin : end + 1].sum(axis=0)
        pose = int(np.searchsorted(track.t, frames.t[end + 1]))
        # What SLAM did is the opposite of what had to be put right.
        out.append(Jump(float(track.t[pose]), pose, float(np.hypot(np.hypot(x, y), z)), float(-turn), 0.0))
    return tuple(out)
