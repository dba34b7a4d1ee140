"""All ranges of the recent past, as they came."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from synchronizar.arrays import Array, Indices
from synchronizar.data.ranges import Ranges
from synchronizar.estimation.incremental.tracking import NewRanges
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import nlos_share_of

COLUMNS = ("t", "a", "b", "distance", "sigma", "antenna_a", "antenna_b", "rx_power", "fp_power", "nlos", "serial")
_WHOLE = ("a", "b", "antenna_a", "antenna_b")
_T, _A, _B, _DISTANCE, _SIGMA, _ANTENNA_A, _ANTENNA_B, _RX_POWER, _FP_POWER, _NLOS, _SERIAL = range(len(COLUMNS))
_FIRST_ROWS = 256


class RangeLog:
    """A table of ranges in the order in which they were added."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._table = np.empty((_FIRST_ROWS, len(COLUMNS)))
        self._count = 0
        self._taken = 0
        self._latest: set[tuple[float, ...]] = set()

    def add(self, serial: int, t: float, a: int, b: int, distance: float, optional: Mapping[str, float]) -> bool:
        """A range, by users' indices; whether it can be a distance, and is none that came already."""
        ranges = self._parameters.ranges
        if not ranges.shortest <= distance <= ranges.longest:
            return False
        known = {"antenna_a": -1.0, "antenna_b": -1.0, **optional}
        row = (t, a, b, distance, *(known.get(name, np.nan) for name in COLUMNS[4:-1]), serial)
        if row[:4] in self._latest:
            return False
        self._latest.add(row[:4])
        if self._count == len(self._table):
            self._table = np.concatenate([self._table, np.empty_like(self._table)])
        self._table[self._count] = row
        self._count += 1
        return True

    @property
    def rows(self) -> Array:
        """(n, columns), a view."""
        return self._table[: self._count]

    @property
    def taken(self) -> int:
        """How many of the rows `take` has given already."""
        return self._taken

    def restore(self, rows: Array, taken: int) -> None:
        """Just these rows (n, columns). ValueError where they have other columns."""
        if rows.ndim != 2 or rows.shape[1] != len(COLUMNS):
            raise ValueError(f"a table of {len(COLUMNS)} columns is needed")
        self._table = np.concatenate([rows, np.empty((_FIRST_ROWS, len(COLUMNS)))])
        self._count, self._taken = len(rows), taken
        self._latest = {tuple(row[:4].tolist()) for row in rows}

    def forget(self, before: float) -> None:
        """Ranges that are older than `before` (s)."""
        kept = self.rows[:, _T] >= before
        self._latest.difference_update(map(tuple, self.rows[~kept, :4].tolist()))
        left = self.rows[kept].copy()
        self._table[: len(left)] = left
        self._count, self._taken = len(left), int(kept[: self._taken].sum())

    def take(self) -> Array:
        """(n, columns): those added since the last call."""
        new = self.rows[self._taken :]
        self._taken = self._count
        return new

    def ranges(self, rows: Array) -> Ranges:
        """Rows (n, columns) as ranges."""
        columns: dict[str, Any] = {
            name: rows[:, n].astype(np.int32) if name in _WHOLE else rows[:, n].copy()
            for n, name in enumerate(COLUMNS[:-1])
        }
        return Ranges.of(**columns)

    def to_follow(self, rows: Array) -> NewRanges:
        """Rows (n, columns) as tracking takes them: the first user is the one with the smaller index."""
        share = nlos_share_of(rows[:, _RX_POWER], rows[:, _FP_POWER], rows[:, _NLOS], self._parameters)
        whole = rows[:, [_A, _B, _ANTENNA_A, _ANTENNA_B, _SERIAL]].astype(np.int32)
        swap = whole[:, 0] > whole[:, 1]
        whole[swap, :4] = whole[swap][:, [1, 0, 3, 2]]
        sigma = rows[:, _SIGMA]
        return NewRanges(
            rows[:, _T].copy(),
            whole[:, 0],
            whole[:, 1],
            rows[:, _DISTANCE].copy(),
            np.where(np.isnan(sigma), self._parameters.ranges.sigma, sigma),
            share / (1.0 - share),
            whole[:, 2],
            whole[:, 3],
            whole[:, 4],
        )

    @staticmethod
    def users(rows: Array) -> tuple[Indices, Indices]:
        """(n,) each: both users of rows (n, columns)."""
        return rows[:, _A].astype(np.int32), rows[:, _B].astype(np.int32)
