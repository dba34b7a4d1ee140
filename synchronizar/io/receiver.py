"""A session's receiver: collects datagrams and converts them to ranges."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from synchronizar.arrays import Array, Indices
from synchronizar.data.ranges import Ranges
from synchronizar.data.user import User
from synchronizar.io.datagrams import (
    LAST_ADDRESS,
    MEASURED,
    SIGHT_UNKNOWN,
    UNKNOWN_POWER,
    UNKNOWN_SIGMA,
    KeyOf,
    RangesDatagram,
    Window,
    WireError,
    decode_ranges,
)
from synchronizar.io.range_clock import RangeClock


class _Taken(NamedTuple):
    datagram: RangesDatagram
    arrived: float


class Receiver:
    """Collects the datagrams of one session, in any order, each once; no input makes it fail.

    `key_of` knows the keys of the session's reporters; `users` are the names of users by address.
    """

    def __init__(self, key_of: KeyOf, users: Mapping[int, str]) -> None:
        self.refused: Counter[str] = Counter()
        """Number of refused datagrams by reason: that of WireError, `sequence` for one that came before or is too
        old."""
        self._key_of, self._users = key_of, dict(users)
        self._windows: defaultdict[int, Window] = defaultdict(Window)
        self._dropped: dict[tuple[int, int], int] = {}
        self._taken: list[_Taken] = []

    @property
    def dropped(self) -> int:
        """Number of ranges that reporters dropped by their own count, over all their restarts."""
        return sum(self._dropped.values())

    def take(self, datagram: bytes, arrived: float) -> RangesDatagram | None:
        """The datagram, decoded, that arrived at `arrived` (s, receiver's clock); None where it is refused."""
        try:
            decoded = self._checked(datagram)
        except WireError as error:
            self.refused[str(error)] += 1
            return None
        start = decoded.reporter, decoded.sequence >> 32
        self._dropped[start] = max(self._dropped.get(start, 0), decoded.dropped)
        if len(decoded.ranges):
            self._taken.append(_Taken(decoded, arrived))
        return decoded

    def newest(self) -> Array:
        """(m,) s, receiver's clock: stamp of the newest range in each collected datagram that has any, by arrival."""
        if not self._taken:
            return np.zeros(0)
        t, _, begin = self._stamps()
        return np.asarray(np.maximum.reduceat(t, begin))

    def ranges(self, users: Sequence[User]) -> Ranges:
        """All ranges so far between two of these users, sorted by time, stamped by the receiver's clock.

        Failed and doubtful measurements are left out: the device that measured reports a fault, and others follow.
        A user's antenna is the only one that it declares. Raises ValueError where it declares several.
        """
        if not self._taken:
            none = np.zeros(0, dtype=np.int32)
            return Ranges.of(np.zeros(0), none, none, np.zeros(0))
        measured = np.concatenate([taken.datagram.ranges for taken in self._taken])
        t, reporter, _ = self._stamps()
        index_of = self._indices(users)
        a, b = index_of[reporter], index_of[measured["peer"]]
        kept = np.flatnonzero((measured["status"] == MEASURED) & (a >= 0) & (b >= 0) & (a != b))
        kept = kept[np.argsort(t[kept], kind="stable")]
        measured, t, a, b = measured[kept], t[kept], a[kept], b[kept]
        antenna = _only_antennas(users)
        return Ranges.of(
            t,
            a,
            b,
            measured["distance_mm"] / 1000.0,
            sigma=_known(measured["sigma_mm"], UNKNOWN_SIGMA) / 1000.0,
            antenna_a=antenna[a],
            antenna_b=antenna[b],
            rx_power=_known(measured["rx_power_cdbm"], UNKNOWN_POWER) / 100.0,
            fp_power=_known(measured["fp_power_cdbm"], UNKNOWN_POWER) / 100.0,
            nlos=_known(measured["sight"], SIGHT_UNKNOWN),
            source=measured["source"].astype(np.int32),
        )

    def _checked(self, datagram: bytes) -> RangesDatagram:
        """The datagram, decoded. Raises WireError where it is refused."""
        decoded = decode_ranges(datagram, self._key_of)
        if not self._windows[decoded.reporter].take(decoded.sequence):
            raise WireError("sequence")
        return decoded

    def _stamps(self) -> tuple[Array, NDArray[np.uint16], NDArray[np.intp]]:
        """Stamps (n,) s by the receiver's clock, reporters (n,), and index of each datagram's first range (m,)."""
        datagrams = [taken.datagram for taken in self._taken]
        count = np.array([len(datagram.ranges) for datagram in datagrams])
        begin = np.concatenate([[0], np.cumsum(count)[:-1]])
        epoch = np.array([datagram.epoch for datagram in datagrams], dtype=np.uint32)
        reporter = np.array([datagram.reporter for datagram in datagrams], dtype=np.uint16)
        arrived = np.array([taken.arrived for taken in self._taken], dtype=float)
        begin_ns = np.array([datagram.time_ns for datagram in datagrams], dtype=np.int64)
        offset_us = np.concatenate([datagram.ranges["offset_us"] for datagram in datagrams])
        time_ns = np.repeat(begin_ns, count) + 1000 * offset_us.astype(np.int64)
        clock = RangeClock(epoch, np.maximum.reduceat(time_ns, begin), arrived)
        return clock.seconds(np.repeat(epoch, count), time_ns), np.repeat(reporter, count), begin

    def _indices(self, users: Sequence[User]) -> Indices:
        """(addresses,) index in `users` of every address; -1 where it has none."""
        index_of = {user.name: u for u, user in enumerate(users)}
        indices = np.full(LAST_ADDRESS + 1, -1, dtype=np.int32)
        for address, name in self._users.items():
            indices[address] = index_of.get(name, -1)
        return indices


def _known(column: NDArray[np.integer], unknown: int) -> Array:
    """(n,) numbers; NaN where unknown."""
    return np.where(column == unknown, np.nan, column.astype(float))


def _only_antennas(users: Sequence[User]) -> Indices:
    """(k,) 0 for users that declare an antenna, -1 for those that declare none."""
    if several := [user.name for user in users if len(user.antennas) > 1]:
        raise ValueError(f"{several[0]} has several antennas: a module has one")
    return np.array([len(user.antennas) - 1 for user in users], dtype=np.int32)
