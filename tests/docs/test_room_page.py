"""docs/room.md: its program runs, against a room and with frames that are known."""

from __future__ import annotations

import asyncio
import re
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from live.test_server import run, serving
from support.paths import REPOSITORY

from synchronizar.geometry import YawFrame
from synchronizar.live import BlockingClient

PROGRAM, *_ = re.findall(r"```python\n(.*?)```", (REPOSITORY / "docs" / "room.md").read_text(), flags=re.DOTALL)
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


@pytest.fixture
def walk() -> Any:
    names: dict[str, Any] = {}
    exec(PROGRAM, names)
    return names["walk"]


def test_the_program_is_refused_nothing(walk: Any) -> None:
    def blocking(address: str) -> None:
        begin = time.monotonic()
        slam = [(begin + 0.001 * i, (0.1 * i, 0.0, 0.0), UPRIGHT) for i in range(3)]
        with BlockingClient.join(address, ["bob"], up="y") as bob:
            assert list(walk(address, slam, {begin: 2.0}.get, time.monotonic)) == []
            assert bob.refused == {}

    async def test() -> None:
        async with serving() as (server, address):
            await asyncio.to_thread(blocking, address)
            (room,) = server.lobby.rooms.values()
            alice = room.devices["alice"]
            for _ in range(600):  # what it said waits until its clock is known
                if alice.ranges:
                    break
                await asyncio.sleep(0.1)
            assert (len(alice.poses), len(alice.ranges), dict(alice.refused)) == (3, 1, {})

    run(test)


def test_the_program_brings_bob_into_alices_axes(walk: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    alice, bob = YawFrame(1.0, 2.0, 0.1, 0.7, 1.01, "y"), YawFrame(-1.0, 0.5, 0.0, -2.0, 0.99, "y")
    users = {
        name: SimpleNamespace(state="registered", matrix=frame.matrix.tolist())
        for name, frame in (("alice", alice), ("bob", bob))
    }

    class Fake:
        members = ("alice", "bob")
        frames = SimpleNamespace(users=users)

        def __enter__(self) -> Fake:
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def send_pose(self, *_: object) -> None:
            pass

    monkeypatch.setitem(walk.__globals__, "BlockingClient", SimpleNamespace(join=lambda *_, **__: Fake()))
    (alice_from_bob,) = walk("", [(0.0, (0.0, 0.0, 0.0), UPRIGHT)], lambda _: None, None)
    place = np.array([0.3, 1.4, -2.0])
    np.testing.assert_allclose(alice @ (alice_from_bob @ [*place, 1.0])[:3], bob @ place, atol=1e-12)
