from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from synchronizar.cli import main
from synchronizar.data.recording import Recording
from synchronizar.io.registration_folder import range_counts
from synchronizar.io.registration_reader import read_registration

pytest.importorskip("rerun", reason="the extra `rerun` is not installed")


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rerun") / "walk"
    assert main(["simulate", str(folder), "--users", "2", "--seconds", "8", "--static-radios", "1", "--seed", "2"]) == 0
    assert main(["replay", str(folder), "--out", str(folder.parent / "live")]) == 0
    assert main(["register", str(folder), "--out", str(folder.parent / "answer")]) == 0
    return folder


def rerun(*arguments: str) -> str:
    run = [sys.executable, "-m", "rerun", "rrd", *arguments]
    done = subprocess.run(run, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def entities(file: Path) -> set[str]:
    return set(re.findall(r"^(/\S+): \d+", rerun("stats", str(file)), re.MULTILINE))


def test_rerun_verifies_a_recording_an_answer_and_a_replay(walk: Path) -> None:
    bare, answer, live = (walk.parent / f"{name}.rrd" for name in ("bare", "answer", "live"))
    assert main(["convert", str(walk), str(bare)]) == 0
    assert main(["convert", str(walk), str(answer), "--answer", str(walk.parent / "answer")]) == 0
    assert main(["plot", "--rerun", str(walk), str(walk.parent / "live")]) == 0
    (walk.parent / "live" / "answer.rrd").rename(live)
    assert "3 files verified without error" in rerun("verify", *map(str, (bare, answer, live)))
    tracks = {f"/{what}/phone{k}" for what in ("world", "tracks") for k in range(2)}
    assert tracks <= entities(bare)
    regions = {"/regions/phone0", "/regions/phone1", "/regions/radio0"}
    assert tracks | regions | {"/world/radio0", "/ranges", "/residuals/used"} <= entities(answer)
    assert {f"/{what}/phone1" for what in ("sigma", "progress", "states")} | {"/events"} <= entities(live)


def test_every_used_range_has_its_residual_in_the_file(walk: Path) -> None:
    file = walk.parent / "counted.rrd"
    assert main(["convert", str(walk), str(file), "--answer", str(walk.parent / "answer")]) == 0
    registration, _ = read_registration(walk.parent / "answer", Recording.load(walk))
    used = range_counts(registration.ranges)["used"]
    rows = re.findall(r"with (\d+) rows [^\n]* - /residuals/used ", rerun("print", str(file)))
    assert sum(map(int, rows)) == used
