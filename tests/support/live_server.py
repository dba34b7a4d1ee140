"""A server on the loopback, in this process."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from synchronizar.live.server import Server, ServerOptions


@asynccontextmanager
async def serving(**options: Any) -> AsyncIterator[tuple[Server, str]]:
    """The server, and the address of its room."""
    server = Server(ServerOptions(host="127.0.0.1", port=0, udp_port=0, tls=False, **options), None)
    try:
        where = await server.start()
        yield server, str(where["join"])
    finally:
        await server.close()
