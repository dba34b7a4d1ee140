"""A TCP proxy on the loopback that delays and stalls what goes through it, each way in its order, by a seed."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

import numpy as np


class BadProxy:
    """Between clients and a server at `port`."""

    def __init__(self, port: int, seed: int, loss: float, delay: float, jitter: float, again: float) -> None:
        """`loss`: share of what is read at once that waits `again` (s) longer, as if it had to be sent again."""
        self._port, self._loss, self._delay, self._jitter, self._again = port, loss, delay, jitter, again
        self._random = np.random.default_rng(seed)
        self._tasks: set[asyncio.Task[None]] = set()
        self._writers: set[asyncio.StreamWriter] = set()
        self.stalls = 0

    async def connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._port)
        self._writers |= {writer, far_writer}
        await asyncio.gather(self._pump(reader, far_writer), self._pump(far_reader, writer))

    async def _pump(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        waiting: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()
        sending = asyncio.create_task(self._send(waiting, sink))
        with suppress(ConnectionError):
            while data := await source.read(1400):
                wait = self._delay + float(self._random.exponential(self._jitter))
                while self._random.random() < self._loss:
                    wait += self._again
                    self.stalls += 1
                waiting.put_nowait((asyncio.get_running_loop().time() + wait, data))
        waiting.put_nowait((0.0, b""))
        await sending

    async def _send(self, waiting: asyncio.Queue[tuple[float, bytes]], sink: asyncio.StreamWriter) -> None:
        with suppress(ConnectionError):
            while (item := await waiting.get())[1]:
                await asyncio.sleep(max(0.0, item[0] - asyncio.get_running_loop().time()))
                sink.write(item[1])
        sink.close()

    def break_all(self) -> None:
        """All connections are gone, without a word."""
        for writer in self._writers:
            writer.transport.abort()
        self._writers.clear()


@asynccontextmanager
async def bad_proxy(
    port: int, seed: int, loss: float = 0.3, delay: float = 0.2, jitter: float = 0.06, again: float = 0.4
) -> AsyncIterator[tuple[BadProxy, int]]:
    """The proxy, and the port to which clients connect instead."""
    proxy = BadProxy(port, seed, loss, delay, jitter, again)
    server = await asyncio.start_server(proxy.connected, "127.0.0.1", 0)
    try:
        yield proxy, server.sockets[0].getsockname()[1]
    finally:
        proxy.break_all()
        server.close()
