from __future__ import annotations

import json
import math
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from support.paths import REPOSITORY

from synchronizar.arrays import Array
from synchronizar.cli import main
from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.data.track import Track
from synchronizar.estimation.incremental.replay import replay
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

ROOT = REPOSITORY
PLACE = ("x", "y", "z", "yaw")
NOWHERE = dict.fromkeys((*PLACE, "covariance"))
PAUSE = (2.0, 3.05)
"""s: no range comes meanwhile."""
Line = dict[str, Any]


class Played(NamedTuple):
    """A recording, and what its replay left behind."""

    recording: Path
    out: Path
    printed: str
    told: str
    """On standard error."""

    @property
    def lines(self) -> list[Line]:
        return read_updates(self.out)

    @property
    def registration(self) -> Line:
        return dict(json.loads((self.out / "registration.json").read_text()))


def saved(folder: Path, scene: Scene) -> Path:
    simulate(scene).save(folder)
    return folder


def keep_ranges(recording: Path, kept: Any) -> None:
    """Only those of the rows of ranges.csv for which `kept`, of the row's stamp, is true."""
    file = recording / "ranges.csv"
    header, *rows = file.read_text().splitlines(keepends=True)
    file.write_text(header + "".join(row for row in rows if kept(float(row.split(",")[0]))))


def read_updates(folder: Path) -> list[Line]:
    text = (folder / "updates.jsonl").read_text()
    assert text == "" or text.endswith("\n")
    return [json.loads(line, parse_constant=pytest.fail) for line in text.splitlines()]


def poses(file: Path) -> Array:
    return np.loadtxt(file, ndmin=2)


def numbers(said: object) -> Iterator[float]:
    if isinstance(said, dict):
        said = list(said.values())
    if isinstance(said, list):
        for part in said:
            yield from numbers(part)
    elif isinstance(said, float):
        yield said


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Played:
    """Three walkers whose radios pause for a second, replayed by the command in a process of its own."""
    folder = tmp_path_factory.mktemp("replay")
    recording, out = saved(folder / "walk", Scene(users=3, seconds=10.0, seed=1)), folder / "answer"
    keep_ranges(recording, lambda t: not PAUSE[0] <= t < PAUSE[1])
    run = subprocess.run(
        [sys.executable, "-m", "synchronizar", "replay", str(recording), "--json", "--out", str(out)],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0
    return Played(recording, out, run.stdout, run.stderr)


@pytest.fixture(scope="module")
def beside_a_radio(tmp_path_factory: pytest.TempPathFactory) -> Played:
    """Two walkers, and a radio that stands still."""
    folder = tmp_path_factory.mktemp("radio")
    recording, out = saved(folder / "walk", Scene(seconds=8.0, static_radios=1, seed=2)), folder / "answer"
    assert main(["replay", str(recording), "--out", str(out)]) == 0
    return Played(recording, out, "", "")


@pytest.fixture
def walk(played: Played, tmp_path: Path) -> Path:
    """A copy of the recording, to be spoilt."""
    return Path(shutil.copytree(played.recording, tmp_path / "walk"))


# updates.jsonl


def test_there_is_a_line_for_each_tenth_of_a_second_in_which_a_range_came(played: Played) -> None:
    stamps = [row.split(",")[0] for row in (played.recording / "ranges.csv").read_text().splitlines()[1:]]
    tenths = sorted({math.floor(10 * Decimal(stamp)) for stamp in stamps})
    assert not set(tenths) & set(range(20, 30))
    np.testing.assert_allclose([line["t"] for line in played.lines], [(n + 1) / 10 for n in tenths], atol=1e-9)


def test_the_keys_of_a_line_are_those_of_the_contract(played: Played) -> None:
    for line in played.lines:
        assert line.keys() == {"t", "update_ms", "reference", "users", "events"}
        assert line["reference"] == "phone0"
        assert list(line["users"]) == ["phone0", "phone1", "phone2"]
        assert line["update_ms"] >= 0.0
        assert all(isinstance(event, str) for event in line["events"])
        for user in line["users"].values():
            assert user.keys() >= {"state", *PLACE, "covariance", "progress", "cue"}
            assert user["state"] in ("registered", "ambiguous", "unobservable", "disconnected")
            assert user["cue"] is None or isinstance(user["cue"], str)


def test_who_has_no_place_has_no_number_and_who_has_one_has_all(played: Played) -> None:
    placed = [user for line in played.lines for user in line["users"].values() if user["x"] is not None]
    nowhere = [user for line in played.lines for user in line["users"].values() if user["x"] is None]
    assert nowhere
    assert placed
    assert all(user.items() >= NOWHERE.items() for user in nowhere)
    for user in placed:
        values = np.array([*(user[key] for key in PLACE), *np.ravel(user["covariance"])], dtype=float)
        assert values.shape == (20,)
        assert np.isfinite(values).all()
        assert np.linalg.eigvalsh(user["covariance"]).min() > -1e-9


def test_a_static_radio_has_a_place_and_no_heading(beside_a_radio: Played) -> None:
    placed = [line["users"]["radio0"] for line in beside_a_radio.lines if line["users"]["radio0"]["x"] is not None]
    assert placed
    for radio in placed:
        assert radio["yaw"] is None
        assert np.isfinite([row[:3] for row in radio["covariance"][:3]]).all()


def test_progress_is_a_share_and_whole_where_registered_alone(played: Played) -> None:
    for line in played.lines:
        for user in line["users"].values():
            assert 0.0 <= user["progress"] <= 1.0
            assert (user["progress"] == 1.0) == (user["state"] == "registered")


@pytest.mark.parametrize("recording", ["played", "beside_a_radio"])
def test_no_state_changes_without_an_event_and_no_event_is_told_without_a_change(
    recording: str, request: pytest.FixtureRequest
) -> None:
    lines = request.getfixturevalue(recording).lines
    assert all(name == "phone0" or user["state"] == "disconnected" for name, user in lines[0]["users"].items())
    changes = 0
    for before, line in pairwise(lines):
        changed = {
            f"{name}: {user['state']}"
            for name, user in line["users"].items()
            if user["state"] != before["users"][name]["state"]
        }
        assert {": ".join(event.split(": ")[:2]) for event in line["events"]} == changed
        changes += len(changed)
    assert changes >= 4


# The tracks


def in_force(lines: list[Line], t: float) -> Line:
    """The last line that was written by a time."""
    return [line for line in lines if line["t"] <= t + 1e-9][-1]


@pytest.mark.parametrize("name", ["phone0", "phone1", "phone2"])
def test_a_pose_is_written_where_its_user_was_registered_then_and_nowhere_else(played: Played, name: str) -> None:
    """The reference from its first pose on."""
    lines = played.lines
    first = lines[0]["t"]
    own = poses(played.recording / f"tracks/{name}.tum")[:, 0]
    said = {t: in_force(lines, t)["users"][name] for t in own if t >= first}
    registered = [t for t, user in said.items() if user["state"] == "registered" and user["x"] is not None]
    assert 0 < len(registered) < len(own)
    np.testing.assert_array_equal(poses(played.out / f"{name}.tum")[:, 0], own if name == "phone0" else registered)


@pytest.mark.parametrize("name", ["phone0", "phone1", "phone2"])
def test_a_pose_is_where_the_update_then_had_its_frame(played: Played, name: str) -> None:
    lines = played.lines
    own = {row[0]: row[1:] for row in poses(played.recording / f"tracks/{name}.tum")}
    for t, *pose in poses(played.out / f"{name}.tum"):
        user = in_force(lines, max(t, lines[0]["t"]))["users"][name]
        if user["x"] is None:  # the reference, before anything is solved: where its own SLAM has it
            np.testing.assert_allclose(pose, own[t], atol=1e-9)
            continue
        c, s = math.cos(user["yaw"]), math.sin(user["yaw"])
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        expected = user["scale"] * turn @ own[t][:3] + [user["x"], user["y"], user["z"]]
        np.testing.assert_allclose(pose[:3], expected, atol=1e-6)
        # The attitude's heading turns with the frame: q = (0, 0, sin, cos) q_own by half the yaw.
        qx, qy, qz, qw = own[t][3:]
        hs, hc = math.sin(0.5 * user["yaw"]), math.cos(0.5 * user["yaw"])
        turned = np.array([hc * qx - hs * qy, hc * qy + hs * qx, hc * qz + hs * qw, hc * qw - hs * qz])
        assert abs(turned @ pose[3:]) == pytest.approx(1.0, abs=1e-7)


def test_causal_tracks_come_near_the_truth(played: Played, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", str(played.recording), str(played.out), "--json"]) == 0
    errors = json.loads(capsys.readouterr().out)
    assert errors["missing"] == []
    assert max(errors["transfer_xy"].values()) < 0.6


def test_what_came_later_changes_nothing_that_was_known_before() -> None:
    recording, end = simulate(Scene(seconds=10.0, seed=2)).recording, 7.0
    before = Recording(
        recording.users,
        {name: _until(track, end) for name, track in recording.tracks.items()},
        recording.ranges.select(recording.ranges.t < end),
    )
    whole, first = replay(recording, "phone0"), replay(before, "phone0")
    assert len(first.updates) < len(whole.updates)
    # At its end a replay solves for all that came, due or not.
    for one, other in zip(whole.updates, first.updates[:-1], strict=False):
        assert (one.t, one.events) == (other.t, other.events)
        assert {name: user.state for name, user in one.users.items()} == {
            name: user.state for name, user in other.users.items()
        }
        assert {name: user.common_from_user for name, user in one.users.items()} == {
            name: user.common_from_user for name, user in other.users.items()
        }
    for name, track in first.tracks.items():
        assert len(track) > 0
        np.testing.assert_array_equal(track.position, whole.tracks[name].position[: len(track)])


def _until(track: Track, end: float) -> Track:
    kept = track.t < end
    return Track(track.t[kept], track.position[kept], track.quat_xyzw[kept])


def test_each_update_is_told_when_it_is_known() -> None:
    told: list[Any] = []
    replayed = replay(simulate(Scene(seconds=3.0)).recording, told=told.append)
    assert told == replayed.updates
    assert told


# The end


@pytest.mark.parametrize("recording", ["played", "beside_a_radio"])
def test_the_registration_is_what_was_known_last(recording: str, request: pytest.FixtureRequest) -> None:
    it = request.getfixturevalue(recording)
    said, last = it.registration, it.lines[-1]
    assert said.keys() == {"reference", "model", "method", "users", "alternatives", "ranges", "seconds", "findings"}
    assert said["findings"] == []
    assert (said["reference"], said["model"], said["method"]) == ("phone0", "full", "joint")
    assert said["users"].keys() == last["users"].keys()
    for name, user in said["users"].items():
        now = last["users"][name]
        assert user["state"] == now["state"]
        values = [[of[key] for key in PLACE if of[key] is not None] for of in (user, now)]
        np.testing.assert_allclose(values[0], values[1], atol=1e-9)
    assert sum(said["ranges"].values()) == len((it.recording / "ranges.csv").read_text().splitlines()) - 1
    assert said["ranges"]["used"] > 0
    assert said["seconds"]["load"] > 0.0


def test_json_alone_stands_on_standard_output_and_is_what_is_written(played: Played) -> None:
    assert played.told == ""
    assert played.printed.count("\n") == 1
    assert json.loads(played.printed, parse_constant=pytest.fail) == played.registration


def test_a_file_is_written_for_each_user_and_the_three_of_the_answer(played: Played, beside_a_radio: Played) -> None:
    answer = {"ranges.csv", "registration.json", "updates.jsonl"}
    assert {file.name for file in played.out.iterdir()} == answer | {"phone0.tum", "phone1.tum", "phone2.tum"}
    assert {file.name for file in beside_a_radio.out.iterdir()} >= answer | {"phone0.tum", "phone1.tum"}


def test_the_reference_can_be_chosen(walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keep_ranges(walk, lambda t: t < 2.0)
    assert main(["replay", str(walk), "--reference", "phone2", "--json", "--out", str(tmp_path / "out")]) == 0
    assert json.loads(capsys.readouterr().out)["reference"] == "phone2"
    assert {line["reference"] for line in read_updates(tmp_path / "out")} == {"phone2"}


def test_what_an_earlier_replay_wrote_of_a_user_that_is_now_never_registered_goes(
    played: Played, walk: Path, tmp_path: Path
) -> None:
    out = Path(shutil.copytree(played.out, tmp_path / "out"))
    keep_ranges(walk, lambda t: t < 1.5)
    assert main(["replay", str(walk), "--out", str(out)]) == 0
    lines = read_updates(out)
    assert max(line["t"] for line in lines) <= 1.5 + 1e-9
    assert all(line["users"][name]["state"] != "registered" for line in lines for name in ("phone1", "phone2"))
    assert not (out / "phone1.tum").exists()
    assert not (out / "phone2.tum").exists()


# Ranges that tell nothing


def _no_range(recording: Path) -> None:
    keep_ranges(recording, lambda _: False)


def _ranges_of_another_day(recording: Path) -> None:
    file = recording / "ranges.csv"
    header, *rows = (row.split(",", 1) for row in file.read_text().splitlines())
    file.write_text("\n".join([",".join(header), *(f"{float(t) + 86400.0},{rest}" for t, rest in rows)]) + "\n")


def _no_distance_that_can_be(recording: Path) -> None:
    file = recording / "ranges.csv"
    header, *rows = (row.split(",") for row in file.read_text().splitlines())
    column = header.index("range")
    lines = [",".join([*row[:column], "-6e5", *row[column + 1 :]]) for row in rows]
    file.write_text("\n".join([",".join(header), *lines]) + "\n")


@pytest.mark.parametrize("spoil", [_no_range, _ranges_of_another_day, _no_distance_that_can_be])
def test_without_a_usable_range_everybody_but_the_reference_is_disconnected(
    spoil: Any, walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spoil(walk)
    out = tmp_path / "out"
    assert main(["replay", str(walk), "--json", "--out", str(out)]) == 0
    printed, told = capsys.readouterr()
    said = json.loads(printed)
    assert told == ""
    assert np.isfinite(list(numbers(said))).all()
    assert said["users"]["phone0"]["state"] == "registered"
    for name in ("phone1", "phone2"):
        assert said["users"][name].items() >= {"state": "disconnected", **NOWHERE}.items()
    count = len((walk / "ranges.csv").read_text().splitlines()) - 1
    assert said["ranges"] == {"used": 0, "rejected": 0, "unusable": count}
    lines = read_updates(out)
    assert bool(lines) == bool(count)
    for line in lines:
        assert line["events"] == []
        for name in ("phone1", "phone2"):
            assert line["users"][name].items() >= {"state": "disconnected", **NOWHERE}.items()
    assert sorted(file.name for file in out.glob("*.tum")) in ([], ["phone0.tum"])


def test_a_user_that_nobody_ranges_to_stays_disconnected_and_has_no_file(walk: Path, tmp_path: Path) -> None:
    shutil.copy(walk / "tracks/phone1.tum", walk / "tracks/zoe.tum")
    keep_ranges(walk, lambda t: t < 4.0)
    out = tmp_path / "out"
    assert main(["replay", str(walk), "--out", str(out)]) == 0
    for line in read_updates(out):
        assert line["users"]["zoe"].items() >= {"state": "disconnected", "progress": 0.0, **NOWHERE}.items()
    assert not (out / "zoe.tum").exists()


# What cannot be done


def assert_one_line(err: str) -> None:
    assert err.startswith("synchronizar: ")
    assert err.endswith("\n")
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize("name", ["eve", "radio0"])
def test_a_reference_that_cannot_be_one_is_told(
    beside_a_radio: Played, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    out = tmp_path / "out"
    assert main(["replay", str(beside_a_radio.recording), "--reference", name, "--out", str(out)]) == 2
    printed, err = capsys.readouterr()
    assert printed == ""
    assert_one_line(err)
    assert err.startswith("synchronizar: --reference: ")
    assert f"'{name}'" in err
    assert not out.exists()


@pytest.mark.parametrize("place", [".", "tracks", "truth"])
def test_a_replay_never_overwrites_a_recording(walk: Path, capsys: pytest.CaptureFixture[str], place: str) -> None:
    before = {file: file.read_bytes() for file in walk.rglob("*.*")}
    assert main(["replay", str(walk), "--out", str(walk / place)]) == 2
    assert_one_line(capsys.readouterr().err)
    assert before == {file: file.read_bytes() for file in walk.rglob("*.*")}


@pytest.mark.parametrize("in_the_way", ["updates.jsonl", "phone2.tum", "registration.json"])
def test_what_cannot_be_written_is_told_in_one_line(
    walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], in_the_way: str
) -> None:
    keep_ranges(walk, lambda t: t < 0.3)
    (tmp_path / "out" / in_the_way).mkdir(parents=True)
    assert main(["replay", str(walk), "--json", "--out", str(tmp_path / "out")]) == 2
    printed, err = capsys.readouterr()
    assert printed == ""
    assert_one_line(err)
    assert in_the_way in err


# The live view


def test_a_terminal_is_shown_events_and_everybodys_progress_and_nothing_else_is_printed(
    walk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    keep_ranges(walk, lambda t: t < 3.5)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["replay", str(walk), "--json"]) == 0
    printed, told = capsys.readouterr()
    json.loads(printed)
    assert "phone1: unobservable: " in told
    assert "phone0 ████████" in told
    assert "phone2 ░░░░░░░░" in told


def test_slam_that_jumps_in_height_leaves_everybodys_height_where_it_was() -> None:
    """Windows that begin after the jump too: heights are about the origins as they were."""
    simulation = simulate(Scene(users=3, seconds=45.0, seed=2))
    tracks = dict(simulation.recording.tracks)
    jumped = tracks["phone0"]
    up = np.where(jumped.t > 15.0, 1.5, 0.0)
    tracks["phone0"] = replace(jumped, position=jumped.position + up[:, None] * np.array([0.0, 0.0, 1.0]))
    played = replay(replace(simulation.recording, tracks=tracks), "phone0")
    for name in ("phone1", "phone2"):
        user = played.registration.users[name]
        assert user.state is State.REGISTERED
        assert user.common_from_user is not None
        true = simulation.world_from_user["phone0"].inverse() @ simulation.world_from_user[name]
        last = tracks[name].position[-1]
        assert abs((user.common_from_user @ last - true @ last)[2]) < 0.3
