"""Mistakes made by hand are told as what they are, and nothing is told where nothing is wrong."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pytest
from support.mistakes import MISTAKES, Mistake, of_ranges, of_tracks, swapped, w_first
from support.paths import SHARED

from synchronizar.data.findings import Code, Finding, finding_json
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.diagnosis import findings_of
from synchronizar.diagnosis.summary import summary_of
from synchronizar.parameters import Parameters
from synchronizar.reporting.check import check_json, check_table
from synchronizar.simulation.simulate import Scene, simulate

SEEDS = (1, 2)
REAL_TROUBLES = {
    "clock_offset_sigma": 0.04,
    "bias_sigma": 0.05,
    "scale_sigma": 0.03,
    "drift_m_per_sqrt_s": 0.007,
    "drift_rad_per_sqrt_s": 0.004,
}
CLEAN: list[dict[str, Any]] = [
    {},
    {"users": 6, "late_share": 0.3},
    {"walk": ("line",)},
    {"walk": ("still",)},
    {"walk": ("free", "still", "line"), "users": 4, "static_radios": 2},
    dict(antennas=2, late_share=0.2, seconds=30.0, **REAL_TROUBLES),
    {"users": 2, "static_radios": 3, "links": "star"},
    dict(jumps=2, late_share=0.2, seconds=40.0, **REAL_TROUBLES),
    {"late_joiners": 1, "loss": 0.3},
    {"height_bob": 0.0, "speed": 0.3, "area": 15.0},
]


@cache
def walk(seed: int) -> Recording:
    return simulate(Scene(users=3, seconds=20.0, seed=seed, late_share=0.1 * (seed % 2))).recording


def told(findings: list[Finding]) -> set[tuple[str, str | None]]:
    return {(str(finding.code), finding.user) for finding in findings}


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake.name)
def test_a_mistake_is_told_as_what_it_is_and_as_nothing_else(mistake: Mistake, seed: int) -> None:
    expected = {(mistake.code, user) for user in mistake.users}
    if mistake.code == Code.CLOCK:
        # That it has no range within its time is true too.
        expected |= {(str(Code.TIME_OVERLAP), user) for user in mistake.users}
    assert told(findings_of(mistake.make(walk(seed)), Parameters())) == expected


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("settings", CLEAN, ids=str)
def test_nothing_is_told_of_fifty_clean_walks(settings: dict[str, Any], seed: int) -> None:
    scene = Scene(**({"users": 3, "seconds": 12.0, "seed": seed} | settings))
    assert findings_of(simulate(scene).recording, Parameters()) == []


@pytest.mark.parametrize("seed", [0, 1])
def test_exchanged_radios_are_told_where_a_small_room_lets_their_ranges_fit_to_a_decimetre(seed: int) -> None:
    room = simulate(Scene(users=4, area=2.0, speed=0.2, sigma=0.03, seconds=60.0, seed=seed)).recording
    assert told(findings_of(swapped(room), Parameters())) == {("swapped-radios", "phone0")}
    assert findings_of(room, Parameters()) == []


def kept(track: Track, rows: slice) -> Track:
    return replace(track, t=track.t[rows], position=track.position[rows], quat_xyzw=track.quat_xyzw[rows])


def test_a_track_of_one_pose_is_too_short_and_no_matter_of_clocks() -> None:
    found = findings_of(of_tracks(lambda track: kept(track, slice(1)), ("phone1",))(walk(3)), Parameters())
    assert told(found) == {("time-overlap", "phone1")}


def test_poses_too_far_apart_to_use_are_told_of_a_device_that_hardly_moves_too() -> None:
    def rare(track: Track) -> Track:
        ends = kept(track, slice(0, None, len(track) - 1))
        return replace(ends, position=ends.position[0] + np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0]]))

    found = findings_of(of_tracks(rare, ("phone1",))(walk(3)), Parameters())
    assert ("sparse-poses", "phone1") in told(found)


def climbing_in_one_plane(track: Track) -> Track:
    """It rises and sinks, and hardly moves along x."""
    x, y, z = track.position.T
    return replace(track, position=np.column_stack([0.1 * x, y, z + 2.0 * np.sin(track.t - track.t[0])]))


@pytest.mark.parametrize("seed", [0, 1])
def test_a_drone_that_climbs_beside_a_wall_has_w_first_where_the_others_have(seed: int) -> None:
    drone = of_tracks(climbing_in_one_plane, ("phone1",))(walk(seed))
    assert told(findings_of(drone, Parameters())) == set()
    found = findings_of(of_tracks(w_first)(drone), Parameters())
    assert {finding for finding in told(found) if finding[1] == "phone1"} == {("quaternion-order", "phone1")}


def test_nothing_is_told_of_a_clean_walk_with_y_up_that_says_so(tmp_path: Any) -> None:
    simulate(Scene(users=3, up="y", seed=3)).save(tmp_path)
    assert findings_of(Recording.load(tmp_path), Parameters()) == []


def test_two_mistakes_are_both_told() -> None:
    y_up = next(m for m in MISTAKES if m.name == "y up, taken for z up")
    millimetres = of_ranges(distance=lambda d: 1e3 * d)
    found = told(findings_of(millimetres(y_up.make(walk(1))), Parameters()))
    assert found == {("range-unit", None), *(("up-axis", f"phone{n}") for n in range(3))}


def test_both_spans_are_told_where_times_do_not_overlap() -> None:
    mistake = next(m for m in MISTAKES if m.name == "tracks by uptime, ranges since 1970")
    message = findings_of(mistake.make(walk(1)), Parameters())[0].message
    assert "the track runs from 81234." in message
    assert "its ranges from 1700000000." in message


def test_numbers_that_make_it_likely_are_told() -> None:
    feet = of_ranges(distance=lambda d: d / 0.3048)(walk(2))
    (finding,) = findings_of(feet, Parameters())
    assert "likely in feet" in finding.message
    assert "3." in finding.message
    assert finding.remedy.startswith("divide the column range by 3.2808")


def test_a_finding_is_one_line_and_one_json_object() -> None:
    finding = Finding(Code.UP_AXIS, "ann", "its y axis is vertical", 'say `up = "y"`')
    assert str(finding) == 'up-axis: ann: its y axis is vertical. Remedy: say `up = "y"`'
    assert finding_json(finding) == {
        "code": "up-axis",
        "user": "ann",
        "message": "its y axis is vertical",
        "remedy": 'say `up = "y"`',
    }


def test_nothing_is_changed_and_nothing_breaks_on_hardly_any_data() -> None:
    recording = walk(1)
    before = recording.ranges.distance.copy(), recording.tracks["phone0"].position.copy()
    findings_of(recording, Parameters())
    assert (recording.ranges.distance == before[0]).all()
    assert (recording.tracks["phone0"].position == before[1]).all()
    for count in (0, 1, 2, 30):
        findings_of(replace(recording, ranges=recording.ranges.select(np.arange(count))), Parameters())
    one = {
        n: replace(t, t=t.t[:1], position=t.position[:1], quat_xyzw=t.quat_xyzw[:1])
        for n, t in recording.tracks.items()
    }
    findings_of(replace(recording, tracks=one), Parameters())


def test_twenty_thousand_ranges_take_less_than_half_a_second_of_work() -> None:
    # 0.065 s where nothing else runs; a machine may be some times slower.
    recording = simulate(Scene(users=10, seconds=167.0, rate_hz=2.67)).recording
    assert len(recording.ranges) > 20_000
    findings_of(recording, Parameters())
    times = []
    for _ in range(3):
        began = process_time()
        findings_of(recording, Parameters())
        times.append(process_time() - began)
    assert min(times) < 0.5


EXPECTED = {
    "cases/boot_vs_epoch": {("time-overlap", "ann"), ("time-overlap", "ben")},
    "cases/frozen": {("frozen-poses", "ben")},
    "cases/future_one": {("stray-stamp", "ben")},
    "cases/zero_first": {("stray-stamp", "ann"), ("stray-stamp", "ben")},
    "cases/wxyz": {("quaternion-order", name) for name in ("ann", "ben", "cleo")},
    "cases/room": {("never-moves", "room")},
    "cases/one_jump": set(),
    "cases/robot_person_0.6": set(),
    "cases/truth_1hz_phase": set(),
    "recordings/cmu_scott": set(),
    "recordings/miluv_hist": set(),
    "recordings/tiers5_cora": set(),
    "recordings/tiers_case4_k7": {("repeated-ranges", None), ("never-moves", "r1"), ("never-moves", "r2")},
    "recordings/vub_exp2": set(),
    "recordings/vub_exp4": set(),
}


@pytest.mark.parametrize("name", EXPECTED)
def test_of_real_recordings_and_cases_what_is_known_of_them_is_told(name: str) -> None:
    if not (SHARED / name).is_dir():
        pytest.skip(f"{SHARED / name} is not there")
    assert told(findings_of(Recording.load(SHARED / name), Parameters())) == EXPECTED[name]


def test_garbage_ranges_of_a_real_recording_are_counted_and_shown_though_no_code_names_them() -> None:
    if not (SHARED / "recordings/cmu_scott").is_dir():
        pytest.skip(f"{SHARED / 'recordings/cmu_scott'} is not there")
    summary = summary_of(Recording.load(SHARED / "recordings/cmu_scott"), Parameters())
    assert (summary.no_distance, summary.ranges) == (7, 5346)
    assert summary.longest is not None
    assert summary.longest > 6.1e6
    assert "7 of 5346 ranges are no possible distances" in check_table(summary, (), refused=False)
    assert check_json(summary, (), None)["ranges"]["longest"] == summary.longest


@pytest.mark.parametrize("seed", range(4))
def test_the_order_of_quaternions_is_that_of_the_file_whatever_axis_points_up(tmp_path: Path, seed: int) -> None:
    simulate(Scene(users=2, seconds=25.0, seed=seed, up="y", antennas=1)).save(tmp_path)
    assert findings_of(Recording.load(tmp_path), Parameters()) == []
    for file in (tmp_path / "tracks").glob("*.tum"):
        rows = np.loadtxt(file)
        np.savetxt(file, rows[:, [0, 1, 2, 3, 7, 4, 5, 6]])
    found = findings_of(Recording.load(tmp_path), Parameters())
    assert [(f.code, f.user) for f in found] == [(Code.QUATERNION_ORDER, name) for name in ("phone0", "phone1")]
