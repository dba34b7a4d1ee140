"""What a device works out of its own clock and the room's, from words that go one way and the other."""

from __future__ import annotations

from collections import deque

WINDOW_S = 16.0
"""s over which the quickest word of each way is looked for."""


class RoundTrips:
    """Bounds of the room's clock minus the device's, by that nothing comes before it was said.

    What the room says bounds it from below, what it has answered from above; the middle is right where the quickest of
    both ways are alike. Each way by itself: where much is lost, one ping and its pong are hardly ever both quick.
    """

    def __init__(self) -> None:
        self._lower, self._upper = _Lowest(), _Lowest()

    def pong(self, t: float, room_t: float, now: float) -> None:
        """A pong to the ping of `t` came at `now`, both by the device's clock; `room_t` by the room's."""
        if self._lower.value is not None and room_t - t < -self._lower.value:
            self._lower.clear()
        self.heard(room_t, now)
        self._upper.take(now, room_t - t)

    def heard(self, room_t: float, now: float) -> None:
        """A word that the room said at `room_t`, by its clock, came at `now`, by the device's."""
        self._lower.take(now, now - room_t)
        if self._upper.value is not None and self._upper.value < room_t - now:
            self._upper.clear()  # bounds that contradict each other: the clock stood still meanwhile, or was set

    @property
    def offset(self) -> float | None:
        """s: the room's clock minus the device's; None before the first pong."""
        if self._upper.value is None or self._lower.value is None:
            return None
        return 0.5 * (self._upper.value - self._lower.value)

    @property
    def quickest(self) -> float | None:
        """s: the quickest ways there and back together."""
        if self._upper.value is None or self._lower.value is None:
            return None
        return self._upper.value + self._lower.value


class _Lowest:
    """The lowest value of the last while."""

    def __init__(self) -> None:
        self._kept: deque[tuple[float, float]] = deque()

    def take(self, t: float, value: float) -> None:
        if self._kept and t < self._kept[-1][0]:
            self.clear()  # the clock was set back
        while self._kept and self._kept[-1][1] >= value:
            self._kept.pop()
        self._kept.append((t, value))
        while self._kept[0][0] < t - WINDOW_S:
            self._kept.popleft()

    def clear(self) -> None:
        self._kept.clear()

    @property
    def value(self) -> float | None:
        return self._kept[0][1] if self._kept else None
