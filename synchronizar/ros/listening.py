"""What topics of one rosbridge say of robots: poses and ranges. No network and no clock of its own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from synchronizar.convert.asked import LENGTH_UNITS, Asked
from synchronizar.convert.fields import Topic
from synchronizar.convert.guess import PoseRole, RangeRole, Roles, preferred, roles_of
from synchronizar.convert.mapping import Mapped
from synchronizar.convert.reading import Pose, PoseReader, RangeReader, likely_unit
from synchronizar.convert.track_file import poses_as_asked
from synchronizar.geometry import Up
from synchronizar.io.text import MAX_PLACE, MIN_SIGMA
from synchronizar.ros.tf_poses import TfPoses

OWN = "/synchronizar/"
"""Topics below it are the bridge's own."""
SETTLED_S, SETTLED_MESSAGES = 1.0, 5
"""s and messages after which a topic is believed to be a robot's track: a goal that somebody clicks is none."""
_MOST_WAITING = 2000
"""Messages of a topic that wait until it is known whose they are."""
_UNIT_OF = 20
"""Distances by which the unit is judged where nothing says it."""
_NONSENSE = (KeyError, TypeError, ValueError, AttributeError, IndexError)
"""What reading a message raises that is not what its topic has."""


class HeardPose(NamedTuple):
    """A pose in the axes in which a room takes it."""

    user: str
    stamp: float
    """s by the robot's clock; NaN: none."""
    arrived: float
    frame_id: str
    ros: tuple[float, float, float]
    """m: where it is in that frame, by ROS's own axes."""
    position: tuple[float, float, float]
    quat_xyzw: tuple[float, float, float, float]
    up: Up


class HeardRange(NamedTuple):
    """A distance in m between two radios."""

    stamp: float
    arrived: float
    topic: str
    a: str
    b: str
    distance: float
    optional: dict[str, Any]


Heard = HeardPose | HeardRange


class Wanted(NamedTuple):
    """What has to be subscribed to."""

    topic: str
    kind: str
    is_track: bool
    """Whether the newest alone counts: what comes too often may be left out."""


@dataclass
class RangeTopic:
    """A topic of ranges that is read."""

    role: RangeRole
    reader: RangeReader
    metres: float | None
    """In one of its unit; None: not known yet."""
    a: set[str] = field(default_factory=set)
    b: set[str] = field(default_factory=set)
    seen: list[float] = field(default_factory=list)


@dataclass
class _Undecided:
    """A topic of poses that is nobody's yet."""

    first_at: float
    waiting: list[tuple[float, Any]] = field(default_factory=list)


class Listening:
    """Says what is to be subscribed to, and what the messages of that tell."""

    def __init__(self, asked: Asked, said: Mapped, place: str, common: str, told: Callable[[str], None]) -> None:
        """`asked.user`: whose all tracks are of which nobody said whose they are; `place`: rosbridge's address.

        `common`: the frame that is not ROS's own but what comes out of the room.
        """
        self.ranges: dict[str, RangeTopic] = {}
        self.malformed: Counter[str] = Counter()
        """By topic: messages that are not what the topic has."""
        self.topics: dict[str, Topic] = {}
        self.dropped: list[str] = []
        """Topics that turned out to be of no use, and need no subscription any more: whoever ends it empties this."""
        self._asked, self._said, self._place, self._told = asked, said, place, told
        self._firsts: dict[str, Any] = {}
        self._undecided: dict[str, _Undecided] = {}
        self._tracks: dict[str, tuple[str, PoseReader]] = {}
        self._users: dict[str, str] = {}
        """Who was decided, and by which topic or frame."""
        self._done, self._useless = dict[str, Wanted](), set[str]()
        self._tf, self._tf_topics = TfPoses(common), set[str]()

    def learn(self, topics: list[Topic]) -> list[Wanted]:
        """What there is now; what of it is new and has to be heard. Raises InputError for a field that is not there."""
        for topic in topics:
            if not topic.name.startswith(OWN):
                self.topics[topic.name] = topic
        roles = self._roles()
        wanted = [Wanted(r.topic.name, r.topic.type, True) for r in roles.poses if not r.is_truth]
        wanted += [Wanted(r.topic.name, r.topic.type, False) for r in roles.ranges]
        unclear = [name for name, why in roles.rest.items() if why.startswith("may have ranges")]
        wanted += [Wanted(name, self.topics[name].type, False) for name in unclear]
        wanted += self._wanted_tf(roles)
        new = [one for one in wanted if one.topic not in self._done.keys() | self._useless]
        self._done |= {one.topic: one for one in new}
        return new

    def silent(self) -> list[Wanted]:
        """What was subscribed to, and has never said anything."""
        return [one for topic, one in self._done.items() if topic not in self._firsts]

    def forget_subscriptions(self) -> None:
        """A connection is new: what is of use is wanted once more."""
        self._done.clear()
        self.dropped.clear()

    def missing(self) -> list[str]:
        """Topics that were named, and are not there."""
        return sorted(set(self._said.topics) - self.topics.keys())

    def users(self) -> dict[str, str]:
        """Robots, and the topic or frame of each one's track."""
        return dict(self._users)

    def hear(self, topic: str, arrived: float, message: Any) -> Iterator[Heard]:
        """A message that came at `arrived` (s). What makes no sense is counted."""
        try:
            yield from self._heard(topic, arrived, message)
        except _NONSENSE:
            self.malformed[topic] += 1

    def _heard(self, topic: str, arrived: float, message: Any) -> Iterator[Heard]:
        if topic not in self._firsts:
            self._firsts[topic] = message
            self._look_again()
        if topic in self._tracks:
            yield from self._of_track(topic, arrived, message)
        elif (read := self.ranges.get(topic)) is not None:
            yield from self._ranges(topic, read, arrived, message)
        elif topic in self._tf_topics:
            for child, user, stamp, parent, pose in self._tf.take(topic, arrived, message):
                name = dict(self._asked.renamed).get(self._asked.user or user, self._asked.user or user)
                if name in self._asked.left_out or self._users.setdefault(name, child) != child:
                    continue
                yield self._pose(name, stamp, arrived, parent, pose)
        elif (undecided := self._undecided.get(topic)) is not None:
            undecided.first_at = min(undecided.first_at, arrived)
            undecided.waiting.append((arrived, message))
            del undecided.waiting[:-_MOST_WAITING]
            if len(undecided.waiting) >= SETTLED_MESSAGES and arrived - undecided.first_at >= SETTLED_S:
                yield from self._decided(topic)

    def _roles(self) -> Roles:
        known = {name: of for name, of in self._said.topics.items() if name in self.topics}
        roles = roles_of(
            list(self.topics.values()),
            replace(self._said, topics=known),
            lambda t: self._firsts.get(t.name),
            self._place,
        )
        # A path tells of where its robot has been, not of where it is.
        return replace(roles, poses=tuple(role for role in roles.poses if not role.is_path))

    def _look_again(self) -> None:
        """What the first message of a topic tells of it."""
        roles = self._roles()
        for role in roles.poses:
            name = role.topic.name
            if name in self._firsts and name not in self._tracks and not role.is_truth and name in self._done:
                self._undecided.setdefault(name, _Undecided(np.inf))
        for range_role in roles.ranges:
            if range_role.topic.name in self._firsts and range_role.topic.name not in self.ranges:
                self._begin_ranges(range_role)

    def _begin_ranges(self, role: RangeRole) -> None:
        unit = self._asked.range_unit or role.unit
        if unit is None and likely_unit(role, [])[0] == "mm":
            unit = "mm"
        self.ranges[role.topic.name] = RangeTopic(role, RangeReader(role), None if unit is None else LENGTH_UNITS[unit])
        if unit is not None:
            self._told(f"{self._place}: {role.topic.name} has ranges, {role.value} in {unit}")

    def _decided(self, topic: str) -> Iterator[HeardPose]:
        """Whose a topic is, and whether it is the one of several that counts; then what waited of it."""
        roles = {role.topic.name: role for role in self._roles().poses}
        user = self._user(roles[topic])
        rivals = [role for name, role in roles.items() if name in self._undecided and self._user(role) == user]
        rivals = [r for r in rivals if len(self._undecided[r.topic.name].waiting) >= SETTLED_MESSAGES]
        best = None if user in self._users or user in self._asked.left_out else preferred(rivals).topic.name
        for name in [role.topic.name for role in rivals]:
            waited = self._undecided.pop(name).waiting
            if name != best:
                self.dropped.append(name)
                self._useless.add(name)
                continue
            reader = PoseReader(roles[name])
            self._users[user], self._tracks[name] = name, (user, reader)
            self._told(f"{self._place}: {name} is {user}'s track")
            for arrived, message in waited:
                yield from self._of_track(name, arrived, message)

    def _of_track(self, topic: str, arrived: float, message: Any) -> Iterator[HeardPose]:
        user, reader = self._tracks[topic]
        try:
            yield self._pose(user, reader.stamp(message), arrived, _frame_id(message), reader.pose(message))
        except _NONSENSE:
            self.malformed[topic] += 1

    def _user(self, role: PoseRole) -> str:
        said = self._said.topics.get(role.topic.name, {}).get("user")
        user = said or self._asked.user or role.user
        return dict(self._asked.renamed).get(user, user)

    def _pose(self, user: str, stamp: float, arrived: float, frame_id: str, pose: Pose) -> HeardPose:
        """Raises ValueError for what is no pose."""
        row = np.array([[arrived, *map(float, pose)]])
        if not np.isfinite(row).all() or not row[0, 4:].any() or np.abs(row[0, 1:4]).max() > MAX_PLACE:
            raise ValueError("no pose")
        own = poses_as_asked(row, self._asked, "flu", None)
        _, x, y, z, qx, qy, qz, qw = own.rows[0].tolist()
        by_log = self._asked.stamps == "log" or not stamp > 0.0
        ros = (*row[0, 1:4].tolist(),)
        return HeardPose(user, np.nan if by_log else stamp, arrived, frame_id, ros, (x, y, z), (qx, qy, qz, qw), own.up)

    def _ranges(self, topic: str, read: RangeTopic, arrived: float, message: Any) -> Iterator[HeardRange]:
        stamp = np.nan if self._asked.stamps == "log" else read.reader.stamp(message)
        for one in read.reader.ranges(message):
            if not np.isfinite(one.distance):
                continue
            read.a.add(one.a)
            read.b.add(one.b)
            if read.metres is None:
                self._judge_unit(topic, read, one.distance)
            if read.metres is not None:
                known = _known(one.optional, read.metres)
                yield HeardRange(stamp, arrived, topic, one.a, one.b, read.metres * one.distance, known)

    def _judge_unit(self, topic: str, read: RangeTopic, distance: float) -> None:
        read.seen.append(distance)
        if len(read.seen) < _UNIT_OF:
            return
        unit, why = likely_unit(read.role, read.seen)
        read.metres = LENGTH_UNITS[unit]
        self._told(
            f"{self._place}: {topic} has ranges, {read.role.value} is taken to be in {unit} ({why}; --range-unit says"
            " otherwise)"
        )

    def _wanted_tf(self, roles: Roles) -> list[Wanted]:
        """Transforms where they were asked for, or nothing else tells where a robot is."""
        asked = {topic.name for topic in roles.transforms if "tf" in self._said.topics.get(topic.name, {})}
        if roles.poses and not asked:
            return []
        chosen = [topic for topic in roles.transforms if not asked or topic.name in asked]
        self._tf_topics |= {topic.name for topic in chosen}
        return [Wanted(topic.name, topic.type, False) for topic in chosen]


def _known(optional: Mapping[str, float | str], metres: float) -> dict[str, float | str | bool]:
    """What a room takes of it; `metres`: in one of the distance's unit."""
    found: dict[str, float | str | bool] = {}
    for name, value in optional.items():
        if isinstance(value, str):
            found |= {name: value} if value else {}
        elif not np.isfinite(value):
            continue
        elif name == "nlos":
            found[name] = bool(value)
        elif name != "sigma" or metres * value >= MIN_SIGMA:
            found[name] = metres * value if name == "sigma" else value
    return found


def _frame_id(message: Any) -> str:
    header = message.get("header") if isinstance(message, Mapping) else None
    frame = header.get("frame_id") if isinstance(header, Mapping) else None
    return frame.strip().strip("/") if isinstance(frame, str) else ""
