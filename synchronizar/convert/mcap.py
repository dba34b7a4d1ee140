"""Reads MCAP files: messages of ROS 1 and 2 (extra `ros` besides `mcap`), and JSON by a schema, as Foxglove has it.

| | |
|---|---|
| messages | encodings ros1, cdr (with ros2msg or ros2idl definitions) and json; others are listed and not read |
| JSON | foxglove.FrameTransform(s), PoseInFrame, and the ranges that `convert` writes |
| time | s: messages' own stamps; when they were logged where they have none or of another clock |
| the rest | as for bags (`rosbag`): names, units, frames, what is guessed |
| refused | files that are broken, files without a message that can be read |
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from synchronizar.convert.asked import Asked
from synchronizar.convert.fields import Field, Topic, json_fields
from synchronizar.convert.imported import Imported
from synchronizar.convert.mapping import mapped
from synchronizar.convert.messages import broken, imported_of
from synchronizar.convert.messages import listing as listing_of
from synchronizar.convert.ros_types import fields_of, short_type, store_of
from synchronizar.convert.source import Source
from synchronizar.errors import InputError, os_faults
from synchronizar.progress import Progress

MAGIC = b"\x89MCAP0\r\n"
REMEDY = "`mcap recover` mends some"
_ROS = {"ros1msg": ("msg", 1), "ros2msg": ("msg", 2), "ros2idl": ("idl", 2)}


def recognises(source: Source) -> bool:
    """By its first bytes."""
    return source.head.startswith(MAGIC)


def listing(path: Path, asked: Asked) -> list[str]:
    """A line for each topic."""
    with _opened(path, asked) as messages:
        return listing_of(messages, asked, str(path))


def read(path: Path, asked: Asked, progress: Progress) -> Imported:
    """Tracks, truth and ranges. Raises InputError where the file cannot be read."""
    with _opened(path, asked) as messages:
        return imported_of(messages, asked, str(path), progress)


class _File:
    """An MCAP file, open."""

    def __init__(self, path: Path, stream: BinaryIO, asked: Asked) -> None:
        from mcap.reader import make_reader

        self._stream, self._path = stream, path
        self._reader = make_reader(stream)
        summary = self._reader.get_summary()
        if summary is None or not summary.channels:
            raise InputError(path, "has no summary of its topics: `mcap recover` mends it")
        counts: dict[str, int] = defaultdict(int)
        if summary.statistics is not None:
            for channel, count in summary.statistics.channel_message_counts.items():
                counts[summary.channels[channel].topic] += count
            self._begin = summary.statistics.message_start_time
            self._span = max(summary.statistics.message_end_time - self._begin, 1)
        else:
            raise InputError(path, "has no statistics of its topics: `mcap recover` mends it")
        self._decoders: dict[int, Callable[[bytes], Any]] = {}
        stores: dict[int, Any] = {}
        topics: dict[str, Topic] = {}
        for channel in summary.channels.values():
            schema = summary.schemas.get(channel.schema_id)
            name = "" if schema is None else schema.name
            fields: tuple[Field, ...] = ()
            if schema is not None and schema.encoding in _ROS and channel.message_encoding in ("cdr", "ros1"):
                ros = _ROS[schema.encoding][1]
                if ros not in stores:
                    stores[ros] = self._store(summary.schemas.values(), ros, asked)
                full = name if name.count("/") > 1 else name.replace("/", "/msg/", 1)
                self._decoders[channel.id] = _of_ros(stores[ros], full, ros)
                name, fields = short_type(full), fields_of(stores[ros], full)
            elif schema is not None and channel.message_encoding == "json":
                self._decoders[channel.id] = json.loads
                fields = tuple(json_fields(self._json(schema.data)))
            topics[channel.topic] = Topic(channel.topic, name, counts[channel.topic], fields)
        self.topics = list(topics.values())

    def _store(self, schemas: Any, ros: int, asked: Asked) -> Any:
        definitions = []
        for schema in schemas:
            kind, of = _ROS.get(schema.encoding, ("", 0))
            if of == ros:
                full = schema.name if schema.name.count("/") > 1 else schema.name.replace("/", "/msg/", 1)
                definitions.append((full, kind, schema.data.decode("utf-8", errors="replace")))
        return store_of(definitions, ros, mapped(asked).types)

    def _json(self, data: bytes) -> Any:
        try:
            schema = json.loads(data)
        except ValueError:
            return {}
        return schema if isinstance(schema, dict) else {}

    def read(self, names: Collection[str]) -> Iterator[tuple[str, float, Any, float]]:
        """As `Messages.read`."""
        messages = self._reader.iter_messages(topics=list(names))
        while True:
            with broken(self._path, REMEDY):
                found = next(messages, None)
                if found is None:
                    return
                _, channel, message = found
                decode = self._decoders.get(channel.id)
                value = None if decode is None else decode(message.data)
            if value is not None:
                share = (message.log_time - self._begin) / self._span
                yield channel.topic, 1e-9 * message.log_time, value, share


def _of_ros(store: Any, name: str, ros: int) -> Callable[[bytes], Any]:
    decode = store.deserialize_ros1 if ros == 1 else store.deserialize_cdr
    return lambda data: decode(data, name)


@contextmanager
def _opened(path: Path, asked: Asked) -> Iterator[_File]:
    import mcap.reader  # noqa: F401  (its absence is told before the file is blamed)

    with os_faults(path), path.open("rb") as stream:
        with broken(path, REMEDY):
            file = _File(path, stream, asked)
        yield file
