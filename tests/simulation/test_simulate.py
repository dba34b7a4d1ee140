from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synchronizar.arrays import Array, Mask
from synchronizar.data.recording import Recording
from synchronizar.errors import InputError
from synchronizar.geometry import Up, YawFrame
from synchronizar.io.tum import read_tum
from synchronizar.quaternions import rotate_by_quaternions
from synchronizar.simulation.simulate import Scene, Simulation, simulate

PERFECT = Scene(users=4, seconds=6.0, sigma=0.0)
EVERYTHING = Scene(
    users=4,
    seconds=8.0,
    walk=("free", "line", "still"),
    late_share=0.3,
    loss=0.1,
    bias_sigma=0.1,
    clock_offset_sigma=0.2,
    scale_sigma=0.1,
    drift_m_per_sqrt_s=0.02,
    drift_rad_per_sqrt_s=0.01,
    jumps=2,
    late_joiners=1,
    static_radios=2,
    antennas=2,
    power=True,
)


def true_positions(simulation: Simulation, end: str) -> Array:
    """Where the antennas at one end of each range were, from the truth, one range at a time."""
    ranges, users = simulation.recording.ranges, simulation.recording.users
    out = []
    for t, who, antenna in zip(ranges.t, getattr(ranges, end), getattr(ranges, f"antenna_{end}"), strict=True):
        user = users[who]
        truth = simulation.truth[user.name]
        if user.static:
            out.append(truth.position[0])
            continue
        poses = truth.at(np.array([t + simulation.clock_offset[user.name]]), 0.1)
        assert poses.valid[0]
        lever = np.zeros(3) if antenna < 0 else np.array(list(user.antennas.values())[antenna])
        out.append(poses.position[0] + rotate_by_quaternions(poses.quat_xyzw, lever[None, :])[0])
    return np.array(out)


def errors(simulation: Simulation) -> Array:
    """Measured minus true distance of each range."""
    distance = np.linalg.norm(true_positions(simulation, "a") - true_positions(simulation, "b"), axis=1)
    return np.asarray(simulation.recording.ranges.distance - distance)


def runs(late: Mask) -> list[int]:
    """Lengths of the runs of True that are seen from begin to end."""
    edges = np.flatnonzero(np.diff(late.astype(int)))
    pieces = np.split(late, edges + 1)[1:-1]
    return [len(piece) for piece in pieces if piece[0]]


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("one", "two"):
        simulate(EVERYTHING).save(tmp_path / name)
    files = sorted(p.relative_to(tmp_path / "one") for p in (tmp_path / "one").rglob("*") if p.is_file())
    assert len(files) == 4 + 6 + 3, "tracks, truth, and ranges.csv, truth/ranges.csv, recording.toml"
    for file in files:
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()


def test_another_seed_gives_another_walk() -> None:
    one, two = simulate(Scene(seed=1)), simulate(Scene(seed=2))
    assert np.abs(one.truth["phone0"].position[0] - two.truth["phone0"].position[0]).max() > 0.01


def test_worse_radios_and_slam_leave_the_walk_as_it_was() -> None:
    clean = simulate(replace(EVERYTHING, late_share=0.0, drift_m_per_sqrt_s=0.0, jumps=0, antennas=0, sigma=0.0))
    for name, track in simulate(EVERYTHING).truth.items():
        np.testing.assert_array_equal(track.position, clean.truth[name].position)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), scale_sigma=st.sampled_from([0.0, 0.2]))
def test_without_drift_the_truth_is_the_own_track_under_one_frame(seed: int, scale_sigma: float) -> None:
    simulation = simulate(Scene(seed=seed, scale_sigma=scale_sigma, clock_offset_sigma=0.1))
    for name, own in simulation.recording.tracks.items():
        frame, truth = simulation.world_from_user[name], simulation.truth[name]
        np.testing.assert_array_equal(own.t, truth.t)
        np.testing.assert_allclose(frame @ own.position, truth.position, atol=1e-9)
        axes = np.eye(3)[:, None, :]
        turned = rotate_by_quaternions(frame.rotate_quaternions(own.quat_xyzw), axes)
        np.testing.assert_allclose(turned, rotate_by_quaternions(truth.quat_xyzw, axes), atol=1e-9)
        np.testing.assert_allclose(own.position[0], 0.0, atol=1e-12)
        assert (frame.scale == 1.0) == (scale_sigma == 0.0)


def test_without_noise_each_range_is_the_distance_of_the_placed_tracks_at_its_time_plus_the_clock_offsets() -> None:
    scene = replace(PERFECT, clock_offset_sigma=0.3, scale_sigma=0.1, static_radios=1)
    simulation = simulate(scene)
    recording = simulation.recording
    ends = []
    for who in (recording.ranges.a, recording.ranges.b):
        places = np.empty((len(recording.ranges), 3))
        for i, user in enumerate(recording.users):
            mine = who == i
            own_t = recording.ranges.t[mine] + simulation.clock_offset[user.name]
            position, valid = recording.antenna_positions(i, own_t, np.full(mine.sum(), -1, dtype=np.int32), 0.1)
            assert valid.all()
            places[mine] = simulation.world_from_user[user.name] @ position
        ends.append(places)
    assert min(abs(simulation.clock_offset[f"phone{i}"]) for i in range(4)) > 1e-3
    distance = np.linalg.norm(ends[0] - ends[1], axis=1)
    np.testing.assert_allclose(recording.ranges.distance, distance, atol=1e-9)


def test_a_range_runs_between_the_antennas_it_names_and_has_both_radios_biases() -> None:
    simulation = simulate(replace(EVERYTHING, sigma=0.0))
    ranges = simulation.recording.ranges
    bias = np.array([simulation.range_bias[user.name] for user in simulation.recording.users])
    expected = bias[ranges.a] + bias[ranges.b] + simulation.extra
    np.testing.assert_allclose(errors(simulation), expected, atol=1e-9)
    of_phones = ranges.antenna_a[ranges.a < 4]
    assert set(of_phones.tolist()) == {0, 1}
    assert set(ranges.antenna_b[ranges.b >= 4].tolist()) == {-1}
    levers = np.array([lever for user in simulation.recording.users for lever in user.antennas.values()])
    assert len(levers) == 8
    assert np.linalg.norm(levers, axis=1).max() <= 0.15


def test_the_noise_of_ranges_in_line_of_sight_has_the_sigma_asked_for_and_no_mean() -> None:
    simulation = simulate(Scene(users=6, seconds=60.0, sigma=0.1, late_share=0.3))
    clear = errors(simulation)[~simulation.late]
    n = len(clear)
    assert abs(clear.mean()) < 4.0 * 0.1 / np.sqrt(n)
    assert abs(clear.std() - 0.1) < 4.0 * 0.1 / np.sqrt(2 * n)


def test_late_ranges_have_their_share_from_the_first_second_to_the_last() -> None:
    shares = []
    for seed in range(40):
        simulation = simulate(Scene(users=6, seconds=20.0, late_share=0.3, seed=seed))
        t = simulation.recording.ranges.t
        shares.append([simulation.late[t < 2.0].mean(), simulation.late[t >= 18.0].mean(), simulation.late.mean()])
    np.testing.assert_allclose(np.mean(shares, axis=0), 0.3, atol=0.03)


@pytest.mark.parametrize("burst_s", [0.5, 1.0, 3.0])
def test_bursts_of_late_ranges_last_as_long_as_asked_for(burst_s: float) -> None:
    scene = Scene(users=6, seconds=300.0, rate_hz=20.0, late_share=0.3, late_burst_s=burst_s, track_rate_hz=1.0)
    simulation = simulate(scene)
    ranges = simulation.recording.ranges
    seen = [n for a in range(6) for b in range(a) for n in runs(simulation.late[(ranges.a == b) & (ranges.b == a)])]
    assert np.mean(seen) / 20.0 == pytest.approx(burst_s, rel=0.15)


def test_late_ranges_are_longer_by_their_mean_and_alike_within_a_burst() -> None:
    simulation = simulate(Scene(users=6, seconds=300.0, late_share=0.5, late_mean=1.2, track_rate_hz=1.0))
    late, extra = simulation.late, simulation.extra
    assert (extra[~late] == 0.0).all()
    assert extra[late].min() > 0.1
    assert extra[late].mean() == pytest.approx(1.2, rel=0.1)
    ranges = simulation.recording.ranges
    pair = (ranges.a == 0) & (ranges.b == 1)
    follows = late[pair][1:] & late[pair][:-1]
    logs = np.log(np.maximum(extra[pair], 1e-9))
    within = np.abs(np.diff(logs))[follows]
    assert np.median(within) == pytest.approx(0.6745 * np.sqrt(2.0) * 0.2, rel=0.25)


def test_shares_of_none_and_all_are_exact() -> None:
    assert not simulate(Scene(late_share=0.0)).late.any()
    assert simulate(Scene(late_share=1.0)).late.all()
    assert len(simulate(Scene(loss=1.0)).recording.ranges) == 0


def test_the_share_of_lost_ranges_is_as_asked_for() -> None:
    scene = Scene(users=5, seconds=60.0)
    kept = len(simulate(replace(scene, loss=0.25)).recording.ranges) / len(simulate(scene).recording.ranges)
    assert kept == pytest.approx(0.75, abs=0.03)


@pytest.mark.parametrize(("users", "radios", "hz"), [(2, 0, 1000 / 101), (4, 0, 1000 / 143), (6, 2, 1000 / 227)])
def test_each_pair_ranges_at_the_rate_of_the_formula(users: int, radios: int, hz: float) -> None:
    ranges = simulate(Scene(users=users, static_radios=radios, seconds=30.0)).recording.ranges
    pair = (ranges.a == 0) & (ranges.b == 1)
    assert pair.sum() == pytest.approx(30.0 * hz, abs=1.0)
    np.testing.assert_allclose(np.diff(ranges.t[pair]), 1.0 / hz, rtol=0.21)


def test_the_pairs_of_a_round_take_turns_and_the_stamps_rise() -> None:
    ranges = simulate(Scene(users=4, rate_hz=5.0, seconds=10.0)).recording.ranges
    assert len(ranges) == 6 * 50
    assert np.diff(ranges.t).min() > 0.5 * 0.2 / 6
    assert np.diff(ranges.t).max() < 1.5 * 0.2 / 6


@pytest.mark.parametrize(
    ("links", "pairs"),
    [
        ("all", {(0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3), (0, 4), (1, 4), (2, 4)}),
        ("star", {(0, 1), (0, 2), (0, 3), (0, 4)}),
        ("chain", {(0, 1), (1, 2), (2, 3), (2, 4)}),
    ],
)
def test_links_say_who_ranges_and_radios_never_range_with_one_another(links: str, pairs: set[tuple[int, int]]) -> None:
    ranges = simulate(Scene(users=3, static_radios=2, links=links)).recording.ranges
    assert set(zip(ranges.a.tolist(), ranges.b.tolist(), strict=True)) == pairs


def test_late_joiners_appear_in_the_second_half() -> None:
    simulation = simulate(Scene(users=3, seconds=20.0, late_joiners=1))
    ranges = simulation.recording.ranges
    of_joiner = (ranges.a == 2) | (ranges.b == 2)
    assert 9.9 < simulation.recording.tracks["phone2"].t[0] <= 10.0
    assert 9.9 < ranges.t[of_joiner].min() < 10.5
    assert ranges.t[~of_joiner].min() < 0.5


def test_static_radios_hang_in_the_room_and_have_no_track() -> None:
    simulation = simulate(Scene(static_radios=3, area=8.0))
    assert [user.name for user in simulation.recording.users if user.static] == ["radio0", "radio1", "radio2"]
    assert set(simulation.recording.tracks) == {"phone0", "phone1"}
    for name in ("radio0", "radio1", "radio2"):
        x, y, z = simulation.truth[name].position[0]
        assert max(abs(x), abs(y)) <= 4.0
        assert 2.0 <= z <= 3.0
        assert simulation.truth[name].t.tolist() == [0.0]
        assert simulation.world_from_user[name] == YawFrame(x, y, z)


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    area=st.floats(1.0, 30.0),
    seconds=st.floats(0.1, 120.0),
    kind=st.sampled_from(["free", "line"]),
)
def test_walkers_stay_in_the_room_and_keep_walking(seed: int, area: float, seconds: float, kind: str) -> None:
    simulation = simulate(Scene(seed=seed, area=area, seconds=seconds, walk=(kind,), rate_hz=1.0))
    for track in simulation.truth.values():
        assert np.abs(track.position[:, :2]).max() <= area / 2.0
        speed = 30.0 * np.linalg.norm(np.diff(track.position[:, :2], axis=0), axis=1)
        assert speed.max() < 1.31
        assert np.median(speed) > 0.1


def test_walkers_walk_at_about_the_speed_asked_for_and_face_where_they_go() -> None:
    track = simulate(Scene(seconds=120.0, speed=1.3, area=20.0)).truth["phone0"]
    step = np.diff(track.position, axis=0) * 30.0
    speed = np.linalg.norm(step[:, :2], axis=1)
    assert speed.mean() == pytest.approx(1.3, rel=0.1)
    facing = rotate_by_quaternions(track.quat_xyzw, np.array([1.0, 0.0, 0.0]))[:-1, :2]
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    assert np.mean(np.sum(facing * step[:, :2], axis=1) / speed) > 0.9
    turn_rate = np.abs(np.diff(np.unwrap(np.arctan2(facing[:, 1], facing[:, 0])))) * 30.0
    assert turn_rate.max() < 2.0 * np.pi + 0.5


def test_a_line_is_straight_and_who_stands_still_sways_by_a_centimetre() -> None:
    truth = simulate(Scene(walk=("line", "still"), seconds=30.0)).truth
    line = truth["phone0"].position[:, :2] - truth["phone0"].position[:, :2].mean(axis=0)
    spread = np.linalg.svd(line, compute_uv=False)
    assert spread[1] < 1e-9 * spread[0]
    still = truth["phone1"].position
    assert still.std(axis=0).min() > 0.001
    assert np.ptp(still, axis=0).max() < 0.04


def test_heights_spread_as_asked_for_and_a_walk_without_bob_is_level() -> None:
    scenes = [Scene(users=10, seconds=0.2, seed=seed, height_bob=0.0, height_spread=0.3) for seed in range(40)]
    heights = np.array([[t.position[0, 2] for t in simulate(scene).truth.values()] for scene in scenes])
    assert heights.mean() == pytest.approx(1.4, abs=0.06)
    assert heights.std() == pytest.approx(0.3, rel=0.15)
    level = simulate(Scene(height_bob=0.0)).truth["phone0"].position[:, 2]
    assert np.ptp(level) < 1e-12


def test_drift_grows_with_the_root_of_time() -> None:
    off = []
    for seed in range(60):
        simulation = simulate(Scene(seed=seed, seconds=16.0, drift_m_per_sqrt_s=0.02, rate_hz=1.0))
        for name, own in simulation.recording.tracks.items():
            placed = simulation.world_from_user[name] @ own.position
            off.append(placed[0] - simulation.truth[name].position[0])
            np.testing.assert_allclose(placed[-1], simulation.truth[name].position[-1], atol=1e-9)
    assert np.std(off) == pytest.approx(0.02 * 4.0, rel=0.15)


def test_a_jump_moves_and_turns_the_own_track_once() -> None:
    simulation = simulate(Scene(jumps=1, jump_m=0.7, jump_rad=0.4))
    own, truth = simulation.recording.tracks["phone0"], simulation.truth["phone0"]
    steps = np.linalg.norm(np.diff(own.position, axis=0), axis=1)
    true_steps = np.linalg.norm(np.diff(truth.position, axis=0), axis=1)
    jump = int(np.argmax(np.abs(steps - true_steps)))
    np.testing.assert_allclose(np.delete(steps, jump), np.delete(true_steps, jump), atol=1e-9)
    assert steps[jump] == pytest.approx(0.7, abs=0.06)
    placed = simulation.world_from_user["phone0"] @ own.position
    np.testing.assert_allclose(placed[jump + 1 :], truth.position[jump + 1 :], atol=1e-9)
    before = placed[: jump + 1] - truth.position[: jump + 1]
    assert np.linalg.norm(before, axis=1).min() > 0.0


def test_power_tells_late_ranges_from_the_others() -> None:
    simulation = simulate(Scene(users=5, seconds=60.0, late_share=0.4, power=True))
    lost = simulation.recording.ranges.rx_power - simulation.recording.ranges.fp_power
    assert lost[~simulation.late].mean() == pytest.approx(3.0, abs=0.2)
    assert lost[simulation.late].mean() == pytest.approx(12.0, abs=0.4)
    assert np.isnan(simulate(Scene()).recording.ranges.rx_power).all()


def test_more_than_ten_users_stand_in_the_order_of_their_numbers() -> None:
    users = simulate(Scene(users=12, seconds=1.0)).recording.users
    assert [user.name for user in users] == [f"phone{i:02d}" for i in range(12)]


@pytest.mark.parametrize("up", ["z", "y"])
def test_what_is_saved_is_read_as_it_was(tmp_path: Path, up: Up) -> None:
    simulation = simulate(replace(EVERYTHING, up=up))
    simulation.save(tmp_path)
    recording = Recording.load(tmp_path)
    assert [(u.name, u.static) for u in recording.users] == [(u.name, u.static) for u in simulation.recording.users]
    for name, own in simulation.recording.tracks.items():
        np.testing.assert_allclose(recording.tracks[name].position, own.position, atol=1e-5)
        axes = np.eye(3)[:, None, :]
        turned = rotate_by_quaternions(recording.tracks[name].quat_xyzw, axes)
        np.testing.assert_allclose(turned, rotate_by_quaternions(own.quat_xyzw, axes), atol=1e-5)
    np.testing.assert_allclose(recording.ranges.distance, simulation.recording.ranges.distance, atol=1e-4)
    for name, truth in simulation.truth.items():
        saved = read_tum(tmp_path / "truth" / f"{name}.tum", up)
        np.testing.assert_allclose(saved.position, truth.position, atol=1e-5)
    header, *rows = (tmp_path / "truth" / "ranges.csv").read_text().splitlines()
    assert header == "t,a,b,late,extra"
    assert len(rows) == len(simulation.recording.ranges)
    assert [row.split(",")[3] == "1" for row in rows] == simulation.late.tolist()


def test_the_truth_of_another_scene_stands_in_the_way(tmp_path: Path) -> None:
    simulate(Scene(static_radios=2)).save(tmp_path)
    with pytest.raises(InputError, match=r"radio1\.tum: stands in the way"):
        simulate(Scene(static_radios=1)).save(tmp_path)


def test_tracks_saved_with_y_up_have_their_heights_in_y(tmp_path: Path) -> None:
    simulation = simulate(Scene(up="y"))
    simulation.save(tmp_path)
    own = simulation.recording.tracks["phone0"].position
    saved = np.loadtxt(tmp_path / "tracks" / "phone0.tum")[:, 1:4]
    np.testing.assert_allclose(saved, np.column_stack([-own[:, 1], own[:, 2], -own[:, 0]]), atol=1e-5)


@pytest.mark.parametrize(
    "options",
    [
        {"users": 1},
        {"seconds": 0.0},
        {"seconds": float("nan")},
        {"seed": -1},
        {"walk": ("free", "fly")},
        {"walk": ()},
        {"late_share": 1.1},
        {"late_mean": 0.1},
        {"loss": -0.1},
        {"rate_hz": 0.0},
        {"late_joiners": 2},
        {"links": "ring"},
        {"up": "x"},
        {"height": float("inf")},
    ],
)
def test_a_scene_that_cannot_be_names_its_option(options: dict[str, object]) -> None:
    (option,) = options
    with pytest.raises(InputError, match=f"^--{option.replace('_', '-')}: "):
        Scene(**options)  # type: ignore[arg-type]
