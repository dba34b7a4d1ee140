"""What a solver is spared: most of what devices say so often.

Ranges of a pair that follow one another closely tell much the same: their errors are alike. A walk between two poses is
nearly straight. So no more than a thousand ranges and a thousand poses a second go to it, of each pair and each device
as many; and of a solver that falls behind each device and pair is told less often the further it is, until it has kept
up for a while. The recording has all of it.
"""

from __future__ import annotations

from synchronizar.live.solver_wire import Command, Pose, Range

MOST_RANGES, MOST_POSES = 1000, 1000
"""A second, of all pairs and of all devices."""
BEHIND_S, UP_S = 1.5, 1.0
"""s behind from which more is spared, and below which less is."""
MORE_EVERY, LESS_EVERY = 2.0, 10.0
"""s for which that has to last for each such step."""
POSES_S = (0.0, 1 / 30, 1 / 30, 1 / 15, 1 / 15, 1 / 15)
"""s at least between two poses of a device, by how far it has gone: half of 60 a second, a quarter of it."""
RANGES_S = (0.0, 0.1, 0.2, 0.4, 0.8, 1.6)
"""The same of a pair's ranges."""


class Sparing:
    """Decides what goes to one solver; times are the room's (s)."""

    def __init__(self) -> None:
        self.step = 0
        self._late_since: float | None = None
        self._up_since: float | None = None
        self._last: dict[str | tuple[str, str], float] = {}
        self._pairs = self._devices = 0

    def update(self, t: float, behind: float) -> bool:
        """It is `t`, and the solver is so far behind; whether another share is spared from now on."""
        before = self.step
        self._late_since = None if behind <= BEHIND_S else t if self._late_since is None else self._late_since
        self._up_since = None if behind >= UP_S else t if self._up_since is None else self._up_since
        if self._late_since is not None and t - self._late_since >= MORE_EVERY:
            self.step, self._late_since = min(self.step + 1, len(RANGES_S) - 1), t
        elif self._up_since is not None and t - self._up_since >= LESS_EVERY:
            self.step, self._up_since = max(self.step - 1, 0), t
        return self.step != before

    def takes(self, command: Command) -> bool:
        """Whether it goes to the solver."""
        match command:
            case Pose(user=user):
                self._devices += user not in self._last
                return self._is_due(user, command.t, max(self._devices / MOST_POSES, POSES_S[self.step]))
            case Range(a=a, b=b):
                pair = min(a, b), max(a, b)
                self._pairs += pair not in self._last
                return self._is_due(pair, command.t, max(self._pairs / MOST_RANGES, RANGES_S[self.step]))
            case _:
                return True

    def _is_due(self, of: str | tuple[str, str], t: float, every: float) -> bool:
        last = self._last.get(of)
        if last is not None and last <= t < last + 0.99 * every:
            return False
        self._last[of] = t
        return True
