"""What one message says: a pose, or ranges, by what its topic's role has told of its fields."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from synchronizar.convert.fields import Items, numbers_at, stamp_of
from synchronizar.convert.guess import PoseRole, RangeRole, kind_of

Pose = tuple[float, float, float, float, float, float, float]
"""x y z (in the unit of the message), qx qy qz qw."""

ANTENNAS = ("antenna_a", "antenna_b")
LONGEST_RANGE = 300.0
"""m: numbers of which most are larger are millimetres."""


class PoseReader:
    """Of a topic of poses."""

    def __init__(self, role: PoseRole) -> None:
        self._pose = pose_numbers(role, role.path)
        self._stamp = None if role.time == "log" else Items(role.time)

    def pose(self, message: Any) -> Pose:
        """Where the device is."""
        return self._pose(message)

    def stamp(self, message: Any) -> float:
        """s: its own stamp; NaN where it has none."""
        return np.nan if self._stamp is None else stamp_of(self._stamp(message))


def pose_numbers(role: PoseRole, path: str) -> Callable[[Any], Pose]:
    """A function of a message, or of an item of its list: the pose at a path."""
    within = f"{role.path.partition('[]')[0]}[].{path}" if role.is_path else path
    dot, below = (f"{path}." if path else ""), (f"{within}." if within else "")
    named = role.topic.has(f"{below}position.x")
    place, turn = ("position", "orientation") if named else ("translation", "rotation")
    numbers: Callable[[Any], Any] = numbers_at(
        [*(f"{dot}{place}.{x}" for x in "xyz"), *(f"{dot}{turn}.{x}" for x in "xyzw")]
    )
    return numbers


class ReadRange(NamedTuple):
    """A distance as a message has it, in the message's own unit."""

    distance: float
    a: str
    b: str
    optional: dict[str, float | str]
    """sigma in the unit of the distance, powers in dBm, nlos; NaN where not known. Names of antennas; or blank."""


class RangeReader:
    """Of a topic of ranges; a message may hold several."""

    def __init__(self, role: RangeRole) -> None:
        self.empty = 0
        """How many distances of 0 were no measurements."""
        self._stamp = None if role.time == "log" else Items(role.time)
        self._value = Items(role.value)
        self._a, self._b = _end(role.a), _end(role.b)
        self._optional = {name: Items(path) for name, path in role.optional.items()}
        self._place = None if role.place is None else tuple(map(Items, role.place))
        self.places: dict[str, tuple[float, float, float]] = {}
        """m: where each `b` was surveyed to be, as messages say it."""
        self._indexed = "anchor" if "tag" in role.topic.type.lower() else ""
        self._zero_counts = role.topic.type == "sensor_msgs/Range"

    def stamp(self, message: Any) -> float:
        """s: its own stamp; NaN where it has none."""
        return np.nan if self._stamp is None else stamp_of(self._stamp(message))

    def ranges(self, message: Any) -> list[ReadRange]:
        """All that the message has; what is no number in JSON is null there, and no measurement."""
        values = self._value(message)
        several = values if self._value.is_list else [values]
        a, b = self._a(message), self._b(message)
        optional = {name: of(message) for name, of in self._optional.items()}
        found = []
        for k, value in enumerate(several):
            distance = _number(value)
            if distance == 0.0 and not self._zero_counts:
                self.empty += 1
                continue
            own = {name: _optional(name, _of_item(of, k)) for name, of in optional.items()}
            found.append(ReadRange(distance, _item(a, k, ""), _item(b, k, self._indexed), own))
            if self._place is not None:
                x, y, z = (_number(_of_item(of(message), k)) for of in self._place)
                if np.isfinite([x, y, z]).all():
                    self.places[found[-1].b] = x, y, z
        return found


def likely_unit(role: RangeRole, distances: Sequence[float]) -> tuple[str, str]:
    """The unit of distances of which nothing is said, and why: integers are mm, and so is what is too far for m."""
    known = np.abs(np.array(distances, dtype=float))
    known = known[np.isfinite(known)]
    is_integer = kind_of(role.topic, role.value) == "integer"
    unit = "mm" if is_integer or (len(known) and np.median(known) > LONGEST_RANGE) else "m"
    return unit, "integers" if is_integer else f"{np.median(known):.6g} in the median" if len(known) else "none"


def _number(value: Any) -> float:
    """NaN for null: JSON has no other."""
    return np.nan if value is None else float(value)


def _of_item(of: Any, k: int) -> Any:
    """The value of a list's k-th item, where each has its own."""
    if not isinstance(of, list):
        return of
    return of[k] if k < len(of) else None


def _optional(name: str, value: Any) -> float | str:
    if name in ANTENNAS:
        return "" if value is None else str(value)
    return _number(value)


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
