"""MCAP files of other programs become recordings: protobuf and JSON as Foxglove has them, with a summary or without."""

from __future__ import annotations

import json
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mcap", reason="the extra `mcap` is not installed")

from support.bags import walk

from synchronizar.cli import main
from synchronizar.convert import mcap
from synchronizar.convert.asked import Asked
from synchronizar.convert.imported import Imported
from synchronizar.progress import unheard


def write(path: Path, schemas: dict[str, tuple[str, str, bytes]], messages: Iterable[Any], **options: Any) -> Path:
    """Topics by (message encoding, schema's name, schema), and messages (topic, logged in s, bytes)."""
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start()
        channels = {}
        for topic, (encoding, name, data) in schemas.items():
            kind = {"json": "jsonschema"}.get(encoding, encoding)
            schema = writer.register_schema(name, kind, data) if data else 0
            channels[topic] = writer.register_channel(topic, encoding, schema)
        for topic, logged, data in messages:
            writer.add_message(channels[topic], round(1e9 * logged), data, round(1e9 * logged))
        writer.finish()
    return path


def read(path: Path, **asked: Any) -> Imported:
    return mcap.read(path, Asked(**asked), unheard)


def foxglove(name: str) -> tuple[Any, bytes]:
    """A message class as Foxglove publishes it, and all that its descriptor needs, as its files have it."""
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    made = getattr(import_module(f"foxglove_schemas_protobuf.{name}_pb2"), name)
    files, seen = FileDescriptorSet(), set[str]()

    def add(descriptor: Any) -> None:
        if descriptor.name not in seen:
            seen.add(descriptor.name)
            descriptor.CopyToProto(files.file.add())
            for other in descriptor.dependencies:
                add(other)

    add(made.DESCRIPTOR.file)
    return made, files.SerializeToString()


def fill(message: Any, row: list[float], place: str, turn: str) -> None:
    for name, value in zip("xyz", row[1:4], strict=True):
        setattr(getattr(message, place), name, value)
    for name, value in zip("xyzw", row[4:], strict=True):
        setattr(getattr(message, turn), name, value)


def protobuf_walks(kind: str) -> tuple[dict[str, tuple[str, str, bytes]], list[Any]]:
    made, descriptors = foxglove(kind)
    topics, messages = {}, []
    for k in (1, 2):
        topic = f"/phone{k}/pose" if kind == "PoseInFrame" else "/tf"
        topics[topic] = ("protobuf", f"foxglove.{kind}", descriptors)
        for row in walk(phase=k).tolist():
            message = made()
            several = message.transforms.add() if kind == "FrameTransforms" else message
            several.timestamp.FromNanoseconds(round(1e9 * row[0]))
            if kind == "PoseInFrame":
                fill(message.pose, row, "position", "orientation")
            else:
                several.parent_frame_id, several.child_frame_id = f"phone{k}/odom", f"phone{k}/base_link"
                fill(several, row, "translation", "rotation")
            messages.append((topic, row[0] + 0.01, message.SerializeToString()))
    return topics, sorted(messages, key=lambda m: m[1])


@pytest.mark.parametrize("kind", ["PoseInFrame", "FrameTransform", "FrameTransforms"])
@pytest.mark.parametrize(
    "options", [{}, {"use_chunking": False}, {"use_statistics": False, "use_summary_offsets": False}]
)
def test_foxgloves_protobuf_messages_come_as_they_were_written(tmp_path: Path, kind: str, options: Any) -> None:
    pytest.importorskip("foxglove_schemas_protobuf", reason="Foxglove's own classes are not installed")
    imported = read(write(tmp_path / "a.mcap", *protobuf_walks(kind), **options))
    assert set(imported.tracks) == {"phone1", "phone2"}
    for k in (1, 2):
        np.testing.assert_allclose(imported.tracks[f"phone{k}"], walk(phase=k), rtol=0, atol=1e-6)


RANGE_FIELDS = {
    "time": {"type": "number"},
    "from_id": {"type": "string"},
    "to_id": {"type": "string"},
    "distance": {"type": "number"},
}
POSE_FIELDS = {
    "timestamp": {"$ref": "#/$defs/Time"},
    "pose": {
        "type": "object",
        "properties": {
            "position": {"$ref": "#/$defs/V"},
            "orientation": {"$ref": "#/$defs/Q"},
        },
    },
}
DEFINITIONS = {
    "Time": {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}},
    "V": {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyz"}},
    "Q": {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyzw"}},
}


@pytest.mark.parametrize("with_schema", [True, False])
def test_json_is_read_by_its_schema_or_by_what_its_messages_hold(tmp_path: Path, with_schema: bool) -> None:
    schema = {"type": "object", "properties": POSE_FIELDS, "$defs": DEFINITIONS}
    ranges = {"type": "object", "properties": RANGE_FIELDS}
    topics = {f"/phone{k}/pose": ("json", "Pose", json.dumps(schema).encode()) for k in (1, 2)}
    topics["/uwb"] = ("json", "Uwb", json.dumps(ranges).encode())
    topics = topics if with_schema else dict.fromkeys(topics, ("json", "", b""))
    messages = []
    for k in (1, 2):
        for row in walk(phase=k).tolist():
            sec, nsec = divmod(round(1e9 * row[0]), 10**9)
            pose = {
                "position": dict(zip("xyz", row[1:4], strict=True)),
                "orientation": dict(zip("xyzw", row[4:], strict=True)),
            }
            value = {"timestamp": {"sec": sec, "nsec": nsec}, "pose": pose}
            messages.append((f"/phone{k}/pose", row[0], json.dumps(value).encode()))
    value = {"time": 1000.5, "from_id": "phone1", "to_id": "phone2", "distance": 2.5}
    messages.append(("/uwb", 1000.6, json.dumps(value).encode()))
    imported = read(write(tmp_path / "a.mcap", topics, sorted(messages, key=lambda m: m[1])))
    np.testing.assert_allclose(imported.tracks["phone2"], walk(phase=2), rtol=0, atol=1e-6)
    rows = imported.ranges
    assert (rows.a, rows.b, list(rows.distance), list(rows.t)) == (["phone1"], ["phone2"], [2.5], [1000.5])


def test_a_message_that_lacks_a_field_is_one_line_with_its_topic(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    schema = json.dumps({"type": "object", "properties": POSE_FIELDS, "$defs": DEFINITIONS}).encode()
    value = {"timestamp": {"sec": 5, "nsec": 0}, "pose": {"position": {"x": 1, "y": 2, "z": 3}}}
    file = write(tmp_path / "a.mcap", {"/p": ("json", "Pose", schema)}, [("/p", 5.0, json.dumps(value).encode())])
    assert main(["convert", str(file), str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert (
        "a.mcap: a message of /p, logged at 5 s, cannot be read: has no 'orientation' (--topic '/p skip' leaves" in err
    )
    assert err.count("\n") == 1


def test_a_value_that_is_no_number_is_one_line_and_null_is_not_known(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def convert(nlos: object, x: object) -> str:
        value = {"time": 1.0, "from_id": "a", "to_id": "b", "distance": 2.0}
        messages = [
            value | {"nlos": n, "anchor_position": {"x": at, "y": 1, "z": 2}} for n, at in ((1, 0.5), (nlos, x))
        ]
        data = [("/uwb", 1.0 + k, json.dumps(message).encode()) for k, message in enumerate(messages)]
        file = write(tmp_path / "a.mcap", {"/uwb": ("json", "", b"")}, data)
        status = main(["convert", str(file), str(tmp_path / "out"), "--force", "--topic", "/uwb nlos=nlos"])
        told = capsys.readouterr().err
        assert (status, told.count("\n")) in ((0, 0), (2, 1))
        return told

    assert "a message of /uwb, logged at 2 s, cannot be read: could not convert" in convert("blocked", 0.5)
    assert "a message of /uwb, logged at 2 s, cannot be read: could not convert" in convert(1, "here")
    assert convert(None, None) == ""
    assert "position = [0.5, 1.0, 2.0]" in (tmp_path / "out" / "recording.toml").read_text()
    assert [line.split(",")[-1] for line in (tmp_path / "out" / "ranges.csv").read_text().split()] == ["nlos", "1", ""]


@pytest.mark.parametrize("schema", [b"[1]", b'{"properties": 5}', b'{"properties": {}, "$defs": 1}'])
def test_a_schema_that_is_none_says_nothing(tmp_path: Path, schema: bytes) -> None:
    data = json.dumps({"time": 1.0, "from_id": "a", "to_id": "b", "distance": 2.0}).encode()
    imported = read(write(tmp_path / "a.mcap", {"/uwb": ("json", "Uwb", schema)}, [("/uwb", 1.0, data)]))
    assert list(imported.ranges.distance) == [2.0]


@pytest.mark.parametrize(
    ("kind", "schema", "data"),
    [
        ("protobuf", b"none", b"\x08\x01"),
        ("protobuf", b"\n\x00", b"\x08\x01"),
        ("json", b"", b"{no"),
        ("json", b"", b"[" * 9999),
    ],
)
def test_a_topic_that_cannot_be_understood_does_not_spoil_the_others(
    tmp_path: Path, kind: str, schema: bytes, data: bytes
) -> None:
    good = json.dumps({"time": 1.0, "from_id": "a", "to_id": "b", "distance": 2.0}).encode()
    topics = {"/odd": (kind, "some.Type", schema), "/uwb": ("json", "", b"")}
    imported = read(write(tmp_path / "a.mcap", topics, [("/odd", 1.0, data), ("/uwb", 2.0, good)]))
    assert list(imported.ranges.distance) == [2.0]
    assert any(note.startswith("/odd is not read: ") for note in imported.notes)


def test_messages_in_another_encoding_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write(tmp_path / "a.mcap", {"/p": ("flatbuffer", "foxglove.PoseInFrame", b"bfbs")}, [("/p", 5.0, b"\0\0")])
    assert main(["convert", str(file), "--list"]) == 0
    assert "messages in flatbuffer: ros1, cdr, json and protobuf are read" in capsys.readouterr().out
    assert main(["convert", str(file), str(tmp_path / "out")]) == 2
    assert "--list shows what it has" in capsys.readouterr().err


@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 0.98])
@pytest.mark.parametrize("options", [{}, {"use_chunking": False}])
def test_a_file_that_is_cut_off_is_one_clear_line(
    tmp_path: Path, share: float, options: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("foxglove_schemas_protobuf", reason="Foxglove's own classes are not installed")
    file = write(tmp_path / "a.mcap", *protobuf_walks("PoseInFrame"), **options)
    file.write_bytes(file.read_bytes()[: 12 + int(share * file.stat().st_size)])
    assert main(["convert", str(file), str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "a.mcap: is broken" in err
