"""A server on the loopback, its solver's process and real clients: by a recording's time, so that nothing waits."""

from __future__ import annotations

import asyncio
import os
import secrets
import signal
import socket
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
import pytest
from aiohttp import web
from support.serving import run, serving

from experiments.live import walkers
from synchronizar.data.recording import Recording
from synchronizar.errors import InputError
from synchronizar.live import messages as m
from synchronizar.live.client import Client
from synchronizar.live.lobby import OPENED_A_MINUTE
from synchronizar.live.play import play
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate


@pytest.fixture(scope="module")
def walk() -> Recording:
    return simulate(Scene(users=2, seconds=9.0, seed=4, up="y")).recording


def test_a_recording_that_is_played_has_the_same_answer_at_any_speed_and_is_recorded_as_it_was(
    walk: Recording, tmp_path: Path
) -> None:
    answers = []

    async def test() -> None:
        for speed in (1e9, 30.0):
            async with serving(record=tmp_path / str(speed)) as (_, address):
                answers.append(await play(walk, address, speed))

    run(test)
    for answer in answers:
        answer["seconds"] = {}
    assert answers[0] == answers[1]
    assert {name: user["state"] for name, user in answers[0]["users"].items()}.keys() == walk.tracks.keys()
    (folder,) = (tmp_path / "30.0").iterdir()
    recorded = Recording.load(folder)
    assert recorded.users == walk.users
    for name, track in walk.tracks.items():
        np.testing.assert_allclose(recorded.tracks[name].t, track.t, atol=1e-8)
        np.testing.assert_allclose(recorded.tracks[name].position, track.position, atol=1e-8)
        np.testing.assert_allclose(recorded.tracks[name].quat_xyzw, track.quat_xyzw, atol=1e-6)
    np.testing.assert_allclose(recorded.ranges.distance, walk.ranges.distance)
    np.testing.assert_allclose(recorded.ranges.t, walk.ranges.t, atol=1e-8)


def test_a_solver_that_is_killed_is_begun_again_and_loses_nothing(walk: Recording) -> None:
    answers = []

    async def test() -> None:
        async with serving() as (server, address):
            answers.append(await play(walk, address, 1e9))
        async with serving() as (server, address):

            def kill_once(_: m.Frames) -> None:
                solver = server.hosts[0].solver
                assert solver is not None
                if solver.restarts == 0 and solver.process_id is not None and not killed:
                    killed.append(solver.process_id)
                    os.kill(solver.process_id, signal.SIGKILL)

            killed: list[int] = []
            answers.append(await play(walk, address, 1e9, kill_once))
            solver = server.hosts[0].solver
            assert solver is not None
            assert solver.restarts == 1

    run(test)
    for answer in answers:
        answer["seconds"] = {}
    assert answers[0] == answers[1]


def test_without_a_token_there_is_nothing_but_pages() -> None:
    async def test() -> None:
        async with serving() as (server, address), aiohttp.ClientSession() as session:
            base = address.partition("/#")[0]
            async with session.ws_connect(f"{base}/live") as socket:
                await socket.send_str(m.encode(m.Hello("guessed")).decode())
                bye = m.decode_from_room(await socket.receive_str())
                assert isinstance(bye, m.Bye)
                assert bye.reason == "token"
                assert (await socket.receive()).type in (aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.CLOSED)
            async with session.post(f"{base}/api/join", data=b'{"room":"WRONG"}') as response:
                assert response.status == 404
                assert "no room" in (await response.json())["what"]
            async with session.get(base) as response:
                assert response.status == 200
                assert "default-src 'none'" in response.headers["Content-Security-Policy"]
            assert server.lobby.refused == {"token": 1, "room": 1}

    run(test)


def test_a_client_says_why_a_room_cannot_be_joined() -> None:
    async def test() -> None:
        async with serving() as (_, address):
            base, _, _ = address.partition("#")
            with pytest.raises(InputError, match="no room with that code"):
                await Client.join(f"{base}#WRONG", ["alice"])
            with pytest.raises(InputError, match="no room's address"):
                await Client.join(base, ["alice"])
            async with await Client.join(address, ["alice"]):
                with pytest.raises(InputError, match="somebody called 'alice' already"):
                    await Client.join(address, ["alice"])

    run(test)


def test_two_clients_hear_each_other_and_objects_stand_for_both() -> None:
    async def test() -> None:
        async with (
            serving() as (_, address),
            await Client.join(address, ["alice"]) as alice,
            await Client.join(address, ["bob"], up="y") as bob,
        ):
            await alice.say_message(m.Create("coin", "coin", (1.0, 2.0, 0.0)))
            heard = await bob.until(lambda word: isinstance(word, m.Objects))
            assert isinstance(heard, m.Objects)
            assert [(o.id, o.by, o.position) for o in heard.changed] == [("coin", "alice", (1.0, 2.0, 0.0))]
            await bob.say_message(m.Say("hello", [1, 2], to="alice"))
            said = await alice.until(lambda word: isinstance(word, m.Said))
            assert said == m.Said("hello", [1, 2], "bob")
            await alice.until(lambda word: isinstance(word, m.Pong))
            assert alice.offset is not None
            assert abs(alice.offset) < 1.0

    run(test)


def test_what_a_later_room_says_is_left_alone_and_counted() -> None:
    async def test() -> None:
        async with serving() as (server, address), await Client.join(address, ["alice"]) as alice:
            outbox = next(iter(server.hosts[0].room.clients)).outbox
            for word in (
                b'{"type": "weather", "rain": true}',
                b'{"type": "pong", "t": "soon"}',
                b'{"kind": 1}',
                b"\x07 another kind of bytes",
                b'{"type": "said", "topic": "chat", "data": 1, "by": "bob", "mood": "good"}',
            ):
                outbox.put(word)
            said = await alice.until(lambda word: isinstance(word, m.Said))
            assert said == m.Said("chat", 1, "bob")
            assert alice.not_understood == {"weather": 1, "pong": 1, "malformed": 1, "binary": 1}

    run(test)


async def forwarding(request: web.Request, ports: dict[str, int]) -> web.StreamResponse:
    """A proxy as small as can be: /a/... goes to one server, /b/... to the other."""
    base, _, rest = request.path.removeprefix("/").partition("/")
    url = f"http://127.0.0.1:{ports[base]}/{rest}"
    async with aiohttp.ClientSession() as session:
        if request.headers.get("Upgrade", "").lower() != "websocket":
            async with session.request(request.method, url, data=await request.read()) as answer:
                return web.Response(status=answer.status, body=await answer.read(), content_type=answer.content_type)
        near = web.WebSocketResponse()
        await near.prepare(request)
        async with session.ws_connect(url) as far:

            async def pump(source: Any, sink: Any) -> None:
                async for word in source:
                    await (sink.send_str if word.type is aiohttp.WSMsgType.TEXT else sink.send_bytes)(word.data)
                await sink.close()

            await asyncio.gather(pump(near, far), pump(far, near))
        return near


def free_port() -> int:
    """None of those that a system gives to whoever asks for any: nobody else gets it until it is taken."""
    while True:
        port = secrets.randbelow(12_000) + 20_000
        with socket.socket() as asked, suppress(OSError):
            asked.bind(("127.0.0.1", port))
            return port


def test_rooms_of_two_servers_are_behind_one_address_and_one_goes_on_without_the_other() -> None:
    async def test() -> None:
        ports = {"a": free_port(), "b": free_port()}
        proxy = web.Application()

        async def forward(request: web.Request) -> web.StreamResponse:
            return await forwarding(request, ports)

        proxy.router.add_route("*", "/{path:.*}", forward)
        runner = web.AppRunner(proxy)
        await runner.setup()
        await web.TCPSite(runner, "127.0.0.1", 0).start()
        public = f"http://127.0.0.1:{runner.addresses[0][1]}"
        with ExitStack() as second, ExitStack() as first:

            def process(name: str, stack: ExitStack) -> str:
                options = "--no-tls", "--port", str(ports[name]), "--public-url", f"{public}/{name}"
                return str(stack.enter_context(walkers.server(*options))["join"])

            in_a, in_b = process("a", first), process("b", second)
            async with aiohttp.ClientSession() as session:
                asked = m.encode(m.Join(in_b.partition("#")[2]))
                async with session.post(f"{public}/b/api/rooms", data=asked) as response:
                    opened = await response.json()
            assert opened["join"] == f"{public}/b/#{opened['room']}"
            for address in (in_a, in_b, opened["join"]):
                async with await Client.join(address, ["alice"]) as alice:
                    assert alice.welcome.room == address.partition("#")[2]
            with pytest.raises(InputError, match="no room with that code"):
                await Client.join(in_a.replace("/a/", "/b/"), ["bob"])
            async with await Client.join(in_b, ["bob"]) as bob:
                first.close()
                await bob.say_message(m.Create("coin", "coin", (1.0, 2.0, 0.0)))
                await bob.until(lambda word: isinstance(word, m.Objects))
        await runner.cleanup()

    run(test)


def test_rooms_cannot_be_opened_without_end() -> None:
    async def test() -> None:
        async with serving(lambda: 1000.0) as (server, address), aiohttp.ClientSession() as session:
            base, _, code = address.partition("/#")
            statuses = []
            for _ in range(OPENED_A_MINUTE + 1):
                async with session.post(f"{base}/api/rooms", data=m.encode(m.Join(code))) as response:
                    statuses.append(response.status)
            assert statuses == [200] * OPENED_A_MINUTE + [429]
            assert len(server.lobby.rooms) == OPENED_A_MINUTE + 1

    run(test)
