"""Which topics there are, and what their messages have, as rosapi tells it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from synchronizar.convert.fields import Field, Topic
from synchronizar.convert.ros_types import short_type
from synchronizar.ros.rosbridge import Rosbridge, ServiceError

_DEEPEST = 5
_TIMES = ("time", "duration", "builtin_interfaces/Time", "builtin_interfaces/Duration")
_KINDS = {
    **dict.fromkeys(("float", "double", "float32", "float64"), "float"),
    **dict.fromkeys(("string", "wstring"), "text"),
    **dict.fromkeys(("bool", "boolean"), "truth"),
    **dict.fromkeys((f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)), "integer"),
    **dict.fromkeys(("byte", "char", "octet"), "integer"),
}


class Rosapi:
    """Of one connection; each type is asked for once."""

    def __init__(self, rosbridge: Rosbridge) -> None:
        self._rosbridge = rosbridge
        self._fields: dict[str, tuple[Field, ...]] = {}

    async def topics(self) -> list[Topic]:
        """All that there are. Raises ServiceError where rosapi does not run, ConnectionError without rosbridge."""
        answer = await self._rosbridge.call("/rosapi/topics")
        names, types = answer.get("topics"), answer.get("types")
        if not isinstance(names, list) or not isinstance(types, list) or len(names) != len(types):
            raise ServiceError("/rosapi/topics: no list of topics and types")
        found = sorted(zip(map(str, names), map(str, types), strict=True))
        return [Topic(name, short_type(kind), 1, await self._of_type(kind)) for name, kind in found]

    async def _of_type(self, kind: str) -> tuple[Field, ...]:
        """Empty where the definition is not known."""
        if kind not in self._fields:
            try:
                answer = await self._rosbridge.call("/rosapi/message_details", {"type": kind})
                self._fields[kind] = fields_of_typedefs(answer.get("typedefs"))
            except (ServiceError, AttributeError, LookupError, TypeError, ValueError):
                self._fields[kind] = ()
        return self._fields[kind]


def fields_of_typedefs(typedefs: Any) -> tuple[Field, ...]:
    """The fields of a message by rosapi's definitions of it and of what it holds, its own first."""
    by_name = {short_type(of["type"]): of for of in typedefs}
    return tuple(_fields(typedefs[0], by_name, "", _DEEPEST)) if typedefs else ()


def _fields(of: Mapping[str, Any], by_name: Mapping[str, Mapping[str, Any]], path: str, depth: int) -> Iterator[Field]:
    for name, kind, length in zip(of["fieldnames"], of["fieldtypes"], of["fieldarraylen"], strict=True):
        is_list = length >= 0
        if is_list and "[]" in path:
            continue
        here, kind = f"{path}{name}" + ("[]" if is_list else ""), short_type(kind.split(",")[0].strip())
        if kind in _TIMES:
            yield from (Field(f"{here}.sec", "integer"), Field(f"{here}.nanosec", "integer"))
        elif kind in by_name and depth:
            yield from _fields(by_name[kind], by_name, f"{here}.", depth - 1)
        else:
            yield Field(here, _KINDS.get(kind, "other"))
