"""Module to device by UDP, device to device by WebRTC, samples to the solver by UDP. What is waited for comes, or it
fails; what comes is judged by stamps and truth, by a clock that waits where the machine has no time."""

from __future__ import annotations

import asyncio
import socket

import pytest

pytest.importorskip("aiortc", reason="the extra `webrtc` is not installed")

from support.air_built import needs_air
from support.serving import PatientClock, run, serving

from experiments.live.paper_wiring import walk_as_in_the_paper
from experiments.live.room import Seen, summary
from synchronizar.live.client import Client
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

SEEN_WELL = 60
"""Places of each device that are judged."""


def enough(seen: list[Seen]) -> bool:
    registered = [one.user for one in seen if one.registered]
    return min(registered.count("phone0"), registered.count("phone1")) >= SEEN_WELL


@needs_air
def test_two_devices_wired_as_in_the_paper_place_each_other() -> None:
    simulation = simulate(Scene(users=2, seconds=60.0, speed=1.5, seed=1, up="y"))

    clock = PatientClock()

    async def test() -> None:
        async with serving(clock) as (server, address):
            counted = await walk_as_in_the_paper(simulation, address, 1, enough, clock)
            room = server.hosts[0].room
            assert len(room.modules.receiver.reporters) == 2
            assert not room.modules.receiver.refused
            assert not any(device.refused for device in room.devices.values())
        placed = summary(counted.seen)
        assert placed["phone0"]["p95"] < 0.25
        assert placed["phone1"]["p95"] < 0.25
        assert min(counted.by_channel.values()) > SEEN_WELL

    run(test)


def test_a_modules_datagrams_go_on_unchanged_and_what_the_room_answers_finds_back() -> None:
    async def test() -> None:
        loop = asyncio.get_running_loop()
        room = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        room.bind(("127.0.0.1", 0))
        modules = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
        for one in (room, *modules):
            one.setblocking(False)
        async with serving() as (_, address), await Client.join(address, ["alice"]) as alice:
            port = alice.forward_module(host="127.0.0.1", udp_port=room.getsockname()[1])
            for n, module in enumerate(modules):
                said = bytes([n]) * 700
                await loop.sock_sendto(module, said, ("127.0.0.1", port))
                heard, source = await loop.sock_recvfrom(room, 2048)
                assert heard == said
                await loop.sock_sendto(room, b"order %d" % n, source)
                assert await loop.sock_recv(module, 2048) == b"order %d" % n
        for one in (room, *modules):
            one.close()

    run(test)
