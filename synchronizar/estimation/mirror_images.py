"""Mirror images of a joint placement: what ranges cannot tell apart where users walk lines, or on the level.

Each is a start, from which a minimum may be reached; whether it explains the ranges is for the cost to say.
"""

from __future__ import annotations

import numpy as np

from synchronizar.arrays import Array
from synchronizar.estimation.initialisation import connected
from synchronizar.preprocessing.range_measurements import RangeMeasurements


def height_mirrors(measurements: RangeMeasurements, frames: Array, reference: int) -> list[Array]:
    """Placements (k, 4) with one user mirrored in the mean level of those it ranges to, or all of them in height 0."""
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
    """Placements (k, 4) in which all that hang together by way of one user only are reflected in that user's line.

    A user that walks a line sees everybody else as well reflected in it; those that range to nobody but such a user can
    be reflected each for itself. The image of a user is one only as far as it walks a line too: its frame is turned so
    that its own line comes to lie as a mirror shows it.
    """
    out = []
    active_users = np.flatnonzero(~np.isnan(frames[:, 0]))
    for pivot in active_users.tolist():
        others = measurements[((measurements.i != pivot) & (measurements.j != pivot)).nonzero()[0].astype(np.int32)]
        middle, direction = _line(measurements, frames, pivot)
        left = set(active_users.tolist()) - {pivot}
        while left:
            part = set(connected(others, len(frames), min(left)))
            left -= part
            moved = part if reference not in part else set(active_users.tolist()) - part - {pivot}
            if moved:
                reflected = frames.copy()
                for u in moved:
                    reflected[u] = _reflect(measurements, frames, u, middle, direction)
                out.append(reflected)
    return out


def _own_places(measurements: RangeMeasurements, user: int) -> Array:
    """(n, 2) m: its antennas in its own frame, in the plane."""
    return np.concatenate([measurements.p_i[measurements.i == user], measurements.p_j[measurements.j == user]])[:, :2]


def _own_line(measurements: RangeMeasurements, user: int) -> tuple[Array, float]:
    """The middle (2,) of a user's places in its own frame and the angle (rad) of their longest axis."""
    places = _own_places(measurements, user)
    middle = places.mean(axis=0)
    away = places - middle
    angle = 0.5 * np.arctan2(2.0 * (away[:, 0] * away[:, 1]).sum(), (away[:, 0] ** 2 - away[:, 1] ** 2).sum())
    return middle, float(angle)


def _line(measurements: RangeMeasurements, frames: Array, user: int) -> tuple[Array, float]:
    """The same in the common frame."""
    middle, angle = _own_line(measurements, user)
    x, y, _, yaw = frames[user]
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([x + c * middle[0] - s * middle[1], y + s * middle[0] + c * middle[1]]), float(angle + yaw)


def _reflect(measurements: RangeMeasurements, frames: Array, user: int, middle: Array, direction: float) -> Array:
    """The frame (4,) of a user reflected in the line through `middle` (2,) in `direction` (rad)."""
    own_middle, own_angle = _own_line(measurements, user)
    its_middle, its_angle = _line(measurements, frames, user)
    c2, s2 = np.cos(2.0 * direction), np.sin(2.0 * direction)
    away = its_middle - middle
    image = middle + np.array([c2 * away[0] + s2 * away[1], s2 * away[0] - c2 * away[1]])
    yaw = 2.0 * direction - its_angle - own_angle
    c, s = np.cos(yaw), np.sin(yaw)
    origin = image - np.array([c * own_middle[0] - s * own_middle[1], s * own_middle[0] + c * own_middle[1]])
    return np.array([*origin, frames[user, 2], yaw])
