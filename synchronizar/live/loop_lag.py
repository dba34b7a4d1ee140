"""How late the server's loop comes to what is due: whether one machine is still enough."""

from __future__ import annotations

import asyncio
from collections import deque

from synchronizar.live.messages import Lag

_EVERY_S = 0.01
_KEPT_S = 60.0


class LoopLag:
    """Lateness of a task that is due a hundred times a second, over the last minute."""

    def __init__(self) -> None:
        self._late: deque[float] = deque(maxlen=round(_KEPT_S / _EVERY_S))

    async def run(self) -> None:
        """Watch until it is cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            due = loop.time() + _EVERY_S
            await asyncio.sleep(_EVERY_S)
            self.note(loop.time() - due)

    def note(self, late: float) -> None:
        """It was late by so much (s)."""
        self._late.append(late)

    def told(self) -> Lag:
        """In ms; zeros before anything was noted."""
        late = sorted(self._late) or [0.0]
        median, most = (max(0.0, 1000.0 * late[int(share * (len(late) - 1))]) for share in (0.5, 0.99))
        return Lag(median, most)
