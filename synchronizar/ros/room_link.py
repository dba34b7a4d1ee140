"""The bridge's connection to its room: joined again when it breaks, and when more robots come."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any

import aiohttp

from synchronizar.errors import InputError
from synchronizar.live import messages as m
from synchronizar.live.certificates import state_folder
from synchronizar.live.client import Client
from synchronizar.live.pose_wire import PosesDown

FIRST_AGAIN_S, LAST_AGAIN_S = 0.5, 10.0
"""s until it is tried again: at first, and after many times."""
TOGETHER_S = 0.2
"""s for which more robots are waited for before all are told to the room at once."""


class RoomLink:
    """Speaks for the bridge's robots."""

    def __init__(
        self,
        join: str,
        of: str,
        simulated: bool,
        clock: Callable[[], float],
        told: Callable[[str], None],
    ) -> None:
        """`of`: whose link it is, under which it is the same devices again when the bridge is begun anew."""
        self.client: Client | None = None
        """None while the room cannot be reached."""
        self.refused: dict[str, str] = {}
        """Robots that the room does not take, and why."""
        self._join, self._simulated, self._clock, self._told = join, simulated, clock, told
        self._settings: dict[str, Mapping[str, Any]] = {}
        self._inside: set[str] = set()
        self._more = asyncio.Event()
        self._path = state_folder() / "ros" / f"{sha256(f'{join} {of}'.encode()).hexdigest()[:24]}.json"

    @property
    def inside(self) -> bool:
        """Whether all who were added are in the room."""
        return self.client is not None and not self._more.is_set()

    def add(self, name: str, settings: Mapping[str, Any]) -> None:
        """Somebody to speak for."""
        if name not in self._settings:
            self._settings[name] = settings
            self._more.set()

    def speaks_for(self, name: str) -> bool:
        """Whether the room would take a word of that device now."""
        return self.client is not None and name in self._inside

    async def say(self, what: Callable[[Client], Awaitable[None]]) -> None:
        """Something, where it can be said; what is lost with the connection is lost."""
        if self.client is not None:
            with suppress(ConnectionError, aiohttp.ClientError):
                await what(self.client)

    async def run(
        self, joined: Callable[[Client], Awaitable[None]], heard: Callable[[m.FromRoom | PosesDown], Awaitable[None]]
    ) -> None:
        """Without end. Raises InputError where the room cannot be joined at first, or somebody else is its robots."""
        resume, again, ever = self._resume(), FIRST_AGAIN_S, False
        last = ""
        while True:
            self._more.clear()
            wanted = {name: of for name, of in self._settings.items() if name not in self.refused}
            try:
                client = await Client.join(
                    self._join,
                    wanted,
                    time="recorded" if self._simulated else "live",
                    resume=resume,
                    clock=self._clock,
                )
            except InputError as error:
                new = wanted.keys() - self._inside
                is_refused = error.__cause__ is None
                if not ever or (is_refused and new and not self._inside):
                    raise
                if is_refused and new:
                    self.refused |= dict.fromkeys(new, str(error))
                    self._told(f"{', '.join(sorted(new))}: left out: {error}")
                    continue
                if str(error) != last:
                    last = str(error)
                    self._told(f"{error}; it is tried again")
                await asyncio.sleep(again)
                again = min(2.0 * again, LAST_AGAIN_S)
                continue
            if last:
                self._told("the room is joined again")
            ever, again, last, resume = True, FIRST_AGAIN_S, "", client.resume
            self._inside = set(wanted)
            self._keep(resume)
            if await self._stay(client, joined, heard):
                await asyncio.sleep(TOGETHER_S)
            else:
                last = "the room has ended the connection"
                self._told(f"{last}; it is joined again")
                await asyncio.sleep(again)

    async def _stay(
        self,
        client: Client,
        joined: Callable[[Client], Awaitable[None]],
        heard: Callable[[m.FromRoom | PosesDown], Awaitable[None]],
    ) -> bool:
        """Until the connection ends, or there are more robots: True."""
        self.client = client
        reading = asyncio.create_task(self._read(client, joined, heard))
        more = asyncio.create_task(self._more.wait())
        try:
            await asyncio.wait({reading, more}, return_when=asyncio.FIRST_COMPLETED)
            if reading.done():
                reading.result()
            return not reading.done()
        finally:
            self.client = None
            for task in (reading, more):
                task.cancel()
            with suppress(ConnectionError, aiohttp.ClientError):
                await client.close()

    async def _read(
        self,
        client: Client,
        joined: Callable[[Client], Awaitable[None]],
        heard: Callable[[m.FromRoom | PosesDown], Awaitable[None]],
    ) -> None:
        with suppress(ConnectionError, aiohttp.ClientError):
            await joined(client)
            async for message in client.messages():
                if isinstance(message, m.Bye) and message.reason == "elsewhere":
                    raise InputError(self._join.partition("#")[0], f"{message.what}: is a second bridge running?")
                await heard(message)

    def _resume(self) -> str | None:
        try:
            return str(json.loads(self._path.read_text())["resume"])
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def _keep(self, resume: str) -> None:
        """So that a bridge that is begun anew is the same robots."""
        with suppress(OSError):  # it is as before then: names are taken for as long as the room stands
            _write_secret(self._path, json.dumps({"resume": resume}))


def _write_secret(path: Path, text: str) -> None:
    half = path.with_suffix(".half")
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    half.touch(mode=0o600)
    half.write_text(text)
    half.replace(path)
