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

from synchronizar._core import judge
from synchronizar.arrays import Array, Indices
from synchronizar.data.jump import Jump
from synchronizar.data.track import Track
from synchronizar.estimation.initialisation import Hypothesis, extend
from synchronizar.geometry import apply_frames, relative_to, wrap_angle
from synchronizar.graph.pose_graph import AnchoredGraph
from synchronizar.graph.rigid_graph import late_loss
from synchronizar.graph.states import CLOCK, SCALE, Walks, steps
from synchronizar.parameters import Model
from synchronizar.preprocessing.range_measurements import Samples

_PIECES = (3, 6)  # of a walk
_FEWEST_RANGES = 20  # in a piece that is laid by itself
_GAIN = 15.0  # of log likelihood: what a piece must gain elsewhere
_MOST_TRIED = 3
_SLIPPED = 5.0  # sigmas of a step


def relaid(graph: AnchoredGraph, walks: Walks, model: Model) -> Iterator[Walks]:
    """The same walks with pieces of one device's moved to where they fit much better, what gains most first."""
    flat = graph.flattened(walks)
    wide = replace(flat, sigma=np.hypot(flat.sigma, model.search_sigma))
    moving = [u for u in graph.placed if not graph.users[u].static]
    moved = [_moved(graph, walks, wide, user, pieces, model) for pieces in _PIECES for user in moving]
    likely = sorted(((gain, elsewhere) for gain, elsewhere in moved if gain > 0.0), key=lambda m: -m[0])
    yield from (elsewhere for _, elsewhere in likely[:_MOST_TRIED])


def _moved(
    graph: AnchoredGraph, walks: Walks, wide: Samples, user: int, pieces: int, model: Model
) -> tuple[float, Walks]:
    """What moving some pieces of a user's walk gains (log likelihood, of ranges alone), and the walks then."""
    mine = np.flatnonzero((wide.i == user) | (wide.j == user)).astype(np.int32)
    begin, end = wide.t[mine].min(), wide.t[mine].max()
    bounds = np.linspace(begin, end, pieces + 1)
    laid, gained = np.tile(walks.frames[user], (pieces, 1)), 0.0
    for piece in range(pieces):
        inside = mine[(wide.t[mine] >= bounds[piece]) & (wide.t[mine] <= bounds[piece + 1])]
        if len(inside) >= _FEWEST_RANGES:
            gain, there = _best(graph, walks, wide[inside], user, model)
            if gain > _GAIN:
                laid[piece], gained = there, gained + gain
    stamps = graph.keyframes[user].t - walks.device[user, CLOCK]
    which = np.clip(np.searchsorted(bounds[1:-1], stamps), 0, pieces - 1).astype(np.int32)
    return gained, _with(graph, walks, user, laid, which)


def _best(graph: AnchoredGraph, walks: Walks, samples: Samples, user: int, model: Model) -> tuple[float, Array]:
    """The frame (4,) by which a device's samples fit best, and what it gains against where the device is."""
    here = walks.frames[user]
    others = walks.frames.copy()
    others[user] = np.nan
    found = extend(samples, [Hypothesis(others, 0.0)], graph.users, user, model)
    if not found:
        return 0.0, here
    there = found[0].frames[user]
    return _cost(walks.frames, samples, user, here, model) - _cost(walks.frames, samples, user, there, model), there


def _cost(frames: Array, samples: Samples, user: int, frame: Array, model: Model) -> float:
    frames = frames.copy()
    frames[user] = frame
    q_i, q_j = apply_frames(frames[samples.i], samples.p_i), apply_frames(frames[samples.j], samples.p_j)
    whitened = (np.linalg.norm(q_i - q_j, axis=1) - samples.distance) / samples.sigma
    return float(judge(whitened, samples.sigma, samples.late_odds, late_loss(model))[0].sum())


def _with(graph: AnchoredGraph, walks: Walks, user: int, laid: Array, which: Indices) -> Walks:
    """The walks with each keyframe of a user laid by the frame (4,) of its piece; its first keyframe stays pinned."""
    local, scale = walks.local[user], float(np.exp(walks.device[user, SCALE]))
    place = apply_frames(laid[which], scale * local[:, :3])
    yaw = local[:, 3] + laid[which, 3]

    frames = walks.frames.copy()
    first = np.array([*place[0, :2], place[0, 2] - scale * local[0, 2], yaw[0] - local[0, 3]])
    frames[user] = first
    c, s = np.cos(first[3]), np.sin(first[3])
    dx, dy = (place[:, :2] - first[:2]).T
    about = np.column_stack([c * dx + s * dy, -s * dx + c * dy, place[:, 2] - first[2]]) / scale
    of_all = list(walks.local)
    of_all[user] = np.column_stack([about, wrap_angle(yaw - first[3])])
    return walks._replace(frames=relative_to(frames, graph.reference), local=of_all)


def slips(walks: Walks, graph: AnchoredGraph, user: int, track: Track) -> tuple[Jump, ...]:
    """Where a user's SLAM slipped: steps that the ranges did not believe, those that follow each other as one."""
    frames, local = graph.keyframes[user], walks.local[user]
    away = steps(local, frames)
    slipped = (away**2).sum(axis=1) > _SLIPPED**2
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
