"""What is added to a recording, and what of it stays as it was."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.bags import walk

from synchronizar.cli import main
from synchronizar.convert import saving
from synchronizar.data.ranges import SOURCES
from synchronizar.data.recording import Recording
from synchronizar.errors import InputError

SETTINGS = """[users.A1]
static = true
position = [1.0, 2.0, 3.0]
range_bias = 0.1

[users.alice]
height_sigma = 0.5
up = "y"
antennas.left = [0.1, 0.2, 0.0]
"""


def write_track(path: Path, table: Any) -> None:
    np.savetxt(path, table, fmt="%.9f")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A recording of alice and a surveyed radio, with truth, a column of another program and a file of the user's."""
    folder = tmp_path / "walk"
    for name in ("tracks", "truth"):
        (folder / name).mkdir(parents=True)
        write_track(folder / name / "alice.tum", walk())
    (folder / "ranges.csv").write_text("t,a,b,range,antenna_a,source,firmware\n1000.5,alice,A1,2.5,left,module,7\n")
    (folder / "recording.toml").write_text(SETTINGS)
    (folder / "notes.txt").write_text("in the hall")
    return folder


def test_what_a_recording_says_stays_where_something_is_added(tmp_path: Path, folder: Path) -> None:
    before = {user.name: user for user in Recording.load(folder).users}
    log = tmp_path / "bob.log"
    log.write_text("".join(f"{1000.0 + k} DIST,1,AN0,A1,0,0,-9999,{2.0 + k}\n" for k in range(3)))
    write_track(tmp_path / "bob.tum", walk(phase=1.0))
    for added in ("bob.tum", "bob.log"):
        assert main(["convert", str(tmp_path / added), str(folder), "--add"]) == 0
    made = Recording.load(folder)
    after = {user.name: user for user in made.users}
    assert after.keys() == {"A1", "alice", "bob"}
    assert {name: after[name] for name in before} == before
    assert made.ranges.source.tolist() == [-1, SOURCES.index("module"), -1, -1]
    np.testing.assert_allclose(np.loadtxt(folder / "tracks" / "alice.tum"), walk(), atol=1e-8)
    np.testing.assert_allclose(np.loadtxt(folder / "truth" / "alice.tum"), walk(), atol=1e-8)
    assert (folder / "notes.txt").read_text() == "in the hall"


def test_what_is_left_out_when_something_is_added_is_told(
    tmp_path: Path, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_track(tmp_path / "bob.tum", np.vstack([walk(phase=1.0), np.full(8, np.nan)]))
    assert main(["convert", str(tmp_path / "bob.tum"), str(folder), "--add"]) == 0
    told = capsys.readouterr().out
    assert "1 of 21 poses of bob's track are no poses and left out" in told
    assert "has a column 'firmware', which is not read, and is left out" in told


def test_a_track_in_other_axes_replaces_the_old_one_and_truth_follows(tmp_path: Path, folder: Path) -> None:
    before = Recording.load(folder).tracks["alice"]
    table = np.column_stack([before.t, before.position, before.quat_xyzw])
    write_track(tmp_path / "alice.tum", table)
    assert main(["convert", str(tmp_path / "alice.tum"), str(folder), "--add"]) == 0
    made = Recording.load(folder)
    alice = made.users[made.index("alice")]
    assert (alice.up, alice.height_sigma, dict(alice.antennas)) == ("z", 0.5, {"left": (0.1, 0.2, 0.0)})
    np.testing.assert_allclose(made.tracks["alice"].position, before.position, atol=1e-8)
    np.testing.assert_allclose(np.loadtxt(folder / "truth" / "alice.tum"), table, atol=1e-8)


def test_an_anchors_id_may_be_a_device_that_is_there_already(tmp_path: Path, folder: Path) -> None:
    (tmp_path / "bob.log").write_text("1000.5 DIST,1,AN0,0A1B,0,0,0,2.0\n")
    before = Recording.load(folder)
    assert main(["convert", str(tmp_path / "bob.log"), str(folder), "--add", "--rename", "0A1B=alice"]) == 0
    made = Recording.load(folder)
    assert made.users[made.index("alice")] == before.users[before.index("alice")]
    np.testing.assert_allclose(made.tracks["alice"].position, before.tracks["alice"].position, atol=1e-8)


def test_an_offset_shifts_tracks_and_their_truth_alike(tmp_path: Path) -> None:
    lines = [f"VERTEX_SE2 {k}.0 A{k} {k} 0 0\n" for k in range(3)] + ["VERTEX_XY L0 2 3\n"]
    lines += [f"EDGE_SE2 {k + 1}.0 A{k} A{k + 1} 1 0 0 0.1 0 0 0.1 0 0.1\n" for k in range(2)]
    (tmp_path / "a.pyfg").write_text("".join([*lines, "EDGE_RANGE 1.0 A1 L0 3.2 0.01\n"]))
    out = tmp_path / "walk"
    assert main(["convert", str(tmp_path / "a.pyfg"), str(out), "--time-offset", "100"]) == 0
    for kind in ("tracks", "truth"):
        np.testing.assert_allclose(np.loadtxt(out / kind / "A.tum")[:, 0], [100.0, 101.0, 102.0])
    assert Recording.load(out).ranges.t.tolist() == [101.0]
    assert np.loadtxt(out / "truth" / "L0.tum")[0] == 0.0


@pytest.mark.parametrize("fails_at", range(1, 9))
def test_what_cannot_be_moved_into_its_place_leaves_everything_as_it_was(
    folder: Path, fails_at: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def contents() -> dict[str, bytes]:
        return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}

    before, recording, rename, calls = contents(), Recording.load(folder), Path.rename, 0

    def failing(path: Path, to: Path) -> Path:
        nonlocal calls
        calls += 1
        if calls == fails_at:
            raise OSError(28, "No space left on device")
        return rename(path, to)

    monkeypatch.setattr(Path, "rename", failing)
    truth = {"alice": recording.tracks["alice"]}
    with pytest.raises(InputError, match="walk: No space left on device"):
        saving.save(recording, truth, folder)
    assert contents() == before
    assert [path.name for path in folder.parent.iterdir()] == ["walk"]
