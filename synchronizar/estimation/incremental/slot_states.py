"""Where those who are followed are at the begins of slots: one table, which all ranges of the window are read by."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from synchronizar._core import Bursts, NlosMixture, followed_apart, judged_bursts
from synchronizar.arrays import Array, Indices, Mask
from synchronizar.estimation.incremental.slot_ranges import PLACE_COLUMNS, WEIGHT_COLUMNS

_STAMP, _PLACE, _STATE = 0, slice(1, 4), slice(4, 11)
_COLUMNS = 11
_AHEAD = 16  # slots for which there is room when more is made


class SlotTable(NamedTuple):
    """A `SlotStates` as plain values."""

    first: int
    rows: Array
    """(slots, users, 11) stamp, place and state; NaN where a user has no such slot."""


class SlotStates:
    """Stamps, SLAM's places and estimates of users at slots."""

    def __init__(self, users: int) -> None:
        self._first = self._end = 0
        self._table = np.full((0, users, _COLUMNS), np.nan)

    def __len__(self) -> int:
        """How many users' slots there are."""
        return int(self._known.sum())

    @property
    def _known(self) -> Mask:
        return np.asarray(~np.isnan(self._table[: self._end - self._first, :, _STAMP]))

    def add(self, user: int, slot: int, stamp: float, place: Array, state: Array) -> None:
        """A user's slot: its begin by the user's own clock (s), where its SLAM is then (3,), its state (7,)."""
        if self._end == self._first:
            self._first = self._end = slot
        before, after = max(self._first - slot, 0), max(slot + 1 - self._first - len(self._table), 0)
        if before or after:
            room = np.full((before + len(self._table) + after + _AHEAD, *self._table.shape[1:]), np.nan)
            room[before : before + self._end - self._first] = self._table[: self._end - self._first]
            self._table, self._first = room, self._first - before
        self._end = max(self._end, slot + 1)
        row = self._table[slot - self._first, user]
        row[_STAMP], row[_PLACE], row[_STATE] = stamp, place, state

    def has(self, user: int, slot: int) -> bool:
        """Whether a user has a slot."""
        return self._first <= slot < self._end and not np.isnan(self._table[slot - self._first, user, _STAMP])

    def have(self, user: Indices, slot: Indices) -> Mask:
        """The same of many, of shapes that go together."""
        there = (slot >= self._first) & (slot < self._end)
        return np.asarray(there & ~np.isnan(self._table[np.where(there, slot - self._first, 0), user, _STAMP]))

    def place(self, user: int, slot: int) -> Array:
        """(3,) SLAM units."""
        return self._table[slot - self._first, user, _PLACE].copy()

    def places(self, user: Indices, slot: Indices) -> Array:
        """(..., 3) SLAM units, of users at slots, of shapes that go together."""
        return self._table[slot - self._first, user, _PLACE]

    def state(self, user: int, slot: int) -> Array:
        """(7,) as in `Tracked`."""
        return self._table[slot - self._first, user, _STATE].copy()

    def change(self, at: Iterable[tuple[int, int]], states: Array) -> None:
        """Other states (n, 7) of users at slots."""
        users, slots = np.array(list(at), dtype=np.int32).reshape(-1, 2).T
        self._table[slots - self._first, users, _STATE] = states

    def apart(self, ranges: Array) -> tuple[Array, Array, Array]:
        """Of rows (n, columns) of `SlotRanges`: from j to i (n, 3) m, what radios add (n,) m, residuals (n,) m."""
        return followed_apart(ranges, PLACE_COLUMNS, *self._states())

    def _states(self) -> tuple[Array, int, int]:
        """(slots * users, 7) of the window slot by slot, how many users there are, and the first slot."""
        states = np.ascontiguousarray(self._table[: self._end - self._first, :, _STATE])
        return states.reshape(-1, states.shape[2]), states.shape[1], self._first

    def judged(
        self, ranges: Array, since: int, sizes: Array, loss: NlosMixture, bursts: Bursts, surest: float, changed: float
    ) -> tuple[list[int], Indices, Array]:
        """Slots from `since` on in which bursts are judged otherwise now, rows of all their ranges, and their odds.

        Of rows (n, columns) of `SlotRanges`. A range is judged otherwise whose probability of line of sight is another
        one by more than `changed`; `sizes` (users, users): of a pair's errors, of what the model says; `surest`: log
        odds, at most.
        """
        states = self._states()
        return judged_bursts(
            ranges, PLACE_COLUMNS, WEIGHT_COLUMNS, *states, since, sizes, loss, bursts, surest, changed
        )

    def residuals(self, ranges: Array) -> Array:
        """(n,) m, predicted minus measured, of rows (n, columns) of `SlotRanges`."""
        return self.apart(ranges)[2]

    def drop(self, user: int) -> None:
        """Forget a user."""
        self._table[:, user] = np.nan

    def forget(self, before: int) -> None:
        """Forget the slots before `before`."""
        gone = min(max(before - self._first, 0), self._end - self._first)
        if gone:
            left = self._table[gone : self._end - self._first].copy()
            self._table[: len(left)] = left
            self._table[len(left) :] = np.nan
            self._first += gone

    def add_user(self) -> None:
        """One more user, the last by index."""
        none = np.full((len(self._table), 1, _COLUMNS), np.nan)
        self._table = np.concatenate([self._table, none], axis=1)

    # To and from plain values

    def to_table(self) -> SlotTable:
        """All of it, as `restore` takes it."""
        return SlotTable(self._first, self._table[: self._end - self._first].copy())

    def restore(self, table: SlotTable) -> None:
        """What `to_table` told of."""
        self._first, rows = int(table.first), np.array(table.rows)
        if rows.ndim != 3 or rows.shape[1:] != self._table.shape[1:]:
            raise ValueError("a table of other users")
        self._end, self._table = self._first + len(rows), rows
