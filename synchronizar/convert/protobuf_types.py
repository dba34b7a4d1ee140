"""Protobuf messages by the descriptors that a file holds. Needs `protobuf`, of the extra `mcap`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from synchronizar.convert.fields import Field

_REPEATED, _MESSAGE = 3, 11
_KINDS = {1: "float", 2: "float", 8: "truth", 9: "text"} | dict.fromkeys((3, 4, 5, 6, 7, 13, 15, 16, 17, 18), "integer")
"""By the numbers that descriptor.proto gives types."""
_DEEPEST = 5


def decoder_of(name: str, descriptors: bytes) -> tuple[Callable[[bytes], Any], tuple[Field, ...]]:
    """What makes messages of a type out of bytes, and its fields; `descriptors`: a FileDescriptorSet.

    Raises ValueError, TypeError or KeyError where the set is broken, or does not hold the type.
    """
    from google.protobuf.descriptor_pb2 import FileDescriptorSet
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message import DecodeError
    from google.protobuf.message_factory import GetMessageClass

    try:
        files = {file.name: file for file in FileDescriptorSet.FromString(descriptors).file}
    except DecodeError as error:
        raise ValueError(str(error)) from error
    pool, added = DescriptorPool(), set[str]()
    while ready := [file for n, file in files.items() if n not in added and added.issuperset(file.dependency)]:
        for file in ready:
            pool.Add(file)
            added.add(file.name)
    made = GetMessageClass(pool.FindMessageTypeByName(name))
    types: dict[str, Any] = {}
    for file in files.values():
        types |= _types(f".{file.package}" if file.package else "", file.message_type)
    return made.FromString, tuple(_fields(types, f".{name}", "", _DEEPEST))


def _types(space: str, messages: Any) -> Mapping[str, Any]:
    found: dict[str, Any] = {}
    for message in messages:
        found[f"{space}.{message.name}"] = message
        found |= _types(f"{space}.{message.name}", message.nested_type)
    return found


def _fields(types: Mapping[str, Any], name: str, path: str, depth: int) -> Iterator[Field]:
    if name not in types or not depth:
        return
    for field in types[name].field:
        below = f"{path}{field.name}{'[]' if field.label == _REPEATED else ''}"
        if below.count("[]") > 1:
            continue
        if field.type == _MESSAGE:
            yield from _fields(types, field.type_name, f"{below}.", depth - 1)
        else:
            yield Field(below, _KINDS.get(field.type, "other"))
