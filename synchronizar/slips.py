"""Where a device may have been all the while, should its SLAM have slipped: a start that no single step betrays.

A heading that slips by 100 degrees in seconds, or a tracker that was lost, leaves walks that no one frame can lay, and a
minimum in which half of the ranges pass for late. So each device is laid anew, piece by piece of its walk, beside where
the others are; pieces that fit much better elsewhere are moved there, and the graph decides, by its heavy-tailed steps,
whether and where SLAM slipped.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from synchronizar._core import judge
from synchronizar.anchored import AnchoredGraph
from synchronizar.arrays import Array, Indices
from synchronizar.geometry import apply_frames, wrap_angle
from synchronizar.graph import late_loss
from synchronizar.initialise import Hypothesis, extend, relative_to
from synchronizar.model import Model
from synchronizar.samples import Samples
from synchronizar.walks import CLOCK, SCALE, Walks

_PIECES = (3, 6)  # of a walk
_FEWEST_RANGES = 20  # in a piece that is laid by itself
_GAIN = 15.0  # of log likelihood: what a piece must gain elsewhere


def relaid(graph: AnchoredGraph, walks: Walks, model: Model) -> Iterator[Walks]:
    """The same walks with pieces of one device's moved to where they fit much better."""
    flat = graph.flattened(walks)
    wide = replace(flat, sigma=np.hypot(flat.sigma, model.search_sigma))
    for pieces in _PIECES:
        for user in graph.placed:
            if not graph.users[user].static:
                moved = _moved(graph, walks, wide, user, pieces, model)
                if moved is not None:
                    yield moved


def _moved(graph: AnchoredGraph, walks: Walks, wide: Samples, user: int, pieces: int, model: Model) -> Walks | None:
    mine = np.flatnonzero((wide.i == user) | (wide.j == user)).astype(np.int32)
    begin, end = wide.t[mine].min(), wide.t[mine].max()
    bounds = np.linspace(begin, end, pieces + 1)
    laid = np.tile(walks.frames[user], (pieces, 1))
    for piece in range(pieces):
        inside = mine[(wide.t[mine] >= bounds[piece]) & (wide.t[mine] <= bounds[piece + 1])]
        if len(inside) >= _FEWEST_RANGES:
            laid[piece] = _better(graph, walks, wide[inside], user, model)
    if (laid == walks.frames[user]).all():
        return None
    stamps = graph.keyframes[user].t - walks.device[user, CLOCK]
    which = np.clip(np.searchsorted(bounds[1:-1], stamps), 0, pieces - 1).astype(np.int32)
    return _with(graph, walks, user, laid, which)


def _better(graph: AnchoredGraph, walks: Walks, samples: Samples, user: int, model: Model) -> Array:
    """The frame (4,) by which a device's samples fit best, if that is much better than where it is."""
    here = walks.frames[user]
    others = walks.frames.copy()
    others[user] = np.nan
    found = extend(samples, [Hypothesis(others, 0.0)], graph.users, user, model)
    if not found:
        return here
    there = found[0].frames[user]
    gain = _cost(walks.frames, samples, user, here, model) - _cost(walks.frames, samples, user, there, model)
    return np.asarray(there if gain > _GAIN else here)


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
