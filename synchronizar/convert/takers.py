"""What is taken out of the messages of a topic: poses, paths, ranges, transforms."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from typing import Any

import numpy as np

from synchronizar.arrays import Array
from synchronizar.convert.asked import LENGTH_UNITS, Asked
from synchronizar.convert.fields import Items, Topic, numbers_at, stamp_of
from synchronizar.convert.guess import PoseRole, RangeRole, kind_of
from synchronizar.convert.imported import Imported
from synchronizar.convert.message_clock import MessageClock
from synchronizar.convert.surveyed import add_surveyed
from synchronizar.convert.transforms import Transforms

Decode = Callable[[], Any]
"""Makes a message of its bytes."""
LONGEST_RANGE = 300.0
"""m: numbers of which most are larger are millimetres."""
_PATH_EVERY_S = 1.0
"""Paths are sent whole again and again: one of them in so long, and the last, say all."""


def _pose_numbers(role: PoseRole, path: str) -> Callable[[Any], tuple[Any, ...]]:
    """Of a message, or of an item of its list: x y z qx qy qz qw."""
    within = f"{role.path.partition('[]')[0]}[].{path}" if role.is_path else path
    dot, below = (f"{path}." if path else ""), (f"{within}." if within else "")
    named = role.topic.has(f"{below}position.x")
    place, turn = ("position", "orientation") if named else ("translation", "rotation")
    return numbers_at([*(f"{dot}{place}.{x}" for x in "xyz"), *(f"{dot}{turn}.{x}" for x in "xyzw")])


class Poses:
    """The poses of a topic."""

    def __init__(self, role: PoseRole) -> None:
        self.role, self.topic = role, role.topic.name
        self._pose = _pose_numbers(role, role.path)
        self._stamp = None if role.time == "log" else Items(role.time)
        self.logged, self.own, self._poses = array("d"), array("d"), array("d")

    def take(self, logged: float, decode: Decode) -> None:
        """Take a message."""
        message = decode()
        self._poses.extend(self._pose(message))
        self.logged.append(logged)
        self.own.append(np.nan if self._stamp is None else stamp_of(self._stamp(message)))

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
        self._items, self._pose = Items(before), _pose_numbers(role, after.lstrip("."))
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
    """The ranges of a topic; a message may hold several."""

    def __init__(self, role: RangeRole) -> None:
        self.role = role
        self._stamp = None if role.time == "log" else Items(role.time)
        self._value = Items(role.value)
        self._a, self._b = _end(role.a), _end(role.b)
        self._optional = {name: Items(path) for name, path in role.optional.items()}
        self.logged, self.own = array("d"), array("d")
        self.distance = array("d")
        self.a: list[str] = []
        self.b: list[str] = []
        self.optional: dict[str, list[Any]] = {name: [] for name in self._optional}
        self.empty = 0
        self._place = None if role.place is None else tuple(map(Items, role.place))
        self.places: dict[str, tuple[float, float, float]] = {}
        """m: where `b` was surveyed to be, as messages say it."""
        self._indexed = "anchor" if "tag" in role.topic.type.lower() else ""

    @property
    def topic(self) -> str:
        """Its name."""
        return self.role.topic.name

    def take(self, logged: float, decode: Decode) -> None:
        """Take a message."""
        message = decode()
        own = np.nan if self._stamp is None else stamp_of(self._stamp(message))
        values = self._value(message)
        several = values if self._value.is_list else [values]
        a, b = self._a(message), self._b(message)
        optional = {name: of(message) for name, of in self._optional.items()}
        for k, value in enumerate(several):
            distance = float(value)
            if distance == 0.0 and self.role.topic.type != "sensor_msgs/Range":
                self.empty += 1
                continue
            self.logged.append(logged)
            self.own.append(own)
            self.distance.append(distance)
            self.a.append(_item(a, k, ""))
            self.b.append(_item(b, k, self._indexed))
            for name, of in optional.items():
                self.optional[name].append(of[k] if isinstance(of, list) and k < len(of) else of)
            if self._place is not None:
                x, y, z = (of(message) for of in self._place)
                self.places[self.b[-1]] = (x[k], y[k], z[k]) if isinstance(x, list) else (x, y, z)

    def add_to(self, imported: Imported, t: Array, asked: Asked) -> None:
        """Add them, in metres."""
        distance = np.array(self.distance) * self._metres(imported, asked)
        numbers = {name: np.array(self.optional.get(name, [])) for name in ("sigma", "rx_power", "fp_power", "nlos")}
        ranges = imported.ranges
        n = len(distance)
        ranges.t.extend(t.tolist())
        ranges.distance.extend(distance.tolist())
        ranges.a.extend(self.a)
        ranges.b.extend(self.b)
        for name, of in numbers.items():
            getattr(ranges, name).extend(of.astype(float).tolist() if len(of) == n else [np.nan] * n)
        self._survey(imported)
        for name in ("antenna_a", "antenna_b"):
            getattr(ranges, name).extend(map(str, self.optional.get(name, [""] * n)))
        if self.empty:
            imported.note(f"{self.empty} distances of 0 in {self.role.topic.name} are no measurements and left out")

    def _survey(self, imported: Imported) -> None:
        """Places of anchors, but those of devices with tracks."""
        add_surveyed(imported, {name: place for name, place in self.places.items() if name not in imported.tracks})

    def _metres(self, imported: Imported, asked: Asked) -> float:
        name, value = self.role.topic.name, self.role.value
        if asked.range_unit is not None:
            return LENGTH_UNITS[asked.range_unit]
        unit = self.role.unit
        if unit is None:
            known = np.abs(np.array(self.distance))
            known = known[np.isfinite(known)]
            is_integer = kind_of(self.role.topic, value) == "integer"
            unit = "mm" if is_integer or (len(known) and np.median(known) > LONGEST_RANGE) else "m"
            why = "integers" if is_integer else f"{np.median(known):.6g} in the median" if len(known) else "none"
            imported.note(f"{value} in {name} is taken to be in {unit} ({why}; --range-unit says otherwise)")
        return LENGTH_UNITS[unit]


class Frames:
    """Transforms of a topic."""

    def __init__(self, topic: Topic, frames: Transforms, asked: Asked) -> None:
        self._frames, self._is_static = frames, topic.name.rstrip("/").endswith("tf_static")
        self._space = topic.name.strip("/").rpartition("/")[0]
        self._items = Items("transforms") if topic.has("transforms") else None
        within = "transforms[]." if self._items is not None else ""
        self._ends = numbers_at(["header.frame_id", "child_frame_id"])
        place, stamp = "transform.", "header.stamp"
        if topic.has(f"{within}parent_frame_id"):
            self._ends = numbers_at(["parent_frame_id", "child_frame_id"])
            place, stamp = "", "timestamp"
        self._pose = numbers_at(
            [*(f"{place}translation.{x}" for x in "xyz"), *(f"{place}rotation.{x}" for x in "xyzw")]
        )
        self._stamp = None if asked.stamps == "log" else Items(stamp)

    def take(self, logged: float, decode: Decode) -> None:
        """Take a message."""
        message = decode()
        for item in [message] if self._items is None else self._items(message):
            stamp = logged if self._stamp is None else stamp_of(self._stamp(item)) or logged
            parent, child = (f"{self._space}/{end.strip('/')}".strip("/") for end in self._ends(item))
            self._frames.add(parent, child, stamp, self._pose(item), self._is_static)


def _end(end: str) -> Callable[[Any], Any]:
    """A function of a message: a name, or one for each item."""
    if end == "#":
        return lambda _: "#"
    if end.startswith("="):
        return lambda _: end[1:]
    items = Items(end)

    def names(message: Any) -> Any:
        value = items(message)
        return [_name(v) for v in value] if items.is_list else _name(value)

    return names


def _name(value: Any) -> str:
    """A device's name out of a field: 7 of 7.0, and no slash at the ends of a frame."""
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return str(value).strip().strip("/").replace("/", "_")


def _item(of: Any, k: int, indexed: str) -> str:
    if of == "#":
        return f"{indexed}{k}"
    if isinstance(of, list):
        return str(of[k]) if k < len(of) else "?"
    return str(of)
