"""A client of a room: joins, says poses and ranges, hears frames. With asyncio; `blocking` has it without."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any, Literal
from urllib.parse import urlsplit

import aiohttp
import msgspec

from synchronizar.errors import InputError
from synchronizar.live import messages as m
from synchronizar.live.messages import MessageError
from synchronizar.live.pose_wire import PosesDown, PoseUp, decode_poses_down, encode_poses_up
from synchronizar.live.trust import trust

_FIRST_PINGS, _FIRST_PING_S, _PING_S = 4, 0.1, 2.0
_QUICKEST_OF = 8


class Client:
    """One connection to a room, for one device or several, or for none, which only looks.

    `async with await Client.join("https://192.168.1.5:47180/#ABCD2345", ["alice"], up="y") as client: ...`
    """

    def __init__(
        self,
        session: aiohttp.ClientSession,
        socket: aiohttp.ClientWebSocketResponse,
        welcome: m.Welcome,
        resume: str,
        clock: Callable[[], float],
    ) -> None:
        self.welcome = welcome
        self.resume = resume
        """To join again as the same devices."""
        self.frames = welcome.frames
        """Everybody's frames, as told last."""
        self.members = {member.name: member for member in welcome.members}
        self.objects = {o.id: o for o in welcome.objects.changed}
        self.poses: PosesDown | None = None
        """Everybody's poses in the common frame, as told last."""
        self.status: m.Status | None = None
        self.refused: dict[str, str] = {}
        """What the room refused, by reason: the last sentence."""
        self.offset: float | None = None
        """s: the room's clock minus this client's."""
        self._session, self._socket, self._clock = session, socket, clock
        self._index = {name: i for i, name in enumerate(welcome.you)}
        self._frame = {member.name: member.frame for member in welcome.members if member.name in self._index}
        self._sequence = 0
        self._round_trips: list[tuple[float, float]] = []
        self._pinging: asyncio.Task[None] | None = None

    @classmethod
    async def join(
        cls,
        address: str,
        users: Iterable[str] | Mapping[str, Mapping[str, Any]] = (),
        *,
        up: Literal["y", "z"] = "z",
        time: Literal["live", "recorded"] = "live",
        resume: str | None = None,
        clock: Callable[[], float] = time.time,
    ) -> Client:
        """Join the room at an address, whose fragment is the room's code.

        `users`: names of the devices that this connection speaks for, or settings by name as in recording.toml; `up`:
        their vertical axis where settings do not say; `clock`: what stamps their poses and ranges (s), which need not
        agree with anybody's. Raises InputError where the room cannot be joined, and says why.
        """
        parts = urlsplit(address)
        if parts.scheme not in ("https", "http") or not parts.hostname or not parts.fragment:
            raise InputError(address, "is no room's address; one looks like https://192.168.1.5:47180/#ABCD2345")
        settings = users if isinstance(users, Mapping) else {name: {} for name in users}
        asked = m.Join(parts.fragment, [_settings(name, own, up) for name, own in settings.items()], time, resume)
        base = f"{parts.scheme}://{parts.netloc}{parts.path.rstrip('/')}"
        verify: Any = True
        if parts.scheme == "https":
            verify = await trust(parts.hostname, parts.port or 443)
        session = aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=None, connect=10.0))
        try:
            async with session.post(f"{base}/api/join", data=m.encode(asked), ssl=verify) as response:
                body = await response.read()
            if response.status != 200:
                raise InputError(base, _why(body))
            joined = m.decode_joined(body)
            socket = await session.ws_connect(f"{base}/live", ssl=verify, max_msg_size=0, heartbeat=15.0)
            await socket.send_str(m.encode(m.Hello(joined.token)).decode())
            welcome = m.decode_from_room(await socket.receive_str())
            if not isinstance(welcome, m.Welcome):
                raise InputError(base, welcome.what if isinstance(welcome, m.Bye) else "does not welcome")
        except (aiohttp.ClientError, TypeError, OSError, MessageError) as error:
            await session.close()
            raise InputError(base, f"cannot be joined: {error}") from error
        except InputError:
            await session.close()
            raise
        client = cls(session, socket, welcome, joined.resume, clock)
        if time == "live" and client._index:
            client._pinging = asyncio.create_task(client._ping())
        return client

    async def __aenter__(self) -> Client:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """End the connection; the devices may come again with `resume`."""
        if self._pinging is not None:
            self._pinging.cancel()
        await self._socket.close()
        await self._session.close()

    async def leave(self) -> None:
        """Leave for good."""
        await self.say_message(m.Leave())
        await self.close()

    async def send_pose(self, user: str, t: float, position: Sequence[float], quat_xyzw: Sequence[float]) -> None:
        """A device's pose in its own axes: s by the client's clock, (3,) m, (4,) x y z w."""
        await self.send_poses([(user, t, position, quat_xyzw)])

    async def send_poses(self, poses: Iterable[tuple[str, float, Sequence[float], Sequence[float]]]) -> None:
        """Several at once: user, t, position, quat_xyzw."""
        up = []
        for user, t, (x, y, z), (qx, qy, qz, qw) in poses:
            self._sequence += 1
            sequence = self._sequence & 0xFFFFFFFF
            index = self._own(user)
            up.append(PoseUp(index, self._frame[user], sequence, t, (x, y, z), (qx, qy, qz, qw)))
        if up:
            await self._socket.send_bytes(encode_poses_up(up))

    async def send_range(self, t: float, a: str, b: str, distance: float, **columns: Any) -> None:
        """A distance (m) at t (s by the client's clock); other columns of ranges.csv by their names."""
        await self.send_ranges([m.MeasuredRange(t, a, b, distance, **columns)])

    async def send_ranges(self, ranges: Sequence[m.MeasuredRange]) -> None:
        """Several at once."""
        for begin in range(0, len(ranges), m.MOST_RANGES // 2):
            await self.say_message(m.Ranges(list(ranges[begin : begin + m.MOST_RANGES // 2])))

    async def new_frame(self, user: str) -> None:
        """SLAM of a device began anew: its poses are in another frame from now on."""
        self._own(user)
        self._frame[user] = (self._frame[user] + 1) % 256
        await self.say_message(m.Reset(user, self._frame[user]))

    async def lost_tracking(self, user: str) -> None:
        """SLAM of a device has lost track."""
        await self.say_message(m.Lost(user))

    async def say_message(self, message: msgspec.Struct) -> None:
        """Any message of `messages` that a client may say."""
        await self._socket.send_str(m.encode(message).decode())

    async def messages(self) -> AsyncIterator[m.FromRoom | PosesDown]:
        """What the room says, until it or this client ends; `frames`, `poses` and the others are kept up on the way."""
        async for word in self._socket:
            if word.type is aiohttp.WSMsgType.BINARY:
                self.poses = decode_poses_down(word.data)
                yield self.poses
            elif word.type is aiohttp.WSMsgType.TEXT:
                message = m.decode_from_room(word.data)
                self._take(message)
                yield message

    async def until(self, wanted: Callable[[m.FromRoom | PosesDown], bool]) -> m.FromRoom | PosesDown:
        """The first message of that kind. Raises ConnectionError where none comes any more."""
        async for message in self.messages():
            if wanted(message):
                return message
        raise ConnectionError("the room has ended the connection")

    def _take(self, message: m.FromRoom) -> None:
        match message:
            case m.Frames():
                self.frames = message
            case m.Members():
                self.members = {member.name: member for member in message.members}
            case m.Objects():
                self.objects |= {o.id: o for o in message.changed}
                for gone in message.removed:
                    self.objects.pop(gone, None)
            case m.Status():
                self.status = message
            case m.Refused():
                self.refused[message.reason] = message.what
            case m.Pong():
                self._pong(message, self._clock())

    def _pong(self, pong: m.Pong, now: float) -> None:
        """Of the recent round trips the quickest says most: half of it is what each way takes."""
        round_trip = now - pong.t
        self._round_trips = [
            *self._round_trips[1 - _QUICKEST_OF :],
            (round_trip, pong.room_t - pong.t - 0.5 * round_trip),
        ]
        self.offset = min(self._round_trips)[1]

    async def _ping(self) -> None:
        with suppress(ConnectionError, aiohttp.ClientError):
            for n in range(1_000_000_000):
                quickest = min(self._round_trips)[0] if self._round_trips else None
                await self.say_message(m.Ping(self._clock(), self.offset, quickest))
                await asyncio.sleep(_FIRST_PING_S if n < _FIRST_PINGS else _PING_S)

    def _own(self, user: str) -> int:
        if user not in self._index:
            raise ValueError(f"user: this connection does not speak for {user!r}, but for {', '.join(self._index)}")
        return self._index[user]


def _settings(name: str, own: Mapping[str, Any], up: Literal["y", "z"]) -> m.UserSettings:
    try:
        return msgspec.convert({"name": name, "up": up, **own}, m.UserSettings)
    except msgspec.ValidationError as error:
        raise ValueError(f"users: {name!r}: {error}") from None


def _why(body: bytes) -> str:
    try:
        return str(msgspec.json.decode(body)["what"])
    except (msgspec.DecodeError, KeyError, TypeError):
        return "refuses, and does not say why"
