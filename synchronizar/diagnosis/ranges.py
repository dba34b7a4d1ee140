"""Ranges that are there twice, and devices that have none."""

from __future__ import annotations

import numpy as np

from synchronizar.arrays import Mask
from synchronizar.data.findings import Code, Finding
from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.parameters import DiagnosisParameters, Parameters


def repeated_range_findings(recording: Recording, parameters: Parameters) -> list[Finding]:
    """Ranges that stand in the file more than once, and radios whose last number is written anew at each stamp."""
    r = recording.ranges
    copy = _copies(r)
    seen, remedy = [], "write each measurement once"
    if copy.any():
        seen.append(
            f"{copy.sum()} of {len(r)} ranges are exact copies of another one (time, devices, distance) and count once"
        )
    share, chance = _held_numbers(r.select(~copy), parameters.diagnosis)
    if share - chance > parameters.diagnosis.repeated_share:
        seen.append(
            f"{share:.0%} of the ranges have exactly the value of the one before them of the same pair ({chance:.0%} "
            f"would by chance): likely old measurements under new stamps"
        )
        remedy += ", with its own stamp"
    return [Finding(Code.REPEATED_RANGES, None, "; ".join(seen), remedy)] if seen else []


def no_range_findings(recording: Recording) -> list[Finding]:
    """Of each user without a range; one for all (user None) where there is none at all."""
    ranges = recording.ranges
    if not len(ranges):
        return [Finding(Code.NO_RANGES, None, "ranges.csv has no range", "nothing can be registered without ranges")]
    count = np.bincount(np.concatenate([ranges.a, ranges.b]), minlength=len(recording.users))
    return [
        Finding(
            Code.NO_RANGES,
            user.name,
            "it has no range with anybody",
            "check that its radio was on and that ranges.csv calls it by the same name as its track",
        )
        for user, n in zip(recording.users, count.tolist(), strict=True)
        if n == 0
    ]


def _copies(r: Ranges) -> Mask:
    """(n,) which ranges repeat an earlier one to the letter, its two devices in either order."""
    swap = r.a > r.b
    columns = (
        r.distance,
        np.where(swap, r.antenna_a, r.antenna_b),
        np.where(swap, r.antenna_b, r.antenna_a),
        np.maximum(r.a, r.b),
        np.minimum(r.a, r.b),
        r.t,
    )
    order = np.lexsort(columns)
    same = np.ones(max(len(r) - 1, 0), dtype=bool)
    for column in columns:
        same &= np.diff(column[order]) == 0
    copy = np.zeros(len(r), dtype=bool)
    copy[order[1:][same]] = True
    return copy


def _held_numbers(r: Ranges, limits: DiagnosisParameters) -> tuple[float, float]:
    """How many ranges equal the one before of their pair, and how many one of their pair that is not near; shares."""
    order = np.lexsort((r.t, r.antenna_b, r.antenna_a, np.maximum(r.a, r.b), np.minimum(r.a, r.b)))
    a, b, t, distance = (column[order] for column in (np.minimum(r.a, r.b), np.maximum(r.a, r.b), r.t, r.distance))

    def equal_share(apart: int) -> float:
        of_one = (a[apart:] == a[:-apart]) & (b[apart:] == b[:-apart]) & (t[apart:] > t[:-apart])
        if of_one.sum() < limits.repeated_fewest:
            return 0.0
        return float((distance[apart:] == distance[:-apart])[of_one].mean())

    return equal_share(1), equal_share(limits.repeated_rows_apart)
