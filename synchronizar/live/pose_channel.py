"""A WebRTC connection with one data channel for poses: unordered, never sent again. Needs aiortc.

Both ends are this: the room and a device, or two devices. Whoever calls offers; all candidates stand in the offer and
in the answer, so that two words set it up. No STUN server is asked: both ends are in one network.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from aiortc import RTCConfiguration, RTCDataChannel, RTCPeerConnection, RTCSessionDescription
from aiortc.exceptions import InvalidStateError

from synchronizar.live.messages import MessageError
from synchronizar.live.pose_wire import parts_of_poses

LABEL = "pose"
MOST_BUFFERED = 8192
"""Bytes that wait in a channel at most; more are not taken. Sends without such a cap close the whole association."""
LARGEST_PART = 1100
"""Bytes of a message that fits into one packet: of one that is cut, each lost piece would be all of it."""
OPENED_WITHIN_S = 10.0
_NOT_UNDERSTOOD = (ValueError, LookupError, AttributeError, TypeError, AssertionError)
"""aiortc's parser has no error of its own for text that is no SDP."""


class PoseChannel:
    """One end. There must be a running loop."""

    def __init__(self, heard: Callable[[bytes], None]) -> None:
        """`heard` is given each message that comes."""
        self.called = False
        """Whether this end has begun."""
        self.sent = self.refused = 0
        """Messages that were taken, and those that were not."""
        self._heard = heard
        self._connection = RTCPeerConnection(RTCConfiguration(iceServers=[]))
        self._connection.on("datachannel", self._take)
        self._connection.on("connectionstatechange", self._changed)
        self._channel: RTCDataChannel | None = None
        self._opened = asyncio.Event()
        self._ended = False

    @property
    def is_open(self) -> bool:
        """Whether messages can be sent."""
        return not self._ended and self._channel is not None and self._channel.readyState == "open"

    @property
    def ended(self) -> bool:
        """Whether it will never be open again."""
        return self._ended

    async def offer(self) -> dict[str, Any]:
        """Begin: what to say to the other end."""
        self.called = True
        self._use(self._connection.createDataChannel(LABEL, ordered=False, maxRetransmits=0))
        await self._connection.setLocalDescription(await self._connection.createOffer())
        return self._description()

    async def answer(self, offer: dict[str, Any]) -> dict[str, Any]:
        """What to say to an offer. Raises MessageError where it is none."""
        await self._hear_description(offer, "offer")
        try:
            await self._connection.setLocalDescription(await self._connection.createAnswer())
        except InvalidStateError as error:
            raise MessageError("signal", f"the offer was taken back: {error}") from None
        return self._description()

    async def take_answer(self, answer: dict[str, Any]) -> None:
        """What the other end says to the offer. Raises MessageError where it is no answer."""
        await self._hear_description(answer, "answer")

    async def opened(self) -> None:
        """Until messages can be sent. Raises ConnectionError where that does not come to be."""
        with suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._opened.wait(), OPENED_WITHIN_S)
        if not self.is_open:
            raise ConnectionError("no data channel came about: the two may not reach each other by UDP")

    def send(self, data: bytes) -> bool:
        """Whether it took the message; not where it is not open, or too much waits already."""
        channel = self._channel
        if self._ended or channel is None or channel.readyState != "open" or channel.bufferedAmount > MOST_BUFFERED:
            self.refused += 1
            return False
        channel.send(data)
        self.sent += 1
        return True

    def send_poses_down(self, data: bytes) -> bool:
        """The same of everybody's poses, in as many messages as packets need."""
        parts = parts_of_poses(data, LARGEST_PART)
        return self.send(parts[0]) and all(self.send(part) for part in parts[1:])

    async def close(self) -> None:
        """End it."""
        self._end()
        await self._connection.close()

    def _description(self) -> dict[str, Any]:
        local = self._connection.localDescription
        return {"type": local.type, "sdp": local.sdp}

    async def _hear_description(self, data: dict[str, Any], kind: str) -> None:
        sdp = data.get("sdp")
        if data.get("type") != kind or not isinstance(sdp, str):
            raise MessageError("signal", f'a word of WebRTC is {{"type": "{kind}", "sdp": text}}')
        if [line.split(" ", 1)[0] for line in sdp.splitlines() if line.startswith("m=")] != ["m=application"]:
            raise MessageError("signal", "data channels alone: no sound, no pictures")
        try:
            await self._connection.setRemoteDescription(RTCSessionDescription(sdp, kind))
        except (*_NOT_UNDERSTOOD, InvalidStateError) as error:
            raise MessageError("signal", f"this {kind} cannot be understood: {error}") from None

    def _take(self, channel: RTCDataChannel) -> None:
        if channel.label == LABEL and self._channel is None:
            self._use(channel)

    def _use(self, channel: RTCDataChannel) -> None:
        self._channel = channel
        channel.on("message", self._message)
        channel.on("open", self._opened.set)
        channel.on("close", self._end)
        if channel.readyState == "open":
            self._opened.set()

    def _message(self, data: bytes | str) -> None:
        if isinstance(data, bytes) and not self._ended:
            self._heard(data)

    def _changed(self) -> None:
        if self._connection.connectionState in ("failed", "closed"):
            self._end()

    def _end(self) -> None:
        self._ended = True
        self._opened.set()
