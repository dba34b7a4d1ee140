"""One connection, whatever carries it: hello, then words and poses in, and what waits in the outbox out."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress
from typing import Protocol

from synchronizar.live import messages as m
from synchronizar.live.lobby import Lobby
from synchronizar.live.member import Client
from synchronizar.live.messages import MessageError
from synchronizar.live.room import Room

HELLO_WITHIN_S = 10.0


class Link(Protocol):
    """What carries messages: text for words, bytes for poses."""

    address: str
    """Of the other end, for limits and the log."""

    def received(self) -> AsyncIterator[str | bytes]:
        """What comes, until the link ends."""

    async def send(self, data: bytes, text: bool) -> None:
        """One message. Raises ConnectionError where the link has ended."""

    async def close(self) -> None:
        """End it."""


async def serve_link(link: Link, lobby: Lobby) -> None:
    """Serve a connection until it ends."""
    received = link.received()
    try:
        with lobby.waiting(link.address):
            room, client = await _greeted(received, lobby)
    except MessageError as error:
        lobby.refused[error.reason] += 1
        with suppress(ConnectionError):
            await link.send(m.encode(m.Bye(error.reason, str(error))), True)
        await link.close()
        return
    sender = asyncio.create_task(_send(client, link))
    try:
        await _hear_all(received, room, client)
    finally:
        room.disconnect(client)
        client.outbox.close()
        with suppress(asyncio.TimeoutError):
            await asyncio.wait_for(sender, 2.0)
        await link.close()


async def _greeted(received: AsyncIterator[str | bytes], lobby: Lobby) -> tuple[Room, Client]:
    """Raises MessageError where the first message is not a hello with a token."""
    try:
        first = await asyncio.wait_for(anext(received), HELLO_WITHIN_S)
    except (TimeoutError, StopAsyncIteration):
        raise MessageError("hello", "no hello came") from None
    if isinstance(first, bytes):
        raise MessageError("hello", "the first message is a hello, as text")
    hello = m.decode_from_client(first)
    if not isinstance(hello, m.Hello):
        raise MessageError("hello", "the first message is a hello")
    if hello.protocol != m.PROTOCOL:
        raise MessageError(
            "protocol", f"the room speaks protocol {m.PROTOCOL}, not {hello.protocol}: update the client"
        )
    room, ticket = lobby.redeem(hello.token)
    return room, room.connect(ticket)


async def _hear_all(received: AsyncIterator[str | bytes], room: Room, client: Client) -> None:
    async for data in received:
        if client.outbox.closed:
            return
        if client.recorded:
            await room.drained()
        hear_word(room, client, data)


def hear_word(room: Room, client: Client, data: str | bytes) -> None:
    """A word or poses, as they came; what makes no sense is refused."""
    if not client.recorded and not client.allowance.word(room.now(), len(data)):
        return room.refuse(client, MessageError("rate", "too many words, or bytes, a second: say less"))
    if isinstance(data, bytes):
        return room.hear_poses(client, data)
    try:
        message = m.decode_from_client(data)
    except MessageError as error:
        return room.refuse(client, error)
    return room.hear(client, message)


async def _send(client: Client, link: Link) -> None:
    """Send what waits; who takes nothing any more is let go."""
    outbox = client.outbox
    while True:
        await outbox.wait()
        try:
            for word in outbox.take():
                await link.send(word, word[:1] == b"{")
        except ConnectionError:
            return
        if outbox.overflowed:
            await link.close()
            return
        if outbox.closed and outbox.empty:
            return
