"""The process in which an application runs: it is a client of its room like any other, with its own secret.

`python -m synchronizar.live.app_run NAME` reads where its room is from one line of standard input, and ends when that
is closed.
"""

from __future__ import annotations

import asyncio
import sys
from contextlib import suppress
from pathlib import Path

import aiohttp
import msgspec

from synchronizar.errors import InputError
from synchronizar.live import messages as m
from synchronizar.live.applications import Application, application
from synchronizar.live.client import Client
from synchronizar.live.pose_wire import PosesDown
from synchronizar.live.stage import Stage


class Place(msgspec.Struct):
    """Where an application's room is, and how the room knows that it is the one."""

    address: str
    secret: str
    certificate_sha256: str | None
    """In hex; None without TLS."""
    folder: str = "."
    """For its files."""


async def run(app: Application, place: Place) -> None:
    """Until the room ends the connection. Raises InputError where the room cannot be joined."""
    pinned = None if place.certificate_sha256 is None else bytes.fromhex(place.certificate_sha256)
    verify = None if pinned is None else aiohttp.Fingerprint(pinned)
    async with await Client.join(place.address, app=place.secret, verify=verify) as client:
        stage = Stage(client.welcome, Path(place.folder))
        app.begin(stage)
        async for word in client.messages():
            hear(app, stage, word)
            for said in stage.take_words():
                await client.say_message(said)
            for refused in stage.take_refused():
                print(refused, file=sys.stderr)


def hear(app: Application, stage: Stage, word: m.FromRoom | PosesDown) -> None:
    """Something that the room has said: the stage is as it says, and the application goes on."""
    stage.hear(word)
    if isinstance(word, PosesDown):
        app.tick(stage)
    elif isinstance(word, m.Said):
        app.said(stage, word.by, word.topic, word.data)


async def _until_closed() -> None:
    """Until standard input ends: who started this process is gone."""
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    await reader.read()


async def _main(name: str) -> None:
    place = msgspec.json.decode(sys.stdin.readline(), type=Place)
    running = asyncio.create_task(run(application(name)(), place))
    closed = asyncio.create_task(_until_closed())
    await asyncio.wait({running, closed}, return_when=asyncio.FIRST_COMPLETED)
    if running.done():
        closed.cancel()
        running.result()
    else:
        running.cancel()
        await asyncio.wait({running})  # a second cancellation would interrupt its end


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        try:
            asyncio.run(_main(sys.argv[1]))
        except (InputError, ConnectionError) as error:
            sys.exit(str(error))
