"""A session's collector: takes datagrams, and turns what they tell into ranges."""

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
    """Takes the datagrams of one session, in any order, each once; nothing that comes in makes it fail.

    `users` are the names of those whose addresses are known.
    """

    def __init__(self, session: int, key: bytes, users: Mapping[int, str]) -> None:
        self.refused: Counter[str] = Counter()
        """How many datagrams were not taken, by the reason: that of WireError, `session` for another one's, `sequence`
        for one that came before or is too old."""
        self._session, self._key, self._users = session, key, dict(users)
        self._windows: defaultdict[int, Window] = defaultdict(Window)
        self._dropped: dict[tuple[int, int], int] = {}
        self._taken: list[_Taken] = []

    @property
    def dropped(self) -> int:
        """How many ranges reporters have told that they dropped, over all their restarts."""
        return sum(self._dropped.values())

    def take(self, datagram: bytes, arrived: float) -> RangesDatagram | None:
        """What a datagram tells that came in at `arrived` (s, the receiver's clock); None where it is refused."""
        try:
            said = self._checked(datagram)
        except WireError as error:
            self.refused[str(error)] += 1
            return None
        start = said.reporter, said.sequence >> 32
        self._dropped[start] = max(self._dropped.get(start, 0), said.dropped)
        if len(said.ranges):
            self._taken.append(_Taken(said, arrived))
        return said

    def newest(self) -> Array:
        """(m,) s, the receiver's clock: stamp of the newest range in each datagram taken that has any, as they came."""
        if not self._taken:
            return np.zeros(0)
        t, _, begin = self._stamps()
        return np.asarray(np.maximum.reduceat(t, begin))

    def ranges(self, users: Sequence[User]) -> Ranges:
        """All that was taken so far between two of these users, by time, stamped by the receiver's clock.

        Failed measurements are left out, and doubtful ones: who measured says that something is wrong, and there are
        always others. A user's antenna is the only one it declares. Raises ValueError where one declares several.
        """
        if not self._taken:
            none = np.zeros(0, dtype=np.int32)
            return Ranges.of(np.zeros(0), none, none, np.zeros(0))
        said = np.concatenate([taken.datagram.ranges for taken in self._taken])
        t, reporter, _ = self._stamps()
        index_of = self._indices(users)
        a, b = index_of[reporter], index_of[said["peer"]]
        kept = np.flatnonzero((said["status"] == MEASURED) & (a >= 0) & (b >= 0) & (a != b))
        kept = kept[np.argsort(t[kept], kind="stable")]
        said, t, a, b = said[kept], t[kept], a[kept], b[kept]
        antenna = _only_antennas(users)
        return Ranges.of(
            t,
            a,
            b,
            said["distance_mm"] / 1000.0,
            sigma=_known(said["sigma_mm"], UNKNOWN_SIGMA) / 1000.0,
            antenna_a=antenna[a],
            antenna_b=antenna[b],
            rx_power=_known(said["rx_power_cdbm"], UNKNOWN_POWER) / 100.0,
            fp_power=_known(said["fp_power_cdbm"], UNKNOWN_POWER) / 100.0,
            nlos=_known(said["sight"], SIGHT_UNKNOWN),
            source=said["source"].astype(np.int32),
        )

    def _checked(self, datagram: bytes) -> RangesDatagram:
        said = decode_ranges(datagram, self._key)
        if said.session != self._session:
            raise WireError("session")
        if not self._windows[said.reporter].take(said.sequence):
            raise WireError("sequence")
        return said

    def _stamps(self) -> tuple[Array, NDArray[np.uint16], NDArray[np.intp]]:
        """Of all ranges (n,): s by the receiver's clock, and whose they are; and where each datagram's begin (m,)."""
        said = [taken.datagram for taken in self._taken]
        count = np.array([len(datagram.ranges) for datagram in said])
        begin = np.concatenate([[0], np.cumsum(count)[:-1]])
        epoch = np.array([datagram.epoch for datagram in said], dtype=np.uint32)
        reporter = np.array([datagram.reporter for datagram in said], dtype=np.uint16)
        arrived = np.array([taken.arrived for taken in self._taken], dtype=float)
        begin_ns = np.array([datagram.time_ns for datagram in said], dtype=np.int64)
        offset_us = np.concatenate([datagram.ranges["offset_us"] for datagram in said])
        time_ns = np.repeat(begin_ns, count) + 1000 * offset_us.astype(np.int64)
        clock = RangeClock(epoch, np.maximum.reduceat(time_ns, begin), arrived)
        return clock.seconds(np.repeat(epoch, count), time_ns), np.repeat(reporter, count), begin

    def _indices(self, users: Sequence[User]) -> Indices:
        """Of every address the index in `users`; -1 for those that are nobody's."""
        index_of = {user.name: u for u, user in enumerate(users)}
        indices = np.full(LAST_ADDRESS + 1, -1, dtype=np.int32)
        for address, name in self._users.items():
            indices[address] = index_of.get(name, -1)
        return indices


def _known(column: NDArray[np.integer], unknown: int) -> Array:
    """As numbers, NaN where unknown."""
    return np.where(column == unknown, np.nan, column.astype(float))


def _only_antennas(users: Sequence[User]) -> Indices:
    """(k,) 0 for users that declare an antenna, -1 for those that declare none."""
    if several := [user.name for user in users if len(user.antennas) > 1]:
        raise ValueError(f"{several[0]} has several antennas: a module has one")
    return np.array([len(user.antennas) - 1 for user in users], dtype=np.int32)
