from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.broken import BROKEN, Broken, write_good
from support.paths import REPOSITORY

import synchronizar as sz
from synchronizar.cli import main
from synchronizar.cli.terminal import bar_of, live_line
from synchronizar.data.registration import State
from synchronizar.data.updates import Update, UserUpdate
from synchronizar.estimation import register as pipeline
from synchronizar.simulation.scene import Scene

ROOT = REPOSITORY
SILENT = {"state": "disconnected", "x": None, "y": None, "z": None, "yaw": None, "covariance": None}

Run = subprocess.CompletedProcess[str]


def run(*argv: str | Path, **settings: Any) -> Run:
    """The command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "synchronizar", *map(str, argv)], cwd=ROOT, capture_output=True, text=True, **settings
    )


def simulated(folder: Path, *options: str) -> Path:
    assert main(["simulate", str(folder), *options]) == 0
    return folder


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three walkers and a radio, which nobody may change."""
    return simulated(tmp_path_factory.mktemp("cli") / "walk", "--users", "3", "--static-radios", "1", "--seed", "1")


def registered(recording: Path, capsys: pytest.CaptureFixture[str], *options: str) -> dict[str, Any]:
    """The one JSON object that `register --json` prints."""
    capsys.readouterr()
    assert main(["register", str(recording), "--json", *options]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    return dict(json.loads(out, parse_constant=pytest.fail))


def numbers(said: object) -> Iterator[float]:
    if isinstance(said, dict):
        said = list(said.values())
    if isinstance(said, list):
        for part in said:
            yield from numbers(part)
    elif isinstance(said, float):
        yield said


def assert_one_line(err: str) -> None:
    assert err.startswith("synchronizar: ")
    assert err.endswith("\n")
    assert len(err.splitlines()) == 1


# The whole way


def test_a_walk_is_simulated_registered_evaluated_and_drawn(tmp_path: Path) -> None:
    recording, out = tmp_path / "walk", tmp_path / "answer"
    made = run("simulate", recording, "--users", "3", "--seed", "4", "--late-share", "0.2")
    assert (made.returncode, made.stderr) == (0, "")
    assert made.stdout.startswith(f"{recording}: 3 users, ")

    found = run("register", recording, "--out", out)
    assert (found.returncode, found.stderr) == (0, "")
    assert [line.split()[0] for line in found.stdout.splitlines()] == ["user", "phone0", "phone1", "phone2", "ranges:"]

    compared = run("evaluate", recording, out)
    assert (compared.returncode, compared.stderr) == (0, "")
    assert compared.stdout.splitlines()[1].startswith("all together")

    drawn = run("plot", recording, out)
    assert (drawn.returncode, drawn.stderr) == (0, "")
    assert drawn.stdout.splitlines() == [str(out / name) for name in ("picture.png", "devices.png")]
    assert all((out / name).stat().st_size > 0 for name in ("picture.png", "devices.png"))


def test_json_alone_stands_on_standard_output_and_is_what_is_written(walk: Path, tmp_path: Path) -> None:
    printed = run("register", walk, "--json", "--out", tmp_path)
    assert (printed.returncode, printed.stderr) == (0, "")
    assert json.loads(printed.stdout) == json.loads((tmp_path / "registration.json").read_text())


def test_the_installed_command_is_this_one() -> None:
    assert 'synchronizar = "synchronizar.cli:main"' in (ROOT / "pyproject.toml").read_text()


def test_help_names_every_command() -> None:
    told = run("--help")
    assert told.returncode == 0
    assert all(c in told.stdout for c in ("register", "replay", "evaluate", "check", "simulate", "plot"))


def test_the_version_is_that_of_the_package() -> None:
    told = run("--version")
    assert (told.returncode, told.stdout) == (0, f"synchronizar {sz.__version__}\n")


@pytest.mark.parametrize("command", ["register", "replay", "evaluate", "simulate", "plot"])
def test_the_help_of_a_command_has_an_example(command: str) -> None:
    told = " ".join(run(command, "--help").stdout.split())
    assert f"example: synchronizar {command} walk/" in told
    if command in ("register", "replay"):
        assert "the first by name that is not static and moves" in told


def test_a_walk_of_others_is_replaced_by_force_alone(tmp_path: Path) -> None:
    assert run("simulate", tmp_path, "--users", "3", "--seconds", "2").returncode == 0
    refused = run("simulate", tmp_path, "--seconds", "2")
    assert refused.returncode == 2
    assert "phone2 is not in the scene to be saved (--force removes it)" in refused.stderr
    assert run("simulate", tmp_path, "--seconds", "2", "--force").returncode == 0
    assert sorted(file.name for file in tmp_path.rglob("*.tum")) == ["phone0.tum"] * 2 + ["phone1.tum"] * 2


@pytest.mark.parametrize("users", [2, 5, 30])
def test_the_live_line_fits_its_columns(users: int) -> None:
    nobody = {f"phone{u:02d}": UserUpdate(State.DISCONNECTED, None, None, u / users, False, None) for u in range(users)}
    line = live_line(Update(3.0, 0.0, nobody, []), 3.0, 79)
    assert len(line) <= 79
    assert ("█" in line) == (users == 2)
    assert f"phone{users - 1:02d}" in line


# What register writes


def test_the_keys_are_those_of_the_contract(walk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = registered(walk, capsys)
    assert said.keys() == {"reference", "model", "method", "users", "alternatives", "ranges", "findings", "seconds"}
    assert (said["reference"], said["model"], said["method"]) == ("phone0", "full", "joint")
    assert list(said["users"]) == ["phone0", "phone1", "phone2", "radio0"]
    for name, user in said["users"].items():
        assert user.keys() >= {"state", "x", "y", "z", "yaw", "covariance", "scale", "range_bias", "clock_offset"}
        assert user["state"] in ("registered", "ambiguous", "unobservable", "disconnected")
        assert np.shape(user["covariance"]) == (4, 4)
        assert (user["yaw"] is None) == (name == "radio0")
        assert isinstance(user["prior_dominated"], list)
    assert said["users"]["phone0"]["state"] == "registered"
    assert said["ranges"].keys() == {"used", "rejected", "unusable"}
    assert sum(said["ranges"].values()) == len((walk / "ranges.csv").read_text().splitlines()) - 1
    assert said["seconds"].keys() == {"load", "initialise", "solve"}
    assert said["seconds"]["load"] > 0.0


def test_a_pose_is_written_for_each_that_was_read(walk: Path, tmp_path: Path) -> None:
    assert main(["register", str(walk), "--out", str(tmp_path)]) == 0
    said = json.loads((tmp_path / "registration.json").read_text())
    for name in ("phone0", "phone1", "phone2"):
        own, common = np.loadtxt(walk / f"tracks/{name}.tum"), np.loadtxt(tmp_path / f"{name}.tum")
        np.testing.assert_array_equal(common[:, 0], own[:, 0])
        x, y, z, yaw, scale = (said["users"][name][key] for key in ("x", "y", "z", "yaw", "scale"))
        turn = np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
        np.testing.assert_allclose(common[-1, 1:4], scale * own[-1, 1:4] @ turn.T + [x, y, z], atol=1e-6)
    radio = np.loadtxt(tmp_path / "radio0.tum", ndmin=2)
    assert radio.shape == (1, 8)
    assert radio[0, 0] == 0.0
    written = (tmp_path / "ranges.csv").read_text().splitlines()
    assert written[0] == "t,a,b,range,residual,weight,verdict"
    assert len(written) == len((walk / "ranges.csv").read_text().splitlines())


def test_the_reference_can_be_chosen(walk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = registered(walk, capsys, "--reference", "phone2", "--model", "rigid", "--method", "joint")
    assert said["reference"] == "phone2"
    assert [said["users"]["phone2"][key] for key in ("x", "y", "z", "yaw")] == [0.0] * 4


@pytest.mark.parametrize("name", ["eve", "radio0"])
def test_a_reference_that_cannot_be_one_is_told(walk: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    assert main(["register", str(walk), "--reference", name]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert_one_line(err)
    assert err.startswith("synchronizar: --reference: ")
    assert f"'{name}'" in err


# Recordings of many kinds


def test_y_up_is_read_as_z_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ("--seed", "2", "--antennas", "2")
    z_up = registered(simulated(tmp_path / "z", *options), capsys)
    y_up = registered(simulated(tmp_path / "y", *options, "--up", "y"), capsys)
    place = ("x", "y", "z", "yaw")
    for name, user in z_up["users"].items():
        assert y_up["users"][name]["state"] == user["state"]
        np.testing.assert_allclose([y_up["users"][name][k] for k in place], [user[k] for k in place], atol=1e-5)


@pytest.mark.parametrize(
    "options",
    [
        ("--users", "3", "--late-joiners", "1", "--seconds", "20"),
        ("--users", "2", "--antennas", "3"),
        ("--users", "4", "--links", "star"),
        ("--users", "3", "--links", "chain", "--seconds", "20"),
        ("--users", "2", "--static-radios", "3"),
    ],
    ids=["a late joiner", "several antennas", "a star", "a pair that never ranges", "static radios"],
)
def test_a_clean_walk_ends_near_the_truth(
    options: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, out = simulated(tmp_path / "walk", *options, "--seed", "6"), tmp_path / "answer"
    said = registered(recording, capsys, "--out", str(out))
    assert main(["evaluate", str(recording), str(out), "--json"]) == 0
    errors = json.loads(capsys.readouterr().out)
    assert errors["missing"] == []
    for name, error in errors["transfer_xy"].items():
        assert said["users"][name]["state"] != "disconnected"
        assert error < 0.6 or said["users"][name]["state"] != "registered"
    assert sum(user["state"] == "registered" for user in said["users"].values()) >= len(said["users"]) / 2


def test_a_device_without_ranges_is_disconnected_and_has_no_file(
    walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, out = Path(shutil.copytree(walk, tmp_path / "walk")), tmp_path / "answer"
    out.mkdir()
    (out / "zoe.tum").write_text("0 0 0 0 0 0 0 1\n")
    shutil.copy(recording / "tracks/phone1.tum", recording / "tracks/zoe.tum")
    said = registered(recording, capsys, "--out", str(out))
    assert said["users"]["zoe"].items() >= SILENT.items()
    assert sorted(file.name for file in out.iterdir()) == [
        "phone0.tum",
        "phone1.tum",
        "phone2.tum",
        "radio0.tum",
        "ranges.csv",
        "registration.json",
    ]
    assert main(["plot", str(recording), str(out)]) == 0


def test_without_any_range_everybody_but_the_reference_is_disconnected(
    walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, out = Path(shutil.copytree(walk, tmp_path / "walk")), tmp_path / "answer"
    (recording / "ranges.csv").write_text("t,a,b,range\n")
    said = registered(recording, capsys, "--out", str(out))
    assert said["users"]["phone0"]["state"] == "registered"
    assert all(said["users"][name].items() >= SILENT.items() for name in ("phone1", "phone2", "radio0"))
    assert said["ranges"] == {"used": 0, "rejected": 0, "unusable": 0}
    assert main(["plot", str(recording), str(out)]) == 0


@pytest.mark.parametrize("broken", BROKEN, ids=lambda broken: broken.sentence)
def test_a_broken_recording_is_told_in_one_line_or_answered_in_finite_numbers(
    broken: Broken, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = tmp_path / "walk", tmp_path / "answer"
    write_good(folder)
    broken.build(folder)
    status = main(["register", str(folder), "--out", str(out), "--json"])
    printed, err = capsys.readouterr()
    if broken.fault is not None:
        assert status == 2
        assert printed == ""
        assert_one_line(err)
        assert broken.fault.words in err
        assert not out.exists()
    elif status == 2:
        # It reads well, but nobody in it can be the reference.
        assert_one_line(err)
    else:
        assert status == 0
        said = json.loads(printed)
        unread = [finding for finding in said["findings"] if finding["code"] == "unknown-column"]
        assert err.count("\n") == len(unread)
        assert all(finding["message"] in err for finding in unread)
        assert np.isfinite(list(numbers(said))).all()
        assert said == json.loads((out / "registration.json").read_text())


def test_a_column_that_is_not_read_is_named_by_every_command_that_reads_it(
    walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, out = Path(shutil.copytree(walk, tmp_path / "walk")), tmp_path / "answer"
    header, *rows = (recording / "ranges.csv").read_text().splitlines()
    (recording / "ranges.csv").write_text("\n".join([f"{header},mood", *(f"{row},glad" for row in rows)]) + "\n")
    for argv in (
        ["register", recording, "--out", out],
        ["plot", recording, out],
        ["convert", recording, out / "w.mcap"],
    ):
        assert main([str(word) for word in argv]) == 0
        err = capsys.readouterr().err
        assert_one_line(err)
        assert "'mood'" in err


# What cannot be done


@pytest.mark.parametrize(
    ("argv", "line"),
    [
        ([], "the following arguments are required: COMMAND"),
        (["dance"], "COMMAND: invalid choice: 'dance'"),
        (["register"], "the following arguments are required: RECORDING"),
        (["register", "walk", "--model", "magic"], "--model: invalid choice: 'magic'"),
        (["register", "walk", "--method", "pairs"], "--method: invalid choice: 'pairs'"),
        (["register", "walk", "--ref", "bob"], "unrecognized arguments: --ref bob"),
        (["register", "walk", "--out"], "--out: expected one argument"),
        (["register", "no/such/walk"], "no/such/walk: No such file or directory"),
        (["evaluate", "walk"], "the following arguments are required: DIR"),
        (["plot", "no/such/walk", "x"], "no/such/walk: No such file or directory"),
        (["simulate", "x", "--users", "two"], "--users: invalid int value: 'two'"),
        (["simulate", "x", "--users", "1"], "--users: must be a number of at least 2, not 1"),
        (["simulate", "x", "--late-share", "nan"], "--late-share: must be between 0 and 1, not nan"),
        (["simulate", "x", "--walk", "line,fly"], "--walk: 'fly' is none of free, line, still"),
        (["simulate", "x\ny", "--seconds", "0"], "--seconds: must be a number above 0, not 0.0"),
    ],
)
def test_a_bad_option_is_told_in_one_line(argv: list[str], line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(argv) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert_one_line(err)
    assert err.startswith(f"synchronizar: {line}")


@pytest.mark.parametrize("place", [".", "tracks", "truth", "tracks/deeper", "../walk", "../link"])
def test_an_answer_never_overwrites_a_recording(
    walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], place: str
) -> None:
    recording = Path(shutil.copytree(walk, tmp_path / "walk"))
    (tmp_path / "link").symlink_to(recording / "truth")
    before = {file: file.read_bytes() for file in recording.rglob("*.*")}
    assert main(["register", str(walk), "--out", str(recording / place)]) == 2
    assert_one_line(capsys.readouterr().err)
    assert before == {file: file.read_bytes() for file in recording.rglob("*.*")}


def test_an_answer_may_stand_in_a_folder_of_the_recording_or_among_recordings(walk: Path, tmp_path: Path) -> None:
    recording = Path(shutil.copytree(walk, tmp_path / "tracks/walk"))
    for out in (recording / "answer", tmp_path / "tracks/answer", recording / "answer"):
        assert main(["register", str(recording), "--out", str(out)]) == 0


def test_a_place_that_cannot_be_written_to_is_told(
    walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    assert main(["register", str(walk), "--out", str(tmp_path / "file/answer")]) == 2
    assert main(["simulate", str(tmp_path / "file")]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert [line.split(": ")[0] for line in err.splitlines()] == ["synchronizar"] * 2


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
def test_a_full_disk_behind_standard_output_is_told(walk: Path) -> None:
    with Path("/dev/full").open("w") as full:
        told = subprocess.run(
            [sys.executable, "-m", "synchronizar", "register", walk],
            cwd=ROOT,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert told.returncode == 2
    assert told.stderr == "synchronizar: standard output: No space left on device\n"


def test_a_reader_that_goes_away_is_no_fault(walk: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    told = subprocess.run(
        [sys.executable, "-m", "synchronizar", "register", walk],
        cwd=ROOT,
        stdout=writer,
        stderr=subprocess.PIPE,
        text=True,
    )
    os.close(writer)
    assert told.returncode == 141
    assert told.stderr == ""


def test_a_terminal_that_knows_no_letters_but_ascii_is_served(walk: Path) -> None:
    told = run("register", walk, env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert (told.returncode, told.stderr) == (0, "")


def raising(error: BaseException) -> Any:
    def raise_it(*_: object, **__: object) -> None:
        raise error

    return raise_it


def test_an_interrupt_ends_it_quietly(
    walk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(pipeline, "register", raising(KeyboardInterrupt()))
    assert main(["register", str(walk)]) == 130
    assert capsys.readouterr() == ("", "")


def test_what_gtsam_throws_is_told_in_one_line(
    walk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(pipeline, "register", raising(RuntimeError("\nIndeterminant linear system\nnear variable 3")))
    assert main(["register", str(walk)]) == 2
    err = capsys.readouterr().err
    assert_one_line(err)
    assert err == f"synchronizar: {walk}: cannot be solved: Indeterminant linear system near variable 3\n"


@pytest.mark.parametrize("error", [ValueError("a bug"), RecursionError("a bug"), NotImplementedError("a bug")])
def test_a_fault_of_the_program_is_not_hidden(walk: Path, monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    monkeypatch.setattr(pipeline, "register", raising(error))
    with pytest.raises(type(error), match="a bug"):
        main(["register", str(walk)])


def test_progress_is_told_to_a_terminal_alone(
    walk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    assert main(["register", str(walk), "--json"]) == 0
    out, err = capsys.readouterr()
    json.loads(out)
    assert err.startswith(f"loading {walk} ...\n")


def test_a_bar_shows_how_far_long_work_has_come(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with bar_of(4, 280) as progress:
        assert progress is not None
        time.sleep(1.1)
        for share in (0.1, 0.5, 0.4, 1.0):
            progress(share)
    shown = capsys.readouterr().err.split("\r")
    assert any("registering 4 users, 280 ranges" in line and "%" in line for line in shown)
    assert max(map(len, shown)) <= 80
    monkeypatch.setattr("sys.stderr.isatty", lambda: False)
    with bar_of(4, 280) as progress:
        assert progress is None


# Simulated and evaluated


def test_every_setting_of_a_scene_is_an_option_that_tells_what_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["simulate", "--help"])
    assert left.value.code == 0
    told = " ".join(capsys.readouterr().out.split())
    for field in fields(Scene):
        assert f" --{field.name.replace('_', '-')}" in told
    assert "--late-share X 0 to 1: expected share of ranges without line of sight" in told
    assert "each user moves, cycled: free from one random place to the next, line to and fro, still. [free]" in told


def test_the_same_options_make_the_same_walk(tmp_path: Path) -> None:
    one = simulated(tmp_path / "one", "--walk", "free,line", "--rate-hz", "5", "--power")
    two = simulated(tmp_path / "two", "--walk", "free,line", "--rate-hz", "5", "--power")
    other = simulated(tmp_path / "other", "--walk", "free,line", "--rate-hz", "5", "--power", "--seed", "1")
    assert (one / "ranges.csv").read_text() == (two / "ranges.csv").read_text()
    assert (one / "ranges.csv").read_text() != (other / "ranges.csv").read_text()
    header = (one / "ranges.csv").read_text().splitlines()[0]
    assert header.endswith("rx_power,fp_power")


def test_evaluation_has_the_keys_of_the_contract(
    walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["register", str(walk), "--out", str(tmp_path)]) == 0
    (tmp_path / "phone2.tum").unlink()
    capsys.readouterr()
    assert main(["evaluate", str(walk), str(tmp_path), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    per_user = {"transfer", "transfer_xy", "yaw"}
    overall = {"joint_ate", "joint_ate_xy", "reference_ate", "reference_ate_xy"}
    assert said.keys() == overall | per_user | {"missing"}
    assert all(said[key].keys() == {"phone1", "radio0"} for key in per_user)
    assert said["missing"] == ["phone2"]

    assert main(["evaluate", str(walk), str(tmp_path)]) == 0
    table = capsys.readouterr().out.splitlines()
    assert len({len(line) for line in table[:-1]}) == 1
    assert table[3].split()[0] == "phone1"
    assert float(table[3].split()[-3]) == pytest.approx(said["transfer"]["phone1"], abs=5e-4)
    assert float(table[3].split()[-1]) == pytest.approx(math.degrees(said["yaw"]["phone1"]), abs=5e-3)
    assert table[-1] == "no estimate of phone2"


def test_a_recording_without_truth_cannot_be_evaluated(
    walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = Path(shutil.copytree(walk, tmp_path / "walk", ignore=shutil.ignore_patterns("truth")))
    assert main(["evaluate", str(recording), str(tmp_path)]) == 2
    err = capsys.readouterr().err
    assert_one_line(err)
    assert err.startswith(f"synchronizar: {recording / 'truth'}: No such file or directory; errors are told where")


def test_what_is_not_there_is_told_with_the_command_that_makes_it(
    walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, nowhere = tmp_path / "walk.bag", tmp_path / "nowhere"
    bag.touch()
    for argv, remedy in (
        (["register", bag], "`synchronizar convert` makes one"),
        (["check", tmp_path], "`synchronizar convert` makes one"),
        (["plot", walk, nowhere], f"`synchronizar register RECORDING --out {nowhere}` writes it"),
        (["evaluate", walk, nowhere], f"`synchronizar register {walk} --out {nowhere}` writes it"),
        (["register", walk, "--reference", "bob"], "there are phone0, phone1"),
    ):
        assert main([str(word) for word in argv]) == 2
        err = capsys.readouterr().err
        assert_one_line(err)
        assert remedy in err


def test_the_truth_is_not_read_by_register_or_plot(walk: Path, tmp_path: Path) -> None:
    recording = Path(shutil.copytree(walk, tmp_path / "walk"))
    for file in (recording / "truth").iterdir():
        file.write_text("no truth")
    assert main(["register", str(recording), "--out", str(tmp_path / "answer")]) == 0
    assert main(["plot", str(recording), str(tmp_path / "answer")]) == 0
