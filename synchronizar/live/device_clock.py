"""A device's clock against the room's.

A word arrives later than it was stamped, by a delay that is never below zero: the least of (arrival - stamp) over some
seconds is the room's clock minus the device's, too large by the least delay. A device that hears pongs knows a bound
from below, too small by the least delay of the other way: the middle of both is right where the ways are alike. What
remains, some milliseconds, is constant, and the solver's own to find.
"""

from __future__ import annotations

from collections import deque

WINDOW_S = 20.0
"""s over which the least delay is looked for."""
SLEWED = 0.002
"""s per s: how fast a small correction is brought in, so that stamps never run backwards."""
SETTLED_S = 5.0
"""s in which most of a large one is brought in: clocks that are compared over a bad network are known late."""
STEPPED = 0.25
"""s: two clocks do not part so far within the window, beyond a round trip; the device's clock was set anew."""
SILENT_S = 5.0
"""s: after such a silence words come that were said before it, and a device's clock may have stood still meanwhile."""
SURE_S = 2.0
"""s: so long what was known before a silence still counts, and then what came since."""
KNOWN_S, KNOWN_ROUND_TRIPS, KNOWN_AT_LAST_S = 0.3, 2.0, 1.5
"""s and round trips until the clock of a device that pings is known; s until it is taken for known in any case."""
ANOTHER_S = 10.0
"""s: no word of somebody who comes again is so late: it is stamped by another clock."""
ANEW_S, ANEW_WORDS = 1.0, 8
"""s and words in a row from the future, until the clock is believed to have been set: one such word is a mistake, and
believed it would make all that follow look old."""
_AT_FIRST_S = 2.0


class DeviceClock:
    """Converts a device's stamps to the room's clock."""

    def __init__(self) -> None:
        self.steps = 0
        """How often the device's clock was set anew."""
        self._least: deque[tuple[float, float]] = deque()
        self._lower: float | None = None
        self._round_trip = 0.0
        self._asked_at: float | None = None
        self._began: float | None = None
        self._offset: float | None = None
        self._at = 0.0
        self._again = False
        self._ahead, self._ahead_since = 0, 0.0

    def reconnect(self) -> None:
        """The device comes again, perhaps by another clock."""
        self._again = True

    def offer(self, offset: float, round_trip: float | None) -> None:
        """The device has worked out how far the room's clock is ahead of its own, within half of a round trip (s)."""
        self._round_trip = max(0.0, round_trip or 0.0)
        self._lower = offset - 0.5 * self._round_trip

    def asked(self, arrived: float) -> None:
        """The device has begun to ping: it will work out more soon."""
        if self._asked_at is None:
            self._asked_at = arrived

    def is_known(self, now: float) -> bool:
        """Whether stamps can be relied on; while it is new, a device that pings soon tells more than its words do."""
        if self._asked_at is None:
            return True
        waited = now - self._asked_at
        enough = KNOWN_S + KNOWN_ROUND_TRIPS * self._round_trip
        return waited >= KNOWN_AT_LAST_S or (self._lower is not None and waited >= enough)

    def convert(self, stamp: float) -> float:
        """The room's time of a word that was heard before, by what is known now."""
        return stamp + (self._offset or 0.0)

    def hear(self, stamp: float, arrived: float) -> float:
        """The room's time of a word that was stamped by the device and arrived at `arrived` (s, room's clock)."""
        delay = arrived - stamp
        if self._least and (self._again or arrived - self._at > SILENT_S):
            known = self._least[0][1]
            another = self._again and abs(delay - known) > ANOTHER_S
            self._least = deque([] if another else [(arrived + SURE_S - WINDOW_S, known)])
        self._again = False
        if self._is_future(delay, arrived):
            assert self._offset is not None
            return stamp + self._offset
        while self._least and self._least[-1][1] >= delay:
            self._least.pop()
        self._least.append((arrived, delay))
        while self._least[0][0] < arrived - WINDOW_S:
            self._least.popleft()
        target = self._target()
        if self._began is None:
            self._began = arrived
        if self._offset is None or arrived - self._began < _AT_FIRST_S:
            self._offset = target
        elif abs(target - self._offset) > STEPPED + self._round_trip:
            self._offset, self.steps, self._began = target, self.steps + 1, arrived
            self._least = deque([(arrived, delay)])
        else:
            off = target - self._offset
            most = max(SLEWED, abs(off) / SETTLED_S) * max(0.0, arrived - self._at)
            self._offset += min(most, max(-most, off))
        self._at = arrived
        return stamp + self._offset

    def _target(self) -> float:
        """The middle of what words of both ways allow; a bound from before the clock was set anew is none."""
        upper = self._least[0][1]
        if self._lower is None or not 0.0 <= upper - self._lower <= self._round_trip + STEPPED:
            return upper
        return 0.5 * (upper + self._lower)

    def _is_future(self, delay: float, arrived: float) -> bool:
        """Whether a word comes so long before it was said that it is wrong; where all do, the clock was set."""
        known = self._began is not None and arrived - self._began >= _AT_FIRST_S
        if not known or not self._least or self._offset is None or delay > self._offset - self._round_trip - STEPPED:
            self._ahead = 0
            return False
        if self._ahead == 0:
            self._ahead_since = arrived
        self._ahead += 1
        return self._ahead < ANEW_WORDS or arrived - self._ahead_since < ANEW_S
