"""Extent points of a walk: its outermost points, where an error of its frame shows most."""

from __future__ import annotations

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording

_SIDES = np.array([[1, 0, 0], [0, 1, 0], [1, 1, 0], [1, -1, 0]], dtype=float)


def extent_points(recording: Recording) -> Array:
    """Extent points (k, c, 3) m of each user's own track: both ends, and the furthest in 8 horizontal directions."""
    extent = np.zeros((len(recording.users), 2 + 2 * len(_SIDES), 3))
    for u, user in enumerate(recording.users):
        if not user.static:
            p = recording.tracks[user.name].position
            along = p @ _SIDES.T
            extent[u] = p[[0, len(p) - 1, *along.argmin(axis=0), *along.argmax(axis=0)]]
    return extent
