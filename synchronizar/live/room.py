"""A room: who is in it, what they say, what everybody is told. No wall time, no network: both come from outside."""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from synchronizar.io.datagrams import RangesDatagram
from synchronizar.live import messages as m
from synchronizar.live.again import Again
from synchronizar.live.checks import alike, check_stamp
from synchronizar.live.common_frame import CommonFrame
from synchronizar.live.fan_out import FanOut
from synchronizar.live.given import Given, Recorder
from synchronizar.live.handing_on import HandingOn
from synchronizar.live.health import status
from synchronizar.live.joining import Joining
from synchronizar.live.measuring import Measuring
from synchronizar.live.member import Client, Device, Peer, Ticket
from synchronizar.live.messages import MessageError
from synchronizar.live.modules import Modules
from synchronizar.live.objects import ObjectStore
from synchronizar.live.people import People
from synchronizar.live.recorder import recorded_name
from synchronizar.live.room_time import RoomTime, need_recorded
from synchronizar.live.roster import KnownDevice, Roster
from synchronizar.live.sleeping import Sleeping
from synchronizar.live.solver import Solver
from synchronizar.live.solver_wire import Told
from synchronizar.live.words_file import MOST_BYTES, Word
from synchronizar.parameters import SleepParameters

UPDATES_A_SECOND = 10
STATUS_EVERY = 1.0
STANDINGS_EVERY = 0.5
"""s between looks at whose modules are needed."""


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
        self.time = RoomTime(now)
        self.people = People()
        self.devices, self.clients = self.people.devices, self.people.clients
        self.objects = ObjectStore(saved)
        self.sleeping = Sleeping(sleep)
        self.common = CommonFrame(now(), self.people)
        self.fan_out = FanOut(self.people, self.common)
        self.given = Given(recorder)
        self.measuring = Measuring(self.people, self.time, self.given, self.sleeping.ranged)
        self.modules = Modules(self.key, allow_version_1, self.people, self.time, self.measuring, self.sleeping)
        self.refused_outside: Counter[str] = Counter()
        """Of the server: what came without a room, by reason."""
        self.lag: Callable[[], m.Lag] | None = None
        """How late the loop is that calls all of this."""
        self.open_peer: Callable[[Room, Client], Peer] | None = None
        """Begins a client's second way for poses; None where the server has none."""
        self.app_secret = secrets.token_urlsafe(24)
        """What its application says to be let in as such."""
        self._joining = Joining(self.people, self.time, self.given, None if app is None else self.app_secret)
        self._handing_on = HandingOn(self.people, now)
        self.again = Again(self.people, self.objects)
        self._words_kept = True
        self._status_at = self._asked_at = self._stood_at = -np.inf
        self._finishing: list[Client] = []

    @property
    def solver(self) -> Solver | None:
        """Who solves it."""
        return self.given.solver

    @solver.setter
    def solver(self, solver: Solver | None) -> None:
        self.given.solver = solver

    @property
    def frames(self) -> m.Frames:
        """What is known of everybody's frame."""
        return self.common.now

    def roster(self) -> Roster:
        """What has to be remembered to open it again."""
        devices = [KnownDevice(d.settings, d.owner, d.frame, d.session) for d in self.devices.values()]
        modules = self.modules
        addresses, given, sequences = dict(modules.users), dict(modules.given), modules.receiver.sequences()
        return Roster(self.code, self.key.hex(), devices, addresses, given, sequences, self.app)

    def restore(self, roster: Roster) -> None:
        """Its devices as they were; all of them are away."""
        names = {alike(known.settings.name) for known in roster.devices}
        for known in roster.devices:
            device = Device(known.settings, len(self.devices), known.owner, known.frame, known.session)
            device.left_at = self.now()
            self.devices[device.name] = device
            for session in range(known.session + 1):
                if session == 0 or alike(recorded_name(device.name, session)) not in names:
                    self.given.recorded_user(device, session)
        self.modules.restore(roster)

    # Coming and going

    def admit(self, join: m.Join) -> tuple[Ticket, str]:
        """Who may come in as whom, and the secret to come again. Raises MessageError with a way on."""
        return self._joining.admit(join)

    def connect(self, ticket: Ticket) -> Client:
        """Its connection stands: it is told everything as it is now. Raises MessageError where it cannot come in."""
        client = self._joining.connect(ticket)
        you = [device.name for device in client.devices]
        welcome = m.Welcome(
            *(self.code, you, m.PROTOCOL, self.time(), self.people.members(), self.frames, self.objects.snapshot()),
            udp_port=self.udp_port,
            app=self.app,
            webrtc=self.open_peer is not None and not client.recorded,
        )
        client.outbox.put(m.encode(welcome))
        if client.devices:
            self.people.tell_members()
        return client

    def disconnect(self, client: Client) -> None:
        """Its connection is gone; its devices may come again."""
        self._joining.disconnect(client)

    def idle_for(self) -> float:
        """How long (s) nobody has been here."""
        return self._joining.idle_for()

    # What comes

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
        self.measuring.hear_poses(client, data)

    def hear_datagram(self, data: bytes, arrived: float) -> RangesDatagram | None:
        """A datagram of a module that arrived at `arrived` (s, room's clock); None where it is refused."""
        return self.modules.hear(data, arrived)

    def orders_for(self, heard: RangesDatagram, now: float) -> list[bytes]:
        """What a module is told in answer to a datagram."""
        return self.modules.orders_for(heard, now)

    def refuse(self, client: Client, error: MessageError) -> None:
        """Count it, and tell the client when it is news."""
        self.people.refuse(client, error)

    def told(self, told: Told) -> None:
        """What the solver knows."""
        self.common.hear(told)
        self.objects.place_waiting(self.common.in_common, self.time())

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
        self.people.tell(m.Events(self.time(), [sentence]))

    def tick(self) -> None:
        """About thirty times a second: poses, objects, ten times a second the solver, once how the room is."""
        t = self.time()
        self.measuring.give_held(t)
        if self.solver is not None and not self.time.recorded and t - self._asked_at >= 0.999 / UPDATES_A_SECOND:
            self._asked_at = t
            self.solver.advance(t)
        if t - self._stood_at >= STANDINGS_EVERY or t < self._stood_at:
            self._stood_at = t
            self.sleeping.update(t, self.common.standings())
        self.objects.expire(t)
        if (changes := self.objects.changes()) is not None:
            self.people.tell(changes)
            words = [Word(t, object=changed) for changed in changes.changed]
            self._write_down(words + [Word(t, removed=gone) for gone in changes.removed])
        self.fan_out.send(t)
        now = self.now()
        if now - self._status_at >= STATUS_EVERY or now < self._status_at:
            self._status_at = now
            self.people.tell_latest("status", self.status())

    def status(self) -> m.Status:
        """How the room is."""
        datagrams = self.modules.refused + self.modules.receiver.refused
        refused = (
            *(self.people.refused, self.refused_outside),
            Counter({f"datagram {reason}": n for reason, n in datagrams.items()}),
        )
        lag = None if self.lag is None else self.lag()
        trouble = None if self.solver is None else self.solver.trouble
        return status(self.time(), self.people, self.sleeping, self.common, refused, lag, trouble)

    # Inside

    def _hear(self, client: Client, message: m.FromClient) -> None:
        people, t = self.people, self.time()
        if client.app and self.again.goes_on:
            raise MessageError("app", "a recording is played here, with what was done then")
        match message:
            case m.Ping():
                self.time.answer(client, message)
            case m.Ranges():
                self.measuring.hear_ranges(client, message)
            case m.Reset():
                self.measuring.reset(client, message, self._joining.sessions())
            case m.Lost():
                self.given.lost(people.moving(client, message.user))
            case m.Module():
                self.modules.take(client, message, self.udp_port)
            case m.Clock():
                self._clock(client, message)
            case m.Finish():
                self._finish(client, message)
            case m.Again():
                self.again.hear(client, message)
            case m.Create():
                if message.user is not None:
                    people.own(client, message.user)
                self.objects.create(message, people.speaker(client), t, self.common.in_common)
            case m.Grab():
                self.objects.grab(message.id, people.speaker(client), t)
            case m.Move():
                self.objects.move(message, people.speaker(client), t)
            case m.Release():
                self.objects.release(message.id, people.speaker(client))
            case m.Remove():
                self.objects.remove(message.id, people.speaker(client))
            case m.Heartbeat():
                pass
            case m.Say():
                self._write_down([Word(t, said=self._handing_on.say(client, message), to=message.to)])
            case m.Signal():
                self._signal(client, message)
            case m.Leave():
                self._joining.leave(client)
            case m.Hello():
                raise MessageError("hello", "hello is said once")

    def _write_down(self, words: list[Word]) -> None:
        kept = self.given.words(self.app, self.frames.reference, words)
        if self._words_kept and not kept:
            self.event(f"what is said and moved is recorded no more: its file has {MOST_BYTES // 2**20} MB")
        self._words_kept = kept

    def _clock(self, client: Client, message: m.Clock) -> None:
        need_recorded(client)
        self.time.go_on(message.t)
        if self.solver is not None:
            self.solver.advance(message.t)

    def _finish(self, client: Client, message: m.Finish) -> None:
        need_recorded(client)
        check_stamp(message.t)
        if client in self._finishing:
            raise MessageError("time", "the answer is under way")
        self._finishing.append(client)
        if self.solver is not None:
            self.solver.finish(message.t)

    def _signal(self, client: Client, message: m.Signal) -> None:
        if m.data_too_large(message.data):
            raise MessageError("size", f"a signal has at most {m.LARGEST_DATA} bytes as JSON")
        if message.to == m.ROOM:
            self._signal_to_room(client, message.data)
        else:
            self._handing_on.signal(client, message)

    def _signal_to_room(self, client: Client, data: dict[str, Any]) -> None:
        if self.open_peer is None:
            raise MessageError("signal", "this server has no WebRTC: send poses by this connection")
        if client.recorded:
            raise MessageError("signal", "a recording's poses come in order: send them by this connection")
        if client.peer is None:
            client.peer = self.open_peer(self, client)
        client.peer.signalled(data)
