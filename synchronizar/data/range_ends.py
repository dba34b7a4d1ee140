"""Where both devices of a range were, by the answer: as an array, and as lines to be shown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array, Indices, Mask
from synchronizar.data.ranges import Ranges
from synchronizar.data.registration import Registration
from synchronizar.data.track import Track

LINES_S = 0.2
"""s: so long a line of a range is shown, in a time that passes."""


class RangeLines(NamedTuple):
    """The n ranges of a while."""

    t: float
    """s, range clock: of the last of them."""
    ends: Array
    """(n, 2, 3) m, common frame."""
    used: Mask
    """(n,); the others were rejected."""


def range_lines(
    ranges: Ranges, registration: Registration, tracks: Mapping[str, Track], max_gap: float
) -> Iterator[RangeLines]:
    """Usable ranges whose ends are known, as `range_ends` has them, each LINES_S together, in the order of time."""
    ends, verdicts = range_ends(ranges, registration, tracks, max_gap), registration.ranges
    rows: Indices = np.argsort(ranges.t, kind="stable").astype(np.int32)
    rows = rows[verdicts.usable[rows] & np.isfinite(ends[rows]).all(axis=(1, 2))]
    slot = np.floor(ranges.t[rows] / LINES_S)
    for some in np.split(rows, np.flatnonzero(np.diff(slot)) + 1):
        if len(some):
            yield RangeLines(float(ranges.t[some[-1]]), ends[some], verdicts.used[some])


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
