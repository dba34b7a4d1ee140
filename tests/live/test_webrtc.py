"""Data channels with the room and between devices, on this machine's own addresses."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextlib import AsyncExitStack
from typing import Any

import numpy as np
import pytest

pytest.importorskip("aiortc", reason="the extra `webrtc` is not installed")

from support.serving import run, serving

from synchronizar.geometry import YawFrame
from synchronizar.live import messages as m
from synchronizar.live.client import Client
from synchronizar.live.lobby import Lobby
from synchronizar.live.messages import MessageError
from synchronizar.live.pose_channel import MOST_BUFFERED, PoseChannel
from synchronizar.live.pose_wire import PoseDown, PosesDown, decode_poses_down, encode_poses_down
from synchronizar.live.room import Room
from synchronizar.live.webrtc import RoomPeers

NO_TURN = (0.0, 0.0, 0.0, 1.0)


async def hearing(client: Client, topics: list[str] | None = None) -> None:
    """Goes on until it is cancelled; `topics` of what others say are noted."""
    async for word in client.messages():
        if topics is not None and isinstance(word, m.Said):
            topics.append(word.topic)


async def until(condition: Callable[[], bool]) -> None:
    while not condition():
        await asyncio.sleep(0.01)


def test_poses_go_to_the_room_and_come_back_by_the_channel_and_words_by_the_connection() -> None:
    async def test() -> None:
        async with serving() as (server, address), await Client.join(address, ["alice"], up="y") as alice:
            room = server.hosts[0].room
            assert alice.welcome.webrtc
            listening = asyncio.create_task(hearing(alice))
            channel = await alice.call()
            await channel.opened()
            for n in range(200):
                await alice.send_pose("alice", time.time(), [0.01 * n, 1.5, 0.0], [0.0, 0.0, 0.0, 1.0])
                await asyncio.sleep(0.002)
            device = room.devices["alice"]
            await until(lambda: device.pose is not None and device.pose[1][0] > 1.9)
            assert channel.sent > 0
            assert channel.sent + channel.refused == 200  # what a busy machine's channel did not take went beside it
            await alice.say_message(m.Create("coin", "coin", (1.0, 2.0, 0.0)))
            await until(lambda: "coin" in alice.objects)
            peer = next(iter(room.clients)).peer
            assert peer is not None
            before = alice.poses
            await until(lambda: alice.poses is not before)
            while alice.poses is None or alice.poses.sequence != 1 << 30:  # each may be lost
                peer.send_poses(encode_poses_down(PosesDown(1 << 30, 7.0, [])))
                await asyncio.sleep(0.01)
            listening.cancel()

    run(test)


def test_two_devices_say_their_poses_to_each_other_and_place_them_by_what_the_room_tells() -> None:
    async def test() -> None:
        async with (
            serving() as (_, address),
            await Client.join(address, ["alice"]) as alice,
            await Client.join(address, ["bob"], up="y") as bob,
            AsyncExitStack() as ended,
        ):
            for client in (alice, bob):
                task = asyncio.create_task(hearing(client))
                ended.callback(task.cancel)
            bob.answer_calls()
            await (await alice.call("bob")).opened()
            await until(lambda: bob._peers is not None and bob._peers.channels["alice"].is_open)
            while "bob" not in alice.peer_poses:  # each may be lost
                await bob.send_pose("bob", 1.0, [0.4, 1.5, -2.0], [0.0, 0.0, 0.0, 1.0])
                await asyncio.sleep(0.01)
            assert alice.place_of_peer("bob") is None
            frame = YawFrame(1.0, 2.0, 0.5, 0.7, 1.02, "y")
            alice.frames.users["bob"] = m.UserFrame(
                *("registered", "", 0, frame.matrix.tolist(), 1.0, 2.0, 0.5, 0.7, 1.02), *(None,) * 5
            )
            placed = alice.place_of_peer("bob")
            assert placed is not None
            np.testing.assert_allclose(placed[0], frame @ np.array([0.4, 1.5, -2.0]), atol=1e-9)

    run(test)


def test_a_call_is_answered_only_by_who_wants_to_and_two_calls_at_once_are_one() -> None:
    async def test() -> None:
        async with (
            serving() as (_, address),
            await Client.join(address, ["alice"]) as alice,
            await Client.join(address, ["bob"]) as bob,
            AsyncExitStack() as ended,
        ):
            topics: list[str] = []
            for client, heard in ((alice, []), (bob, topics)):
                task = asyncio.create_task(hearing(client, heard))
                ended.callback(task.cancel)
            unheard = await alice.call("bob")
            await alice.say_message(m.Say("after the call", to="bob"))
            await until(lambda: topics == ["after the call"])
            assert not unheard.is_open
            alice.answer_calls()
            bob.answer_calls()
            await asyncio.gather(alice.call("bob"), bob.call("alice"))
            peers = alice._peers, bob._peers
            assert peers[0] is not None
            assert peers[1] is not None
            await until(lambda: peers[0].channels["bob"].is_open and peers[1].channels["alice"].is_open)
            assert peers[0].channels["bob"].called
            assert not peers[1].channels["alice"].called

    run(test)


class Pair:
    """A room's end and a client's, without a server."""

    def __init__(self) -> None:
        self.t = 1000.0
        self.room = Room("CODE", lambda: self.t, key=bytes(32))
        self.peers = RoomPeers()
        self.room.open_peer = self.peers.open
        self.lobby = Lobby(lambda: self.t)
        ticket, _ = self.room.admit(m.Join("CODE", [m.UserSettings("alice")]))
        self.client = self.room.connect(ticket)
        self.heard: list[bytes] = []
        self.own = PoseChannel(self.heard.append)

    def words(self) -> list[Any]:
        return [m.decode_from_room(word) for word in self.client.outbox.take() if word[:1] == b"{"]

    async def answer(self) -> Any:
        found: list[Any] = []
        while not found:
            found = [word for word in self.words() if isinstance(word, m.Signalled | m.Refused)]
            await asyncio.sleep(0.01)
        return found[0]

    async def connect(self) -> None:
        self.room.hear(self.client, m.Signal(m.ROOM, await self.own.offer()))
        await self.own.take_answer((await self.answer()).data)
        await self.own.opened()

    async def close(self) -> None:
        self.room.disconnect(self.client)
        await self.own.close()
        await self.peers.close()


def test_what_is_no_offer_is_refused() -> None:
    async def test() -> None:
        pair = Pair()
        audio = "v=0\r\nm=audio 9 UDP/TLS/RTP/SAVPF 0\r\n"
        for data in ({}, {"type": "offer"}, {"type": "offer", "sdp": "nothing"}, {"type": "offer", "sdp": audio}):
            pair.t += 10.0
            pair.room.hear(pair.client, m.Signal(m.ROOM, data))
            assert (await pair.answer()).reason == "signal"
            pair.client.told.clear()
        pair.room.hear(pair.client, m.Signal(m.ROOM, {}))
        assert (await pair.answer()).reason == "rate"
        with pytest.raises(MessageError, match="is the room itself"):
            pair.room.admit(m.Join("CODE", [m.UserSettings(m.ROOM)]))
        await pair.close()
        assert pair.peers.open_now == 0

    run(test)


def test_a_channel_takes_no_more_than_fits_and_closes_with_its_connection() -> None:
    async def test() -> None:
        pair = Pair()
        await pair.connect()
        message = encode_poses_down(
            PosesDown(1, 2.0, [PoseDown(n, "registered", 0, 0.0, NO_TURN[:3], NO_TURN) for n in range(60)])
        )
        taken = sum(pair.own.send(message) for _ in range(10_000))
        assert taken * len(message) <= MOST_BUFFERED + len(message)
        assert pair.own.refused == 10_000 - taken
        assert pair.own.is_open
        # Cut into packets on the way down, and joined again by their number.
        peer = pair.client.peer
        assert peer is not None
        while not pair.heard:
            peer.send_poses(message)
            await asyncio.sleep(0.05)
        assert {pose.member for data in pair.heard for pose in decode_poses_down(data).poses} <= set(range(60))
        pair.room.disconnect(pair.client)
        await until(lambda: pair.own.ended)
        await pair.close()

    run(test)
