"""What `mcap doctor` checks of a file, strictest way, from the format's specification alone (https://mcap.dev/spec)."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
STATISTICS, SUMMARY_OFFSET, DATA_END = 0x0B, 0x0E, 0x0F


class Record(NamedTuple):
    at: int
    kind: int
    data: bytes


class Cursor:
    """Numbers, texts and bytes of a record, one after the other."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, form: str) -> Any:
        (value,) = struct.unpack_from(f"<{form}", self.data, self.at)
        self.at += struct.calcsize(f"<{form}")
        return value

    def raw(self, size: int) -> bytes:
        self.at += size
        return self.data[self.at - size : self.at]

    def text(self) -> str:
        return self.raw(self.take("I")).decode()

    def pairs(self, key: str, value: str) -> list[tuple[int, int]]:
        end = self.at + 4 + struct.unpack_from("<I", self.data, self.at)[0]
        self.at += 4
        found = []
        while self.at < end:
            found.append((self.take(key), self.take(value)))
        assert self.at == end
        return found


def records(data: bytes, begin: int = 0) -> Iterator[Record]:
    at = begin
    while at < len(data):
        kind, size = struct.unpack_from("<BQ", data, at)
        assert at + 9 + size <= len(data), f"a record at {at} reaches beyond its end"
        yield Record(at, kind, data[at + 9 : at + 9 + size])
        at += 9 + size


def examine(path: Path) -> Counter[str]:
    """Assert that a file is as the format asks; returns how many messages each topic has."""
    whole = path.read_bytes()
    assert whole.startswith(MAGIC)
    assert whole.endswith(MAGIC)
    body = whole[: -len(MAGIC)]
    schemas: dict[int, bytes] = {}
    channels: dict[int, tuple[int, str]] = {}
    counts: Counter[int] = Counter()
    chunks: dict[int, tuple[int, int, int, int, int]] = {}
    indexes: dict[int, dict[int, tuple[int, list[tuple[int, int]]]]] = {}
    told: dict[int, Counter[str]] = {}
    last = first = -1
    data_end = summary_begin = chunk_at = 0
    summary: list[Record] = []

    def schema(record: Record) -> None:
        cursor = Cursor(record.data)
        number, name, encoding = cursor.take("H"), cursor.text(), cursor.text()
        assert number > 0
        assert name
        assert encoding
        assert schemas.setdefault(number, record.data) == record.data
        assert cursor.raw(cursor.take("I"))
        assert cursor.at == len(record.data)

    def channel(record: Record) -> None:
        cursor = Cursor(record.data)
        number, of, topic, encoding = cursor.take("H"), cursor.take("H"), cursor.text(), cursor.text()
        assert of == 0 or of in schemas
        assert encoding
        assert channels.setdefault(number, (of, topic)) == (of, topic)

    for record in records(body, len(MAGIC)):
        if data_end:
            summary.append(record)
            continue
        if record.kind == HEADER:
            cursor = Cursor(record.data)
            assert record.at == len(MAGIC)
            assert cursor.text() in ("", "ros1", "ros2")
            assert cursor.text()
        elif record.kind == CHUNK:
            cursor, chunk_at = Cursor(record.data), record.at
            begin, end, size, crc = (cursor.take(form) for form in "QQQI")
            compression, packed = cursor.text(), cursor.raw(cursor.take("Q"))
            assert cursor.at == len(record.data)
            inside = _unpacked(compression, packed)
            assert len(inside) == size
            assert crc in (0, zlib.crc32(inside))
            times = []
            index: dict[int, list[tuple[int, int]]] = {}
            for within in records(inside):
                if within.kind == SCHEMA:
                    schema(within)
                elif within.kind == CHANNEL:
                    channel(within)
                else:
                    assert within.kind == MESSAGE
                    number, _, logged = struct.unpack_from("<HIQ", within.data)
                    assert number in channels, "a message before its channel"
                    assert logged >= last, "log times fall"
                    last, first = logged, logged if first < 0 else first
                    times.append(logged)
                    counts[number] += 1
                    index.setdefault(number, []).append((logged, within.at))
            assert (begin, end) == ((min(times), max(times)) if times else (0, 0))
            chunks[record.at] = (begin, end, 9 + len(record.data), size, len(packed))
            indexes[record.at] = {}
            told[record.at] = Counter({str(n): len(of) for n, of in index.items()})
            expected = index
        elif record.kind == MESSAGE_INDEX:
            cursor = Cursor(record.data)
            number, entries = cursor.take("H"), cursor.pairs("Q", "Q")
            assert entries == expected[number], "an index that leads elsewhere"
            indexes[chunk_at][number] = (record.at, entries)
        elif record.kind == DATA_END:
            (crc,) = struct.unpack("<I", record.data)
            assert crc in (0, zlib.crc32(whole[: record.at]))
            data_end = record.at
        else:
            assert record.kind in (SCHEMA, CHANNEL), f"a record of kind {record.kind} in the data"
            {SCHEMA: schema, CHANNEL: channel}[record.kind](record)
    assert {at: set(map(str, of)) for at, of in indexes.items()} == {at: set(of) for at, of in told.items()}
    assert summary, "no footer"
    assert summary[-1].kind == FOOTER
    summary_begin, offsets_begin, crc = struct.unpack("<QQI", summary[-1].data)
    assert summary_begin == summary[0].at
    assert crc in (0, zlib.crc32(whole[summary_begin : summary[-1].at + 9 + 16]))
    known_schemas, known_channels = set(schemas), set(channels)
    seen: dict[int, list[int]] = {}
    for record in summary[:-1]:
        cursor = Cursor(record.data)
        seen.setdefault(record.kind, []).append(record.at)
        if record.kind == SCHEMA:
            schema(record)
            assert set(schemas) == known_schemas, "a schema of the summary alone"
        elif record.kind == CHANNEL:
            channel(record)
            assert set(channels) == known_channels, "a channel of the summary alone"
        elif record.kind == STATISTICS:
            messages, n_schemas, n_channels, attached, noted, n_chunks = (cursor.take(form) for form in "QHIIII")
            begin, end = cursor.take("Q"), cursor.take("Q")
            assert (messages, n_schemas, n_channels) == (counts.total(), len(schemas), len(channels))
            assert (attached, noted, n_chunks, begin, end) == (0, 0, len(indexes), max(first, 0), max(last, 0))
            assert dict(cursor.pairs("H", "Q")) == dict(counts)
        elif record.kind == CHUNK_INDEX:
            begin, end, at, length = (cursor.take("Q") for _ in range(4))
            offsets = dict(cursor.pairs("H", "Q"))
            cursor.take("Q")
            cursor.text()
            packed_size, size = cursor.take("Q"), cursor.take("Q")
            assert chunks.pop(at) == (begin, end, length, size, packed_size)
            assert offsets == {number: place for number, (place, _) in indexes[at].items()}
        elif record.kind == SUMMARY_OFFSET:
            kind, at, length = cursor.take("B"), cursor.take("Q"), cursor.take("Q")
            assert record.at >= offsets_begin
            if not length:
                assert kind not in seen
                continue
            assert seen[kind][0] == at
            ends = [other.at + 9 + len(other.data) for other in summary if other.kind == kind]
            assert at + length == ends[-1]
    assert not chunks, "a chunk that no index leads to"
    assert STATISTICS in seen
    assert len(seen[SCHEMA]) == len(schemas)
    assert len(seen[CHANNEL]) == len(channels)
    by_topic: Counter[str] = Counter()
    for number, count in counts.items():
        by_topic[channels[number][1]] += count
    return by_topic


def _unpacked(compression: str, data: bytes) -> bytes:
    if compression == "zstd":
        import zstandard

        unpacked: bytes = zstandard.ZstdDecompressor().decompressobj().decompress(data)
        return unpacked
    if compression == "lz4":
        import lz4.frame

        return bytes(lz4.frame.decompress(data))
    assert compression == ""
    return data
