"""Poses and ranges as they come, one at a time, in any order; read as the recording of some stretch of time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array, Indices
from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.quaternions import multiply_quaternions, rotate_by_quaternions

_LONG_AGO = -1e9  # s: a track of one pose there covers no range
_NOWHERE = Track(np.array([_LONG_AGO]), np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]))
_FIRST_ROWS = 256
_RANGE = ("t", "a", "b", "distance", "sigma", "antenna_a", "antenna_b", "rx_power", "fp_power", "nlos")
_SERIAL = len(_RANGE)
_WHOLE = ("a", "b", "antenna_a", "antenna_b")


class Stretch(NamedTuple):
    """What came in a stretch of time, SLAM's axes turned and heights lifted as they were found to be at its begin."""

    recording: Recording
    """Of all users; who has no pose there has one long ago."""
    last: Array
    """(k, 3) m: where SLAM has each user at its last pose, in its own frame."""
    end: Array
    """(k,) s, own stamp of that pose; NaN for users without a pose there."""
    serial: Indices
    """(n,) the how-manieth that was ever added each of the recording's ranges is, from 0."""


class Rows:
    """A table that grows at its end, and is cut at its begin; its first column is time."""

    def __init__(self, columns: int) -> None:
        self._table = np.empty((_FIRST_ROWS, columns))
        self._count = 0
        self._in_order = True

    def __len__(self) -> int:
        return self._count

    def add(self, row: Sequence[float]) -> None:
        """At the end."""
        if self._count == len(self._table):
            self._table = np.concatenate([self._table, np.empty_like(self._table)])
        self._table[self._count] = row
        if self._count and row[0] <= self._table[self._count - 1, 0]:
            self._in_order = False
        self._count += 1

    def restore(self, table: Array) -> None:
        """Just these rows. ValueError where they have other columns."""
        if table.ndim != 2 or table.shape[1] != self._table.shape[1] or table.dtype != self._table.dtype:
            raise ValueError(f"a table of {self._table.shape[1]} columns is needed")
        self._table, self._count, self._in_order = table.copy(), len(table), False
        if not len(table):
            self._table = np.empty((_FIRST_ROWS, table.shape[1]))

    def sorted(self) -> Array:
        """(n, columns) by time; of rows with the same time the first that came stands first."""
        table = self._table[: self._count]
        if not self._in_order:
            table[:] = table[np.argsort(table[:, 0], kind="stable")]
            self._in_order = bool((np.diff(table[:, 0]) > 0.0).all())
        return table

    def forget(self, before: float) -> None:
        """Rows whose time is earlier."""
        table = self.sorted()
        first = int(np.searchsorted(table[:, 0], before))
        if first:
            left = table[first:].copy()
            self._table[: len(left)] = left
            self._count = len(left)


class Stream:
    """Everybody's poses and all ranges, as far back as they are needed."""

    def __init__(self, users: tuple[User, ...]) -> None:
        self.users = users
        self._index = {user.name: u for u, user in enumerate(users)}
        self._poses = [Rows(8) for _ in users]
        self._ranges = Rows(len(_RANGE) + 1)
        self.added = 0
        """How many ranges were ever told."""
        self.faults = 0
        """How many poses and ranges were no numbers, or of nobody: they are left out."""

    def add_pose(self, user: str, t: float, position: Sequence[float], quat_xyzw: Sequence[float]) -> None:
        """A device's own pose by its own clock (s, m); an attitude need not be of unit length."""
        row = np.array([t, *position, *quat_xyzw], dtype=float)
        with np.errstate(over="ignore"):
            length = float(np.linalg.norm(row[4:]))
        u = self._index.get(user)
        if (
            u is None
            or self.users[u].static
            or row.shape != (8,)
            or not np.isfinite(row).all()
            or not 0.0 < length < np.inf
        ):
            self.faults += 1
            return
        row[4:] /= length
        self._poses[u].add(row.tolist())

    def add_range(self, t: float, a: str, b: str, distance: float, optional: Mapping[str, float]) -> tuple[int, ...]:
        """A measured distance (m) by the ranges' clock (s); whose it is, or nobody's where it cannot be used."""
        self.added += 1
        first, other = self._index.get(a), self._index.get(b)
        known = {"antenna_a": -1, "antenna_b": -1, **optional}
        if first is None or other is None or first == other or not self._sound(t, distance, (first, other), known):
            self.faults += 1
            return ()
        known |= {"t": t, "a": first, "b": other, "distance": distance}
        self._ranges.add([*(known.get(name, np.nan) for name in _RANGE), self.added - 1])
        return first, other

    def _sound(self, t: float, distance: float, ends: tuple[int, int], known: Mapping[str, float]) -> bool:
        """Whether `Ranges` takes such numbers, and the users have such antennas."""
        antennas = zip(ends, (known["antenna_a"], known["antenna_b"]), strict=True)
        sigma = known.get("sigma", np.nan)
        return (
            bool(np.isfinite([t, distance]).all())
            and all(-1 <= antenna < len(self.users[u].antennas) for u, antenna in antennas)
            and (np.isnan(sigma) or 0.0 < sigma < np.inf)
        )

    def ranges_since(self, t: float) -> Array:
        """(n, 3) stamps and the two users of ranges that are later, by time."""
        table = self._ranges.sorted()
        return np.asarray(table[np.searchsorted(table[:, 0], t, side="right") :, :3])

    def last_pose(self, user: int) -> Array | None:
        """(8,) t x y z qx qy qz qw; None before the first."""
        table = self._poses[user].sorted()
        return table[-1].copy() if len(table) else None

    def poses_since(self, user: int, seconds: float) -> Array:
        """(n, 8) t x y z qx qy qz qw: the last pose of a user who has some, and those that are little older."""
        table = self._poses[user].sorted()
        return table[np.searchsorted(table[:, 0], table[-1, 0] - seconds) :].copy()

    def stretch(self, begin: Array, axes: Array, lift: Array) -> Stretch:
        """Everything from `begin` on, (k,) s own stamps, that of the first pose among it.

        `axes` (k, 4) quaternions turn each user's SLAM, about its first pose there, and `lift` (k,) is added to its
        heights. Ranges are left out that were told before both devices' first poses.
        """
        tracks, k = {}, len(self.users)
        last, end, first = np.zeros((k, 3)), np.full(k, np.nan), np.full(k, -np.inf)
        for u, user in enumerate(self.users):
            if user.static:
                continue
            table = self._poses[u].sorted()
            table = table[np.searchsorted(table[:, 0], begin[u]) :]
            if not len(table):
                tracks[user.name] = _NOWHERE
                continue
            table = table[np.concatenate([[True], np.diff(table[:, 0]) > 0.0])]
            first[u], end[u], last[u] = table[0, 0], table[-1, 0], table[-1, 1:4]
            place = table[0, 1:4] + rotate_by_quaternions(axes[u], table[:, 1:4] - table[0, 1:4])
            place[:, 2] += lift[u]
            tracks[user.name] = Track(table[:, 0].copy(), place, multiply_quaternions(axes[u], table[:, 4:]))
        table = self._ranges.sorted()
        a, b = table[:, 1].astype(int), table[:, 2].astype(int)
        table = table[table[:, 0] > np.maximum(first[a], first[b])]
        columns = {
            name: table[:, n].astype(np.int32) if name in _WHOLE else table[:, n].copy()
            for n, name in enumerate(_RANGE)
        }
        serial = table[:, _SERIAL].astype(np.int32)
        return Stretch(Recording(self.users, tracks, Ranges.of(**columns)), last, end, serial)

    def forget(self, begin: Array, ranges_before: float) -> None:
        """What lies before: poses by own stamps (k,), ranges by theirs."""
        for rows, t in zip(self._poses, begin.tolist(), strict=True):
            if np.isfinite(t):
                rows.forget(t)
        self._ranges.forget(ranges_before)

    def pose_tables(self) -> list[Array]:
        """Of each user (n, 8) t x y z qx qy qz qw."""
        return [rows.sorted().copy() for rows in self._poses]

    def range_table(self) -> Array:
        """(n, 11): the columns of `Ranges`, and the serial number."""
        return self._ranges.sorted().copy()

    def restore(self, poses: list[Array], ranges: Array, added: int, faults: int) -> None:
        """What the tables of another stream held. ValueError where they have another shape."""
        for rows, table in [*zip(self._poses, poses, strict=True), (self._ranges, ranges)]:
            rows.restore(table)
        self.added, self.faults = added, faults
