"""What became of ranges: by the last search, and by the graph where they are followed."""

from __future__ import annotations

import numpy as np

from synchronizar._core import rows_by_serial
from synchronizar.arrays import Array, Indices, Mask
from synchronizar.estimation.incremental.slot_ranges import SERIAL
from synchronizar.estimation.incremental.snapshot import Found
from synchronizar.estimation.incremental.tracking import Tracking

_UNKNOWN = np.array([0.0, 0.0, np.nan])


def verdicts_on(serial: Indices, found: Found | None, tracking: Tracking) -> tuple[Mask, Array, Array, Array]:
    """Of ranges by running index (n,): usable, probability of line of sight, weight (1/m^2), residual (m)."""
    if not len(serial):
        return np.zeros(0, dtype=bool), *np.zeros((3, 0))
    tables = []
    if found is not None:
        of = found.ranges
        tables.append((of.serial, np.column_stack([of.inlier_probability, of.weight, of.residual])))
    rows = tracking.ranges.rows
    if len(rows):
        inlier, residual, weight = tracking.range_verdicts()
        tables.append((rows[:, SERIAL].astype(np.int32), np.column_stack([inlier, weight, residual])))
    usable, values = rows_by_serial(serial, tables, _UNKNOWN)
    return usable, *np.ascontiguousarray(values.T)
