"""A room: who is in it, what they say, what everybody is told. No wall time, no network: both come from outside."""

from __future__ import annotations

import secrets
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from hashlib import blake2s, sha256
from typing import Any, Protocol

import numpy as np

from synchronizar.geometry import YawFrame
from synchronizar.io.datagrams import OrderDatagram, RangesDatagram, RoomKeys, encode_order
from synchronizar.io.receiver import Receiver
from synchronizar.live import messages as m
from synchronizar.live.budget import MEASURED_A_SECOND, Allowance, Budget
from synchronizar.live.checks import alike, check_distance, check_range, check_settings, check_stamp, is_taken
from synchronizar.live.device_clock import DeviceClock
from synchronizar.live.messages import MessageError
from synchronizar.live.module_ranges import measured_ranges
from synchronizar.live.objects import ObjectStore
from synchronizar.live.outbox import Outbox
from synchronizar.live.peer_placing import placed, told_frame
from synchronizar.live.placing import AT_ITS_ORIGIN, OwnPose, Placing, Shown
from synchronizar.live.pose_wire import PoseUp, decode_poses_up, encode_rows_down
from synchronizar.live.recorder import recorded_name
from synchronizar.live.roster import KnownDevice, Roster
from synchronizar.live.sleeping import Sleeping, Standing, standing_of
from synchronizar.live.solver import Solver
from synchronizar.live.solver_wire import AddUser, Lost, NewestRange, NewFrame, Pose, Range, Told
from synchronizar.parameters import SleepParameters

UPDATES_A_SECOND = 10
FRAMES_AT_LEAST_EVERY = 0.5
"""s between frames that are told though nothing has changed."""
MOVES_EVERY = 0.19
"""s between frames that are told because somebody's place changed, and nothing else."""
STATUS_EVERY = 1.0
STANDINGS_EVERY = 0.5
"""s between looks at whose modules are needed."""
FROM_THE_FUTURE = 0.5
"""s: a stamp further ahead of the room's clock is refused."""
TOO_OLD = 10.0
"""s: a pose or range that is older is refused."""
AWAY_AFTER = 300.0
"""s: who has been away for so long is left out of what is told."""
TOKEN_S = 60.0
"""s for which a token may be used, once, and for which its devices' names are kept for it."""
MOST_DEVICES = 64
MOST_HELD = 512
"""Poses of a device, and ranges of a room, that wait until a device's clock is known."""
MOST_SPECTATORS = 128
MOST_ADDRESSES_OF_ONE = 8
"""Addresses that one device's module may have had."""
RESETS_A_SECOND, RESETS_AT_ONCE = 0.2, 20.0
"""Of one device: each new frame is a new user of the recording and of the solver."""
LONGEST_ROUND_TRIP = 60.0
_CHANGED_M, _CHANGED_RAD = 1e-3, 2e-4
_LAST_ADDRESS = 0xFFFD


class Recorder(Protocol):
    """What writes a room down as it goes."""

    def user(self, settings: m.UserSettings, session: int) -> None:
        """Somebody comes, or has a new frame."""

    def pose(self, user: str, frame: int, t: float, position: m.Vector, quat_xyzw: m.Quaternion) -> None:
        """A pose that the solver is given."""

    def range(
        self, t: float, a: str, b: str, frames: tuple[int, int], distance: float, optional: dict[str, Any]
    ) -> None:
        """A range that the solver is given."""


class Peer(Protocol):
    """A client's second way for poses, besides its connection; where it takes none, they go by the connection."""

    def signalled(self, data: dict[str, Any]) -> None:
        """What the client says to set it up."""

    def send_poses(self, data: bytes) -> bool:
        """Whether it took everybody's poses."""

    def close(self) -> None:
        """End it."""


@dataclass
class Device:
    """A device of the room, here or away."""

    settings: m.UserSettings
    index: int
    owner: str
    """Hash of the secret by which its connection is known when it comes again."""
    frame: int = 0
    session: int = 0
    """How often its SLAM began anew."""
    client: Client | None = None
    clock: DeviceClock = field(default_factory=DeviceClock)
    held: list[PoseUp] = field(default_factory=list)
    """Poses that wait until its clock is known."""
    pose: OwnPose | None = None
    """Its newest pose by the room's clock, in its own axes."""
    poses: deque[float] = field(default_factory=lambda: deque(maxlen=128))
    ranges: deque[float] = field(default_factory=lambda: deque(maxlen=1024))
    round_trip: float | None = None
    refused: Counter[str] = field(default_factory=Counter)
    left_at: float | None = None
    resets: Budget | None = None

    @property
    def name(self) -> str:
        """Its name."""
        return self.settings.name

    def member(self) -> m.Member:
        """As others are told of it."""
        here = self.client is not None
        return m.Member(self.name, self.index, here, self.settings.static, self.settings.up, self.frame)


@dataclass(eq=False)
class Client:
    """A connection and the devices that it speaks for."""

    devices: list[Device]
    recorded: bool
    allowance: Allowance
    outbox: Outbox = field(default_factory=Outbox)
    told: Counter[str] = field(default_factory=Counter)
    peer: Peer | None = None

    @property
    def name(self) -> str:
        """In whose name it holds objects and speaks."""
        return self.devices[0].name if self.devices else ""


@dataclass(eq=False)
class Ticket:
    """What a join has bought."""

    settings: list[m.UserSettings]
    owner: str
    """Hash of the secret by which they come again."""
    recorded: bool
    until: float

    @property
    def users(self) -> list[str]:
        """Names of the devices."""
        return [user.name for user in self.settings]


class Room:
    """One room; everything in it happens in the order in which its methods are called."""

    def __init__(
        self,
        code: str,
        now: Callable[[], float],
        key: bytes | None = None,
        recorder: Recorder | None = None,
        udp_port: int | None = None,
        app: str | None = None,
        allow_version_1: bool = False,
        saved: Callable[[m.Object | str], None] | None = None,
        sleep: SleepParameters | None = None,
    ) -> None:
        """`now`: the room's clock (s). `key`: 32 bytes from which modules' keys are derived.

        `allow_version_1`: whether modules may all sign with the room's own key. `saved` hears each object that changes,
        and the id of each one that is gone. `sleep`: when modules sleep.
        """
        self.code, self.now, self.udp_port, self.app = code, now, udp_port, app
        self.key = key or secrets.token_bytes(32)
        self.radio_session = int.from_bytes(blake2s(self.key, digest_size=4, person=b"session").digest(), "little")
        self.keys = RoomKeys(self.radio_session, self.key, allow_version_1)
        self.receiver = Receiver(self.keys)
        self.sleeping = Sleeping(sleep)
        self.devices: dict[str, Device] = {}
        self.clients: set[Client] = set()
        self.modules: dict[int, str] = {}
        """Whose module has which address."""
        self.given: dict[int, str] = {}
        """Whose module ever had which: its key is known there, and so the address is nobody else's any more."""
        self.roster_version = 0
        """Rises when `roster` is another one."""
        self.refused: Counter[str] = Counter()
        """Of what could not be told to be anybody's."""
        self.refused_outside: Counter[str] = Counter()
        """The same, of the server: what came without a room."""
        self.recorded: bool | None = None
        """Whether time is a recording's; None until a device comes."""
        self.recorded_t: float | None = None
        self.objects = ObjectStore(saved)
        self.frames = m.Frames(0, now(), None, {})
        self.solver: Solver | None = None
        self.lag: Callable[[], m.Lag] | None = None
        """How late the loop is that calls all of this."""
        self.begun: Callable[[bool], None] | None = None
        """Hears whether time is a recording's, when the first device comes."""
        self.open_peer: Callable[[Room, Client], Peer] | None = None
        """Begins a client's second way for poses; None where the server has none."""
        self._recorder = recorder
        self._ranges: list[NewestRange] = []
        self._held_ranges: list[tuple[float, str, str, float, dict[str, Any]]] = []
        self._placing: tuple[list[Device], Placing] | None = None
        self._untold = False
        self._told_at = self._frames_at = self._status_at = self._asked_at = self._stood_at = -np.inf
        self._empty_since = now()
        self._sequence = 0
        self._finishing: list[Client] = []
        self._tickets: list[Ticket] = []
        """Of those who have not come yet."""
        self._module_budgets: dict[int, Budget] = {}

    def roster(self) -> Roster:
        """What has to be remembered to open it again."""
        devices = [KnownDevice(d.settings, d.owner, d.frame, d.session) for d in self.devices.values()]
        modules, given, sequences = dict(self.modules), dict(self.given), self.receiver.sequences()
        return Roster(self.code, self.key.hex(), devices, modules, given, sequences)

    def restore(self, roster: Roster) -> None:
        """Its devices as they were; all of them are away."""
        names = {alike(known.settings.name) for known in roster.devices}
        for known in roster.devices:
            device = Device(known.settings, len(self.devices), known.owner, known.frame, known.session)
            device.left_at = self.now()
            self.devices[device.name] = device
            if self._recorder is not None:
                for session in range(known.session + 1):
                    if session == 0 or alike(recorded_name(device.name, session)) not in names:
                        self._recorder.user(known.settings, session)
        self.modules, self.given = dict(roster.modules), roster.modules | roster.given
        self.receiver.go_on(roster.sequences)

    # Coming and going

    def admit(self, join: m.Join) -> tuple[Ticket, str]:
        """Who may come in as whom, and the secret to come again. Raises MessageError with a way on.

        Names are kept for them for as long as the ticket holds; the room changes when they come.
        """
        now, recorded = self.now(), join.time == "recorded" and bool(join.users)
        self._tickets = [ticket for ticket in self._tickets if ticket.until >= now]
        owners = {device.name: device.owner for device in self.devices.values()}
        owners |= {name: ticket.owner for ticket in self._tickets for name in ticket.users}
        secret, owner = join.resume or "", _owner(join.resume or "")
        if owner not in owners.values():  # a secret that is not of this room's making may be easy to guess
            secret = secrets.token_urlsafe(24)
            owner = _owner(secret)
        ticket = Ticket(join.users, owner, recorded, now + TOKEN_S)
        self._check_time(ticket)
        if len({alike(name) for name in ticket.users}) != len(ticket.users):
            raise MessageError("name", "two devices of one connection have the same name")
        for user in join.users:
            check_settings(user)
            self._check_name(user.name, owner, owners)
        if len(owners.keys() | set(ticket.users)) > MOST_DEVICES:
            raise MessageError("full", f"the room has its {MOST_DEVICES} devices: open another room")
        self._tickets.append(ticket)
        return ticket, secret

    def connect(self, ticket: Ticket) -> Client:
        """Its connection stands: it is told everything as it is now. Raises MessageError where it cannot come in."""
        self._check_time(ticket)
        if not ticket.settings and sum(not client.devices for client in self.clients) >= MOST_SPECTATORS:
            raise MessageError("full", f"{MOST_SPECTATORS} look already: come later")
        self._tickets = [other for other in self._tickets if other is not ticket]
        if ticket.settings and self.recorded is None:
            self.recorded = ticket.recorded
            if self.begun is not None:
                self.begun(ticket.recorded)
        for user in ticket.settings:
            if user.name not in self.devices:
                self.devices[user.name] = Device(user, len(self.devices), ticket.owner)
                self._feed_user(self.devices[user.name])
        devices = [self.devices[name] for name in ticket.users]
        client = Client(devices, ticket.recorded, Allowance(len(devices), self.now()))
        for device in devices:
            if (earlier := device.client) is not None:
                self.disconnect(earlier)
                earlier.outbox.put(m.encode(m.Bye("elsewhere", "the same device has joined from somewhere else")))
                earlier.outbox.close()
            device.client, device.left_at = client, None
            device.clock.reconnect()
        self.clients.add(client)
        you = [device.name for device in devices]
        welcome = m.Welcome(
            *(self.code, you, m.PROTOCOL, self.time(), self._members(), self.frames, self.objects.snapshot()),
            udp_port=self.udp_port,
            app=self.app,
            webrtc=self.open_peer is not None and not client.recorded,
        )
        client.outbox.put(m.encode(welcome))
        if devices:
            self._tell_members()
        return client

    def disconnect(self, client: Client) -> None:
        """Its connection is gone; its devices may come again."""
        self.clients.discard(client)
        if client.peer is not None:
            client.peer.close()
            client.peer = None
        if not self.clients:
            self._empty_since = self.now()
        gone = [device for device in client.devices if device.client is client]
        for device in gone:
            device.client, device.left_at = None, self.time()
        if gone:
            self._tell_members()

    def idle_for(self) -> float:
        """How long (s) nobody has been here."""
        return 0.0 if self.clients else self.now() - self._empty_since

    # What comes

    def time(self) -> float:
        """The room's time: its clock's, or a recording's."""
        return self.recorded_t if self.recorded and self.recorded_t is not None else self.now()

    def hear(self, client: Client, message: m.FromClient) -> None:
        """What a client says. A word that is refused is told to it."""
        try:
            self._hear(client, message)
        except MessageError as error:
            self.refuse(client, error)
        if client.devices:
            self.objects.alive(client.name, self.time())

    def hear_poses(self, client: Client, data: bytes) -> None:
        """Poses that a client sends."""
        try:
            poses = decode_poses_up(data)
        except MessageError as error:
            return self.refuse(client, error)
        arrived = self.now()
        if not client.recorded and not client.allowance.measured(arrived, len(poses)):
            return self.refuse(client, _too_many())
        for pose in poses:
            try:
                if pose.user >= len(client.devices):
                    raise MessageError("user", f"this connection speaks for {len(client.devices)} devices")
                self._take_pose(client, client.devices[pose.user], pose, arrived)
            except MessageError as error:
                self.refuse(client, error)
        return None

    def hear_datagram(self, data: bytes, arrived: float) -> RangesDatagram | None:
        """A datagram of a module that arrived at `arrived` (s, room's clock); None where it is refused."""
        if self.recorded:
            self.refused["datagram time"] += 1  # modules range now, and the room is at a recording's time
            return None
        taken = self.receiver.take(data, arrived)
        if taken is None:
            return None
        if not self._budget_of(taken.datagram.reporter).take(arrived, 1 + len(taken.datagram.ranges)):
            self.refused["datagram rate"] += 1
            return None
        for stamped in taken.stamped:
            for measured in measured_ranges(stamped):
                a, b = self.modules.get(measured.reporter), self.modules.get(measured.peer)
                try:
                    if a is None or b is None:
                        raise MessageError("peer", "nobody's module has that address")
                    self._check_moment(a, measured.t, arrived)
                    check_distance(measured.distance)
                except MessageError as error:
                    self.refused[f"datagram {error.reason}"] += 1
                else:
                    self._take_range(measured.t, a, b, measured.distance, self._with_antennas(a, b, measured.optional))
        return taken.datagram

    def orders_for(self, heard: RangesDatagram, now: float) -> list[bytes]:
        """What a module is told in answer to a datagram."""
        user = self.modules.get(heard.reporter)
        sleep_s = None if user is None else self.sleeping.answer(now, user)
        if sleep_s is None:
            return []
        order = OrderDatagram(self.radio_session, heard.reporter, heard.sequence, sleep_s)
        return [encode_order(order, self.keys.of(heard.reporter))]

    def refuse(self, client: Client, error: MessageError) -> None:
        """Count it, and tell the client when it is news."""
        client.told[error.reason] += 1
        for device in client.devices:
            device.refused[error.reason] += 1
        if not client.devices:
            self.refused[error.reason] += 1
        count = client.told[error.reason]
        if count in (1, 10, 100) or count % 1000 == 0:
            client.outbox.put(m.encode(m.Refused(error.reason, str(error), count)))

    def told(self, told: Told) -> None:
        """What the solver knows."""
        self._told_at = told.t
        self._ranges = told.ranges
        if told.events:
            self._broadcast(m.Events(told.t, told.events))
        news, moved = _is_news(self.frames, told), _moved(self.frames, told)
        self.frames = m.Frames(self.frames.version + (news or moved), told.t, told.reference, told.users)
        self._placing = None
        self._untold = self._untold or moved
        since = told.t - self._frames_at
        if news or (self._untold and since >= MOVES_EVERY) or not 0.0 <= since < FRAMES_AT_LEAST_EVERY:
            self._frames_at, self._untold = told.t, False
            self._broadcast_latest("frames", m.encode(self.frames))
        self.objects.place_waiting(self._in_common, self.time())

    def finished(self, registration: dict[str, Any]) -> None:
        """The answer that somebody asked for."""
        waiting, self._finishing = self._finishing, []
        for client in waiting:
            client.outbox.put(m.encode(m.Answer(registration)))

    async def drained(self) -> None:
        """Until the solver has nearly caught up: for a recording that comes faster than anybody walks."""
        if self.solver is not None:
            await self.solver.drained()

    def event(self, sentence: str) -> None:
        """Tell everybody."""
        self._broadcast(m.Events(self.time(), [sentence]))

    def tick(self) -> None:
        """About thirty times a second: poses, objects, ten times a second the solver, once how the room is."""
        t = self.time()
        for device in self.devices.values():
            if device.held and device.clock.is_known(t):
                self._give_held(device)
        if self._held_ranges:
            held, self._held_ranges = self._held_ranges, []
            for measured in held:
                self._take_range(*measured)
        if self.solver is not None and not self.recorded and t - self._asked_at >= 0.999 / UPDATES_A_SECOND:
            self._asked_at = t
            self.solver.advance(t)
        if t - self._stood_at >= STANDINGS_EVERY or t < self._stood_at:
            self._stood_at = t
            self.sleeping.update(t, self._standings())
        self.objects.expire(t)
        if (changes := self.objects.changes()) is not None:
            self._broadcast(changes)
        if self.clients:
            self._sequence += 1
            poses = self._poses(t)
            for client in self.clients:
                if client.peer is None or not client.peer.send_poses(poses):
                    client.outbox.latest("poses", poses)
        now = self.now()
        if now - self._status_at >= STATUS_EVERY or now < self._status_at:
            self._status_at = now
            self._broadcast_latest("status", m.encode(self.status()))

    def status(self) -> m.Status:
        """How the room is."""
        t = self.time()
        users = {
            device.name: m.Health(
                _rate(device.poses, t),
                _rate(device.ranges, t),
                None if device.round_trip is None else 500.0 * device.round_trip,
                self.sleeping.is_asleep(t, device.name),
                dict(device.refused),
            )
            for device in self.devices.values()
        }
        pairs = [m.PairRange(r.a, r.b, r.distance, r.residual, r.used, max(0.0, t - r.t)) for r in self._ranges]
        refused = (
            self.refused
            + self.refused_outside
            + Counter({f"datagram {reason}": n for reason, n in self.receiver.refused.items()})
        )
        behind = float(max(0.0, t - max(self._told_at, t - 3600.0)))
        return m.Status(t, users, pairs, dict(refused), behind, None if self.lag is None else self.lag())

    # Inside

    def _hear(self, client: Client, message: m.FromClient) -> None:
        match message:
            case m.Ping():
                self._ping(client, message)
            case m.Ranges():
                self._ranges_of(client, message)
            case m.Reset():
                self._reset(client, message)
            case m.Lost():
                self._feed(Lost(self._moving(client, message.user).name))
            case m.Module():
                self._module(client, message)
            case m.Clock():
                self._clock(client, message)
            case m.Finish():
                self._need_recorded(client)
                check_stamp(message.t)
                if client in self._finishing:
                    raise MessageError("time", "the answer is under way")
                self._finishing.append(client)
                if self.solver is not None:
                    self.solver.finish(message.t)
            case m.Create():
                if message.user is not None:
                    self._own(client, message.user)
                self.objects.create(message, self._speaker(client), self.time(), self._in_common)
            case m.Grab():
                self.objects.grab(message.id, self._speaker(client), self.time())
            case m.Move():
                self.objects.move(message, self._speaker(client), self.time())
            case m.Release():
                self.objects.release(message.id, self._speaker(client))
            case m.Remove():
                self.objects.remove(message.id, self._speaker(client))
            case m.Heartbeat():
                pass
            case m.Say():
                self._say(client, message)
            case m.Signal():
                self._signal(client, message)
            case m.Leave():
                self._leave(client)
            case m.Hello():
                raise MessageError("hello", "hello is said once")

    def _ping(self, client: Client, message: m.Ping) -> None:
        check_stamp(message.t)
        if message.offset is not None:
            check_stamp(message.offset)
        if message.round_trip is not None and not 0.0 <= message.round_trip < LONGEST_ROUND_TRIP:
            raise MessageError("value", "a round trip is a positive number of s")
        arrived = self.now()
        for device in client.devices:
            device.round_trip = message.round_trip
            if client.recorded:
                continue
            if message.offset is None:
                device.clock.asked(arrived)
            else:
                device.clock.offer(message.offset, message.round_trip)
            device.clock.hear(message.t, arrived)
        client.outbox.put(m.encode(m.Pong(message.t, arrived)))

    def _ranges_of(self, client: Client, message: m.Ranges) -> None:
        if len(message.ranges) > m.MOST_RANGES:
            raise MessageError("size", f"a message has at most {m.MOST_RANGES} ranges")
        arrived = self.now()
        if not client.recorded and not client.allowance.measured(arrived, len(message.ranges)):
            raise _too_many()
        for measured in message.ranges:
            try:
                self._take_measured(client, measured, arrived)
            except MessageError as error:
                self.refuse(client, error)

    def _take_measured(self, client: Client, measured: m.MeasuredRange, arrived: float) -> None:
        reporter = next((device for device in client.devices if device.name in (measured.a, measured.b)), None)
        if reporter is None:
            raise MessageError("user", "a client reports the ranges of its own devices only")
        if measured.a == measured.b:
            raise MessageError("value", f"{measured.a}: a range to itself")
        for name in (measured.a, measured.b):
            if name not in self.devices:
                raise MessageError("user", f"there is nobody called {name[: m.LONGEST_NAME]!r} in the room")
        check_range(measured, (self._antennas(measured.a), self._antennas(measured.b)))
        if not client.recorded:  # a recording has what it has, and the solver judges it as `register` does
            check_distance(measured.distance)
        t = measured.t if client.recorded else self._room_time(reporter, measured.t, arrived)
        optional = {
            name: getattr(measured, name)
            for name in ("sigma", "antenna_a", "antenna_b", "rx_power", "fp_power", "nlos", "source")
            if getattr(measured, name) is not None
        }
        if "nlos" in optional:
            optional["nlos"] = float(optional["nlos"])
        self._take_range(t, measured.a, measured.b, measured.distance, optional)

    def _reset(self, client: Client, message: m.Reset) -> None:
        device, frame = self._moving(client, message.user), message.frame % 256
        if frame == device.frame:
            raise MessageError("frame", "a new frame has another number than the one before")
        device.resets = device.resets or Budget(RESETS_A_SECOND, self.now(), RESETS_AT_ONCE)
        if not device.resets.take(self.now()):
            raise MessageError("rate", "too many new frames within a minute: wait")
        device.frame, device.pose = frame, None
        self._placing = None
        device.session += 1
        while alike(recorded_name(device.name, device.session)) in self._sessions():
            device.session += 1
        self._feed(NewFrame(device.name, device.frame))
        if self._recorder is not None:
            self._recorder.user(device.settings, device.session)
        self._tell_members()

    def _module(self, client: Client, message: m.Module) -> None:
        device = self._own(client, message.user)
        if not 0 <= message.address <= _LAST_ADDRESS:
            raise MessageError("address", f"a module's address is 0 to {_LAST_ADDRESS}")
        owner = self.given.get(message.address)
        if owner not in (None, device.name):
            raise MessageError("address", f"address {message.address} is the module of {owner}: give it another one")
        if owner is None and sum(name == device.name for name in self.given.values()) >= MOST_ADDRESSES_OF_ONE:
            raise MessageError("address", f"{device.name} has had {MOST_ADDRESSES_OF_ONE} addresses: use one of them")
        self.modules = {a: name for a, name in self.modules.items() if name != device.name}
        self.modules[message.address] = self.given[message.address] = device.name
        self.roster_version += 1
        key = self.keys.of(message.address).hex()
        client.outbox.put(m.encode(m.ModuleKey(device.name, message.address, self.radio_session, key, self.udp_port)))

    def _clock(self, client: Client, message: m.Clock) -> None:
        self._need_recorded(client)
        check_stamp(message.t)
        if self.recorded_t is not None and message.t < self.recorded_t:
            raise MessageError("time", "a recording's time goes forwards")
        self.recorded_t = message.t
        if self.solver is not None:
            self.solver.advance(message.t)

    def _need_recorded(self, client: Client) -> None:
        if not client.recorded:
            raise MessageError("time", "only a client that joined with recorded time says what time it is")

    def _say(self, client: Client, message: m.Say) -> None:
        if m.data_too_large(message.data):
            raise MessageError("size", f"data has at most {m.LARGEST_DATA} bytes as JSON")
        said = m.encode(m.Said(message.topic[: m.LONGEST_NAME], message.data, self._speaker(client)))
        self._hand_on(client, said)
        if message.to is None:
            for other in self.clients - {client}:
                other.outbox.put(said)
        else:
            self._client_of(message.to).outbox.put(said)

    def _signal(self, client: Client, message: m.Signal) -> None:
        if m.data_too_large(message.data):
            raise MessageError("size", f"a signal has at most {m.LARGEST_DATA} bytes as JSON")
        if message.to == m.ROOM:
            self._signal_to_room(client, message.data)
            return
        signalled = m.encode(m.Signalled(self._speaker(client), message.data))
        self._hand_on(client, signalled)
        self._client_of(message.to).outbox.put(signalled)

    def _signal_to_room(self, client: Client, data: dict[str, Any]) -> None:
        if self.open_peer is None:
            raise MessageError("signal", "this server has no WebRTC: send poses by this connection")
        if client.recorded:
            raise MessageError("signal", "a recording's poses come in order: send them by this connection")
        if client.peer is None:
            client.peer = self.open_peer(self, client)
        client.peer.signalled(data)

    def _hand_on(self, client: Client, word: bytes) -> None:
        if not client.allowance.handed_on(self.now(), len(word)):
            raise MessageError("rate", "too much is said to others a second: say less")

    def _leave(self, client: Client) -> None:
        client.outbox.put(m.encode(m.Bye("left", "you have left the room")))
        self.disconnect(client)
        client.outbox.close()

    def _take_pose(self, client: Client, device: Device, pose: PoseUp, arrived: float) -> None:
        if device.settings.static:
            raise MessageError("static", f"{device.name} stands still: it has no poses")
        if pose.frame != device.frame:
            raise MessageError("frame", f"a pose of frame {pose.frame}; {device.name} is in frame {device.frame}")
        t = pose.t if client.recorded else self._room_time(device, pose.t, arrived)
        if not client.recorded and not device.clock.is_known(arrived) and len(device.held) < MOST_HELD:
            device.held.append(pose)
            return
        self._give_held(device)
        self._give_pose(device, pose, t)

    def _give_held(self, device: Device) -> None:
        held, device.held = device.held, []
        for pose in held:
            if pose.frame == device.frame:
                self._give_pose(device, pose, device.clock.convert(pose.t))

    def _give_pose(self, device: Device, pose: PoseUp, t: float) -> None:
        if device.pose is None or t >= device.pose[0]:
            device.pose = t, pose.position, pose.quat_xyzw
        device.poses.append(t)
        self._feed(Pose(device.name, t, pose.position, pose.quat_xyzw))
        if self._recorder is not None:
            self._recorder.pose(device.name, device.session, t, pose.position, pose.quat_xyzw)

    def _room_time(self, device: Device, stamp: float, arrived: float) -> float:
        t = device.clock.hear(stamp, arrived)
        self._check_moment(device.name, t, arrived)
        return t

    def _check_moment(self, name: str, t: float, arrived: float) -> None:
        """Whether something of a device may be of then, by the room's clock; what is no number may not."""
        if not t <= arrived + FROM_THE_FUTURE:
            raise MessageError("future", f"{name}: a stamp {t - arrived:.1f} s ahead of the room's clock")
        if not t >= arrived - TOO_OLD:
            raise MessageError("old", f"{name}: a stamp {arrived - t:.1f} s behind the room's clock")

    def _budget_of(self, reporter: int) -> Budget:
        """How much a module may still tell; it has shown that it is that module."""
        if reporter not in self._module_budgets:
            self._module_budgets[reporter] = Budget(MEASURED_A_SECOND, self.now())
        return self._module_budgets[reporter]

    def _antennas(self, name: str) -> Mapping[str, m.Vector]:
        return self.devices[name].settings.antennas

    def _take_range(self, t: float, a: str, b: str, distance: float, optional: dict[str, Any]) -> None:
        if self._waits(a, b) and len(self._held_ranges) < MOST_HELD:
            self._held_ranges.append((t, a, b, distance, optional))
        else:
            self._give_range(t, a, b, distance, optional)

    def _waits(self, a: str, b: str) -> bool:
        """Whether poses of either are held: a range is given after them."""
        return bool(self.devices[a].held or self.devices[b].held)

    def _give_range(self, t: float, a: str, b: str, distance: float, optional: dict[str, Any]) -> None:
        for name in (a, b):
            self.devices[name].ranges.append(t)
        self.sleeping.ranged(t, a, b)
        self._feed(Range(t, a, b, distance, optional))
        if self._recorder is not None:
            frames = self.devices[a].session, self.devices[b].session
            self._recorder.range(t, a, b, frames, distance, optional)

    def _with_antennas(self, a: str, b: str, optional: dict[str, Any]) -> dict[str, Any]:
        """A module is the first antenna that its device declares."""
        for end, name in (("antenna_a", a), ("antenna_b", b)):
            if antennas := self.devices[name].settings.antennas:
                optional[end] = next(iter(antennas))
        return optional

    def _feed_user(self, device: Device) -> None:
        self._feed(AddUser(device.settings))
        if self._recorder is not None:
            self._recorder.user(device.settings, device.session)

    def _feed(self, command: Any) -> None:
        if self.solver is not None:
            self.solver.feed(command)

    def _check_time(self, ticket: Ticket) -> None:
        if ticket.settings and self.recorded not in (None, ticket.recorded):
            kind = "a recording" if self.recorded else "people who walk now"
            raise MessageError("time", f"this room plays {kind}: open another room")

    def _check_name(self, name: str, owner: str, owners: Mapping[str, str]) -> None:
        """Whether somebody may have it; `owners` of all names that are known or kept."""
        if name == m.ROOM:
            raise MessageError("name", f"{m.ROOM!r} is the room itself: choose another name")
        if name in owners:
            if not secrets.compare_digest(owners[name], owner):
                raise MessageError("name", f"there is somebody called {name!r} already: choose another name")
        elif is_taken(name, self._sessions()):
            raise MessageError("name", f"{name!r} is too much like a name that is there already: choose another one")

    def _sessions(self) -> dict[str, int]:
        """How often SLAM began anew, by names as `alike`, of all devices and of those who have not come yet."""
        coming = {alike(name): 0 for ticket in self._tickets for name in ticket.users}
        return coming | {alike(device.name): device.session for device in self.devices.values()}

    def _own(self, client: Client, name: str) -> Device:
        for device in client.devices:
            if device.name == name:
                return device
        raise MessageError("user", f"this connection does not speak for {name!r}")

    def _moving(self, client: Client, name: str) -> Device:
        device = self._own(client, name)
        if device.settings.static:
            raise MessageError("static", f"{name} stands still: it has no SLAM")
        return device

    def _speaker(self, client: Client) -> str:
        if not client.devices:
            raise MessageError("spectator", "who only looks changes nothing: join with a device")
        return client.name

    def _client_of(self, name: str) -> Client:
        device = self.devices.get(name)
        if device is None or device.client is None:
            raise MessageError("user", f"{name!r} is not here")
        return device.client

    def frame_of(self, name: str) -> YawFrame | None:
        """`common_from_user` of a device's present SLAM frame, in its own axes; None: not known."""
        device = self.devices.get(name)
        if device is None:
            return None
        return told_frame(self.frames.users.get(name), device.settings.up, device.frame)

    def _told_of(self, device: Device) -> m.UserFrame | None:
        """What is told of a device's present SLAM frame; None where it is not known where that lies."""
        told = self.frames.users.get(device.name)
        return None if told is None or told.matrix is None or told.frame != device.frame else told

    def _in_common(self, name: str, position: m.Vector, quat: m.Quaternion) -> tuple[m.Vector, m.Quaternion] | None:
        told = self.frames.users.get(name)
        frame = self.frame_of(name)
        if told is None or told.state != "registered" or frame is None:
            return None
        return placed(frame, position, quat)

    def _poses(self, t: float) -> bytes:
        """Everybody's poses in the common frame."""
        if self._placing is None:
            devices = [device for device in self.devices.values() if self._told_of(device) is not None]
            self._placing = devices, Placing([self._shown(device) for device in devices])
        devices, placing = self._placing
        return encode_rows_down(self._sequence, t, placing.rows(t, [_own_pose(device, t) for device in devices]))

    def _shown(self, device: Device) -> Shown:
        settings = device.settings
        return Shown(device.index, self.frames.users[device.name], settings.up == "y", settings.static)

    def _standings(self) -> dict[str, Standing]:
        """How those stand who are here."""
        standings = {}
        for device in self.devices.values():
            told = self.frames.users.get(device.name)
            if device.client is None and not device.settings.static:
                continue
            if told is None or told.frame != device.frame:
                standings[device.name] = Standing(registered=False, sigma=np.inf)
            else:
                standings[device.name] = standing_of(told.state, told.sigma)
        return standings

    def _members(self) -> list[m.Member]:
        return [device.member() for device in self.devices.values()]

    def _tell_members(self) -> None:
        self.roster_version += 1
        self._broadcast(m.Members(self._members()))

    def _broadcast(self, message: Any) -> None:
        word = m.encode(message)
        for client in self.clients:
            client.outbox.put(word)

    def _broadcast_latest(self, kind: str, word: bytes) -> None:
        for client in self.clients:
            client.outbox.latest(kind, word)


def _owner(secret: str) -> str:
    return sha256(secret.encode()).hexdigest()


def _too_many() -> MessageError:
    return MessageError("rate", f"more than {MEASURED_A_SECOND} poses and ranges of a device a second: say less")


def _own_pose(device: Device, t: float) -> OwnPose | None:
    """Its newest; None of who has been away for long."""
    if device.left_at is not None and t - device.left_at > AWAY_AFTER:
        return None
    return AT_ITS_ORIGIN if device.settings.static else device.pose


def _is_news(before: m.Frames, told: Told) -> bool:
    """Whether anything is another one that is no number."""
    if before.reference != told.reference or before.users.keys() != told.users.keys():
        return True
    return any(_kind(before.users[name]) != _kind(now) for name, now in told.users.items())


def _kind(user: m.UserFrame) -> tuple[str, int, str | None, bool]:
    return user.state, user.frame, user.cue, user.matrix is None


def _moved(before: m.Frames, told: Told) -> bool:
    """Whether anybody's frame lies elsewhere."""
    for name, now in told.users.items():
        was = before.users.get(name)
        if was is None or now.matrix is None:
            continue
        moved = [(a or 0.0) - (b or 0.0) for a, b in zip((was.x, was.y, was.z), (now.x, now.y, now.z), strict=True)]
        if max(map(abs, moved)) > _CHANGED_M or abs((was.yaw or 0.0) - (now.yaw or 0.0)) > _CHANGED_RAD:
            return True
    return False


def _rate(stamps: deque[float], t: float) -> float:
    """A second: how many came within the last one; more than the window holds are counted by the window's length."""
    recent = [stamp for stamp in stamps if t - 1.0 <= stamp]
    if len(recent) < len(stamps) or len(stamps) < (stamps.maxlen or 0):
        return float(len(recent))
    span = max(stamps) - min(stamps)
    return len(stamps) / span if span > 0.0 else float(len(recent))
