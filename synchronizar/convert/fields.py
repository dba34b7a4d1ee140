"""Fields of messages by their paths, whatever the messages are: objects with attributes, or dictionaries.

A path is names joined by dots; `[]` after a name stands for each item of a list: `nodes[].dis`, `dis_arr[]`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any


@dataclass(frozen=True)
class Field:
    """A field of a message type."""

    path: str
    """As the paths above."""
    kind: str
    """`integer`, `float`, `text`, `truth` or `other`."""


@dataclass(frozen=True)
class Topic:
    """A topic of a file of messages."""

    name: str
    type: str
    """Without `/msg/`: package/Name, or a schema's name."""
    count: int
    fields: tuple[Field, ...] = field(default=())
    """All that its messages have, nested ones by their paths; none where that is not known."""

    def has(self, path: str) -> bool:
        """Whether its messages have such a field."""
        return any(f.path == path or f.path.startswith((f"{path}.", f"{path}[]")) for f in self.fields)


class Items:
    """What a path leads to in each message: one value, or a list of them."""

    def __init__(self, path: str) -> None:
        before, self.is_list, after = path.partition("[]")
        self._before = _getter(before)
        self._after = _getter(after.lstrip(".")) if after.lstrip(".") else None

    def __call__(self, message: Any) -> Any:
        """The value; where the path has a list in it, a list of values."""
        value = self._before(message)
        if not self.is_list:
            return value
        if self._after is None:
            return list(value)
        return [self._after(item) for item in value]


def _getter(path: str) -> Callable[[Any], Any]:
    """A function that follows a path of names through attributes or dictionaries."""
    by_attribute, names = attrgetter(path), path.split(".")

    def follow(message: Any) -> Any:
        if isinstance(message, Mapping):
            for name in names:
                message = message[name]
            return message
        return by_attribute(message)

    return follow


def stamp_of(value: Any) -> float:
    """Seconds of a ROS or Foxglove time, or of a number that is seconds already."""
    if isinstance(value, int | float):
        return float(value)
    if isinstance(value, Mapping):
        sec = value.get("sec", value.get("secs", 0))
        nsec = next((value[name] for name in ("nsec", "nanosec", "nsecs") if name in value), 0)
    else:
        sec, nsec = value.sec, value.nanosec
    return float(sec) + 1e-9 * float(nsec)


def json_fields(schema: Mapping[str, Any], path: str = "", depth: int = 5) -> Iterator[Field]:
    """The fields of a JSON Schema's object."""
    for name, of in schema.get("properties", {}).items():
        yield from _json_field(of, f"{path}{name}", depth)


def _json_field(schema: Any, path: str, depth: int) -> Iterator[Field]:
    kind = schema.get("type") if isinstance(schema, Mapping) else None
    if kind == "object" and depth:
        yield from json_fields(schema, f"{path}.", depth - 1)
    elif kind == "array" and depth and "[]" not in path:
        yield from _json_field(schema.get("items", {}), f"{path}[]", depth - 1)
    else:
        kinds = {"number": "float", "integer": "integer", "string": "text", "boolean": "truth"}
        yield Field(path, kinds.get(str(kind), "other"))
