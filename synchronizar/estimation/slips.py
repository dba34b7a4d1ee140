"""SLAM slips: starts in which pieces of a track are moved, and the slips found by the optimised states.

After a slip (a heading that turns by 100 degrees in seconds, a tracker that was lost) no single frame fits the whole
track, and at the local optimum half of the ranges are taken for NLOS. No single step shows it. So each device's frame
is searched again piece by piece, with the other users fixed. Pieces that fit much better elsewhere are moved there, and
the optimisation decides, by the heavy-tailed step noise, whether and where SLAM slipped.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from synchronizar._core import mixture_terms
from synchronizar.arrays import Array, Indices
from synchronizar.data.jump import Jump
from synchronizar.data.track import Track
from synchronizar.estimation.initialisation import Candidate, extend
from synchronizar.geometry import apply_frames, relative_to, wrap_angle
from synchronizar.graph.pose_graph import PoseGraph
from synchronizar.graph.priors import nlos_mixture
from synchronizar.graph.problem import Problem
from synchronizar.graph.states import CLOCK, SCALE, States, steps

_MOST_TRIED = 3


def relaid(graph: PoseGraph, states: States) -> Iterator[States]:
    """The states with pieces of one user's track moved to where they fit much better, largest gain first."""
    search = graph.parameters.search
    rigid = graph.rigid_problem(states).widened(search.sigma)
    moving = [u for u in graph.active_users if len(graph.keyframes[u]) > 1]
    moved = [_move_pieces(graph, states, rigid, user, pieces) for pieces in search.slip_pieces for user in moving]
    likely = sorted(((gain, elsewhere) for gain, elsewhere in moved if gain > 0.0), key=lambda m: -m[0])
    yield from (elsewhere for _, elsewhere in likely[:_MOST_TRIED])


def _move_pieces(graph: PoseGraph, states: States, rigid: Problem, user: int, pieces: int) -> tuple[float, States]:
    """The gain (log likelihood of ranges) by moving pieces of a user's track, and the states with these moved."""
    ranges, search = rigid.measurements, rigid.parameters.search
    mine = np.flatnonzero((ranges.i == user) | (ranges.j == user)).astype(np.int32)
    begin, end = ranges.t[mine].min(), ranges.t[mine].max()
    bounds = np.linspace(begin, end, pieces + 1)
    piece_frames, gained = np.tile(states.anchor_poses[user], (pieces, 1)), 0.0
    for piece in range(pieces):
        inside = mine[(ranges.t[mine] >= bounds[piece]) & (ranges.t[mine] <= bounds[piece + 1])]
        if len(inside) >= search.slip_least_ranges:
            gain, best = _best_frame(rigid.with_measurements(ranges[inside]), states.anchor_poses, user)
            if gain > search.slip_gain:
                piece_frames[piece], gained = best, gained + gain
    stamps = graph.keyframes[user].t - states.calibration[user, CLOCK]
    which = np.clip(np.searchsorted(bounds[1:-1], stamps), 0, pieces - 1).astype(np.int32)
    return gained, _with_moved_pieces(graph, states, user, piece_frames, which)


def _best_frame(rigid: Problem, frames: Array, user: int) -> tuple[float, Array]:
    """The frame (4,) that fits a user's ranges best, after its gain (log likelihood) over the present one.

    All other users are where frames (k, 4) have them.
    """
    others, moved = frames.copy(), frames.copy()
    others[user] = np.nan
    found = extend(rigid, [Candidate(others, 0.0)], user)
    if not found:
        return 0.0, frames[user]
    moved[user] = found[0].frames[user]
    return _cost(rigid, frames) - _cost(rigid, moved), moved[user]


def _cost(rigid: Problem, frames: Array) -> float:
    """Negative log likelihood of the ranges by themselves at frames (k, 4)."""
    measurements = rigid.measurements
    q_i, q_j = (
        apply_frames(frames[measurements.i], measurements.p_i),
        apply_frames(frames[measurements.j], measurements.p_j),
    )
    whitened = (np.linalg.norm(q_i - q_j, axis=1) - measurements.distance) / measurements.sigma
    loss = nlos_mixture(rigid.parameters)
    return float(mixture_terms(whitened, measurements.sigma, measurements.nlos_odds, loss)[0].sum())


def _with_moved_pieces(graph: PoseGraph, states: States, user: int, piece_frames: Array, which: Indices) -> States:
    """The states with each keyframe of a user at the frame `piece_frames` (pieces, 4) of its piece `which` (m,).

    The user's first keyframe stays fixed in the axes of the anchor, so the anchor moves with the first piece.
    """
    keyframe_poses, scale = states.keyframe_poses[user], float(np.exp(states.calibration[user, SCALE]))
    place = apply_frames(piece_frames[which], scale * keyframe_poses[:, :3])
    yaw = keyframe_poses[:, 3] + piece_frames[which, 3]

    frames = states.anchor_poses.copy()
    first = np.array([*place[0, :2], place[0, 2] - scale * keyframe_poses[0, 2], yaw[0] - keyframe_poses[0, 3]])
    frames[user] = first
    c, s = np.cos(first[3]), np.sin(first[3])
    dx, dy = (place[:, :2] - first[:2]).T
    about_anchor = np.column_stack([c * dx + s * dy, -s * dx + c * dy, place[:, 2] - first[2]]) / scale
    of_all = list(states.keyframe_poses)
    of_all[user] = np.column_stack([about_anchor, wrap_angle(yaw - first[3])])
    return states._replace(anchor_poses=relative_to(frames, graph.reference), keyframe_poses=of_all)


def slips(states: States, graph: PoseGraph, user: int, track: Track) -> tuple[Jump, ...]:
    """The slips of a user's SLAM: steps whose optimised error exceeds `slip_sigmas`, consecutive ones joined."""
    frames, keyframe_poses = graph.keyframes[user], states.keyframe_poses[user]
    errors = steps(keyframe_poses, frames)
    slipped = (errors**2).sum(axis=1) > graph.parameters.slam.slip_sigmas**2
    if not slipped.any():
        return ()
    begins = np.flatnonzero(slipped & ~np.concatenate([[False], slipped[:-1]]))
    ends = np.flatnonzero(slipped & ~np.concatenate([slipped[1:], [False]]))
    lengths = errors * frames.step_sigma[:, [0, 0, 1, 2]]
    out = []
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        x, y, z, turn = lengths[begin : end + 1].sum(axis=0)
        pose = int(np.searchsorted(track.t, frames.t[end + 1]))
        # SLAM's turn is the opposite of its correction.
        out.append(Jump(float(track.t[pose]), pose, float(np.hypot(np.hypot(x, y), z)), float(-turn), 0.0))
    return tuple(out)


def risen_by(states: States, graph: PoseGraph, user: int) -> float:
    """SLAM units: how far a user's SLAM slipped up or down in all."""
    frames = graph.keyframes[user]
    if len(frames.place) < 2:
        return 0.0
    errors = steps(states.keyframe_poses[user], frames)
    slipped = (errors**2).sum(axis=1) > graph.parameters.slam.slip_sigmas**2
    return float((errors[slipped, 2] * frames.step_sigma[slipped, 1]).sum())
