"""A server on the loopback for as long as a test needs it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any

from synchronizar.live.server import Server, ServerOptions


@asynccontextmanager
async def serving(clock: Callable[[], float] | None = None, **options: Any) -> AsyncIterator[tuple[Server, str]]:
    """The server, and the address to join its first room by."""
    server = Server(ServerOptions(host="127.0.0.1", port=0, udp_port=0, tls=False, **options), None, clock=clock)
    try:
        where = await server.start()
        yield server, str(where["join"])
    finally:
        await server.close()


class PatientClock:
    """s: goes on with the wall's, but for what this process was kept from running: then it stands still."""

    _MOST_S = 0.05

    def __init__(self) -> None:
        self._t, self._asked = 1000.0, time.monotonic()

    def __call__(self) -> float:
        now = time.monotonic()
        self._t += min(now - self._asked, self._MOST_S)
        self._asked = now
        return self._t


def run(test: Callable[[], Coroutine[Any, Any, None]]) -> None:
    """Run it, for five minutes at most: so that it ends, on whatever machine."""
    asyncio.run(asyncio.wait_for(test(), 300.0))
