"""Where both devices of a range were, by the answer."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.ranges import Ranges
from synchronizar.data.registration import Registration
from synchronizar.data.track import Track


def range_ends(ranges: Ranges, registration: Registration, tracks: Mapping[str, Track], max_gap: float) -> Array:
    """(n, 2, 3) m, common frame: positions of a and b at each of n ranges; NaN where unknown.

    `tracks` are those in the common frame, at own stamps; a time in a gap longer than `max_gap` s is unknown.
    """
    positions = np.full((len(ranges), 2, 3), np.nan)
    for index, (name, user) in enumerate(registration.users.items()):
        track = tracks.get(name)
        if track is None:
            continue
        for end, who in enumerate((ranges.a, ranges.b)):
            mine = np.flatnonzero(who == index)
            if user.static:
                positions[mine, end] = track.position[0]
            else:
                place, valid = track.positions_at(ranges.t[mine] + (user.clock_offset or 0.0), max_gap)
                positions[mine[valid], end] = place[valid]
    return positions
