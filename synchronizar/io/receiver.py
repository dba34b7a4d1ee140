"""A session's receiver: takes datagrams as they come, and converts them to ranges."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
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
from synchronizar.io.live_clock import LiveClock
from synchronizar.io.range_clock import RangeClock

MOST_WAITING = 256
"""Datagrams of one epoch that wait for its clock; the oldest is dropped for one more."""


class Stamped(NamedTuple):
    """A datagram whose ranges are stamped by the receiver's clock."""

    datagram: RangesDatagram
    t: Array
    """(n,) s: of each of its ranges."""


class Taken(NamedTuple):
    """A datagram that was taken."""

    datagram: RangesDatagram
    stamped: tuple[Stamped, ...]
    """Datagrams with ranges that are stamped now: usually this one. While an epoch's clock is new they wait for it, for
    half a second, and come all at once; each comes once."""


@dataclass
class Reporter:
    """What one reporter has sent with its own key."""

    heard: float = 0.0
    """s, receiver's clock: arrival of the latest datagram that was taken."""
    datagrams: int = 0
    """Number of datagrams that were taken."""
    ranges: int = 0
    """Number of ranges in them."""
    dropped: int = 0
    """Number of ranges that it dropped by its own count, over all its restarts."""
    refused: Counter[str] = field(default_factory=Counter)
    """Number of datagrams that its tag was right for and that were refused all the same, by reason."""
    window: Window = field(default_factory=Window)
    start: int = -1
    """Its latest restart."""
    dropped_since: int = 0
    """Part of `dropped` since then."""

    def count(self, datagram: RangesDatagram, arrived: float) -> None:
        """Count a datagram that was taken."""
        self.heard = arrived
        self.datagrams += 1
        self.ranges += len(datagram.ranges)
        if (start := datagram.sequence >> 32) > self.start:
            self.start, self.dropped_since = start, 0
        if start == self.start and datagram.dropped > self.dropped_since:
            self.dropped += datagram.dropped - self.dropped_since
            self.dropped_since = datagram.dropped


class Receiver:
    """Takes the datagrams of one session, in any order, each once; no input makes it fail, and its memory is bounded.

    `key_of` knows the keys of the session's reporters.
    """

    def __init__(self, key_of: KeyOf) -> None:
        self.refused: Counter[str] = Counter()
        """Number of refused datagrams by reason: that of WireError; `sequence` for one that came before or is too old,
        `future` for one that tells of a time that has not come."""
        self.reporters: dict[int, Reporter] = {}
        """All that a right tag was seen of, by address."""
        self.unstamped = 0
        """Number of datagrams with ranges that were dropped while they waited for their clock."""
        self._key_of = key_of
        self._clock = LiveClock()
        self._waiting: dict[int, deque[RangesDatagram]] = {}

    @property
    def datagrams(self) -> int:
        """Number of datagrams that were taken."""
        return sum(reporter.datagrams for reporter in self.reporters.values())

    @property
    def dropped(self) -> int:
        """Number of ranges that reporters dropped by their own count, over all their restarts."""
        return sum(reporter.dropped for reporter in self.reporters.values())

    def sequences(self) -> dict[int, int]:
        """The newest sequence of each reporter: what `go_on` needs."""
        return {address: reporter.window.newest for address, reporter in self.reporters.items()}

    def go_on(self, sequences: Mapping[int, int]) -> None:
        """After a restart: what reporters had sent until then is not taken again, if somebody kept it."""
        for address, newest in sequences.items():
            self.reporters[address] = Reporter(window=Window(newest))

    def take(self, datagram: bytes, arrived: float) -> Taken | None:
        """The datagram, decoded, that arrived at `arrived` (s, receiver's clock); None where it is refused."""
        try:
            decoded = decode_ranges(datagram, self._key_of)
        except WireError as error:
            self.refused[str(error)] += 1
            return None
        reporter = self.reporters.setdefault(decoded.reporter, Reporter())
        reason = None
        time_ns = times_ns(decoded)
        if not reporter.window.take(decoded.sequence):
            reason = "sequence"
        elif len(time_ns) and not self._clock.hear(decoded.epoch, decoded.reporter, int(time_ns.max()), arrived):
            reason = "future"
        if reason is not None:
            self.refused[reason] += 1
            reporter.refused[reason] += 1
            return None
        reporter.count(decoded, arrived)
        return Taken(decoded, self._stamped(decoded, time_ns))

    def _stamped(self, datagram: RangesDatagram, time_ns: NDArray[np.int64]) -> tuple[Stamped, ...]:
        """All that can be stamped now that this one came."""
        epoch = datagram.epoch
        if not len(time_ns):
            return ()  # a greeting has not waited for others as ranges have: its delay says nothing of theirs
        if not self._clock.is_set(epoch):
            self._wait(datagram)
            return ()
        waiting = [Stamped(one, self._clock.seconds(epoch, times_ns(one))) for one in self._waiting.pop(epoch, ())]
        return (*waiting, Stamped(datagram, self._clock.seconds(epoch, time_ns)))

    def _wait(self, datagram: RangesDatagram) -> None:
        """Keep a datagram until its epoch's clock is set."""
        for epoch in [epoch for epoch in self._waiting if not self._clock.knows(epoch)]:
            self.unstamped += len(self._waiting.pop(epoch))
        waiting = self._waiting.setdefault(datagram.epoch, deque(maxlen=MOST_WAITING))
        self.unstamped += len(waiting) == MOST_WAITING
        waiting.append(datagram)


def times_ns(datagram: RangesDatagram) -> NDArray[np.int64]:
    """(n,) ns by the clock of its epoch: when each range was measured."""
    return datagram.time_ns + 1000 * datagram.ranges["offset_us"].astype(np.int64)


def stamp_all(datagrams: Sequence[RangesDatagram], arrived: Sequence[float]) -> list[Stamped]:
    """All datagrams of a recording with ranges, stamped by the one line that fits all (RangeClock), by arrival (s)."""
    kept = [i for i, datagram in enumerate(datagrams) if len(datagram.ranges)]
    if not kept:
        return []
    told = [datagrams[i] for i in kept]
    times = [times_ns(datagram) for datagram in told]
    epoch = np.array([datagram.epoch for datagram in told], dtype=np.uint32)
    newest = np.array([of.max() for of in times])
    clock = RangeClock(epoch, newest, np.array([arrived[i] for i in kept], dtype=float))
    count = [len(of) for of in times]
    seconds = clock.seconds(np.repeat(epoch, count), np.concatenate(times))
    return [Stamped(*one) for one in zip(told, np.split(seconds, np.cumsum(count)[:-1]), strict=True)]


def ranges_of(stamped: Sequence[Stamped], users: Sequence[User], names: Mapping[int, str]) -> Ranges:
    """Ranges between two of these users, sorted by time; `names` are those of users, by address.

    Failed and doubtful measurements are left out: the device that measured reports a fault, and others follow. A user's
    antenna is the only one that it declares. Raises ValueError where it declares several.
    """
    if not stamped:
        none = np.zeros(0, dtype=np.int32)
        return Ranges.of(np.zeros(0), none, none, np.zeros(0))
    t = np.concatenate([one.t for one in stamped])
    measured = np.concatenate([one.datagram.ranges for one in stamped])
    reporter = np.repeat([one.datagram.reporter for one in stamped], [len(one.t) for one in stamped])
    index_of = _indices(users, names)
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


def _indices(users: Sequence[User], names: Mapping[int, str]) -> Indices:
    """(addresses,) index in `users` of every address; -1 where it has none."""
    index_of = {user.name: u for u, user in enumerate(users)}
    indices = np.full(LAST_ADDRESS + 1, -1, dtype=np.int32)
    for address, name in names.items():
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
