"""A server on the loopback for as long as a test needs it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any

from synchronizar.live.server import Server, ServerOptions


@asynccontextmanager
async def serving(**options: Any) -> AsyncIterator[tuple[Server, str]]:
    """The server, and the address to join its first room by."""
    server = Server(ServerOptions(host="127.0.0.1", port=0, udp_port=0, tls=False, **options), None)
    try:
        where = await server.start()
        yield server, str(where["join"])
    finally:
        await server.close()


def run(test: Callable[[], Coroutine[Any, Any, None]]) -> None:
    """Run it, for two minutes at most."""
    asyncio.run(asyncio.wait_for(test(), 120.0))
