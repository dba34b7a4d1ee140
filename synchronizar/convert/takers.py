"""What is taken out of the messages of a topic: poses, paths, ranges, transforms."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from typing import Any

import numpy as np

from synchronizar.arrays import Array
from synchronizar.convert.asked import LENGTH_UNITS, Asked
from synchronizar.convert.fields import Items, Topic, stamp_of
from synchronizar.convert.guess import PoseRole, RangeRole
from synchronizar.convert.imported import Imported
from synchronizar.convert.message_clock import MessageClock
from synchronizar.convert.reading import PoseReader, RangeReader, likely_unit, pose_numbers
from synchronizar.convert.surveyed import add_surveyed
from synchronizar.convert.transforms import Transforms, transform_of

Decode = Callable[[], Any]
"""Makes a message of its bytes."""
_PATH_EVERY_S = 1.0
"""Paths are sent whole again and again: one of them in so long, and the last, say all."""


class Poses:
    """The poses of a topic."""

    def __init__(self, role: PoseRole) -> None:
        self.role, self.topic = role, role.topic.name
        self.logged, self.own, self._poses = array("d"), array("d"), array("d")
        self._reader = PoseReader(role)

    def take(self, logged: float, decode: Decode) -> None:
        """Take a message."""
        message = decode()
        self._poses.extend(self._reader.pose(message))
        self.logged.append(logged)
        self.own.append(self._reader.stamp(message))

    def rows(self, clock: MessageClock) -> Array:
        """(n, 8) t x y z qx qy qz qw."""
        return np.column_stack([clock.stamps(self), np.array(self._poses).reshape(-1, 7)])


class Paths:
    """The poses of a topic whose messages each hold the way so far, or the last part of it.

    The latest message that tells of a moment counts, since SLAM may have corrected what it told before.
    """

    def __init__(self, role: PoseRole) -> None:
        self.role, self.topic = role, role.topic.name
        before, _, after = role.path.partition("[]")
        self._items, self._pose = Items(before), pose_numbers(role, after.lstrip("."))
        self._stamp = Items(role.time.partition("[]")[2].lstrip("."))
        self.logged, self.own = array("d"), array("d")
        self._rows = np.empty((0, 8))
        self._due = -np.inf
        self._waiting: tuple[float, Decode] | None = None

    def take(self, logged: float, decode: Decode) -> None:
        """Take a message, or keep it until it is known whether another follows soon."""
        if logged < self._due:
            self._waiting = (logged, decode)
        else:
            self._add(logged, decode())

    def finish(self) -> None:
        """Take the last message."""
        if self._waiting is not None:
            logged, decode = self._waiting
            self._add(logged, decode())

    def _add(self, logged: float, message: Any) -> None:
        self._due, self._waiting = logged + _PATH_EVERY_S, None
        rows = np.array(
            [(stamp_of(self._stamp(item)), *self._pose(item)) for item in self._items(message)], dtype=float
        )
        if not len(rows):
            return
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        self._rows = np.vstack([self._rows[self._rows[:, 0] < rows[0, 0]], rows])
        self.logged.append(logged)
        self.own.append(rows[-1, 0])

    def rows(self, clock: MessageClock) -> Array:
        """(n, 8) t x y z qx qy qz qw."""
        return np.column_stack([self._rows[:, 0] + clock.shift(self), self._rows[:, 1:]])


class Ranges:
    """The ranges of a topic."""

    def __init__(self, role: RangeRole) -> None:
        self.role, self.topic = role, role.topic.name
        self.logged, self.own = array("d"), array("d")
        self.distance = array("d")
        self.a: list[str] = []
        self.b: list[str] = []
        self.optional: dict[str, list[Any]] = {name: [] for name in role.optional}
        """Of each range: sigma in the distance's unit, powers in dBm, nlos, antennas' names."""
        self._reader = RangeReader(role)

    def take(self, logged: float, decode: Decode) -> None:
        """Take a message."""
        message = decode()
        own = self._reader.stamp(message)
        for distance, a, b, optional in self._reader.ranges(message):
            self.logged.append(logged)
            self.own.append(own)
            self.distance.append(distance)
            self.a.append(a)
            self.b.append(b)
            for name, value in optional.items():
                self.optional[name].append(value)

    def add_to(self, imported: Imported, t: Array, asked: Asked) -> None:
        """Add them, in metres."""
        metres = self._metres(imported, asked)
        lengths = {"sigma": [metres * sigma for sigma in self.optional["sigma"]]} if "sigma" in self.optional else {}
        distance = (metres * np.array(self.distance)).tolist()
        imported.ranges.extend(t.tolist(), self.a, self.b, distance, **self.optional | lengths)
        self._survey(imported)
        if self._reader.empty:
            what = f"{self._reader.empty} distances of 0 in {self.topic}"
            imported.note(f"{what} are no measurements and left out")

    def _survey(self, imported: Imported) -> None:
        """Places of anchors, but those of devices with tracks."""
        add_surveyed(
            imported, {name: place for name, place in self._reader.places.items() if name not in imported.tracks}
        )

    def _metres(self, imported: Imported, asked: Asked) -> float:
        name, value = self.role.topic.name, self.role.value
        if asked.range_unit is not None:
            return LENGTH_UNITS[asked.range_unit]
        unit = self.role.unit
        if unit is None:
            unit, why = likely_unit(self.role, self.distance)
            imported.note(f"{value} in {name} is taken to be in {unit} ({why}; --range-unit says otherwise)")
        return LENGTH_UNITS[unit]


class Frames:
    """Transforms of a topic."""

    def __init__(self, topic: Topic, frames: Transforms, asked: Asked) -> None:
        self._frames, self._is_static = frames, topic.name.rstrip("/").endswith("tf_static")
        self._space = topic.name.strip("/").rpartition("/")[0]
        self._items = Items("transforms") if topic.has("transforms") else None
        self._by_log = asked.stamps == "log"

    def take(self, logged: float, decode: Decode) -> None:
        """Take a message."""
        message = decode()
        for item in [message] if self._items is None else self._items(message):
            transform = transform_of(self._space, logged, item)
            self._frames.put(transform._replace(stamp=logged) if self._by_log else transform, self._is_static)
