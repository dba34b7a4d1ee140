"""Mirror images of a solution: frames that ranges cannot distinguish where users walk on lines or on one level.

Each is only a start for the optimisation; the cost of the optimum decides whether it explains the ranges.
"""

from __future__ import annotations

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.geometry import apply_frames
from synchronizar.graph.problem import ranging, reached_from
from synchronizar.preprocessing.range_measurements import RangeMeasurements, pair_bounds


def height_mirrors(
    measurements: RangeMeasurements, frames: Array, reference: int, fixed: Mask | None = None
) -> list[Array]:
    """Frames (k, 4) with one user's height mirrored at the mean height of those it ranges to, or all heights at 0.

    `fixed` (k,) are users who stay where they are.
    """
    heights = frames[:, 2]
    above = heights[measurements.i] + measurements.p_i[:, 2] - heights[measurements.j] - measurements.p_j[:, 2]
    active_users = np.flatnonzero(~np.isnan(heights))
    k = len(heights)
    count = np.bincount(measurements.i, minlength=k) + np.bincount(measurements.j, minlength=k)
    sums = np.bincount(measurements.i, above, k) - np.bincount(measurements.j, above, k)
    shifts = np.zeros((len(active_users) + 1, k))
    shifts[-1] = -2.0 * heights
    shifts[np.arange(len(active_users)), active_users] = (-2.0 * sums / np.maximum(count, 1))[active_users]
    shifts -= shifts[:, [reference]]
    if fixed is not None:
        shifts[:, fixed] = 0.0
    return [np.column_stack([frames[:, :2], heights + s, frames[:, 3]]) for s in shifts]


def reflections(
    measurements: RangeMeasurements, frames: Array, reference: int, linked: list[set[int]] | None = None
) -> list[Array]:
    """Frames (k, 4) with the users that are connected through one user only reflected in that user's line.

    Ranges to a user that walks a line do not distinguish the two sides of it. Each set of users that is connected to
    the rest only through this pivot can be reflected by itself. A rotation cannot mirror a frame: a reflected user's
    frame is turned so that its own principal axis is mirrored, which is exact only as far as it walks a line too.
    `linked`: whom each user is tied to; None: whom it ranges to.
    """
    out: list[Array] = []
    active_users = np.flatnonzero(~np.isnan(frames[:, 0])).tolist()
    linked = ranging(measurements, len(frames)) if linked is None else linked
    own = _own_lines(measurements, len(frames))
    for pivot in active_users:
        remaining = set(active_users) - {pivot}
        while remaining:
            part = reached_from(min(remaining), linked, without=pivot)
            remaining -= part
            moved = part if reference not in part else set(active_users) - part - {pivot}
            if moved:
                reflected = frames.copy()
                who = sorted(moved)
                reflected[who] = _reflected(frames[who], own[who], _in_common(frames[[pivot]], own[[pivot]])[0])
                out.append(reflected)
    return out


def _own_lines(measurements: RangeMeasurements, users: int) -> Array:
    """(k, 3): centroid (m) of each user's positions in its own frame, and angle (rad) of their principal axis."""
    bounds = pair_bounds(measurements)
    i, j = measurements.i[bounds[:-1]], measurements.j[bounds[:-1]]
    # Sums of x, y, x^2, x y and y^2, by pair and then by user.
    moments = np.zeros((users, 6))
    for of_pair, p in ((i, measurements.p_i), (j, measurements.p_j)):
        x, y = p[:, 0], p[:, 1]
        sums = np.add.reduceat(np.stack([np.ones(len(x)), x, y, x * x, x * y, y * y]), bounds[:-1], axis=1)
        np.add.at(moments, of_pair, sums.T)
    count = np.maximum(moments[:, 0], 1.0)
    x, y = moments[:, 1] / count, moments[:, 2] / count
    xx, xy, yy = moments[:, 3] - count * x * x, moments[:, 4] - count * x * y, moments[:, 5] - count * y * y
    return np.column_stack([x, y, 0.5 * np.arctan2(2.0 * xy, xx - yy)])


def _in_common(frames: Array, lines: Array) -> Array:
    """(n, 3): lines (n, 3) of the users' own frames (n, 4) in the common one."""
    out = lines.copy()
    out[:, :2] = apply_frames(frames, np.column_stack([lines[:, :2], np.zeros(len(lines))]))[:, :2]
    out[:, 2] += frames[:, 3]
    return out


def _reflected(frames: Array, own: Array, line: Array) -> Array:
    """Frames (n, 4) of users with own lines (n, 3), reflected in a line (3,) of the common frame."""
    its = _in_common(frames, own)
    c2, s2 = np.cos(2.0 * line[2]), np.sin(2.0 * line[2])
    x, y = (its[:, :2] - line[:2]).T
    out = frames.copy()
    out[:, 3] = 2.0 * line[2] - its[:, 2] - own[:, 2]
    c, s = np.cos(out[:, 3]), np.sin(out[:, 3])
    out[:, 0] = line[0] + (c2 * x + s2 * y) - (c * own[:, 0] - s * own[:, 1])
    out[:, 1] = line[1] + (s2 * x - c2 * y) - (s * own[:, 0] + c * own[:, 1])
    return out
