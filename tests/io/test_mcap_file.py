from __future__ import annotations

import importlib
import json
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.mcap_doctor import examine

from synchronizar.cli import main
from synchronizar.data.recording import Recording
from synchronizar.io.tum import read_tum

pytest.importorskip("mcap", reason="the extra `mcap` is not installed")

from mcap.reader import NonSeekingReader, make_reader

LATER = {"message_id", "lineage"}
"""Fields that Foxglove came to have and asks of nobody."""
TYPES = {"number": (int, float), "integer": int, "string": str, "boolean": bool}


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mcap") / "walk"
    assert main(["simulate", str(folder), "--users", "2", "--seconds", "5", "--seed", "2"]) == 0
    assert main(["replay", str(folder), "--out", str(folder.parent / "live")]) == 0
    assert main(["register", str(folder), "--out", str(folder.parent / "answer")]) == 0
    return folder


def written(walk: Path, *options: str) -> list[tuple[str, str, float, dict[str, object]]]:
    out = walk.parent / "walk.mcap"
    assert main(["convert", str(walk), str(out), *options]) == 0
    with out.open("rb") as file:
        return [
            (channel.topic, schema.name, 1e-9 * message.log_time, json.loads(message.data))
            for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages()
            if schema is not None
        ]


def test_a_recording_is_written_message_by_message_in_the_order_of_time(walk: Path) -> None:
    messages = written(walk)
    recording = Recording.load(walk)
    count = Counter(topic for topic, *_ in messages)
    assert count["/ranges"] == np.isfinite(recording.ranges.distance).sum()
    assert count["/tf"] == sum(len(track) for track in recording.tracks.values())
    assert count["/tracks/phone0"] == 1
    assert [t for _, _, t, _ in messages] == sorted(t for _, _, t, _ in messages)
    assert {value["parent_frame_id"] for topic, _, _, value in messages if topic == "/tf"} == {
        "phone0/slam",
        "phone1/slam",
    }


def test_an_answer_puts_everybody_into_the_common_frame_with_what_became_of_each_range(walk: Path) -> None:
    messages = written(walk, "--answer", str(walk.parent / "answer"))
    moves = [value for topic, _, _, value in messages if topic == "/tf" and value["child_frame_id"] == "phone1"]
    track = read_tum(walk.parent / "answer" / "phone1.tum")
    places = [[value["translation"][axis] for axis in "xyz"] for value in moves]  # type: ignore[index]
    np.testing.assert_allclose(places, track.position, atol=1e-8)
    assert {value["parent_frame_id"] for value in moves} == {"common"}
    assert {value["verdict"] for topic, _, _, value in messages if topic == "/ranges"} <= {
        "used",
        "rejected",
        "unusable",
    }


def test_states_over_time_are_there_where_a_replay_wrote_them(walk: Path) -> None:
    messages = written(walk, "--answer", str(walk.parent / "live"))
    lines = (walk.parent / "live" / "updates.jsonl").read_text().splitlines()
    assert sum(topic == "/states/phone1" for topic, *_ in messages) == len(lines)


def test_what_is_not_known_is_left_out_for_foxglove_reads_no_null(walk: Path) -> None:
    messages = written(walk) + written(walk, "--answer", str(walk.parent / "live"))
    assert all(None not in value.values() for *_, value in messages)
    ranges = [value for topic, _, _, value in messages if topic == "/ranges"]
    assert {"residual" in value for value in ranges} == {False, True}
    assert {value["verdict"] for value in ranges if "residual" not in value} <= {"unknown", "unusable"}


def check_schema(schema: dict[str, Any]) -> None:
    """Foxglove's reader of JSON schemas takes one type for each field, and `properties` wherever there is an object."""
    assert schema["type"] == "object"
    for field in schema["properties"].values():
        inner = field["items"] if field["type"] == "array" else field
        if inner["type"] == "object":
            check_schema(inner)
        else:
            assert inner["type"] in TYPES


def check_value(value: Any, schema: dict[str, Any]) -> None:
    if schema["type"] == "object":
        assert value.keys() <= schema["properties"].keys()
        for name, of in value.items():
            check_value(of, schema["properties"][name])
    elif schema["type"] == "array":
        for of in value:
            check_value(of, schema["items"])
    else:
        assert isinstance(value, TYPES[schema["type"]])
        assert schema["type"] == "boolean" or not isinstance(value, bool)


def test_schemas_are_as_foxglove_reads_them_and_messages_are_as_they_say(walk: Path) -> None:
    out = walk.parent / "checked.mcap"
    assert main(["convert", str(walk), str(out), "--answer", str(walk.parent / "live")]) == 0
    schemas = {}
    with out.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            if schema.name not in schemas:
                schemas[schema.name] = json.loads(schema.data)
                check_schema(schemas[schema.name])
            check_value(json.loads(message.data), schemas[schema.name])
    assert len(schemas) == 5


@pytest.mark.parametrize("answer", ["", "answer", "live"])
def test_a_doctor_finds_nothing_wrong_with_the_file(walk: Path, answer: str) -> None:
    out = walk.parent / "sound.mcap"
    options = ["--answer", str(walk.parent / answer)] if answer else []
    assert main(["convert", str(walk), str(out), *options]) == 0
    counts = examine(out)
    assert counts["/ranges"] == np.isfinite(Recording.load(walk).ranges.distance).sum()
    assert counts.total() > counts["/ranges"] + counts["/tf"] > 0


def test_a_doctor_finds_every_byte_that_is_changed(walk: Path) -> None:
    """In any tenth of the file: what checks the writer has to be able to see that something is wrong."""
    out = walk.parent / "sound.mcap"
    assert main(["convert", str(walk), str(out)]) == 0
    whole = out.read_bytes()
    for at in np.linspace(20, len(whole) - 1, 11).astype(int).tolist():
        out.write_bytes(whole[:at] + bytes([whole[at] ^ 0x41]) + whole[at + 1 :])
        try:
            examine(out)
        except Exception:  # whatever the broken part leads to
            continue
        pytest.fail(f"byte {at} of {len(whole)} may be anything")


def test_the_file_is_sound_whether_it_is_read_by_its_index_or_from_its_beginning(walk: Path) -> None:
    messages = written(walk, "--answer", str(walk.parent / "live"))
    with (walk.parent / "walk.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        statistics = summary.statistics
        assert statistics is not None
        assert statistics.message_count == len(messages)
        assert statistics.channel_count == len(summary.channels) == len({topic for topic, *_ in messages})
        assert statistics.schema_count == len(summary.schemas) == len({schema for _, schema, *_ in messages})
        assert sum(statistics.channel_message_counts.values()) == len(messages)
        assert statistics.chunk_count == len(summary.chunk_indexes) > 0
        assert [round(1e-9 * end, 9) for end in (statistics.message_start_time, statistics.message_end_time)] == [
            round(messages[0][2], 9),
            round(messages[-1][2], 9),
        ]
        file.seek(0)
        assert sum(1 for _ in NonSeekingReader(file, validate_crcs=True).iter_messages()) == len(messages)


def as_protobuf(value: Any, name: str = "") -> Any:
    """JSON as protobuf writes it, which has other words for moments and durations."""
    if isinstance(value, dict) and value.keys() == {"sec", "nsec"}:
        seconds = f"{value['sec']}.{value['nsec']:09d}s"
        if name == "lifetime":
            return seconds
        moment = datetime.fromtimestamp(value["sec"], UTC)
        return f"{moment:%Y-%m-%dT%H:%M:%S}.{value['nsec']:09d}Z"
    if isinstance(value, dict):
        return {key: as_protobuf(of, key) for key, of in value.items()}
    return [as_protobuf(of) for of in value] if isinstance(value, list) else value


def test_messages_have_the_fields_and_types_that_foxglove_publishes(walk: Path) -> None:
    published = pytest.importorskip("foxglove_schemas_protobuf", reason="Foxglove's own schemas are not installed")
    json_format = pytest.importorskip("google.protobuf.json_format")
    seen: Counter[str] = Counter()
    for _, schema, t, value in written(walk, "--answer", str(walk.parent / "live")):
        if not schema.startswith("foxglove."):
            continue
        kind = schema.removeprefix("foxglove.")
        message = getattr(importlib.import_module(f"{published.__name__}.{kind}_pb2"), kind)()
        json_format.ParseDict(as_protobuf(value), message)  # refuses what is not a field, or of another type
        wanted = {field.name for field in message.DESCRIPTOR.fields}
        assert wanted <= value.keys() | LATER
        for entity in value.get("entities", []):  # type: ignore[attr-defined]
            assert {field.name for field in message.entities[0].DESCRIPTOR.fields} <= entity.keys() | LATER
            assert abs(message.entities[0].timestamp.ToNanoseconds() - 1e9 * t) < 1000
        seen[kind] += 1
        for lines in (line for entity in value.get("entities", []) for line in entity["lines"]):  # type: ignore[attr-defined]
            assert {field.name for field in message.entities[0].lines[0].DESCRIPTOR.fields} <= lines.keys() | LATER
    assert seen.keys() == {"FrameTransform", "PosesInFrame", "SceneUpdate"}


def rotation(x: float, y: float, z: float, w: float) -> Any:
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_the_region_about_a_device_is_what_its_covariance_says(walk: Path) -> None:
    messages = written(walk, "--answer", str(walk.parent / "answer"))
    told = json.loads((walk.parent / "answer" / "registration.json").read_text())["users"]["phone1"]["covariance"]
    covariance, track = np.array(told)[:3, :3], read_tum(walk.parent / "answer" / "phone1.tum")
    seen = 0
    for topic, _, t, value in messages:
        (entity,) = value["entities"] if topic == "/scene" else [{"id": ""}]  # type: ignore[misc]
        if entity["id"] != "phone1" or t > track.t[-1]:
            continue
        (ball,) = entity["spheres"]
        body = rotation(*track.at(np.array([t]), np.inf).quat_xyzw[0])
        axes = body @ rotation(*(ball["pose"]["orientation"][axis] for axis in "xyzw"))
        half = np.array([ball["size"][axis] for axis in "xyz"]) / 2.0
        np.testing.assert_allclose(axes @ np.diag(half**2 / 7.8147) @ axes.T, covariance, atol=2e-4)
        seen += 1
    assert seen > 5


def test_a_line_between_two_devices_is_as_long_as_what_was_expected_of_their_range(walk: Path) -> None:
    messages = written(walk, "--answer", str(walk.parent / "answer"))
    expected = [
        value["distance"] - value["residual"]  # type: ignore[operator]
        for topic, _, _, value in messages
        if topic == "/ranges" and value["verdict"] != "unusable"
    ]
    found: list[float] = []
    for topic, _, _, value in messages:
        if topic != "/range_lines":
            continue
        (lines,) = value["entities"][0]["lines"]  # type: ignore[index]
        places = np.array([[point[axis] for axis in "xyz"] for point in lines["points"]]).reshape(-1, 2, 3)
        assert len(lines["colors"]) == 2 * len(places)
        found += np.linalg.norm(places[:, 0] - places[:, 1], axis=1).tolist()
    # Antennas are at the origins here; biases of radios are in what is expected, and small.
    np.testing.assert_allclose(np.sort(found), np.sort(expected), atol=0.1)


def test_the_layout_shows_topics_and_fields_that_are_in_the_file(walk: Path) -> None:
    for answer in ("answer", "live"):
        messages = written(walk, "--answer", str(walk.parent / answer))
        fields: dict[str, set[str]] = {}
        for topic, _, _, value in messages:
            fields.setdefault(topic, set()).update(value)
        layout = json.loads((walk.parent / "walk.layout.json").read_text())
        panels = layout["configById"]
        # In so short a replay nobody but the reference is registered, and there is no line between two.
        assert panels["3D!map"]["topics"].keys() - fields.keys() <= ({"/range_lines"} if answer == "live" else set())
        assert panels["3D!map"]["followTf"] == "common"
        paths = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
        for path in paths:
            topic, _, field = path.partition(".")
            assert field in fields[topic.partition("{")[0]]
        assert any(path.startswith("/states/") for path in paths) == (answer == "live")
        shown: list[str] = []

        def walk_through(part: Any, into: list[str]) -> None:
            if isinstance(part, str):
                into.append(part)
            else:
                walk_through(part["first"], into)
                walk_through(part["second"], into)

        walk_through(layout["layout"], shown)
        assert sorted(shown) == sorted(panels)


def test_a_name_that_says_no_format_is_told(walk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["convert", str(walk), str(walk.parent / "walk.xyz")]) == 2
    assert "--to mcap" in capsys.readouterr().err
