"""Whether tracks and ranges are of the same time, and by which clock."""

from __future__ import annotations

import numpy as np

from synchronizar.data.findings import Code, Finding
from synchronizar.data.recording import Recording
from synchronizar.diagnosis.stamps import duration

CLOCK_S = 2 * 86400.0
"""s: clocks that count from the same moment are set wrongly by time zones or a day; what is farther apart is counted
from another moment."""


def time_overlap_findings(recording: Recording) -> list[Finding]:
    """Of each user none of whose ranges falls within its track; both spans are reported.

    Where both could be by the same clock, set wrongly, a second finding says by how much.
    """
    ranges = recording.ranges
    found = []
    for u, user in enumerate(recording.users):
        if user.static:
            continue
        track = recording.tracks[user.name]
        own = ranges.t[(ranges.a == u) | (ranges.b == u)]
        begin, end = float(track.t[0]), float(track.t[-1])
        if not len(own) or ((own >= begin) & (own <= end)).any():
            continue
        first, last = float(own.min()), float(own.max())
        apart = first - end if first > end else begin - last
        spans = f"its track is {begin:.3f} to {end:.3f}, its ranges are {first:.3f} to {last:.3f}"
        found.append(
            Finding(
                Code.TIME_OVERLAP,
                user.name,
                f"no range falls within its track, they are {duration(apart)} apart: {spans}",
                "stamp tracks and ranges by one clock, or add the difference to the stamps of its track"
                + (" (one counts from 1970 and the other not)" if _epochs_differ(begin, first) else ""),
            )
        )
        offset = begin - first
        if abs(offset) < CLOCK_S and not _epochs_differ(begin, first):
            found.append(
                Finding(
                    Code.CLOCK,
                    user.name,
                    f"its clock is likely {duration(offset)} {'ahead of' if offset > 0 else 'behind'} that of the "
                    f"ranges: {spans}{_time_zone(offset)}",
                    f"{'subtract' if offset > 0 else 'add'} about {abs(offset):.1f} s {'from' if offset > 0 else 'to'} "
                    "the stamps of its track",
                )
            )
    return found


def _epochs_differ(a: float, b: float) -> bool:
    """Whether one of the two is counted from 1970, and the other is not."""
    return (abs(a) > 1e9) != (abs(b) > 1e9)


def _time_zone(offset: float) -> str:
    hours = offset / 3600.0
    return " (full hours: a time zone)" if abs(hours) > 0.9 and abs(hours - np.round(hours)) < 0.02 else ""
