"""Fields of messages by their paths, whatever the messages are: objects with attributes, or dictionaries.

A path is names joined by dots; `[]` after a name stands for each item of a list: `nodes[].dis`, `dis_arr[]`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from operator import attrgetter, getitem
from typing import Any

from synchronizar.convert.asked import TIME_UNITS, time_unit_by_size
from synchronizar.io.text import quoted

SECONDS, _NANOSECONDS = ("sec", "seconds", "secs"), ("nanosec", "nsec", "nanos", "nsecs")
"""What the two fields of a time are called."""
_DEEPEST = 5


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
    unread: str = ""
    """Why its messages cannot be read."""

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
        return reduce(getitem, names, message) if isinstance(message, dict) else by_attribute(message)

    return follow


def numbers_at(paths: Sequence[str]) -> Callable[[Any], tuple[Any, ...]]:
    """A function of a message: the values at several paths without a list in them, in one go."""
    by_attribute, names = attrgetter(*paths), [path.split(".") for path in paths]

    def follow(message: Any) -> tuple[Any, ...]:
        if not isinstance(message, dict):
            found: tuple[Any, ...] = by_attribute(message)
            return found
        return tuple(reduce(getitem, path, message) for path in names)

    return follow


def stamp_of(value: Any) -> float:
    """Seconds of a time of ROS, Foxglove or protobuf, or of a number, whose unit is told by its size."""
    if isinstance(value, int | float):
        return float(value) * TIME_UNITS[time_unit_by_size(value)]
    sec = _first_of(value, SECONDS)
    if sec is None:
        raise ValueError(f"{quoted(str(value)[:40])} is no time")
    return float(sec) + 1e-9 * float(_first_of(value, _NANOSECONDS) or 0)


def _first_of(value: Any, names: Sequence[str]) -> Any:
    if isinstance(value, dict):
        return next((value[name] for name in names if name in value), None)
    return next((getattr(value, name) for name in names if hasattr(value, name)), None)


def json_fields(schema: Mapping[str, Any]) -> Iterator[Field]:
    """The fields of a JSON Schema's object."""
    definitions = {
        f"#/{place}/{name}": of
        for place in ("$defs", "definitions")
        for name, of in _mapping(schema.get(place)).items()
        if isinstance(of, Mapping)
    }
    yield from _json_fields(schema, "", _DEEPEST, definitions)


def _json_fields(schema: Mapping[str, Any], path: str, depth: int, definitions: Mapping[str, Any]) -> Iterator[Field]:
    for name, of in _mapping(schema.get("properties")).items():
        yield from _json_field(of, f"{path}{name}", depth, definitions)


def _json_field(schema: Any, path: str, depth: int, definitions: Mapping[str, Any]) -> Iterator[Field]:
    schema = _mapping(schema)
    schema = definitions.get(str(schema.get("$ref")), schema)
    kind = schema.get("type")
    if kind == "object" and depth:
        yield from _json_fields(schema, f"{path}.", depth - 1, definitions)
    elif kind == "array" and depth and "[]" not in path:
        yield from _json_field(schema.get("items", {}), f"{path}[]", depth - 1, definitions)
    else:
        kinds = {"number": "float", "integer": "integer", "string": "text", "boolean": "truth"}
        yield Field(path, kinds.get(str(kind), "other"))


def _mapping(value: Any) -> Mapping[str, Any]:
    """What is no object in a schema says nothing."""
    return value if isinstance(value, Mapping) else {}


def fields_of_value(value: Any, path: str = "", depth: int = 5) -> Iterator[Field]:
    """The fields of an object that came as JSON without a schema."""
    if isinstance(value, dict) and depth:
        for name, of in value.items():
            yield from fields_of_value(of, f"{path}.{name}" if path else name, depth - 1)
    elif isinstance(value, list) and value and depth and "[]" not in path:
        yield from fields_of_value(value[0], f"{path}[]", depth - 1)
    elif path:
        kinds = {bool: "truth", int: "integer", float: "float", str: "text"}
        yield Field(path, kinds.get(type(value), "other"))
