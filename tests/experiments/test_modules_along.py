from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.air_built import needs_air

from experiments.modules.along_recordings import along, main, stretch_of
from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.estimation.register import register
from synchronizar.io.tum import write_tum
from synchronizar.reporting.evaluate import read_tracks
from synchronizar.simulation.modules import SWITCHED_ON_S, Air, scenario_of
from synchronizar.simulation.radios import Device
from synchronizar.simulation.scene import SCHEMES, Scene
from synchronizar.simulation.simulate import simulate

BEGIN_S = 5000.0
"""Where clocks of devices stand when a walk begins."""
MEAN_HEIGHT = np.array([0.0, 0.0, 0.0, 1.0])
WALK = Scene(users=3, seconds=6.0, seed=5, late_joiners=1, static_radios=1, clock_offset_sigma=0.1)


def save(scene: Scene, folder: Path) -> None:
    """A walk with its truth, long after its clocks were started."""
    simulation = simulate(scene)
    recording = simulation.recording
    ranges = replace(recording.ranges, t=recording.ranges.t + BEGIN_S)
    tracks = {name: later(track) for name, track in recording.tracks.items()}
    truth = {n: later(track) if n in tracks else track for n, track in simulation.truth.items()}
    replace(simulation, recording=replace(recording, tracks=tracks, ranges=ranges), truth=truth).save(folder)


def later(track: Track) -> Track:
    return replace(track, t=track.t + BEGIN_S)


def first_antenna(user: User, truth: dict[str, Track], t: Array) -> Array:
    """(n, 3) m at own stamps t, with the attitude of the next pose."""
    track = truth[user.name]
    if user.static:
        return np.broadcast_to(track.position, (len(t), 3))
    origin = np.column_stack([np.interp(t, track.t, axis) for axis in track.position.T])
    if not user.antennas:
        return origin
    q = track.quat_xyzw[np.minimum(np.searchsorted(track.t, t), len(track) - 1)]
    v, lever = q[:, :3], np.array(next(iter(user.antennas.values())))
    return origin + lever + 2.0 * np.cross(v, np.cross(v, lever) + q[:, 3:] * lever)


@needs_air
@pytest.mark.parametrize(("scheme", "antennas"), [(SCHEMES[0], 0), (SCHEMES[1], 2)])
def test_ranges_are_those_between_true_tracks_at_their_own_stamps(scheme: str, antennas: int, tmp_path: Path) -> None:
    save(replace(WALK, antennas=antennas), tmp_path)
    truth, users = read_tracks(tmp_path / "truth"), Recording.load(tmp_path).users
    ridden = along(stretch_of(tmp_path, 6.0), scheme, seed=1)
    r = ridden.recording.ranges
    pairs = np.unique(np.sort(np.column_stack([r.a, r.b]), axis=1), axis=0)
    assert len(pairs) == 6
    for a, b in pairs.tolist():
        mine = r.select(((r.a == a) & (r.b == b)) | ((r.a == b) & (r.b == a)))
        t = mine.t - ridden.behind
        ends = (first_antenna(users[who], truth, t) for who in (a, b))
        error = mine.distance - np.linalg.norm(np.subtract(*ends), axis=1)
        assert len(error) > 100
        assert abs(error.mean()) < 0.01
        assert error.std() < 0.05


@needs_air
def test_a_module_ranges_from_its_first_to_its_last_truth_but_not_in_gaps(tmp_path: Path) -> None:
    save(WALK, tmp_path)
    truth = read_tracks(tmp_path / "truth")
    joiner, leaver = truth["phone2"], truth["phone1"]
    gap = (leaver.t < leaver.t[0] + 1.5) | (leaver.t > leaver.t[0] + 2.5)
    kept = gap & (leaver.t < leaver.t[0] + 5.0)
    leaver = Track(leaver.t[kept], leaver.position[kept], leaver.quat_xyzw[kept])
    write_tum(tmp_path / "truth" / "phone1.tum", leaver)
    ridden = along(stretch_of(tmp_path, 6.0), SCHEMES[0], seed=1)
    r = ridden.recording.ranges
    of_joiner, of_leaver = (r.t[(r.a == i) | (r.b == i)] - ridden.behind for i in (2, 1))
    rest = r.t[(r.a != 1) & (r.b != 1)]
    assert joiner.t[0] < of_joiner.min() < joiner.t[0] + 1.0
    assert leaver.t[-1] - 0.2 < of_leaver.max() <= leaver.t[-1]
    assert np.diff(of_leaver).max() > 1.0
    assert rest.max() > leaver.t[-1] + 0.5


def test_a_module_has_power_while_its_device_s_track_lasts() -> None:
    t = BEGIN_S + np.array([2.0, 4.0])
    walker = Device(Track(t, np.zeros((2, 3)), np.tile(MEAN_HEIGHT, (2, 1))), False, np.empty((0, 3)), BEGIN_S, 0.0)
    radio = Device(Track(np.zeros(1), np.ones((1, 3)), MEAN_HEIGHT[None, :]), True, np.empty((0, 3)), 0.0, 0.0)
    for seconds, off in ((3.0, np.inf), (6.0, 4.0)):
        scenario = scenario_of(np.random.default_rng(0), [walker, radio], Air(seconds, SCHEMES[0], 0.03))
        (walker_on, walker_off), (radio_on, radio_off) = ((m.on, m.off) for m in scenario.modules)
        assert 2.0 <= walker_on <= 2.0 + SWITCHED_ON_S
        assert walker_off == off
        assert 0.0 <= radio_on <= SWITCHED_ON_S
        assert radio_off == np.inf


@needs_air
def test_clocks_that_are_registered_are_behind_as_the_datagrams_were(tmp_path: Path) -> None:
    save(replace(WALK, seconds=12.0, late_joiners=0), tmp_path)
    ridden = along(stretch_of(tmp_path, 12.0), SCHEMES[1], seed=2)
    users = register(ridden.recording).users
    assert 0.0 < ridden.behind < 0.01
    for name in ("phone0", "phone1", "phone2"):
        assert users[name].state == "registered"
        assert users[name].clock_offset == pytest.approx(-ridden.behind, abs=0.005)


@needs_air
def test_modules_stand_in_a_table_beside_the_recording_s_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save(replace(WALK, users=2, seconds=4.0, late_joiners=0), tmp_path / "walk")
    main([str(tmp_path / "walk"), "--seconds", "3"])
    head, _, modules, own = capsys.readouterr().out.splitlines()
    assert head.startswith("| recording | ranged by | ranges |")
    assert modules.startswith("| walk | modules, one-to-n |")
    assert own.startswith("| walk | its own radios |")


def without_truth(folder: Path) -> None:
    for file in (folder / "truth").iterdir():
        file.unlink()
    (folder / "truth").rmdir()


def without_one_truth(folder: Path) -> None:
    (folder / "truth" / "phone1.tum").unlink()


def with_truth_too_late(folder: Path) -> None:
    track = read_tracks(folder / "truth")["phone2"]
    write_tum(folder / "truth" / "phone2.tum", replace(track, t=track.t + 100.0))


def without_a_recording(folder: Path) -> None:
    (folder / "ranges.csv").unlink()


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (without_truth, "has no truth/phone0.tum: modules ride along the truth of everybody"),
        (without_one_truth, "has no truth/phone1.tum: modules ride along the truth of everybody"),
        (with_truth_too_late, "phone2.tum: has less than 1 s of truth from "),
        (without_a_recording, "ranges.csv: No such file or directory"),
    ],
)
def test_what_cannot_be_ridden_along_is_refused_in_one_line(spoil, told: str, tmp_path: Path) -> None:
    save(WALK, tmp_path)
    spoil(tmp_path)
    with pytest.raises(SystemExit) as caught:
        main([str(tmp_path)])
    assert told in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_more_users_than_a_network_holds_are_refused_in_one_line(tmp_path: Path) -> None:
    save(Scene(users=12, seconds=1.0), tmp_path)
    with pytest.raises(SystemExit) as caught:
        main([str(tmp_path)])
    assert str(caught.value) == f"{tmp_path}: has 12 users: modules are at most 11 in one network"
