"""A robot in a room: a device like any other, which drives by what the room says."""

from __future__ import annotations

import asyncio
from math import inf

from synchronizar.apps.bodies.body import Body, Odometry
from synchronizar.apps.bodies.drive import STOP, Ground, Twist
from synchronizar.apps.robot.game import order_id
from synchronizar.apps.robot.mirror import Mirror
from synchronizar.apps.robot.pilot import Pilot
from synchronizar.apps.stills import Stills
from synchronizar.live import messages as m
from synchronizar.live.client import Client
from synchronizar.live.peer_placing import placed, told_frame
from synchronizar.live.pose_wire import PoseDown, PosesDown
from synchronizar.live.stage import Player, heading_of

BEAT_S = 1.0 / 30.0
OFFERED_EVERY_S = 2.0
LOOKS_EVERY_S = 0.25


class RobotClient:
    """Joins a body and a room."""

    def __init__(self, client: Client, name: str, body: Body, through: str | None = None) -> None:
        """`through`: whose eyes the robot asks for; what that one sees goes to its body."""
        self._client, self._name, self._body = client, name, body
        self.pilot = Pilot()
        self.stills = Stills(name, lambda: body.see(self.at, self.pilot.places), through)
        self.asked: Twist | None = None
        """What it was told last; None while it has no orders, and whoever else drives it is left alone."""
        self.at: Ground | None = None
        """Where its odometry has it in the common frame, at the last decision; None: it does not know."""

    async def run(self) -> None:
        """Until the room ends the connection; the robot then stands still."""
        tasks = [asyncio.create_task(task) for task in (self._offer(), self._drive(), self._look())]
        try:
            async for word in self._client.messages():
                self.hear(word)
                if (by := self.stills.hear(word)) is not None:
                    await self._body.show(by, self.stills.seen[by])
        finally:
            for task in tasks:
                task.cancel()
            await self._body.command(STOP)

    def hear(self, word: m.FromRoom | PosesDown) -> None:
        """Something that the room says."""
        if isinstance(word, PosesDown):
            self._see(word)
        elif isinstance(word, m.Objects):
            self._obey()

    def _see(self, poses: PosesDown) -> None:
        names = {member.index: member for member in self._client.members.values()}
        frames = self._client.frames.users
        for pose in poses.poses:
            member = names.get(pose.member)
            if member is None:
                continue
            told = frames.get(member.name)
            sigma = inf if told is None or told.sigma is None else told.sigma
            t = poses.t - pose.age
            if member.name == self._name:
                self.pilot.own(poses.t, pose.state, sigma)
            elif not member.static:
                self.pilot.person(t, member.name, _ground(pose, member), min(sigma, 1.0))

    def _obey(self) -> None:
        order = self._client.objects.get(order_id(self._name))
        data = {} if order is None else order.data
        pilot = self.pilot
        pilot.whom = data.get("whom")
        pilot.mirror = Mirror(*data["mirror"]) if data.get("do") == "mirror" else None

    async def _offer(self) -> None:
        """Until the application knows of it: that may be begun later, or again."""
        while True:
            if order_id(self._name) not in self._client.objects:
                await self._client.say_message(m.Say("robot", None, m.APP))
            await asyncio.sleep(OFFERED_EVERY_S)

    async def _look(self) -> None:
        """First-person views, both ways."""
        while True:
            for word in self.stills.words(asyncio.get_running_loop().time(), self._client.objects):
                await self._client.say_message(word)
            await asyncio.sleep(LOOKS_EVERY_S)

    async def _drive(self) -> None:
        last = -inf
        while True:
            odometry = self._body.odometry()
            if odometry is not None and odometry.t > last:
                last = odometry.t
                await self._client.send_pose(self._name, odometry.t, odometry.position, odometry.quat_xyzw)
            before, self.asked = self.asked, self.decide(odometry)
            if self.asked is not None:
                await self._body.command(self.asked)
            elif before is not None:
                await self._body.command(STOP)
            await asyncio.sleep(BEAT_S)

    def decide(self, odometry: Odometry | None) -> Twist | None:
        """The command now; None without orders."""
        self.at = None if odometry is None else self._placed(odometry)
        if self.pilot.whom is None:
            return None
        offset = self._client.offset
        if odometry is None or offset is None or self.at is None:
            return STOP
        return self.pilot.twist(odometry.t + offset, self.at)

    def _placed(self, odometry: Odometry) -> Ground | None:
        """In the common frame; None while that is not known."""
        member = self._client.members.get(self._name)
        told = self._client.frames.users.get(self._name)
        frame = None if member is None else told_frame(told, "z", member.frame)
        if frame is None:
            return None
        position, quat = placed(frame, odometry.position, odometry.quat_xyzw)
        return Ground(position[0], position[1], heading_of(Player(self._name, position, quat, "z").forward))


def _ground(pose: PoseDown, member: m.Member) -> Ground:
    x, y, _ = pose.position
    return Ground(x, y, heading_of(Player(member.name, pose.position, pose.quat_xyzw, member.up).forward))
