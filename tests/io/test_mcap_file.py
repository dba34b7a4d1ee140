from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from synchronizar.cli import main
from synchronizar.data.recording import Recording
from synchronizar.io.tum import read_tum

pytest.importorskip("mcap", reason="the extra `mcap` is not installed")

from mcap.reader import make_reader


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


def test_a_name_that_says_no_format_is_told(walk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["convert", str(walk), str(walk.parent / "walk.xyz")]) == 2
    assert "--to mcap" in capsys.readouterr().err
