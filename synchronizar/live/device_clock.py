"""A device's clock against the room's.

A word arrives later than it was stamped, by a delay that is never below zero: the least of (arrival - stamp) over some
seconds is the room's clock minus the device's, too large by the least delay. A device that answers pings knows half of
its round trip and takes that out. What remains, some milliseconds, is constant, and the solver's own to find.
"""

from __future__ import annotations

from collections import deque

WINDOW_S = 20.0
"""s over which the least delay is looked for."""
SLEWED = 0.002
"""s per s: how fast a correction is brought in, so that stamps never run backwards."""
STEPPED = 0.25
"""s: two clocks do not part so far within the window; the device's clock was set anew."""
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
        self._offered: float | None = None
        self._began: float | None = None
        self._offset: float | None = None
        self._at = 0.0
        self._ahead, self._ahead_since = 0, 0.0

    def reconnect(self) -> None:
        """The device comes again, perhaps by another clock: what its earlier words allowed counts no more."""
        self._least.clear()
        self._offered = None

    def offer(self, offset: float) -> None:
        """The device has worked out how far the room's clock is ahead of its own (s)."""
        self._offered = offset

    def hear(self, stamp: float, arrived: float) -> float:
        """The room's time of a word that was stamped by the device and arrived at `arrived` (s, room's clock)."""
        delay = arrived - stamp
        if self._is_future(delay, arrived):
            assert self._offset is not None
            return stamp + self._offset
        while self._least and self._least[-1][1] >= delay:
            self._least.pop()
        self._least.append((arrived, delay))
        while self._least[0][0] < arrived - WINDOW_S:
            self._least.popleft()
        # What a device says of its own clock can be no more than its words allow: none arrives before it was said.
        target = self._least[0][1]
        if self._offered is not None and target - STEPPED < self._offered:
            target = min(target, self._offered)
        if self._began is None:
            self._began = arrived
        if self._offset is None or arrived - self._began < _AT_FIRST_S:
            self._offset = target
        elif abs(target - self._offset) > STEPPED:
            self._offset, self.steps, self._began = target, self.steps + 1, arrived
            self._least = deque([(arrived, delay)])
        else:
            most = SLEWED * max(0.0, arrived - self._at)
            self._offset += min(most, max(-most, target - self._offset))
        self._at = arrived
        return stamp + self._offset

    def _is_future(self, delay: float, arrived: float) -> bool:
        """Whether a word comes so long before it was said that it is wrong; where all do, the clock was set."""
        known = self._began is not None and arrived - self._began >= _AT_FIRST_S
        if not known or not self._least or self._offset is None or delay > self._offset - STEPPED:
            self._ahead = 0
            return False
        if self._ahead == 0:
            self._ahead_since = arrived
        self._ahead += 1
        return self._ahead < ANEW_WORDS or arrived - self._ahead_since < ANEW_S
