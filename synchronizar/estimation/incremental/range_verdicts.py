"""What became of ranges: by the last search, and by the graph where they are followed."""

from __future__ import annotations

import numpy as np

from synchronizar.arrays import Array, Indices, Mask
from synchronizar.estimation.incremental.slot_ranges import SERIAL
from synchronizar.estimation.incremental.snapshot import Found
from synchronizar.estimation.incremental.tracking import Tracking


def verdicts_on(serial: Indices, found: Found | None, tracking: Tracking) -> tuple[Mask, Array, Array, Array]:
    """Of ranges by running index (n,): usable, probability of line of sight, weight (1/m^2), residual (m)."""
    n = len(serial)
    usable, inlier, weight, residual = np.zeros(n, dtype=bool), np.zeros(n), np.zeros(n), np.full(n, np.nan)
    if not n:
        return usable, inlier, weight, residual
    first = int(serial.min())
    place = np.full(int(serial.max()) - first + 1, -1)
    place[serial - first] = np.arange(n)
    if found is not None:
        of = found.ranges
        at, there = _places_of(of.serial, place, first)
        usable[at], inlier[at], weight[at] = True, of.inlier_probability[there], of.weight[there]
        residual[at] = of.residual[there]
    rows = tracking.ranges.rows
    if len(rows):
        followed, off, bring = tracking.range_verdicts()
        at, there = _places_of(rows[:, SERIAL].astype(np.int32), place, first)
        usable[at], inlier[at], weight[at], residual[at] = True, followed[there], bring[there], off[there]
    return usable, inlier, weight, residual


def _places_of(known: Indices, place: Indices, first: int) -> tuple[Indices, Indices]:
    """The places of those of `known` that have one, and which these are; `place` of running index `first` is at 0."""
    there = np.flatnonzero((known >= first) & (known < first + len(place)))
    at = place[known[there] - first].astype(np.int32)
    return at[at >= 0], there[at >= 0].astype(np.int32)
