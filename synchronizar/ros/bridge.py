"""`synchronizar ros`: robots of one rosbridge or several join a room, and hear where they are."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable, Coroutine, Sequence
from math import inf, isfinite
from typing import Any, NoReturn

import msgspec

from synchronizar.convert.messages import listing
from synchronizar.errors import InputError
from synchronizar.live import messages as m
from synchronizar.live.client import Client
from synchronizar.live.pose_wire import PosesDown
from synchronizar.ros import outgoing
from synchronizar.ros.link import Link, Sampled
from synchronizar.ros.listening import OWN, HeardPose, HeardRange
from synchronizar.ros.options import BridgeOptions, RobotSettings
from synchronizar.ros.robot import OUT_EVERY_S, STAMPS_BACK, TF_AHEAD_S, Robot
from synchronizar.ros.room_link import RoomLink
from synchronizar.ros.rosbridge import print_told

DIAGNOSED_EVERY_S = 1.0
FRAMES_HOLD_S = 3.0
"""s after which what the room said of frames, which it says twice a second, is not relied on any more."""
_LATE_S = 0.2
"""s, by a simulation's stamps: so long a message may be under way before the room goes on without it."""
_TICK_S = 0.1
_MOST_WAITING = 2000
"""Poses of a robot that wait until the room knows of it."""
RANGES_WAIT_S = 5.0
"""s for which a range waits for its ends to come into the room."""


class Bridge:
    """Between a room and rosbridges; it goes on until it is ended."""

    def __init__(
        self,
        options: BridgeOptions,
        told: Callable[[str], None] = print_told,
        clock: Callable[[], float] = time.time,
    ) -> None:
        """`told` hears sentences for people."""
        self.robots: dict[str, Robot] = {}
        self._options, self._told, self._clock = options, told, clock
        self._settings = options.robots
        self._links = [Link(name, address, options, told, clock) for name, address in options.bridges]
        self._home: dict[str, Link] = {}
        of = " ".join(sorted(address for _, address in options.bridges))
        self.room = RoomLink(options.join, of, options.simulated, clock, told)
        self._news = 0
        """Rises when a robot is in the room for the first time."""
        self._t, self._room_t, self._others_at, self._frames_at = -inf, -inf, -inf, -inf

    async def run(self) -> None:
        """Without end. Raises InputError where a rosbridge or the room cannot be reached at first."""
        for name, settings in self._settings.items():
            if settings.room.get("static"):
                self.room.add(name, settings.room)
        work = [self.room.run(self._joined, self._hear_room), self._diagnose()]
        work += [link.run(lambda heard, link=link: self._hear(link, heard)) for link in self._links]  # type: ignore[misc]
        await _all_of(work)

    async def _hear(self, link: Link, heard: HeardPose | HeardRange) -> None:
        """What a rosbridge's topics say."""
        if isinstance(heard, HeardPose):
            await self._hear_pose(link, heard)
        else:
            await self._hear_range(link, heard)

    async def _hear_pose(self, link: Link, heard: HeardPose) -> None:
        robot = self._robot(link, heard)
        t, begins = robot.hear(heard)
        if not isfinite(t):
            link.listening.malformed[robot.name] += 1  # nobody knows when it was
            return
        if begins is not None:
            await self._begin_anew(link, robot, begins)
        if not self.room.speaks_for(robot.name):
            if robot.name not in self.room.refused and robot.told is None:
                robot.waiting.append((t, heard))
                del robot.waiting[:-_MOST_WAITING]
            return
        waiting, robot.waiting = robot.waiting, []
        self._news += bool(waiting)
        poses = [(robot.name, at, one.position, one.quat_xyzw) for at, one in (*waiting, (t, heard))]
        for begin in range(0, len(poses), 128):
            await self.room.say(lambda client, some=poses[begin : begin + 128]: client.send_poses(some))  # type: ignore[misc]
        self._t = max(self._t, t)
        await self._go_on()
        if self._room_is_heard() and (now := robot.due(self._options.common)) is not None:
            child, topic = link.frame_of(robot, self._robots_of(link))
            of = outgoing.transform(now.stamp + TF_AHEAD_S, self._options.common, child, now.translation, now.quat_xyzw)
            await link.publish(topic, outgoing.TF, of)
            await link.publish(f"{OWN}{outgoing.ros_name(robot.name)}/pose", outgoing.POSE, now.pose)

    def _room_is_heard(self) -> bool:
        """Whether what it said last of frames can be relied on; a simulation's room says nothing while that stands."""
        return self._options.simulated or self._clock() - self._frames_at <= FRAMES_HOLD_S

    async def _begin_anew(self, link: Link, robot: Robot, why: str) -> None:
        if self._options.simulated and why == STAMPS_BACK:
            raise InputError(
                link.address, f"{robot.name}: {why}; a simulation that begins anew needs a room of its own"
            )
        self._told(f"{robot.name}: {why}: its odometry began anew")
        if self.room.speaks_for(robot.name):
            robot.number = (robot.number + 1) % 256
            await self.room.say(lambda client: client.new_frame(robot.name))

    async def _hear_range(self, link: Link, heard: HeardRange) -> None:
        """Ranges wait for a while where their ends are not in the room yet: robots are known later than they range."""
        if {heard.a, heard.b} & set(self._options.asked.left_out):
            return
        client = self.room.client
        here = frozenset() if client is None else frozenset(client.members)
        known = here, self._news
        if known != link.held_for:
            link.held_for = known
            waiting, link.held = link.held, deque()
            for one in waiting:
                if not await self._say_range(link, one, here):
                    link.held.append(one)
        if not await self._say_range(link, heard, here):
            link.held.append(heard)
        while link.held and link.held[0].arrived < heard.arrived - RANGES_WAIT_S:
            self._leave_out(link, link.held.popleft(), here)

    async def _say_range(self, link: Link, heard: HeardRange, here: frozenset[str]) -> bool:
        measured = link.ends.measured(heard, link.listening.ranges.values(), here)
        if measured is None:
            return False
        own = [name for name in (measured.a, measured.b) if name in self.robots and self.room.speaks_for(name)]
        if not own or self.robots[own[0]].waiting:
            return False
        reporter = next((name for name in own if self._home[name] is link), own[0])
        t = self.robots[reporter].clock.of_range(heard.stamp, heard.arrived)
        if isfinite(t):
            said = msgspec.structs.replace(measured, t=t)
            await self.room.say(lambda client: client.send_ranges([said]))
        return True

    def _leave_out(self, link: Link, heard: HeardRange, here: frozenset[str]) -> None:
        """A range that nobody in the room can have measured; whose radios are not known, is said once."""
        for name in link.ends.unknown(heard, here) if here else ():
            link.unknown[name] += 1
            if link.unknown[name] == 1:
                self._told(
                    f"{link.address}: ranges of {name}, of whom nobody in the room is known: a map's [radios.{name}]"
                    f" says whose it is, --static {name} that it stands still"
                )

    def _robot(self, link: Link, heard: HeardPose) -> Robot:
        name = heard.user
        if (robot := self.robots.get(name)) is not None:
            if self._home[name] is not link:
                raise InputError(
                    link.address, f"has a robot {name}, and so has {self._home[name].address}: say --bridge NAME=URL"
                )
            return robot
        settings = self._settings.get(name, RobotSettings())
        robot = Robot(name, settings, self._options.simulated, self._options.own_from_ros)
        self.robots[name], self._home[name] = robot, link
        self.room.add(name, {"up": heard.up, **settings.room})
        return robot

    def _robots_of(self, link: Link) -> list[Robot]:
        return [robot for name, robot in self.robots.items() if self._home[name] is link]

    async def _go_on(self) -> None:
        """A simulation's time: everything before it has come."""
        t = (self._t - _LATE_S) // _TICK_S * _TICK_S
        if self._options.simulated and t > self._room_t:
            self._room_t = t
            await self.room.say(lambda client: client.say_message(m.Clock(t)))

    async def _joined(self, client: Client) -> None:
        """The room as it is when it is joined, for the first time or again."""
        for name in client.welcome.you:
            if (robot := self.robots.get(name)) is not None:
                robot.number = client.members[name].frame
        self._hear_frames(client.frames)

    async def _hear_room(self, message: m.FromRoom | PosesDown) -> None:
        if isinstance(message, m.Frames):
            before = {name: robot.state() for name, robot in self.robots.items()}
            self._hear_frames(message)
            if before != {name: robot.state() for name, robot in self.robots.items()}:
                await self._publish_diagnostics()
        elif isinstance(message, PosesDown):
            await self._hear_poses(message)

    def _hear_frames(self, frames: m.Frames) -> None:
        self._frames_at = self._clock()
        for name, robot in self.robots.items():
            robot.told = frames.users.get(name, robot.told)

    async def _hear_poses(self, poses: PosesDown) -> None:
        """Where all the others are: people, and robots of other rosbridges."""
        client, now = self.room.client, self._clock()
        if client is None or not 0.0 <= now - self._others_at >= OUT_EVERY_S:
            return
        self._others_at = now
        names = {member.index: name for name, member in client.members.items()}
        for link in self._links:
            stamp = self._ros_time(link)
            if stamp is None:
                continue
            for pose in poses.poses:
                name = names.get(pose.member)
                if name is None or pose.state != "registered" or self._home.get(name) is link:
                    continue
                told = client.frames.users.get(name)
                sigma = 0.0 if told is None or told.sigma is None else told.sigma
                of = outgoing.pose(
                    stamp - pose.age,
                    self._options.common,
                    pose.position,
                    pose.quat_xyzw,
                    outgoing.covariance_of_sigma(sigma),
                )
                await link.publish(f"{OWN}{outgoing.ros_name(name)}/pose", outgoing.POSE, of)

    def _ros_time(self, link: Link) -> float | None:
        """By the clock of a rosbridge's robots (s); None before the first has come."""
        clocks = [robot.clock for robot in self._robots_of(link)]
        known = [clock for clock in clocks if isfinite(clock.newest)] or ([] if self._options.simulated else clocks)
        return known[0].ros_time(self._clock()) if known else None

    async def _diagnose(self) -> None:
        while True:
            await self._publish_diagnostics()
            await asyncio.sleep(DIAGNOSED_EVERY_S)

    async def _publish_diagnostics(self) -> None:
        now = self._clock()
        client = self.room.client if self._room_is_heard() else None
        for link in self._links:
            stamp = self._ros_time(link)
            robots = self._robots_of(link)
            statuses = [robot.status(now, client, self.room.refused.get(robot.name)) for robot in robots]
            statuses.append(self._status(link, client))
            await link.publish(
                "/diagnostics", outgoing.DIAGNOSTICS, outgoing.diagnostics(now if stamp is None else stamp, statuses)
            )

    def _status(self, link: Link, client: Client | None) -> dict[str, Any]:
        """Of the bridge itself."""
        unknown = ", ".join(f"{name} ({n})" for name, n in sorted(link.unknown.items())) or None
        malformed = sum(link.listening.malformed.values()) or None
        refused = "; ".join(client.refused.values()) if client is not None and client.refused else None
        values = {"robots": len(self._robots_of(link)), "ranges of unknown radios": unknown}
        values |= {"malformed messages": malformed, "refused by the room": refused}
        if client is None:
            level, message = outgoing.ERROR, "the room cannot be reached"
        elif not self._robots_of(link):
            level, message = outgoing.WARN, "no robot's odometry has come yet"
        else:
            level, message = outgoing.OK, "connected"
        return outgoing.status("bridge", level, message, values)


async def list_topics(options: BridgeOptions, seconds: float) -> str:
    """What topics each rosbridge has, what is guessed of each, and how many messages came in so many seconds."""
    lines = []
    for name, address in options.bridges:
        link = Link(name, address, options, print_told, time.time)
        sampled: Sampled = await link.sample(seconds)
        lines += [address, *listing(sampled, options.asked, address)]
    return "\n".join(lines)


async def _all_of(work: Sequence[Coroutine[Any, Any, None]]) -> NoReturn:
    """All at once; the first one that fails ends the others."""
    tasks = [asyncio.create_task(one) for one in work]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    raise AssertionError("they have no end")
