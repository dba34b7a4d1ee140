"""What an application sees of its room, and what it does there. No network and no clock of its own."""

from __future__ import annotations

from math import atan2
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from synchronizar.live import messages as m
from synchronizar.live.pose_wire import PosesDown

_FRESH_S = 1.0
"""s: who has said no pose for longer is not where it was."""
HAND_M = 0.35
"""m in front of a device: where what it holds is."""
UPRIGHT: m.Quaternion = (0.0, 0.0, 0.0, 1.0)


class Player(NamedTuple):
    """A device, in the common frame."""

    name: str
    position: m.Vector
    """m."""
    quat_xyzw: m.Quaternion
    """Takes vectors from the device's body to the common frame."""
    up: str
    """Which axis of its body points up where it is held upright: "y" of phones and headsets, "z" of robots."""

    @property
    def forward(self) -> m.Vector:
        """Where it looks, of length 1 in the common frame: along -z of a body with y up, along x of one with z up."""
        x, y, z, w = self.quat_xyzw
        if self.up == "y":
            return -2.0 * (x * z + w * y), -2.0 * (y * z - w * x), 2.0 * (x * x + y * y) - 1.0
        return 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)

    @property
    def hand(self) -> m.Vector:
        """m, common frame: a little in front of it, where what it holds is."""
        (x, y, z), (fx, fy, fz) = self.position, self.forward
        return x + HAND_M * fx, y + HAND_M * fy, z + HAND_M * fz


def heading_of(forward: m.Vector) -> float:
    """Angle (rad) in the plane of the common frame."""
    return atan2(forward[1], forward[0])


class Stage:
    """The room as it is, and words for it: they are gathered, and whoever runs the application sends them."""

    def __init__(self, welcome: m.Welcome, folder: Path = Path()) -> None:
        """`folder`: of the application's own, where it may keep files; it need not be there yet."""
        self.folder = folder
        self.t = welcome.t
        """s, the room's clock at the newest poses."""
        self.frames = welcome.frames
        self.members = {member.index: member for member in welcome.members}
        self.objects = {o.id: o for o in welcome.objects.changed}
        """As they stand, this application's own changes included."""
        self.players: dict[str, Player] = {}
        """Those who are registered, here and fresh: whom a game can rely on."""
        self._own: set[str] = set()
        """Ids of objects that are made or moved here: what the room says of them is an echo, and may be an old one."""
        self._refused: list[str] = []
        self._words: list[m.FromClient] = []

    def hear(self, word: m.FromRoom | PosesDown) -> None:
        """Something that the room has said."""
        match word:
            case PosesDown():
                self._take_poses(word)
            case m.Frames():
                self.frames = word
            case m.Members():
                self.members = {member.index: member for member in word.members}
            case m.Objects():
                for gone in word.removed:
                    if gone not in self._own:
                        self.objects.pop(gone, None)
                self.objects |= {o.id: o for o in word.changed if o.id not in self._own or o.holder != m.APP}
            case m.Refused():
                self._refused.append(word.what)

    def create(
        self, id_: str, kind: str, position: m.Vector, quat_xyzw: m.Quaternion = UPRIGHT, data: Any = None
    ) -> None:
        """An object in the common frame that is the application's own until it lets go of it."""
        self._own.add(id_)
        self.objects[id_] = m.Object(id_, kind, position, quat_xyzw, m.APP, m.APP, None, self.t, data)
        self._words.append(m.Create(id_, kind, position, quat_xyzw, None, data, True))

    def move(
        self,
        id_: str,
        position: m.Vector | None = None,
        quat_xyzw: m.Quaternion | None = None,
        velocity: m.Vector | None = None,
        data: Any = msgspec.UNSET,
    ) -> None:
        """An object of its own, where it is now and what it goes on with; what is left out stays."""
        found = self.objects[id_]
        self._own.add(id_)
        self.objects[id_] = msgspec.structs.replace(
            found,
            position=found.position if position is None else position,
            quat_xyzw=found.quat_xyzw if quat_xyzw is None else quat_xyzw,
            velocity=velocity,
            data=found.data if data is msgspec.UNSET else data,
            t=self.t,
        )
        self._words.append(m.Move(id_, position, quat_xyzw, velocity, data))

    def remove(self, id_: str) -> None:
        """An object of its own."""
        self._own.discard(id_)
        self.objects.pop(id_, None)
        self._words.append(m.Remove(id_))

    def say(self, topic: str, data: Any, to: str | None = None) -> None:
        """A word to one device, or to all pages and devices."""
        self._words.append(m.Say(topic, data, to))

    def take_words(self) -> list[m.FromClient]:
        """What it has said since the last time."""
        words, self._words = self._words, []
        return words

    def take_refused(self) -> list[str]:
        """What the room has refused since the last time: sentences."""
        refused, self._refused = self._refused, []
        return refused

    def _take_poses(self, poses: PosesDown) -> None:
        if poses.t > self.t:
            self.players = {}
        self.t = poses.t
        for pose in poses.poses:
            member = self.members.get(pose.member)
            if member is None or pose.state != "registered" or pose.age > _FRESH_S:
                continue
            self.players[member.name] = Player(member.name, pose.position, pose.quat_xyzw, member.up)
