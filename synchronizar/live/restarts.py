"""When a process that has ended by itself is begun again: at once at first, ever later while it ends again."""

from __future__ import annotations

from collections.abc import Callable

FIRST_WAIT_S, LONGEST_WAIT_S = 0.05, 30.0
"""Each wait is twice the one before: the eleventh in a row is the longest."""
CALM_S = 10.0
"""Who has worked for so long is well again."""
TOLD_FROM_S = 1.0
"""Waits of that and more are a trouble that people should know of."""
_BARREN = 3


class Restarts:
    """How often in a row it ended; `clock` (s) goes forwards."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self.all = 0
        self.in_a_row = 0
        self._clock = clock
        self._works_since: float | None = None
        self._barren = 0

    def began(self) -> None:
        """A process was begun."""
        self._works_since = None

    def works(self) -> bool:
        """It has answered what came after its beginning; whether that is news."""
        news, self._barren = self._works_since is None, 0
        if self._works_since is None:
            self._works_since = self._clock()
        return news

    def ended(self) -> float:
        """It ended by itself; how long (s) it is left alone."""
        calm = self._works_since is not None and self._clock() - self._works_since >= CALM_S
        self.all += 1
        self.in_a_row = 1 if calm else self.in_a_row + 1
        self._barren += self._works_since is None
        return min(LONGEST_WAIT_S, FIRST_WAIT_S * 2.0 ** min(self.in_a_row - 1, 30))

    @property
    def blames_what_came(self) -> bool:
        """Whether it may be what it is told that makes it end: every third time in a row without an answer."""
        return self._barren > 0 and self._barren % _BARREN == 0
