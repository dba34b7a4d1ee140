"""Mirror images of a solution: frames that ranges cannot distinguish where users walk on lines or on one level.

Each is only a start for the optimisation; the cost of the optimum decides whether it explains the ranges.
"""

from __future__ import annotations

import numpy as np

from synchronizar.arrays import Array
from synchronizar.graph.problem import ranging, reached_from
from synchronizar.preprocessing.range_measurements import RangeMeasurements


def height_mirrors(measurements: RangeMeasurements, frames: Array, reference: int) -> list[Array]:
    """Frames (k, 4) with one user's height mirrored at the mean height of those it ranges to, or all heights at 0."""
    heights = frames[:, 2]
    above = heights[measurements.i] + measurements.p_i[:, 2] - heights[measurements.j] - measurements.p_j[:, 2]
    active_users = np.flatnonzero(~np.isnan(heights))
    shifts = np.zeros((len(active_users) + 1, len(heights)))
    shifts[-1] = -2.0 * heights
    for shift, u in zip(shifts, active_users, strict=False):
        i, j = measurements.i == u, measurements.j == u
        shift[u] = -2.0 * (above[i].sum() - above[j].sum()) / max(i.sum() + j.sum(), 1)
    return [np.column_stack([frames[:, :2], heights + s - s[reference], frames[:, 3]]) for s in shifts]


def reflections(measurements: RangeMeasurements, frames: Array, reference: int) -> list[Array]:
    """Frames (k, 4) with the users that are connected through one user only reflected in that user's line.

    Ranges to a user that walks a line do not distinguish the two sides of it. Each set of users that is connected to
    the rest only through this pivot can be reflected by itself. A rotation cannot mirror a frame: a reflected user's
    frame is turned so that its own principal axis is mirrored, which is exact only as far as it walks a line too.
    """
    out = []
    active_users = np.flatnonzero(~np.isnan(frames[:, 0])).tolist()
    linked = ranging(measurements, len(frames))
    for pivot in active_users:
        others = linked.copy()
        others[pivot] = others[:, pivot] = False
        remaining = set(active_users) - {pivot}
        while remaining:
            part = set(reached_from(min(remaining), others))
            remaining -= part
            moved = part if reference not in part else set(active_users) - part - {pivot}
            if moved:
                centroid, direction = _line(measurements, frames, pivot)
                reflected = frames.copy()
                for u in moved:
                    reflected[u] = _reflect(measurements, frames, u, centroid, direction)
                out.append(reflected)
    return out


def _own_places(measurements: RangeMeasurements, user: int) -> Array:
    """(n, 2) m, horizontal positions of a user's antennas in its own frame."""
    return np.concatenate([measurements.p_i[measurements.i == user], measurements.p_j[measurements.j == user]])[:, :2]


def _own_line(measurements: RangeMeasurements, user: int) -> tuple[Array, float]:
    """Centroid (2,) m of a user's positions in its own frame and angle (rad) of their principal axis."""
    places = _own_places(measurements, user)
    if not len(places):
        return np.zeros(2), 0.0
    centroid = places.mean(axis=0)
    offset = places - centroid
    angle = 0.5 * np.arctan2(2.0 * (offset[:, 0] * offset[:, 1]).sum(), (offset[:, 0] ** 2 - offset[:, 1] ** 2).sum())
    return centroid, float(angle)


def _line(measurements: RangeMeasurements, frames: Array, user: int) -> tuple[Array, float]:
    """Centroid (2,) m and angle (rad) of the principal axis in the common frame."""
    centroid, angle = _own_line(measurements, user)
    x, y, _, yaw = frames[user]
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([x + c * centroid[0] - s * centroid[1], y + s * centroid[0] + c * centroid[1]]), float(angle + yaw)


def _reflect(measurements: RangeMeasurements, frames: Array, user: int, centroid: Array, direction: float) -> Array:
    """The frame (4,) of a user reflected in the line through `centroid` (2,) in `direction` (rad)."""
    own_centroid, own_angle = _own_line(measurements, user)
    its_centroid, its_angle = _line(measurements, frames, user)
    c2, s2 = np.cos(2.0 * direction), np.sin(2.0 * direction)
    offset = its_centroid - centroid
    image = centroid + np.array([c2 * offset[0] + s2 * offset[1], s2 * offset[0] - c2 * offset[1]])
    yaw = 2.0 * direction - its_angle - own_angle
    c, s = np.cos(yaw), np.sin(yaw)
    origin = image - np.array([c * own_centroid[0] - s * own_centroid[1], s * own_centroid[0] + c * own_centroid[1]])
    return np.array([*origin, frames[user, 2], yaw])
