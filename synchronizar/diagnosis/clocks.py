"""Whether tracks and ranges are of the same time, and by which clock."""

from __future__ import annotations

import numpy as np

from synchronizar.data.findings import Code, Finding
from synchronizar.data.recording import Recording
from synchronizar.diagnosis.stamps import duration
from synchronizar.parameters import Parameters


def time_overlap_findings(recording: Recording, parameters: Parameters) -> list[Finding]:
    """Of each user none of whose ranges falls within its track; both spans are reported.

    Where both could be by the same clock, set wrongly, a second finding says by how much.
    """
    ranges, limits = recording.ranges, parameters.diagnosis
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
        epochs_differ = (abs(begin) > limits.epoch[0]) != (abs(first) > limits.epoch[0])
        spans = f"the track runs from {begin:.3f} s to {end:.3f} s, its ranges from {first:.3f} s to {last:.3f} s"
        found.append(
            Finding(
                Code.TIME_OVERLAP,
                user.name,
                f"no range falls within the time of its track: {spans} ({duration(apart)} apart)",
                "stamp the track and the ranges by the same clock"
                + (" (one counts from 1970, the other from another moment)" if epochs_differ else ""),
            )
        )
        offset = begin - first
        is_clock = parameters.slam.longest_pose_gap < abs(offset) < limits.largest_clock_error  # less: it is short
        if is_clock and not epochs_differ:
            found.append(
                Finding(
                    Code.CLOCK,
                    user.name,
                    f"its clock is likely {duration(offset)} {'ahead of' if offset > 0 else 'behind'} that of the "
                    f"ranges: {spans}{_time_zone(offset, limits.time_zone_tolerance)}",
                    f"{'subtract' if offset > 0 else 'add'} about {abs(offset):.1f} s {'from' if offset > 0 else 'to'} "
                    "the stamps of its track",
                )
            )
    return found


def _time_zone(offset: float, tolerance: float) -> str:
    hours = float(np.round(offset / 3600.0))
    return " (full hours: a time zone)" if hours != 0.0 and abs(offset - 3600.0 * hours) < tolerance else ""
