from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.data.track import Track
from synchronizar.data.updates import Update, UserUpdate
from synchronizar.data.user import User
from synchronizar.errors import InputError
from synchronizar.geometry import YawFrame
from synchronizar.io.updates_jsonl import read_updates, write_updates


@pytest.fixture
def recording() -> Recording:
    """Alice stands; Bob stands 1 m away; the radio has no track."""
    stands = Track(np.array([100.0, 110.0]), np.zeros((2, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)))
    a, b = np.array([0, 0], dtype=np.int32), np.array([1, 2], dtype=np.int32)
    users = (User("alice"), User("bob"), User("radio", static=True))
    return Recording(users, {"alice": stands, "bob": stands}, Ranges.of(np.array([101.0, 102.0]), a, b, np.ones(2)))


def said(**of_user: Any) -> dict[str, Any]:
    place = {"x": 0.0, "y": 0.0, "z": 0.0, "yaw": 0.0, "covariance": None}
    return {"state": "registered", **place, "scale": 1.0, "progress": 1.0, "cue": None, **of_user}


def line(t: float, **of_bob: Any) -> dict[str, Any]:
    users = {"alice": said(), "bob": said(**of_bob), "radio": said(yaw=None)}
    return {"t": t, "update_ms": 1.0, "reference": "alice", "users": users, "events": []}


def test_what_is_written_reads_back_the_same(recording: Recording, tmp_path: Path) -> None:
    alice = UserUpdate(State.REGISTERED, YawFrame(0.0, 1.0, -2.0, 0.5, 1.25), np.diag([1.0, 2, 3, 4]), 1.0, False, None)
    bob = UserUpdate(State.DISCONNECTED, None, None, 0.25, False, "walk 2 m to your left")
    of_place = np.full((4, 4), np.nan)
    of_place[:3, :3] = np.diag([4.0, 5.0, 6.0])
    radio = UserUpdate(State.UNOBSERVABLE, YawFrame(3.0, 2.0, 1.0), of_place, 0.5, True, None)
    users = {"alice": alice, "bob": bob, "radio": radio}
    updates = [Update(101.0, 0.5, users, ["bob: came"]), Update(102.0, 0.25, users, [])]
    write_updates(tmp_path / "updates.jsonl", updates, "alice")
    read = read_updates(tmp_path / "updates.jsonl", recording)
    assert [(of.t, of.seconds, of.events) for of in read] == [(101.0, 0.5, ["bob: came"]), (102.0, 0.25, [])]
    for one in read:
        assert {name: user._replace(covariance=None) for name, user in one.users.items()} == {
            name: user._replace(covariance=None) for name, user in users.items()
        }
        np.testing.assert_array_equal(one.users["alice"].covariance, alice.covariance)
        np.testing.assert_array_equal(one.users["radio"].covariance, of_place)
        assert one.users["bob"].covariance is None


def test_a_line_has_the_keys_that_others_read(tmp_path: Path) -> None:
    radio = UserUpdate(State.REGISTERED, YawFrame(3.0, 2.0, 1.0, 0.5), None, 1.0, True, None)
    bob = UserUpdate(State.DISCONNECTED, None, None, 0.0, False, None)
    write_updates(tmp_path / "updates.jsonl", [Update(101.5, 0.002, {"bob": bob, "radio": radio}, ["x"])], "alice")
    written = json.loads((tmp_path / "updates.jsonl").read_text())
    nowhere = {"x": None, "y": None, "z": None, "yaw": None, "covariance": None, "scale": 1.0, "cue": None}
    assert written == {
        "t": 101.5,
        "update_ms": 2.0,
        "reference": "alice",
        "users": {
            "bob": nowhere | {"state": "disconnected", "progress": 0.0},
            "radio": nowhere | {"state": "registered", "progress": 1.0, "x": 3.0, "y": 2.0, "z": 1.0},
        },
        "events": ["x"],
    }


def test_a_replay_of_no_range_is_an_empty_file(recording: Recording, tmp_path: Path) -> None:
    write_updates(tmp_path / "updates.jsonl", [], "alice")
    assert read_updates(tmp_path / "updates.jsonl", recording) == []


GOOD = line(102.0)


@pytest.mark.parametrize(
    "broken",
    [
        "",
        "t: 3",
        "[]",
        "[" * 100_000,
        "{}",
        json.dumps(GOOD | {"t": None}),
        json.dumps(GOOD | {"t": float("nan")}),
        json.dumps(GOOD | {"t": 101.9}),
        json.dumps(GOOD),
        json.dumps(GOOD | {"t": 103.0, "update_ms": None}),
        json.dumps(GOOD | {"t": 103.0, "events": None}),
        json.dumps(GOOD | {"t": 103.0, "users": []}),
        json.dumps(line(103.0, state="lost")),
        json.dumps(line(103.0, progress=None)),
        json.dumps(line(103.0, progress=1.5)),
        json.dumps(line(103.0, progress=float("nan"))),
        json.dumps(line(103.0, y=None)),
        json.dumps(line(103.0, yaw="north")),
        json.dumps(line(103.0, scale=float("inf"))),
        json.dumps(line(103.0, scale=0.0)),
        json.dumps(line(103.0, covariance=[[1.0, 2.0]])),
        json.dumps(line(103.0, covariance="small")),
        json.dumps(line(103.0))[:-20],
    ],
)
def test_a_broken_line_is_named(recording: Recording, tmp_path: Path, broken: str) -> None:
    file = tmp_path / "updates.jsonl"
    file.write_text(f"{json.dumps(GOOD)}\n{broken}\n")
    with pytest.raises(InputError, match=r"updates\.jsonl:2: is no update of a replay$"):
        read_updates(file, recording)


def test_updates_about_other_users_are_told(recording: Recording, tmp_path: Path) -> None:
    file = tmp_path / "updates.jsonl"
    other = line(102.0)
    other["users"]["carol"] = other["users"].pop("bob")
    file.write_text(json.dumps(other) + "\n")
    with pytest.raises(InputError, match=r"updates\.jsonl:1: is about another recording: its users are not the same$"):
        read_updates(file, recording)


def test_a_file_that_cannot_be_read_or_written_is_named(recording: Recording, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no\.jsonl: No such file or directory$"):
        read_updates(tmp_path / "no.jsonl", recording)
    with pytest.raises(InputError, match=r": Is a directory$"):
        write_updates(tmp_path, [], "alice")
