"""The ranges of users who are followed, by slot: read from the poses, weighted, and given to the graph."""

from __future__ import annotations

import numpy as np

from synchronizar._core import RangeSlot, followed_slot
from synchronizar.arrays import Array, Indices, Mask

T, USER_I, USER_J, DISTANCE, SIGMA, ODDS, LINK, SLOT, NLOS_ODDS, WEIGHT, SERIAL = range(11)
"""Columns of what is known of each range: s, users, m, 1 sigma of the model (m), prior odds, antennas, slot; NLOS odds
given the other ranges, range weight; running index of each range that was ever added."""
_END = 9  # columns of an end: offset, lever, velocity, (3,) each
END_I, END_J = SERIAL + 1, SERIAL + 1 + _END
"""Where the columns of both ends begin."""
_COLUMNS = END_J + _END
PLACE_COLUMNS = USER_I, USER_J, SLOT, DISTANCE, END_I, END_J
WEIGHT_COLUMNS = T, SIGMA, ODDS, NLOS_ODDS, WEIGHT
"""As C++ loops over such tables take them."""
_FIRST_ROWS = 256


class SlotRanges:
    """A table of ranges, by the order in which they were read."""

    def __init__(self) -> None:
        self._table = np.empty((_FIRST_ROWS, _COLUMNS))
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def rows(self) -> Array:
        """(n, columns), a view."""
        return self._table[: self._count]

    def add(self, rows: Array) -> None:
        """More ranges (n, columns)."""
        needed = self._count + len(rows)
        if needed > len(self._table):
            grown = np.empty((max(needed, 2 * len(self._table)), _COLUMNS))
            grown[: self._count] = self.rows
            self._table = grown
        self._table[self._count : needed] = rows
        self._count = needed

    def keep(self, which: Mask) -> None:
        """Forget all rows but these (n,)."""
        left = self.rows[which].copy()
        self._table[: len(left)] = left
        self._count = len(left)

    def restore(self, rows: Array) -> None:
        """Just these rows (n, columns). ValueError where they have other columns."""
        if rows.ndim != 2 or rows.shape[1] != _COLUMNS:
            raise ValueError(f"a table of {_COLUMNS} columns is needed")
        self._table = np.concatenate([rows, np.empty((_FIRST_ROWS, _COLUMNS))])
        self._count = len(rows)

    def of_slot(self, slot: int) -> Indices:
        """Rows of a slot."""
        return np.flatnonzero(self.rows[:, SLOT] == slot).astype(np.int32)


def block_of(rows: Array) -> tuple[list[int], RangeSlot]:
    """The users of ranges (n, columns) of one slot, and the ranges for the graph, pair by pair."""
    return followed_slot(rows, PLACE_COLUMNS, WEIGHT_COLUMNS)
