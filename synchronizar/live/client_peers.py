"""A client's data channels: with the room, and with other devices that the room signals. Needs aiortc."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

from synchronizar.live import messages as m
from synchronizar.live.messages import MessageError
from synchronizar.live.pose_channel import PoseChannel


class ClientPeers:
    """All channels of a client, by the name of the other end."""

    def __init__(
        self, own: str, say: Callable[[m.Signal], Awaitable[None]], heard: Callable[[str, bytes], None]
    ) -> None:
        """`own`: the client's own name. `say` sends a word to the room; `heard` is given what comes, and of whom."""
        self.channels: dict[str, PoseChannel] = {}
        self.answers = False
        """Whether other devices may call."""
        self._own, self._say, self._heard = own, say, heard
        self._tasks: set[asyncio.Task[None]] = set()

    async def call(self, name: str) -> PoseChannel:
        """Begin a channel; it opens when the other end has answered."""
        channel = self._begin(name)
        await self._say(m.Signal(name, await channel.offer()))
        return channel

    def signalled(self, by: str, data: dict[str, Any]) -> None:
        """What another end says."""
        self._run(self._answer(by, data) if data.get("type") == "offer" else self._answered(by, data))

    async def close(self) -> None:
        """End all channels."""
        for task in list(self._tasks):
            task.cancel()
        for channel in self.channels.values():
            await channel.close()
        self.channels.clear()

    def _begin(self, name: str) -> PoseChannel:
        if (earlier := self.channels.pop(name, None)) is not None:
            self._run(earlier.close())
        self.channels[name] = channel = PoseChannel(lambda data: self._heard(name, data))
        return channel

    async def _answer(self, by: str, offer: dict[str, Any]) -> None:
        if not self.answers or by == m.ROOM or by == self._own:
            return
        own = self.channels.get(by)
        if own is not None and own.called and not own.is_open and not own.ended and self._own < by:
            return  # both have called at once: the call of whose name comes first stands
        channel = self._begin(by)
        try:
            answer = await channel.answer(offer)
        except MessageError:
            await channel.close()
            return
        await self._say(m.Signal(by, answer))

    async def _answered(self, by: str, answer: dict[str, Any]) -> None:
        channel = self.channels.get(by)
        if channel is None or not channel.called:
            return
        try:
            await channel.take_answer(answer)
        except MessageError:
            await channel.close()

    def _run(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
