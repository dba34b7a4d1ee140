"""Stamps that are no seconds, and single poses stamped far away from all others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.findings import Code, Finding
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.suspect_poses import stray_poses

UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
"""How many of each make a second."""


def stray_stamp_findings(recording: Recording, parameters: Parameters) -> list[Finding]:
    """Of each track in which a few poses are stamped far away from all others."""
    found = []
    for name, track in recording.tracks.items():
        stray = stray_poses(track, parameters)
        if not stray.any():
            continue
        t, others = track.t[stray], track.t[~stray]
        away = np.maximum(t - others[-1], others[0] - t).max()
        which = "one pose is" if len(t) == 1 else f"{len(t)} poses are"
        found.append(
            Finding(
                Code.STRAY_STAMP,
                name,
                f"{which} stamped {duration(float(away))} away from the other {len(others)} (at {t[0]:.3f} s; the "
                f"others run from {others[0]:.3f} s to {others[-1]:.3f} s), and not used",
                "nothing, or remove the line from its track"
                if len(t) == 1
                else "nothing, or remove these lines from its track",
            )
        )
    return found


def time_unit_findings(recording: Recording, parameters: Parameters) -> list[Finding]:
    """Of each track, and of the ranges (user None), whose stamps are no seconds."""
    found = []
    for name, unit in track_units(recording, parameters).items():
        t = recording.tracks[name].t
        found.append(
            Finding(
                Code.TIME_UNIT,
                name,
                f"its stamps are likely in {unit}: as seconds, its {len(t)} poses would lie "
                f"{duration(float(np.median(np.diff(t))))} apart and last {duration(float(t[-1] - t[0]))}",
                f"divide the stamps of its track by {UNITS[unit]:.0f}",
            )
        )
    if (unit_of_ranges := range_unit(recording, parameters)) is not None:
        t = recording.ranges.t
        found.append(
            Finding(
                Code.TIME_UNIT,
                None,
                f"the stamps of ranges.csv are likely in {unit_of_ranges}: as seconds, its {len(t)} ranges would last "
                f"{duration(float(np.ptp(t)))}",
                f"divide its column t by {UNITS[unit_of_ranges]:.0f}",
            )
        )
    return found


def in_seconds(recording: Recording, parameters: Parameters) -> Recording:
    """The same recording with the stamps that are no seconds divided so that they are."""
    units, of_ranges = track_units(recording, parameters), range_unit(recording, parameters)
    tracks = {
        name: replace(track, t=track.t / UNITS[units[name]]) if name in units else track
        for name, track in recording.tracks.items()
    }
    ranges = recording.ranges
    if of_ranges is not None:
        ranges = replace(ranges, t=ranges.t / UNITS[of_ranges])
    return replace(recording, tracks=tracks, ranges=ranges)


def without_ranges_of_unknown_time(recording: Recording, found: Sequence[Finding]) -> Recording:
    """The same recording, with NaN for ranges whose stamps, or whose device's stamps, were `found` to be no seconds.

    Where a device was at such a range is not known; some would else fall on a wrong pose by chance.
    """
    wrong = {finding.user for finding in found if finding.code is Code.TIME_UNIT}
    if not wrong:
        return recording
    r = recording.ranges
    of_user = np.array([user.name in wrong for user in recording.users])
    unknown = of_user[r.a] | of_user[r.b] | (None in wrong)
    return replace(recording, ranges=replace(r, distance=np.where(unknown, np.nan, r.distance)))


def track_units(recording: Recording, parameters: Parameters) -> dict[str, str]:
    """The unit of each track's stamps, of those alone that are no seconds."""
    units = {}
    for name, track in recording.tracks.items():
        unit = _unit_by_rate(track, parameters) or _unit_by_size(track.t, parameters)
        if unit is not None:
            units[name] = unit
    return units


def range_unit(recording: Recording, parameters: Parameters) -> str | None:
    """The unit of the ranges' stamps; None where they are seconds."""
    t, limits = recording.ranges.t, parameters.diagnosis
    if not len(t):
        return None
    if (by_size := _unit_by_size(t, parameters)) is not None:
        return by_size
    units = track_units(recording, parameters)
    spans = [
        (track.t[0] / UNITS.get(units.get(name, ""), 1.0), track.t[-1] / UNITS.get(units.get(name, ""), 1.0))
        for name, track in recording.tracks.items()
    ]
    if not spans or _covered(t, spans) > limits.covered_wrong or len(t) < 2 or np.median(np.diff(np.sort(t))) == 0.0:
        return None
    for unit, per_second in UNITS.items():
        longest = max(end - begin for begin, end in spans)
        if _covered(t / per_second, spans) > limits.covered_right and np.ptp(t) > limits.span_ratio * longest:
            return unit
    return None


def duration(seconds: float) -> str:
    """A time as people say it: 12.3 s, 5.0 min, 2.00 h, 3.0 days, 53.9 years."""
    size = abs(seconds)
    for limit, unit, form in ((120.0, 1.0, ".1f s"), (7200.0, 60.0, ".1f min"), (1.728e5, 3600.0, ".2f h")):
        if size < limit:
            number, word = form.split(" ")
            return f"{size / unit:{number}} {word}"
    return f"{size / 86400.0:.1f} days" if size < 3.2e7 else f"{size / 31556952.0:.1f} years"


def _unit_by_size(t: Array, parameters: Parameters) -> str | None:
    """Since 1970, by its size."""
    middle, (first, last) = float(np.median(t)), parameters.diagnosis.epoch
    return next((u for u, per_second in UNITS.items() if first < middle / per_second < last), None)


def _unit_by_rate(track: Track, parameters: Parameters) -> str | None:
    """Since any other moment, by how slowly poses follow one another and how slowly the device would move."""
    limits = parameters.diagnosis
    if len(track) < limits.fewest_poses:
        return None
    dt = np.diff(track.t)
    interval = float(np.median(dt))
    if interval < limits.slowest_rate_interval or track.extent() < limits.still_extent:
        return None
    speed = float(np.median(np.linalg.norm(np.diff(track.position, axis=0), axis=1) / dt))
    if speed > limits.slowest_walk:
        return None
    shortest, longest = limits.usual_intervals
    return next((u for u, per_second in UNITS.items() if shortest < interval / per_second < longest), None)


def _covered(t: Array, spans: list[tuple[float, float]]) -> float:
    """The largest share of the stamps that fall within any one span."""
    return max(float(((t >= begin) & (t <= end)).mean()) for begin, end in spans)
