"""A client of a room: joins, says poses and ranges, hears frames. With asyncio; `blocking` has it without."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Literal
from urllib.parse import urlsplit

import aiohttp
import msgspec

from synchronizar.errors import InputError
from synchronizar.live import messages as m
from synchronizar.live.forwarding import ModuleForwarder
from synchronizar.live.messages import MessageError
from synchronizar.live.peer_placing import placed, told_frame
from synchronizar.live.pose_wire import (
    PosesDown,
    PoseUp,
    decode_poses_down,
    decode_poses_up,
    encode_poses_up,
    is_newer,
    newest_poses,
)
from synchronizar.live.round_trips import RoundTrips
from synchronizar.live.trust import trust

if TYPE_CHECKING:
    from synchronizar.live.client_peers import ClientPeers
    from synchronizar.live.pose_channel import PoseChannel

_FIRST_PINGS, _FIRST_PING_S, _PING_S = 4, 0.1, 2.0


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
        host: str,
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
        self.not_understood: Counter[str] = Counter()
        """How many messages of the room were left alone because this client does not know them, by type; those of a
        later version of the room."""
        self.peer_poses: dict[str, PoseUp] = {}
        """The newest pose of each device that says its poses to this one by a data channel, in that device's own axes
        and by its own clock."""
        self._session, self._socket, self._host, self._clock = session, socket, host, clock
        self._index = {name: i for i, name in enumerate(welcome.you)}
        self._frame = {member.name: member.frame for member in welcome.members if member.name in self._index}
        self._sequence = 0
        self._round_trips = RoundTrips()
        self._pinging: asyncio.Task[None] | None = None
        self._peers: ClientPeers | None = None
        self._receiving: asyncio.Task[aiohttp.WSMessage] | None = None
        self._by_channel: PosesDown | None = None
        self._woken: asyncio.Future[None] | None = None
        self._forwarders: list[ModuleForwarder] = []

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
        app: str | None = None,
        verify: aiohttp.Fingerprint | None = None,
    ) -> Client:
        """Join the room at an address, whose fragment is the room's code.

        `users`: names of the devices that this connection speaks for, or settings by name as in recording.toml; `up`:
        their vertical axis where settings do not say; `clock`: what stamps their poses and ranges (s), which need not
        agree with anybody's; `app`: the secret of the room's application; `verify`: the one certificate to believe,
        None: as always. Raises InputError where the room cannot be joined, and says why.
        """
        parts = urlsplit(address)
        if parts.scheme not in ("https", "http") or not parts.hostname or not parts.fragment:
            raise InputError(address, "is no room's address; one looks like https://192.168.1.5:47180/#ABCD2345")
        settings = users if isinstance(users, Mapping) else {name: {} for name in users}
        wanted = [_settings(name, own, up) for name, own in settings.items()]
        asked = m.Join(parts.fragment, wanted, time, resume, app)
        base = f"{parts.scheme}://{parts.netloc}{parts.path.rstrip('/')}"
        believed: Any = verify or True
        if parts.scheme == "https" and verify is None:
            believed = await trust(parts.hostname, parts.port or 443)
        session = aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=None, connect=10.0))
        try:
            async with session.post(f"{base}/api/join", data=m.encode(asked), ssl=believed) as response:
                body = await response.read()
            if response.status != 200:
                raise InputError(base, _why(body))
            joined = m.decode_joined(body)
            socket = await session.ws_connect(f"{base}/live", ssl=believed, max_msg_size=0, heartbeat=15.0)
            await socket.send_str(m.encode(m.Hello(joined.token)).decode())
            welcome = m.decode_from_room(await socket.receive_str())
            if not isinstance(welcome, m.Welcome):
                raise InputError(base, welcome.what if isinstance(welcome, m.Bye) else "does not welcome")
        except (aiohttp.ClientError, TypeError, OSError, MessageError) as error:
            await session.close()
            raise InputError(base, f"cannot be joined: {error}") from error
        except BaseException:  # who gives up waiting leaves nothing open either
            await session.close()
            raise
        client = cls(session, socket, welcome, joined.resume, parts.hostname, clock)
        if time == "live" and client._index:
            client._pinging = asyncio.create_task(client._ping())
        return client

    @property
    def offset(self) -> float | None:
        """s: the room's clock minus this client's."""
        return self._round_trips.offset

    async def __aenter__(self) -> Client:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """End the connection; the devices may come again with `resume`."""
        if self._pinging is not None:
            self._pinging.cancel()
        for forwarder in self._forwarders:
            forwarder.close()
        if self._peers is not None:
            await self._peers.close()
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
            await self._say_poses(encode_poses_up(up))

    async def _say_poses(self, data: bytes) -> None:
        """To who has a data channel by that, where it takes them; to the room by the connection otherwise."""
        channels = {} if self._peers is None else self._peers.channels
        taken = {name for name, channel in channels.items() if channel.is_open and channel.send(data)}
        if m.ROOM not in taken:
            await self._socket.send_bytes(data)

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

    async def call(self, name: str = m.ROOM) -> PoseChannel:
        """Open a WebRTC data channel for poses to the room, or to another device; needs the extra `webrtc`.

        From then on `send_poses` sends to it as well; what waits is left out, and what the room's channel does not take
        goes by the connection as before. The answer is heard by `messages`; `opened` of what is returned waits for it.
        """
        return await self._all_peers().call(name)

    def answer_calls(self) -> None:
        """Let other devices of the room open data channels to this one: `peer_poses` are kept up by them."""
        self._all_peers().answers = True

    def place_of_peer(self, name: str) -> tuple[m.Vector, m.Quaternion] | None:
        """Where a device is by its own newest word, in the common frame; None where that is not known."""
        pose, member = self.peer_poses.get(name), self.members.get(name)
        if pose is None or member is None:
            return None
        frame = told_frame(self.frames.users.get(name), member.up, pose.frame)
        return None if frame is None else placed(frame, pose.position, pose.quat_xyzw)

    def forward_module(self, port: int = 0, host: str | None = None, udp_port: int | None = None) -> int:
        """Hand a module's datagrams on to the room unchanged, and its orders back; the UDP port for the module.

        `host`: the address at which to listen, None: all. `udp_port`: the room's, where it is another one than it says.
        """
        to = udp_port or self.welcome.udp_port
        if to is None:
            raise InputError("forward_module", "this room takes no datagrams")
        forwarder = ModuleForwarder((self._host, to), host, port)
        self._forwarders.append(forwarder)
        return forwarder.port

    async def messages(self) -> AsyncIterator[m.FromRoom | PosesDown]:
        """What the room says, until it or this client ends; `frames`, `poses` and the others are kept up on the way.

        What this client does not know is left alone, and counted in `not_understood`.
        """
        while True:
            word = await self._next()
            if not isinstance(word, PosesDown) and word.type not in (aiohttp.WSMsgType.BINARY, aiohttp.WSMsgType.TEXT):
                return
            if (message := self._understood(word)) is None:
                continue
            if not isinstance(message, PosesDown):
                self._take(message)
                yield message
            elif (newest := newest_poses(self.poses, message)) is not None:
                self.poses = newest
                self._round_trips.heard(newest.t, self._clock())
                yield newest

    def _understood(self, word: aiohttp.WSMessage | PosesDown) -> m.FromRoom | PosesDown | None:
        """None: of a room that knows more than this client."""
        if isinstance(word, PosesDown):
            return word
        try:
            if word.type is aiohttp.WSMsgType.BINARY:
                return decode_poses_down(word.data)
            return m.decode_from_room(word.data)
        except MessageError:
            kind = "binary" if word.type is aiohttp.WSMsgType.BINARY else m.type_of(word.data)
            self.not_understood[kind or "malformed"] += 1
            return None

    async def _next(self) -> aiohttp.WSMessage | PosesDown:
        """By the connection or the room's data channel, whichever comes first."""
        if self._receiving is None:
            self._receiving = asyncio.ensure_future(self._socket.receive())
        if self._by_channel is None and not self._receiving.done():
            self._woken = asyncio.get_running_loop().create_future()
            waited: set[asyncio.Future[Any]] = {self._receiving, self._woken}
            await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
        if self._by_channel is not None:
            poses, self._by_channel = self._by_channel, None
            return poses
        word, self._receiving = self._receiving.result(), None
        return word

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
            case m.Signalled():
                if self._peers is not None:
                    self._peers.signalled(message.by, message.data)
            case m.Pong():
                self._round_trips.pong(message.t, message.room_t, self._clock())

    def _all_peers(self) -> ClientPeers:
        if self._peers is None:
            try:
                from synchronizar.live.client_peers import ClientPeers
            except ModuleNotFoundError as error:
                raise InputError("data channels", "need the extra: pip install 'synchronizar[webrtc]'") from error
            own = self.welcome.you[0] if self.welcome.you else ""
            self._peers = ClientPeers(own, self.say_message, self._hear_channel)
        return self._peers

    def _hear_channel(self, name: str, data: bytes) -> None:
        """A channel's message; one that is none is as lost as any other datagram."""
        with suppress(MessageError):
            if name == m.ROOM:
                poses = decode_poses_down(data)
                self._by_channel = newest_poses(self._by_channel, poses) or self._by_channel
                if self._woken is not None and not self._woken.done():
                    self._woken.set_result(None)
                return
            for pose in decode_poses_up(data):
                before = self.peer_poses.get(name)
                if pose.user == 0 and (before is None or is_newer(pose.sequence, before.sequence)):
                    self.peer_poses[name] = pose

    async def _ping(self) -> None:
        with suppress(ConnectionError, aiohttp.ClientError):
            for n in range(1_000_000_000):
                await self.say_message(m.Ping(self._clock(), self.offset, self._round_trips.quickest))
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
