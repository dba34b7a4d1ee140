"""Extent points of a walk: its outermost points, where an error of its frame shows most."""

from __future__ import annotations

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording

_SIDES = np.array([[1, 0, 0], [0, 1, 0], [1, 1, 0], [1, -1, 0]], dtype=float)


EXTENT_POINTS = 2 + 2 * len(_SIDES)
"""How many there are of each track."""


def extent_points(recording: Recording, duration: float = np.inf) -> Array:
    """Extent points (k, c, 3) m of each user's own track: both ends, and the furthest in 8 horizontal directions.

    Of the last `duration` s of it.
    """
    extent = np.zeros((len(recording.users), EXTENT_POINTS, 3))
    for u, user in enumerate(recording.users):
        if not user.static:
            track = recording.tracks[user.name]
            extent[u] = extent_points_of(track.position[track.t >= track.t[-1] - duration])
    return extent


def extent_points_of(position: Array) -> Array:
    """(c, 3) m: the extent points of positions (n, 3)."""
    along = position @ _SIDES.T
    return np.asarray(position[[0, len(position) - 1, *along.argmin(axis=0), *along.argmax(axis=0)]])
