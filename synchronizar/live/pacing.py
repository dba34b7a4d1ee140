"""How often a solver is asked: so often that there is time left for others on its core."""

from __future__ import annotations

from math import inf

SHARE = 0.5
"""Of a core at most for what is asked, as one question comes after another, ..."""
RARELY_S = 0.5
"""... but no question waits for longer."""


class Pacing:
    """When one solver is asked next. Times s."""

    def __init__(self) -> None:
        self._took, self._next = 0.0, -inf

    def answered(self, took: float) -> None:
        """An answer took so long to find."""
        self._took = took

    def is_due(self, t: float) -> bool:
        """Whether a question is due at `t`; it counts as asked then."""
        if t < self._next:
            return False
        self._next = t + min(self._took / SHARE, RARELY_S)
        return True
