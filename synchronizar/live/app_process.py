"""An application's process, seen from the server: started with its room, begun again where it dies."""

from __future__ import annotations

import asyncio
import sys
import time
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable
from contextlib import suppress

import msgspec

from synchronizar.live.app_run import Place
from synchronizar.live.restarts import Restarts

_ENDS_WITHIN_S = 1.0


class AppProcess:
    """Keeps one application going for one room until it is closed."""

    def __init__(
        self, name: str, place: Place, event: Callable[[str], None], clock: Callable[[], float] = time.monotonic
    ) -> None:
        """`event` hears a sentence when it has ended by itself; `clock` (s) says how long it lives."""
        self._name, self._place, self._event, self._clock = name, place, event, clock
        self._process: Process | None = None
        self._keeping: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin; there must be a running loop."""
        self._keeping = asyncio.create_task(self._keep())

    async def close(self) -> None:
        """End it."""
        if self._keeping is not None:
            self._keeping.cancel()
            with suppress(asyncio.CancelledError):
                await self._keeping
        process = self._process
        if process is None or process.returncode is not None:
            return
        assert process.stdin is not None
        process.stdin.close()
        try:
            await asyncio.wait_for(process.wait(), _ENDS_WITHIN_S)
        except TimeoutError:
            with suppress(ProcessLookupError):  # it has ended just now
                process.kill()
            await process.wait()

    async def _keep(self) -> None:
        restarts = Restarts(self._clock)
        while True:
            restarts.began()
            restarts.works()  # it answers nothing: it works for as long as it lives
            await self._live()
            pause = restarts.ended()
            self._event(f"the application {self._name} has ended; it is begun again in {pause:g} s")
            await asyncio.sleep(pause)

    async def _live(self) -> None:
        """From its start to its end; what it writes to standard error is the server's too."""
        command = sys.executable, "-m", "synchronizar.live.app_run", self._name
        self._process = process = await asyncio.create_subprocess_exec(*command, stdin=PIPE)
        assert process.stdin is not None
        with suppress(ConnectionError):
            process.stdin.write(msgspec.json.encode(self._place) + b"\n")
            await process.stdin.drain()
        await process.wait()
