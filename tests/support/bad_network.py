"""A room, its solver and walking devices over a network that loses, delays and reorders, all in simulated time."""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np

from synchronizar.geometry import YawFrame
from synchronizar.io.datagrams import MEASURED, RANGE, UNKNOWN_CLOCK, RangesDatagram, encode_ranges
from synchronizar.live import messages as m
from synchronizar.live.estimating import Solving
from synchronizar.live.member import Client
from synchronizar.live.pose_wire import PoseUp, decode_poses_down, encode_poses_up
from synchronizar.live.room import Room
from synchronizar.live.round_trips import RoundTrips
from synchronizar.live.solver_wire import Begin, Command, Told
from synchronizar.simulation.simulate import Simulation

BEGAN = 1_000_000.0
"""s, room's clock: when the walk begins."""
TICK_S = 1.0 / 30.0
GATHERED_S = 0.02
"""s between a range and the datagram that tells it."""
SAYS_S = 0.5
MOST_AGAIN_S = 1.0
EPOCH = 7


@dataclass(frozen=True)
class Network:
    """How bad it is: the same for every link, both ways."""

    loss: float = 0.0
    """Share of datagrams that are lost, and of the words of a reliable link that have to be sent again."""
    twice: float = 0.0
    """Share of datagrams that come twice."""
    delay: float = 0.002
    """s, one way."""
    jitter: float = 0.001
    """s: mean of what comes on top, exponential: datagrams overtake one another."""
    again: float = 0.5
    """s until a lost word is sent again; twice as long the next time, but no longer than MOST_AGAIN_S."""


GOOD = Network()
BAD = Network(loss=0.3, twice=0.02, delay=0.2, jitter=0.06)


class Time:
    """Things to be done, each at its moment."""

    def __init__(self) -> None:
        self.t = 0.0
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._number = count()

    def at(self, t: float, do: Callable[[], None]) -> None:
        heapq.heappush(self._due, (max(t, self.t), next(self._number), do))

    def every(self, seconds: float, begin: float, do: Callable[[], None]) -> None:
        def once() -> None:
            do()
            self.at(self.t + seconds, once)

        self.at(begin, once)

    def run(self, until: float) -> None:
        while self._due and self._due[0][0] <= until:
            self.t, _, do = heapq.heappop(self._due)
            do()
        self.t = until


class Way:
    """One direction of one link. It may be cut: what is under way is lost then."""

    def __init__(self, time: Time, network: Network, random: np.random.Generator, deliver: Callable[[Any], None]):
        self._time, self._network, self._random, self._deliver = time, network, random, deliver
        self._last = 0.0
        self.cut = False

    def datagram(self, data: Any) -> None:
        if self._random.random() >= self._network.loss:
            for _ in range(1 + (self._random.random() < self._network.twice)):
                self._time.at(self._time.t + self._delay(), lambda: self._come(data))

    def word(self, data: Any) -> None:
        """Reliable and in order: one that is lost holds those after it."""
        t, again = self._time.t, self._network.again
        while self._random.random() < self._network.loss:
            t, again = t + again, min(2.0 * again, MOST_AGAIN_S)
        self._last = max(self._last, t + self._delay())
        self._time.at(self._last, lambda: self._come(data))

    def _delay(self) -> float:
        return self._network.delay + float(self._random.exponential(self._network.jitter))

    def _come(self, data: Any) -> None:
        if not self.cut:
            self._deliver(data)


class SolverHere:
    """Solves at once, in this process."""

    trouble: str | None = None

    def __init__(self, told: Callable[[Told], None]) -> None:
        self._solving, self._told = Solving(Begin(0)), told

    def feed(self, command: Command) -> None:
        self._solving.do(command, 0)

    def advance(self, t: float) -> None:
        from synchronizar.live.solver_wire import Advance

        told = self._solving.do(Advance(t), 0)
        assert isinstance(told, Told), self._solving._refused
        self._told(told)

    def finish(self, t: float) -> None:
        raise NotImplementedError

    async def drained(self) -> None:
        raise NotImplementedError


class Walker:
    """A device that walks as it was simulated, and says what its SLAM sees by its own clock."""

    def __init__(self, house: House, name: str, address: int) -> None:
        self.house, self.name, self.address = house, name, address
        self.random = np.random.default_rng([house.seed, address])
        self.ahead = float(self.random.uniform(-500.0, 500.0))
        """s: its clock minus the room's."""
        self.asleep = False
        self.silent = False
        self.heard: dict[str, list[int]] = defaultdict(list)
        """Numbers that the others have said, in the order in which they came."""
        self.said = 0
        self.refused: dict[str, int] = {}
        self.frame = 0
        self.own_from_slam = YawFrame()
        self.secret: str | None = None
        self.client: Client | None = None
        self.placed: list[tuple[float, bool, float]] = []
        """When, whether registered, and how far off (m, in the plane), by what the room says."""
        self._ways: list[Way] = []
        self._trips = RoundTrips()
        track = house.simulation.recording.tracks[name]
        for row, t in enumerate(track.t.tolist()):
            house.time.at(t, lambda row=row: self._pose(row))
        house.time.every(SAYS_S, 0.01 * address, self._say)
        house.time.every(TICK_S, 0.003 * address, self._take)

    def now(self) -> float:
        return self.house.now() + self.ahead

    def join(self) -> None:
        """Come, or come again as the same device by another connection."""
        ticket, self.secret = self.house.room.admit(m.Join("", [m.UserSettings(self.name)], resume=self.secret))
        room, self.client = self.house.room, self.house.room.connect(ticket)
        client = self.client
        for way in self._ways:
            way.cut = True
        self.up = self._way(lambda word: room.hear(client, word))
        self.poses_up = self._way(lambda data: room.hear_poses(client, data))
        self.down = self._way(self._hear)
        self.poses_down = self._way(self._hear_poses)
        self._ways = [self.up, self.poses_up, self.down, self.poses_down]
        self._trips = RoundTrips()
        for n in range(4):
            self.house.time.at(self.house.time.t + 0.1 * n, self._ping)
        self._ping_on(client)

    def vanish(self) -> None:
        """Its connection is gone, and the room is told."""
        assert self.client is not None
        self.house.room.disconnect(self.client)
        self.client = None

    def new_frame(self, frame: YawFrame) -> None:
        """Its SLAM begins anew, somewhere else."""
        self.frame += 1
        self.own_from_slam = frame
        self.up.word(m.Reset(self.name, self.frame))

    def _way(self, deliver: Callable[[Any], None]) -> Way:
        return Way(self.house.time, self.house.network, self.random, deliver)

    def _ping_on(self, client: Client) -> None:
        def once() -> None:
            if self.client is client:
                self._ping()
                self.house.time.at(self.house.time.t + 2.0, once)

        self.house.time.at(self.house.time.t + 2.0, once)

    def _ping(self) -> None:
        if self.client is not None and not self.asleep:
            self.up.word(m.Ping(self.now(), self._trips.offset, self._trips.quickest))

    def _pose(self, row: int) -> None:
        if self.client is None or self.asleep:
            return
        track = self.house.simulation.recording.tracks[self.name]
        position = tuple((self.own_from_slam @ track.position[row]).tolist())
        quat = tuple(self.own_from_slam.rotate_quaternions(track.quat_xyzw[row : row + 1])[0].tolist())
        self.poses_up.datagram(encode_poses_up([PoseUp(0, self.frame, row, self.now(), position, quat)]))

    def _say(self) -> None:
        if self.client is not None and not self.asleep and not self.silent:
            self.said += 1
            self.up.word(m.Say("count", self.said))

    def _take(self) -> None:
        """What waits for it goes on its way."""
        if self.client is not None and not self.asleep:
            for word in self.client.outbox.take():
                if word[:1] == b"{":
                    self.down.word(word)
                else:
                    self.poses_down.datagram(word)

    def _hear_poses(self, data: bytes) -> None:
        self._trips.heard(decode_poses_down(data).t, self.now())

    def _hear(self, word: bytes) -> None:
        match m.decode_from_room(word):
            case m.Said(data=number, by=by):
                self.heard[by].append(number)
            case m.Pong(t=t, room_t=room_t):
                self._trips.pong(t, room_t, self.now())
            case m.Refused(reason=reason, count=times):
                self.refused[reason] = times


class House:
    """A room in which simulated people walk."""

    def __init__(self, simulation: Simulation, network: Network, seed: int = 0, names: Iterable[str] = ()) -> None:
        """`names`: who is there from the beginning; none: all."""
        self.simulation, self.network, self.seed = simulation, network, seed
        self.time = Time()
        self.room = Room("CODE", self.now, key=bytes(range(32)))
        self.room.solver = SolverHere(self.room.told)
        all_names = [user.name for user in simulation.recording.users]
        self.walkers = {name: Walker(self, name, n + 1) for n, name in enumerate(all_names)}
        for name in names or all_names:
            self.walkers[name].join()
        for walker in self.walkers.values():
            self.room.modules.users[walker.address] = walker.name
        self._send_ranges()
        self.time.every(TICK_S, 0.0, self._tick)

    def now(self) -> float:
        return BEGAN + self.time.t

    def registered(self) -> set[str]:
        return {name for name, user in self.room.frames.users.items() if user.state == "registered"}

    def errors(self, since: float = 0.0) -> dict[str, np.ndarray]:
        """m: how far off those who are registered are where the room puts them."""
        return {
            name: np.array([error for t, registered, error in walker.placed if registered and t >= since])
            for name, walker in self.walkers.items()
        }

    def _tick(self) -> None:
        self.room.tick()
        reference = self.room.frames.reference
        if reference is None:
            return
        common_from_world = self._common_from_world(reference)
        for pose in decode_poses_down(self.room.fan_out.poses(self.now())).poses:
            walker = list(self.walkers.values())[pose.member]
            t = self.time.t - pose.age
            true = common_from_world @ self._true_place(walker.name, t)
            error = float(np.linalg.norm((np.array(pose.position) - true)[:2]))
            walker.placed.append((t, pose.state == "registered", error))

    def _common_from_world(self, reference: str) -> YawFrame:
        """The common frame is the reference's own at its first pose."""
        from synchronizar.quaternions import yaw_of_quaternions

        own, true = self.simulation.recording.tracks[reference], self.simulation.truth[reference]
        turned = yaw_of_quaternions(own.quat_xyzw[:1])[0] - yaw_of_quaternions(true.quat_xyzw[:1])[0]
        x, y, z = (own.position[0] - YawFrame(yaw=float(turned)) @ true.position[0]).tolist()
        return YawFrame(x, y, z, float(turned))

    def _true_place(self, name: str, t: float) -> np.ndarray:
        track = self.simulation.truth[name]
        return np.array([np.interp(t, track.t, track.position[:, axis]) for axis in range(3)])

    def _send_ranges(self) -> None:
        """Each range by a datagram of its first user's module."""
        ranges, users = self.simulation.recording.ranges, self.simulation.recording.users
        random = np.random.default_rng([self.seed, 0])
        sequence = count()
        for t, a, b, distance in zip(
            ranges.t.tolist(), ranges.a.tolist(), ranges.b.tolist(), ranges.distance.tolist(), strict=True
        ):
            reporter, peer = self.walkers[users[a].name], self.walkers[users[b].name]
            row = (peer.address, 0, MEASURED, round(1000.0 * distance), 0, UNKNOWN_CLOCK, 50, -8000, -8100, 0, 0)
            told = RangesDatagram(
                *(self.room.modules.session, reporter.address, next(sequence), EPOCH, round(1e9 * (5.0 + t)), 0),
                np.array([row], RANGE),
            )
            data = encode_ranges(told, self.room.modules.keys.of(reporter.address))
            way = Way(self.time, self.network, random, lambda data: self._hear_datagram(data))
            self.time.at(t + GATHERED_S, lambda r=reporter, p=peer, w=way, d=data: self._range(r, p, w, d))

    def _range(self, reporter: Walker, peer: Walker, way: Way, data: bytes) -> None:
        if not reporter.asleep and not peer.asleep:
            way.datagram(data)

    def _hear_datagram(self, data: bytes) -> None:
        self.room.hear_datagram(data, self.now())
