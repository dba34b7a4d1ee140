"""The room's end of WebRTC data channels: poses of clients that are connected already. Needs aiortc.

A client says its offer to `room` by the connection that it has; so the channel is its own and needs no token. Words
stay on the connection: they must all arrive, each once and in order.
"""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any

from synchronizar.live import messages as m
from synchronizar.live.budget import Budget
from synchronizar.live.connection import hear_word
from synchronizar.live.member import Client
from synchronizar.live.messages import MessageError
from synchronizar.live.pose_channel import PoseChannel
from synchronizar.live.room import Room

OFFERS_A_SECOND = 0.5
"""Of one client; twice as many may come at once, or else one."""
MOST_PEERS = 256
"""In one process: each has sockets and keys of its own."""


class RoomPeers:
    """All data channels of a server's rooms."""

    def __init__(self) -> None:
        self.open_now = 0
        self._tasks: set[asyncio.Task[None]] = set()

    def open(self, room: Room, client: Client) -> RoomPeer:
        """A client's. Raises MessageError where there are too many."""
        if self.open_now >= MOST_PEERS:
            raise MessageError("full", f"the server has its {MOST_PEERS} data channels: send poses by this connection")
        self.open_now += 1
        return RoomPeer(self, room, client)

    def run(self, work: Coroutine[Any, Any, None]) -> None:
        """Something that nobody waits for but the end."""
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def close(self) -> None:
        """Until all that have ended are closed."""
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=5.0)


class RoomPeer:
    """One client's channel; each offer begins another one."""

    def __init__(self, peers: RoomPeers, room: Room, client: Client) -> None:
        self._peers, self._room, self._client = peers, room, client
        self._offers = Budget(OFFERS_A_SECOND, room.now())
        self._channel: PoseChannel | None = None
        self._closed = False

    def signalled(self, data: dict[str, Any]) -> None:
        """An offer. Raises MessageError where there were too many."""
        if not self._offers.take(self._room.now()):
            raise MessageError("rate", "too many offers: wait some seconds")
        self._end_channel()
        self._channel = PoseChannel(self._hear)
        self._peers.run(self._answer(self._channel, data))

    def send_poses(self, data: bytes) -> bool:
        """Whether the channel took them."""
        return self._channel is not None and self._channel.is_open and self._channel.send_poses_down(data)

    def close(self) -> None:
        """The client is gone."""
        if not self._closed:
            self._closed = True
            self._peers.open_now -= 1
            self._end_channel()

    async def _answer(self, channel: PoseChannel, data: dict[str, Any]) -> None:
        try:
            answer = await channel.answer(data)
        except MessageError as error:
            await channel.close()
            self._room.refuse(self._client, error)
            return
        self._client.outbox.put(m.encode(m.Signalled(m.ROOM, answer)))

    def _hear(self, data: bytes) -> None:
        if not self._closed:
            hear_word(self._room, self._client, data)

    def _end_channel(self) -> None:
        if self._channel is not None:
            self._peers.run(self._channel.close())
            self._channel = None
