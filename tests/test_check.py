"""`synchronizar check`: what it prints, its exit status, and recordings that `register` refuses."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.broken import BROKEN, Broken, write_good

from synchronizar.cli import main
from synchronizar.data.findings import Code
from synchronizar.data.recording import Recording
from synchronizar.diagnosis.summary import summary_of
from synchronizar.parameters import Parameters
from synchronizar.reporting.check import check_table
from synchronizar.simulation.simulate import Scene, simulate


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    simulate(Scene(users=3, seconds=15.0, seed=4)).save(tmp_path / "walk")
    return tmp_path / "walk"


def checked(folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, Any], str]:
    """Exit status, the JSON object, and what was said on stderr."""
    status = main(["check", str(folder), "--json"])
    out, err = capsys.readouterr()
    return status, json.loads(out), err


def codes(answer: dict[str, Any]) -> list[tuple[str, str | None]]:
    return [(finding["code"], finding["user"]) for finding in answer["findings"]]


def edited(file: Path, change: Callable[[str], str]) -> None:
    file.write_text(change(file.read_text()))


def each_row(change: Callable[[list[str]], list[str]], by: str | None = None) -> Callable[[str], str]:
    """The change made to the values of every line but a header."""
    joint = by or " "

    def edit(text: str) -> str:
        return "".join(
            line if line[:1].isalpha() else joint.join(change(line.split(by))) + "\n"
            for line in (one + "\n" for one in text.splitlines())
        )

    return edit


def test_of_a_clean_walk_there_is_a_table_and_nothing_looks_wrong(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", str(folder)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["user", "poses", "Hz", "extent", "(m)", "ranges", "place", "known"]
    assert re.match(r"phone0\s+452\s+30\.0\s+\d\.\d\d\s+\d+\s+100%$", lines[1])
    assert lines[-1] == "nothing looks wrong"


def test_the_json_has_what_was_counted(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, answer, err = checked(folder, capsys)
    assert (status, answer["findings"], answer["refused"], err) == (0, [], None, "")
    rows = (folder / "ranges.csv").read_text().splitlines()[1:]
    assert answer["ranges"]["count"] == len(rows)
    pair = sum(row.split(",")[1:3] == ["phone0", "phone1"] for row in rows)
    assert answer["ranges"]["pairs"][0] == {"a": "phone0", "b": "phone1"} | {
        key: answer["ranges"]["pairs"][0][key] for key in ("ranges", "usable", "rate", "median")
    }
    assert answer["ranges"]["pairs"][0]["ranges"] == pair
    assert answer["users"]["phone1"]["poses"] == len((folder / "tracks/phone1.tum").read_text().splitlines())


def test_a_column_that_nobody_reads_is_told_by_check_and_once_by_register(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = (folder / "ranges.csv").read_text().splitlines()
    text = [lines[0] + ",variance", *(line + ",0.01" for line in lines[1:])]
    (folder / "ranges.csv").write_text("\n".join(text) + "\n")
    status, answer, _ = checked(folder, capsys)
    assert (status, codes(answer)) == (1, [("unknown-column", None)])
    assert "square root as a column sigma" in answer["findings"][0]["remedy"]
    assert main(["register", str(folder), "--json"]) == 0
    out, err = capsys.readouterr()
    assert err.count("'variance'") == 1
    assert codes(json.loads(out)) == [("unknown-column", None)]


def test_a_radio_that_only_ranges_name_is_told_to_be_static(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with (folder / "ranges.csv").open("a") as file:
        file.writelines(f"{0.1 * k},phone0,A7,3.2\n" for k in range(40))
    status, answer, err = checked(folder, capsys)
    assert (status, codes(answer)) == (2, [("unknown-user", "A7")])
    assert "static = true" in answer["findings"][0]["remedy"]
    assert answer["findings"][0]["message"].startswith("40 ranges")
    assert "'A7'" in err
    assert "'A7'" in answer["refused"]
    assert err.count("\n") == 1


def test_a_name_that_is_nearly_a_users_is_told_as_a_slip(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edited(folder / "ranges.csv", lambda text: text.replace("phone1", "Phone1"))
    _, answer, _ = checked(folder, capsys)
    finding = next(f for f in answer["findings"] if f["code"] == "unknown-user")
    assert finding["remedy"] == "call it phone1 in ranges.csv"


def test_a_setting_that_nobody_reads_is_told(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with (folder / "recording.toml").open("a") as file:
        file.write("\n[users.phone1]\nhight_sigma = 0.4\n")
    status, answer, _ = checked(folder, capsys)
    assert (status, codes(answer)) == (2, [("unknown-setting", "phone1")])
    assert answer["findings"][0]["remedy"] == "call it height_sigma"


@pytest.mark.parametrize(("unit", "power"), [("milliseconds", 3), ("microseconds", 6), ("nanoseconds", 9)])
def test_stamps_that_register_refuses_for_their_size_are_told_by_unit(
    unit: str, power: int, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def since_1970(stamp: str) -> str:
        return f"{(1_700_000_000 + float(stamp)) * 10**power:.0f}"

    for track in (folder / "tracks").glob("*.tum"):
        edited(track, each_row(lambda v: [since_1970(v[0]), *v[1:]]))
    edited(folder / "ranges.csv", each_row(lambda v: [since_1970(v[0]), *v[1:]], ","))
    status, answer, _ = checked(folder, capsys)
    assert status == 2
    assert codes(answer) == [("time-unit", f"phone{n}") for n in range(3)] + [("time-unit", None)]
    assert all(unit in finding["message"] for finding in answer["findings"])


def test_y_up_is_told_from_the_files(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    simulate(Scene(users=3, seconds=15.0, seed=4, up="y")).save(folder)
    edited(folder / "recording.toml", lambda text: text.replace('up = "y"', 'up = "z"'))
    status, answer, _ = checked(folder, capsys)
    assert (status, codes(answer)) == (1, [("up-axis", f"phone{n}") for n in range(3)])
    assert 'up = "y"' in answer["findings"][0]["remedy"]


def test_z_up_that_is_said_to_be_y_up_is_told_from_the_files(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edited(folder / "recording.toml", lambda text: text.replace('up = "z"', 'up = "y"'))
    status, answer, _ = checked(folder, capsys)
    assert (status, codes(answer)) == (1, [("up-axis", f"phone{n}") for n in range(3)])
    assert answer["findings"][0]["message"].startswith("its z axis is likely vertical, not y")
    assert 'up = "z"' in answer["findings"][0]["remedy"]


def test_numbers_that_are_no_distances_are_counted_and_shown(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with (folder / "ranges.csv").open("a") as file:
        file.write("3.0,phone0,phone1,-6000000\n4.0,phone0,phone2,5000000\n")
    status, answer, _ = checked(folder, capsys)
    assert (status, codes(answer)) == (0, [])
    ranges = answer["ranges"]
    assert (ranges["no_distance"], ranges["shortest"], ranges["longest"]) == (2, -6e6, 5e6)
    assert ranges["usable"] == ranges["count"] - 2
    table = check_table(summary_of(Recording.load(folder), Parameters()), (), refused=False)
    shown = f"2 of {ranges['count']} ranges are no possible distances and not used (they go from -6e+06 m to 5e+06 m)"
    assert shown in table.splitlines()


def test_nothing_is_written(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def state() -> dict[Path, tuple[bytes, int]]:
        return {f: (f.read_bytes(), f.stat().st_mtime_ns) for f in folder.rglob("*") if f.is_file()}

    before = state()
    checked(folder, capsys)
    assert state() == before


@pytest.mark.parametrize("broken", BROKEN, ids=lambda broken: broken.sentence)
def test_whatever_a_recording_is_like_check_ends_with_a_status_that_register_agrees_with(
    broken: Broken, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "walk"
    write_good(folder)
    broken.build(folder)
    status = main(["check", str(folder), "--json"])
    out, err = capsys.readouterr()
    assert status in ((0, 1) if broken.fault is None else (2,))
    answer = json.loads(out)
    assert {finding["code"] for finding in answer["findings"]} <= set(Code)
    if status == 2:
        assert err.count("\n") == 1
        assert answer["refused"]
