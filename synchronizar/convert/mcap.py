"""Reads MCAP files: messages of ROS 1 and 2 (extra `ros` besides `mcap`), JSON and protobuf, as Foxglove has them.

| | |
|---|---|
| messages | ros1, cdr (by ros2msg or ros2idl), json (with or without a JSON Schema), protobuf; others are listed |
| Foxglove's | FrameTransform(s), PoseInFrame, whatever else has a pose; and the ranges that `convert` writes |
| time | s: messages' own stamps; when they were logged where they have none or of another clock |
| numbers | as stamps: s, or ms, us, ns by their size |
| the rest | as for bags (`rosbag`): names, units, frames, what is guessed |
| refused | files that are broken or cut off, files without a message that can be read |
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from synchronizar.convert.asked import Asked
from synchronizar.convert.fields import Field, Topic, fields_of_value, json_fields
from synchronizar.convert.imported import Imported
from synchronizar.convert.mapping import mapped
from synchronizar.convert.messages import broken, imported_of
from synchronizar.convert.messages import listing as listing_of
from synchronizar.convert.protobuf_types import decoder_of
from synchronizar.convert.ros_types import fields_of, short_type, store_of
from synchronizar.convert.source import Source
from synchronizar.convert.takers import Decode
from synchronizar.errors import os_faults
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


class _Contents(NamedTuple):
    """What a file holds, by its summary or by having read all of it."""

    schemas: Mapping[int, Any]
    channels: Mapping[int, Any]
    counts: Mapping[int, int]
    """Messages of each channel."""
    begin: int
    """ns: when the first message was logged."""
    end: int
    is_indexed: bool


class _File:
    """An MCAP file, open."""

    def __init__(self, stream: BinaryIO, asked: Asked) -> None:
        from mcap.reader import make_reader

        self.remedy, self._stream, self._asked = REMEDY, stream, asked
        self._reader = make_reader(stream)
        summary = self._reader.get_summary()
        if summary is not None and summary.channels and summary.statistics is not None:
            told = summary.statistics
            counts = told.channel_message_counts
            begin, end = told.message_start_time, told.message_end_time
            self._contents = _Contents(summary.schemas, summary.channels, counts, begin, end, True)
        else:
            self._contents = _scanned(stream)
        self._decoders: dict[int, Callable[[bytes], Any]] = {}
        self._stores: dict[int, Any] = {}
        topics: dict[str, Topic] = {}
        for channel in self._contents.channels.values():
            topic = self._topic(channel, self._contents.schemas.get(channel.schema_id))
            known = topics.get(channel.topic, topic)
            count = known.count + self._contents.counts.get(channel.id, 0)
            topics[channel.topic] = replace(known if known.fields else topic, count=count)
        self.topics = list(topics.values())

    def _topic(self, channel: Any, schema: Any) -> Topic:
        """What a channel's messages are, by its schema; makes what decodes them."""
        name = "" if schema is None else schema.name
        fields: tuple[Field, ...] = ()
        kind = "" if schema is None else schema.encoding
        if channel.message_encoding in ("cdr", "ros1") and kind in _ROS:
            ros = _ROS[kind][1]
            if ros not in self._stores:
                self._stores[ros] = self._store(ros)
            full = name if name.count("/") > 1 else name.replace("/", "/msg/", 1)
            self._decoders[channel.id] = _of_ros(self._stores[ros], full, ros)
            name, fields = short_type(full), fields_of(self._stores[ros], full)
        elif channel.message_encoding == "json":
            self._decoders[channel.id] = json.loads
            fields = tuple(json_fields(_json(schema.data))) if kind == "jsonschema" else ()
            fields = fields or tuple(fields_of_value(self._first(channel)))
        elif channel.message_encoding == "protobuf" and kind == "protobuf":
            try:
                self._decoders[channel.id], fields = decoder_of(name, schema.data)
            except (ValueError, TypeError, KeyError) as error:
                fault = " ".join(str(error).split())
                return Topic(channel.topic, name, 0, unread=f"protobuf whose descriptors cannot be read: {fault}")
        else:
            said = channel.message_encoding or "an encoding that is not said"
            return Topic(channel.topic, name, 0, unread=f"messages in {said}: ros1, cdr, json and protobuf are read")
        return Topic(channel.topic, name, 0, fields)

    def _first(self, channel: Any) -> Any:
        """The first message of a channel whose schema says nothing; empty where that is no object."""
        data = next((m.data for _, c, m in self._messages([channel.topic]) if c.id == channel.id), b"null")
        return _json(data)

    def _store(self, ros: int) -> Any:
        definitions = []
        for schema in self._contents.schemas.values():
            kind, of = _ROS.get(schema.encoding, ("", 0))
            if of == ros:
                full = schema.name if schema.name.count("/") > 1 else schema.name.replace("/", "/msg/", 1)
                definitions.append((full, kind, schema.data.decode("utf-8", errors="replace")))
        return store_of(definitions, ros, mapped(self._asked).types)

    def _messages(self, names: Collection[str]) -> Iterator[tuple[Any, Any, Any]]:
        """Schema, channel and message, in the order of time where an index spares it keeping them all."""
        from mcap.reader import NonSeekingReader

        if self._contents.is_indexed:
            yield from self._reader.iter_messages(topics=list(names))
            return
        self._stream.seek(0)
        yield from NonSeekingReader(self._stream).iter_messages(topics=list(names), log_time_order=False)

    def read(self, names: Collection[str]) -> Iterator[tuple[str, float, Decode, float]]:
        """As `Messages.read`."""
        begin, span = self._contents.begin, max(self._contents.end - self._contents.begin, 1)
        for _, channel, message in self._messages(names):
            decode = self._decoders.get(channel.id)
            if decode is not None:
                share = (message.log_time - begin) / span
                yield channel.topic, 1e-9 * message.log_time, partial(decode, message.data), share


def _scanned(stream: BinaryIO) -> _Contents:
    """What is in a file without a summary, by reading all of it."""
    from mcap.records import Channel, Message, Schema
    from mcap.stream_reader import StreamReader

    schemas: dict[int, Any] = {}
    channels: dict[int, Any] = {}
    counts: dict[int, int] = defaultdict(int)
    begin, end = 0, 0
    stream.seek(0)
    for record in StreamReader(stream).records:
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            counts[record.channel_id] += 1
            begin = min(begin or record.log_time, record.log_time)
            end = max(end, record.log_time)
    return _Contents(schemas, channels, counts, begin, end, False)


def _json(data: bytes) -> dict[str, Any]:
    """The object; an empty one for what is none."""
    try:
        value = json.loads(data)
    except (ValueError, RecursionError):
        return {}
    return value if isinstance(value, dict) else {}


def _of_ros(store: Any, name: str, ros: int) -> Callable[[bytes], Any]:
    decode = store.deserialize_ros1 if ros == 1 else store.deserialize_cdr
    return lambda data: decode(data, name)


@contextmanager
def _opened(path: Path, asked: Asked) -> Iterator[_File]:
    import mcap.reader  # noqa: F401  (its absence is told before the file is blamed)

    with os_faults(path), path.open("rb") as stream:
        with broken(path, REMEDY):
            file = _File(stream, asked)
        yield file
