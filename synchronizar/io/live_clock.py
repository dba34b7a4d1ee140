"""One range clock as datagrams come: stamps of all networks' clocks converted to the receiver's clock, at once.

As in `range_clock`, a datagram comes in later than its newest range was measured, so the receiver's time over an
epoch's is a straight line that no datagram lies below. Here each reporter of an epoch has a line of its own: of each
second its datagram of the least delay is kept, the slope is that of the line below those of some minutes, the height
that of the newest half minute. So memory is bounded, and a datagram costs no more after hours than after seconds.

The epoch's line is the lowest of its reporters' lines, and from three reporters on the second lowest: one of them that
tells wrong times cannot move it beyond what the others tell. What is told follows that line without a jump, by SLEW at
most; so stamps of an epoch rise with its times. While an epoch is new its line still falls: it is set after half a
second, and nothing is stamped before.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from synchronizar.arrays import Array
from synchronizar.io.range_clock import line_below

BUCKET_S = 1.0
"""s: of each such span the datagram of the least delay is kept."""
SKEW_S = 300.0
"""s: over which the skew is fitted. Longer, and crystals drift by temperature (1 ppm in an hour: 6 us within it)."""
HEIGHT_S = 30.0
"""s: over which the least delay is looked for; busy spells of Wi-Fi are shorter (assumed). A skew that is wrong, as
after a change of all delays, makes stamps wrong by MAX_SKEW times this at most, 3 ms."""
FIT_EVERY = 10
"""Buckets between fits of the skew, once there are twice as many."""
SLEW = 2e-3
"""s a second: how fast told stamps approach the line. A distance changes by 3 mm/s by it at a walk."""
SET_S, SET_DATAGRAMS, SET_AT_LAST_S = 0.5, 4, 2.0
"""s and datagrams since its first until an epoch's clock is set; s until it is in any case."""
FUTURE_S = 0.5
"""s: a datagram so much earlier than its reporter's line was measured in the future: it is refused."""
ANEW_S, ANEW_DATAGRAMS = 1.0, 8
"""s and datagrams in a row from the future, until the clock is believed to have jumped, and its line begins anew (a
computer that slept: its clock stood still meanwhile)."""
FORGET_S = 600.0
"""s: an epoch or reporter unheard of for so long is forgotten."""
MOST_EPOCHS = 8
"""Epochs of one reporter that are kept, the newest."""


class LiveClock:
    """Converts times of every epoch to the receiver's clock as datagrams come, in bounded memory."""

    def __init__(self) -> None:
        self._epochs: dict[int, _Epoch] = {}
        self._tidied = -np.inf

    def __len__(self) -> int:
        """Number of epochs that are kept."""
        return len(self._epochs)

    def hear(self, epoch: int, reporter: int, newest_ns: int, arrived: float) -> bool:
        """A datagram came: time of its newest range by its epoch's clock (ns), arrival by the receiver's (s).

        False where that time lies in the future, by the reporter's own datagrams before: then it counts for nothing.
        """
        self._tidy(arrived)
        if epoch not in self._epochs:
            self._make_room(reporter)
            self._epochs[epoch] = _Epoch(newest_ns, arrived)
        return self._epochs[epoch].hear(reporter, newest_ns, arrived)

    def knows(self, epoch: int) -> bool:
        """Whether the epoch has been heard of, and not been forgotten."""
        return epoch in self._epochs

    def is_set(self, epoch: int) -> bool:
        """Whether stamps of the epoch can be told."""
        return epoch in self._epochs and self._epochs[epoch].is_set

    def seconds(self, epoch: int, time_ns: NDArray[np.int64]) -> Array:
        """(n,) s by the receiver's clock, of times (n,) ns of an epoch that is set."""
        return self._epochs[epoch].seconds(time_ns)

    def _tidy(self, now: float) -> None:
        """Forget what was unheard of for FORGET_S."""
        if now - self._tidied < FORGET_S / 10.0:
            return
        self._tidied = now
        for known in self._epochs.values():
            known.forget(now - FORGET_S)
        self._epochs = {epoch: known for epoch, known in self._epochs.items() if known.floors}

    def _make_room(self, reporter: int) -> None:
        """Forget what the reporter told of its oldest epochs, for one more."""
        of_it = [epoch for epoch, known in self._epochs.items() if reporter in known.floors]
        of_it.sort(key=lambda epoch: self._epochs[epoch].floors[reporter].heard)
        for epoch in of_it[: max(len(of_it) + 1 - MOST_EPOCHS, 0)]:
            del self._epochs[epoch].floors[reporter]
            if not self._epochs[epoch].floors:
                del self._epochs[epoch]


@dataclass
class _Floor:
    """The line below one reporter's datagrams in one epoch: `height` + `skew` x."""

    skew: float = 0.0
    height: float = np.inf
    heard: float = -np.inf
    """s, receiver's clock: latest arrival."""
    x: deque[float] = field(default_factory=deque)
    """s by the epoch's clock: of each bucket the datagram of the least delay, the newest last."""
    y: deque[float] = field(default_factory=deque)
    """s: its arrival minus x."""
    ahead: int = 0
    """Datagrams from the future in a row, since `ahead_since` (s)."""
    ahead_since: float = 0.0
    closed: int = 0
    """Buckets so far."""

    def at(self, x: float) -> float:
        return self.height + self.skew * x

    def behind(self, arrived: float) -> float:
        """s: arrival minus x on the line, at an arrival."""
        return arrived - (arrived - self.height) / (1.0 + self.skew)

    def is_future(self, x: float, arrived: float) -> bool:
        """Whether a datagram lies so far below the line that its time is wrong; begins anew where all do."""
        if arrived - x >= self.at(x) - FUTURE_S or not self.x:
            self.ahead = 0
            return False
        if self.ahead == 0:
            self.ahead_since = arrived
        self.ahead += 1
        if self.ahead < ANEW_DATAGRAMS or arrived - self.ahead_since < ANEW_S:
            return True
        self.x.clear()
        self.y.clear()
        self.skew, self.height, self.ahead, self.closed = 0.0, np.inf, 0, 0
        return False

    def add(self, x: float, y: float, arrived: float) -> bool:
        """Take a datagram into account; whether the line has changed."""
        self.heard = arrived
        if not self.x or x // BUCKET_S > self.x[-1] // BUCKET_S:
            self.x.append(x)
            self.y.append(y)
            self._close(x)
            return True
        above = y - self.skew * x
        if above < self.y[-1] - self.skew * self.x[-1] and x // BUCKET_S == self.x[-1] // BUCKET_S:
            self.x[-1], self.y[-1] = x, y
        if above < self.height:
            self.height = above
            return True
        return False

    def _close(self, newest: float) -> None:
        """A bucket has begun: forget the oldest, and fit the line anew where that is due."""
        self.closed += 1
        while self.x[0] < newest - SKEW_S:
            self.x.popleft()
            self.y.popleft()
        n = len(self.x)
        if n > 2 and (n <= 2 * FIT_EVERY or self.closed % FIT_EVERY == 0):
            self.skew = line_below(np.array(self.x), np.array(self.y)).skew
        self.height = np.inf
        for x, y in zip(reversed(self.x), reversed(self.y), strict=True):
            if x < newest - HEIGHT_S:
                break
            self.height = min(self.height, y - self.skew * x)


class _Epoch:
    """One network's clock, and the line by which its stamps are told."""

    def __init__(self, base_ns: int, arrived: float) -> None:
        self.floors: dict[int, _Floor] = {}
        self.is_set = False
        self._base_ns, self._first, self._datagrams = base_ns, arrived, 0
        # Told: `_offset` at `_x`, from there on rising by `_skew`, with `_error` still to be made up for.
        self._x, self._offset, self._skew, self._error = 0.0, 0.0, 0.0, 0.0

    def hear(self, reporter: int, newest_ns: int, arrived: float) -> bool:
        x = 1e-9 * (newest_ns - self._base_ns)
        floor = self.floors.setdefault(reporter, _Floor())
        if self.is_set and floor.is_future(x, arrived):
            return False
        self._datagrams += 1
        if floor.add(x, arrived - x, arrived):
            self._aim(x, arrived)
        since = arrived - self._first
        self.is_set |= since >= SET_AT_LAST_S or (since >= SET_S and self._datagrams >= SET_DATAGRAMS)
        return True

    def seconds(self, time_ns: NDArray[np.int64]) -> Array:
        x = 1e-9 * (time_ns - self._base_ns).astype(float)
        since = x - self._x
        most = SLEW * np.maximum(since, 0.0)
        return np.asarray(x + self._offset + self._skew * since + np.clip(self._error, -most, most))

    def forget(self, before: float) -> None:
        """Forget reporters unheard of since `before` (s, receiver's clock)."""
        self.floors = {reporter: floor for reporter, floor in self.floors.items() if floor.heard >= before}

    def _aim(self, x: float, arrived: float) -> None:
        """Tell stamps from x on, or from now on, towards the line of those reporters that are heard."""
        heard = (floor for floor in self.floors.values() if floor.heard >= arrived - HEIGHT_S)
        lines = sorted(heard, key=lambda floor: floor.behind(arrived))
        line = lines[1 if len(lines) > 2 else 0]
        now = arrived - line.behind(arrived)
        if self.is_set:
            # A wrong time of one reporter is no moment of the others' clock.
            present = self._x + (arrived - self._x - self._offset) / (1.0 + self._skew)
            at = max(min(x, present), self._x)
            told = self._told(at)
            error = line.at(at) - told
        if not self.is_set or abs(error) > FUTURE_S:
            at = min(x, now)
            told, error = line.at(at), 0.0
        self._x, self._offset, self._skew, self._error = at, told, line.skew, error

    def _told(self, x: float) -> float:
        """s: arrival minus x, as told at x, not before `_x`."""
        since = x - self._x
        most = SLEW * max(since, 0.0)
        return self._offset + self._skew * since + min(max(self._error, -most), most)
