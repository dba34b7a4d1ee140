from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.paths import SHARED
from support.relocalised import about, glitched, real, relocalised, walk, with_recordings, without

from synchronizar._core import poses_at
from synchronizar.arrays import Array
from synchronizar.data.jump import Jump
from synchronizar.data.track import Track, interpolated
from synchronizar.io.tum import read_tum
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.keyframes import VELOCITY_REACH
from synchronizar.preprocessing.pose_stream import PoseStream
from synchronizar.preprocessing.relocalizations import RepairedTrack, repair_relocalizations
from synchronizar.preprocessing.repaired_poses import Tail, ends_of_ranges
from synchronizar.preprocessing.stream_events import Dismissed, Levelled, SetAside
from synchronizar.preprocessing.suspect_poses import frozen_poses, stray_poses
from synchronizar.quaternions import angles_between, normalized_quaternions, rotate_by_quaternions, yaw_quaternion
from synchronizar.simulation.simulate import Scene, simulate

MODEL = Parameters()
FEW = 25
"""Poses in which a walk has told too little of its noise to tell a jump from it; the batch knows what comes later."""
CASES = SHARED / "cases"
ALL = -np.inf

with_cases = pytest.mark.skipif(not CASES.is_dir(), reason=f"{CASES} is not there")

Row = tuple[float, list[float], list[float]]


def rows_of(track: Track) -> list[Row]:
    return list(zip(track.t.tolist(), track.position.tolist(), track.quat_xyzw.tolist(), strict=True))


def fed(rows: Iterable[Row], stream: PoseStream | None = None) -> PoseStream:
    stream = PoseStream(MODEL) if stream is None else stream
    for row in rows:
        stream.add(*row)
    return stream


def settled(track: Track) -> PoseStream:
    stream = fed(rows_of(track))
    stream.settle()
    return stream


def poses_of(stream: PoseStream) -> list[int]:
    return [jump.pose for jump in stream.jumps]


def assert_as_the_batch(stream: PoseStream, track: Track, metres: float = 0.01, radians: float = 0.01) -> None:
    assert_as(repair_relocalizations(track, MODEL), stream, track, metres, radians)


def assert_as(
    expected: RepairedTrack, stream: PoseStream, track: Track, metres: float = 0.01, radians: float = 0.01
) -> None:
    got = stream.tail(ALL)
    assert poses_of(stream) == [jump.pose for jump in expected.jumps]
    for jump, other in zip(stream.jumps, expected.jumps, strict=True):
        assert jump.t == other.t
        assert (jump.distance, jump.turn, jump.tilt) == pytest.approx(
            (other.distance, other.turn, other.tilt), abs=1e-3
        )
    whole = stream.repaired(ALL)
    np.testing.assert_array_equal(whole.level, expected.level)
    assert angles_between(whole.repaired_from_slam, expected.repaired_from_slam).max() < radians
    assert whole.jumps == tuple(stream.jumps)
    np.testing.assert_array_equal(whole.segment, expected.segment)
    np.testing.assert_array_equal(whole.track.position, got.position)
    np.testing.assert_array_equal(got.t, track.t)
    np.testing.assert_array_equal(got.segment, expected.segment)
    np.testing.assert_array_equal(np.flatnonzero(got.rebuilt), poses_of(stream))
    assert np.linalg.norm(got.position - expected.track.position, axis=1).max() < metres
    assert angles_between(got.quat_xyzw, expected.track.quat_xyzw).max() < radians


def assert_equal(got: Tail, expected: Tail) -> None:
    for one, other in zip(got, expected, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("hz", [5.0, 10.0, 30.0, 60.0, 200.0])
@pytest.mark.parametrize("kind", ["free", "line", "still"])
def test_a_walk_without_jumps_stays_as_it_is_and_beyond_doubt(hz: float, kind: str) -> None:
    scene = Scene(seconds=60.0, walk=(kind,), rate_hz=1.0, track_rate_hz=hz, drift_m_per_sqrt_s=0.05)
    for track in simulate(scene).recording.tracks.values():
        stream = settled(track)
        tail = stream.tail(ALL)
        np.testing.assert_array_equal(tail.position, track.position)
        np.testing.assert_array_equal(tail.quat_xyzw, track.quat_xyzw)
        assert stream.suspicions == 0
        way = np.linalg.norm(np.diff(track.position, axis=0), axis=1)
        np.testing.assert_allclose(tail.travelled, np.concatenate([[0.0], np.cumsum(way)]), rtol=1e-12)


@pytest.mark.parametrize("hz", [10.0, 20.0, 60.0, 200.0])
@pytest.mark.parametrize("shift", [(0.0, 0.4, 0.0), (2.0, 0.0, 0.1)])
def test_a_jump_is_doubted_at_its_very_pose_and_undone_a_few_poses_later(
    hz: float, shift: tuple[float, float, float]
) -> None:
    true = walk(seconds=20.0, hz=hz, turning=0.3)
    pose = len(true) // 2
    stream = PoseStream(MODEL)
    for n, row in enumerate(rows_of(relocalised(true, pose, shift, yaw_quaternion(0.3)))):
        stream.add(*row)
        assert (stream.suspect is not None) == (pose <= n < pose + 4)
        if n == pose:
            assert stream.suspect is not None
            assert stream.suspect.t == true.t[pose]
            assert stream.suspect.distance == pytest.approx(np.linalg.norm(shift), abs=0.1)
    (event,) = stream.take_events()
    assert isinstance(event, Jump)
    assert (event.t, event.pose, event.turn) == pytest.approx((true.t[pose], pose, 0.3), abs=1e-6)
    assert stream.jumps == [event]
    tail = stream.tail(ALL)
    np.testing.assert_allclose(tail.position, true.position, atol=1e-3)
    assert angles_between(tail.quat_xyzw, true.quat_xyzw).max() < 1e-3


def test_poses_in_doubt_are_not_among_those_that_are_believed() -> None:
    k = 150
    track = relocalised(walk(10.0), k, (1.5, 0.4, 0.0))
    stream = fed(rows_of(track)[: k + 1])
    assert stream.suspect is not None
    assert stream.tail(ALL).t[-1] == track.t[k]
    assert_equal(stream.believed(ALL), Tail(*(column[:k] for column in stream.tail(ALL))))
    fed(rows_of(track)[k + 1 :], stream).settle()
    assert_equal(stream.believed(ALL), stream.tail(ALL))


def test_a_rebuilt_step_is_as_good_as_the_batch_has_it() -> None:
    own = simulate(Scene(users=2, seconds=20.0, seed=3)).recording.tracks["phone0"]
    track = relocalised(own, 300, (1.5, 0.4, 0.0), yaw_quaternion(0.5))
    assert PoseStream(MODEL).rebuilt_sigma == (np.inf, np.inf)
    stream = settled(track)
    assert stream.rebuilt_sigma == pytest.approx(repair_relocalizations(track, MODEL).rebuilt_sigma, rel=0.2)
    assert stream.repaired(ALL).rebuilt_sigma == stream.rebuilt_sigma


@pytest.mark.parametrize("metres", [0.13, 0.16])
def test_a_jump_that_one_side_does_not_show_is_found_within_half_a_second(metres: float) -> None:
    true = walk(seconds=20.0, turning=0.3)
    slam = relocalised(true, 200, (0.0, 0.0, metres))
    stream = PoseStream(MODEL)
    for row in rows_of(slam):
        stream.add(*row)
        if stream.jumps:
            break
    (jump,) = stream.jumps
    assert jump.pose == 200
    assert row[0] - jump.t < 0.8  # half a second, and the neighbours that the search needs
    fed(rows_of(slam)[len(stream) :], stream)
    stream.settle()
    assert_as_the_batch(stream, slam)


@pytest.mark.parametrize("speed", [0.0, 0.4, 1.5, 6.0])
@pytest.mark.parametrize("poses", [slice(100, 101), slice(100, 103), slice(100, 112)])
def test_an_attitude_that_comes_back_at_once_is_doubted_and_was_no_jump(speed: float, poses: slice) -> None:
    track = glitched(walk(hz=30.0, speed=speed), poses, yaw_quaternion(1.4))
    stream = settled(track)
    assert stream.suspicions == 1
    assert stream.take_events() == [Dismissed(track.t[100])]
    assert stream.suspect is None
    np.testing.assert_array_equal(stream.tail(ALL).quat_xyzw, track.quat_xyzw)


@pytest.mark.parametrize("turn", [1.2, -2.0])
def test_axes_that_turn_with_the_velocity_did_jump(turn: float) -> None:
    slam = relocalised(walk(turning=0.2), 100, (0.0, 0.0, 0.0), yaw_quaternion(turn))
    stream = settled(slam)
    assert poses_of(stream) == [100]
    assert_as_the_batch(stream, slam)


@pytest.mark.parametrize("apart", [1, 2, 3, 5, 9])
def test_jumps_close_to_one_another_are_told_apart(apart: int) -> None:
    once = relocalised(walk(turning=0.5), 100, (0.4, 0.0, 0.0), yaw_quaternion(0.3))
    slam = relocalised(once, 100 + apart, (-0.2, 0.3, 0.0), yaw_quaternion(-0.5))
    stream = settled(slam)
    assert poses_of(stream) == [100, 100 + apart]
    assert_as_the_batch(stream, slam)


@pytest.mark.parametrize("pose", [1, 2, 7, 197, 199])
def test_a_jump_at_either_end_is_found(pose: int) -> None:
    slam = relocalised(walk(turning=0.5), pose, (0.4, 0.0, 0.0), yaw_quaternion(0.3))
    stream = settled(slam)
    assert poses_of(stream) == [pose]
    assert_as_the_batch(stream, slam)


def test_gravity_that_was_lost_for_a_while_is_put_right_in_between_alone() -> None:
    tilt = about(1, 0.3)
    lost = relocalised(walk(turning=0.3), 80, (0.3, 0.0, 0.2), tilt)
    slam = relocalised(lost, 120, (0.0, 1.0, 0.0), about(1, -0.3))
    stream = settled(slam)
    assert_as_the_batch(stream, slam)
    assert not any(isinstance(event, Levelled) for event in stream.take_events())


def test_a_vertical_that_holds_longer_than_the_first_becomes_the_level_one() -> None:
    """From then on the track goes on as the batch has all of it, but for where the tilted beginning led."""
    slam = relocalised(walk(seconds=20.0, turning=0.3), 60, (0.3, 0.0, 0.2), about(0, 0.3))
    stream = settled(slam)
    (levelled,) = [event for event in stream.take_events() if isinstance(event, Levelled)]
    assert levelled.tilt == pytest.approx(0.3, abs=1e-6)
    assert 6.0 < levelled.t < 8.5
    expected, got = repair_relocalizations(slam, MODEL).track, stream.tail(levelled.t)
    batch = expected.position[-len(got.t) :]
    np.testing.assert_allclose(got.position[:, 2] + levelled.lift, batch[:, 2], atol=1e-6)
    apart = np.linalg.norm(got.position[0] - got.position, axis=1)
    np.testing.assert_allclose(apart, np.linalg.norm(batch[0] - batch, axis=1), atol=1e-6)


@settings(deadline=None, max_examples=25, derandomize=True)
@given(
    seed=st.integers(0, 10_000),
    hz=st.floats(10.0, 60.0),
    metres=st.floats(0.5, 5.0),
    turn=st.floats(0.0, 0.6),
    kind=st.sampled_from(["free", "still"]),
)
def test_random_jumps_after_the_first_poses_are_found_as_the_batch_finds_them(
    seed: int, hz: float, metres: float, turn: float, kind: str
) -> None:
    scene = Scene(
        seed=seed, seconds=20.0, walk=(kind,), rate_hz=1.0, track_rate_hz=hz, jumps=2, jump_m=metres, jump_rad=turn
    )
    for slam in simulate(scene).recording.tracks.values():
        expected = repair_relocalizations(slam, MODEL)
        if all(jump.pose > FEW for jump in expected.jumps):
            assert_as(expected, settled(slam), slam)


@with_recordings
@pytest.mark.parametrize(
    ("recording", "user"),
    [
        ("cmu_scott", "phone1"),
        ("cmu_scott", "phone2"),
        ("cmu_scott", "phone3"),
        ("tiers5_cora", "B"),
        ("tiers_case4_k7", "r5"),
        ("miluv_hist", "ifo001"),
        ("vub_exp2", "tb3"),
        ("vub_exp4", "tb2"),
    ],
)
def test_real_tracks_are_repaired_as_by_the_batch(recording: str, user: str) -> None:
    track = real(recording, user)
    stream = settled(track)
    assert_as_the_batch(stream, track)
    assert stream.suspicions <= len(stream.jumps) + 2


@with_recordings
def test_a_robot_whose_slam_began_without_gravity_goes_on_level() -> None:
    slam = real("vub_exp2", "tb2")
    stream = settled(slam)
    expected = repair_relocalizations(slam, MODEL)
    assert poses_of(stream) == [jump.pose for jump in expected.jumps]
    (levelled,) = [event for event in stream.take_events() if isinstance(event, Levelled)]
    got = stream.tail(levelled.t)
    batch = expected.track.position[-len(got.t) :]
    shift = got.position[:, 2] - batch[:, 2]
    np.testing.assert_allclose(shift, shift[0], atol=0.01)
    way, other = (np.linalg.norm(np.diff(p[:, :2], axis=0), axis=1) for p in (got.position, batch))
    np.testing.assert_allclose(way, other, atol=1e-6)


# Any order, forgetting, and what is kept


def late(rows: Sequence[Row], places: Sequence[int]) -> list[Row]:
    """The rows, each of those after the first 50 so many places later than it should come."""
    order = sorted(range(len(rows)), key=lambda n: (n + (places[n % len(places)] if n > 50 else 0), n))
    return [rows[n] for n in order]


@settings(deadline=None, max_examples=25)
@given(places=st.lists(st.integers(0, 6), min_size=1, max_size=20))
def test_any_order_of_arrival_gives_the_same_tail(places: list[int]) -> None:
    rows = rows_of(walk(hz=30.0, turning=0.5))
    assert_equal(fed(late(rows, places)).tail(ALL), fed(rows).tail(ALL))


@settings(deadline=None, max_examples=15)
@given(places=st.lists(st.sampled_from([0, 0, 0, 1, 2]), min_size=5, max_size=20))
def test_a_jump_among_poses_that_come_late_is_undone_all_the_same(places: list[int]) -> None:
    true = walk(hz=30.0, turning=0.5)
    stream = fed(late(rows_of(relocalised(true, 150, (1.0, 0.0, 0.0), yaw_quaternion(0.3))), places))
    stream.settle()
    tail = stream.tail(ALL)
    assert [jump.t for jump in stream.jumps] == [true.t[150]]
    np.testing.assert_allclose(tail.position, true.position, atol=0.01)


def test_of_two_poses_with_one_stamp_the_first_counts() -> None:
    rows = rows_of(walk())
    other = (rows[5][0], [9.0, 9.0, 9.0], [0.0, 0.0, 0.0, 1.0])
    stream = fed([*rows[:6], other, *rows[6:10], other])
    assert_equal(stream.tail(ALL), fed(rows[:10]).tail(ALL))
    assert stream.repeated == 2


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", range(8))
def test_what_is_no_number_is_left_out(wrong: float, place: int) -> None:
    rows = rows_of(walk())
    flat = [rows[10][0], *rows[10][1], *rows[10][2]]
    flat[place] = wrong
    stream = fed([*rows[:10], (flat[0], flat[1:4], flat[4:]), *rows[11:]])
    assert stream.faults == 1
    assert len(stream) == len(rows) - 1
    assert np.isfinite(stream.tail(ALL).position).all()


def test_attitudes_need_not_be_of_unit_length_but_have_some() -> None:
    stream = fed([(0.0, [0.0] * 3, [0.0, 0.0, 0.0, 2.0]), (0.1, [0.0] * 3, [0.0] * 4), (0.2, [0.0] * 3, [0, 3, 0, 4])])
    assert stream.faults == 1
    np.testing.assert_allclose(stream.tail(ALL).quat_xyzw, [[0, 0, 0, 1], [0, 0.6, 0, 0.8]])


@settings(deadline=None, max_examples=25)
@given(cut=st.integers(0, 299), pose=st.integers(30, 280), seed=st.integers(0, 100))
def test_a_stream_that_was_kept_goes_on_to_the_last_bit(cut: int, pose: int, seed: int) -> None:
    true = walk(hz=30.0, turning=0.5)
    noise = np.random.default_rng(seed).normal(0.0, 0.002, (300, 3))
    noisy = Track(true.t, true.position + noise, true.quat_xyzw)
    rows = rows_of(relocalised(noisy, pose, (1.0, 0.5, 0.0), yaw_quaternion(0.7)))
    rows[200] = (rows[200][0] + 86400.0, *rows[200][1:])
    stream = fed(rows[:cut])
    state = stream.state()
    assert all(isinstance(value, np.ndarray) for value in state.values())
    other = PoseStream.from_state(MODEL, state)
    untouched = fed(rows)
    for each in (stream, other):
        fed(rows[cut:], each)
        each.settle()
    untouched.settle()
    assert_equal(other.tail(ALL), untouched.tail(ALL))
    assert_equal(stream.tail(ALL), untouched.tail(ALL))
    for kept, expected in zip(other.state().values(), untouched.state().values(), strict=True):
        np.testing.assert_array_equal(kept, expected)
    assert other.take_events() == untouched.take_events()


def test_what_is_forgotten_changes_nothing_after_it() -> None:
    true = walk(seconds=60.0, hz=30.0, turning=0.5)
    slam = relocalised(true, 1200, (1.0, 0.0, 0.0), yaw_quaternion(0.4))
    stream, whole = PoseStream(MODEL), settled(slam)
    for n, row in enumerate(rows_of(slam)):
        stream.add(*row)
        if n % 30 == 0:
            stream.forget(row[0] - 5.0)
            assert len(stream) < 400
    stream.settle()
    assert_equal(stream.tail(56.0), whole.tail(56.0))
    assert stream.jumps == whole.jumps


def test_places_in_between_are_those_of_the_repaired_track() -> None:
    slam = relocalised(walk(hz=30.0, turning=0.5), 150, (1.0, 0.0, 0.0), yaw_quaternion(0.4))
    gap = without(slam, (slam.t < 6.0) | (slam.t > 8.0))
    stream = settled(gap)
    times = np.random.default_rng(0).uniform(-1.0, 11.0, 200)
    expected = repair_relocalizations(gap, MODEL).track.at(times, MODEL.slam.longest_pose_gap)
    got = stream.at(times)
    np.testing.assert_array_equal(got.valid, expected.valid)
    np.testing.assert_allclose(got.position[got.valid], expected.position[got.valid], atol=1e-9)
    assert angles_between(got.quat_xyzw[got.valid], expected.quat_xyzw[got.valid]).max() < 1e-7
    assert not stream.at(times[:0]).valid.size
    assert not PoseStream(MODEL).at(times).valid.any()


def test_axes_map_raw_poses_into_the_repaired_track() -> None:
    slam = relocalised(walk(turning=0.5), 100, (1.0, 0.0, 0.0), yaw_quaternion(0.4))
    stream = settled(slam)
    place, attitude = stream.current_axes().repaired(slam.position[150:], slam.quat_xyzw[150:])
    tail = stream.tail(slam.t[150])
    np.testing.assert_allclose(place, tail.position, atol=1e-12)
    assert angles_between(attitude, tail.quat_xyzw).max() < 1e-7
    last = stream.last()
    assert last is not None
    np.testing.assert_array_equal(last.position, tail.position[-1:])
    assert PoseStream(MODEL).last() is None


def test_a_stretch_is_told_as_a_track_of_its_own() -> None:
    once = relocalised(walk(turning=0.5), 80, (1.0, 0.0, 0.0), yaw_quaternion(0.4))
    stream = settled(relocalised(once, 140, (0.0, 1.0, 0.0), yaw_quaternion(-0.2)))
    stretch = stream.repaired(once.t[100])
    assert [(jump.t, jump.pose) for jump in stretch.jumps] == [(once.t[140], 40)]
    np.testing.assert_array_equal(stretch.segment, np.arange(100) >= 40)
    assert angles_between(stretch.repaired_from_slam[0], yaw_quaternion(-0.4)) < 0.01
    np.testing.assert_array_equal(stretch.level, [True, True])
    with pytest.raises(ValueError, match="n > 0"):
        stream.repaired(np.inf)


def test_a_jump_at_the_last_pose_is_mended_where_attitudes_tell_nothing() -> None:
    stream = PoseStream(MODEL)
    for n in range(61):
        stream.add(0.05 * n, (0.025 * n, 0.4 * (n == 60), 0.0), (0.0, 0.0, 0.0, 1.0))
    stream.settle()
    np.testing.assert_allclose(stream.tail(ALL).position[-1], [1.5, 0.0, 0.0], atol=1e-9)


odd = st.sampled_from([0.0, 1.0, 1e300, -1e308, 5e-324, np.nan, np.inf]) | st.floats(-1e3, 1e3)


@settings(deadline=None, max_examples=60)
@given(
    steps=st.lists(st.sampled_from([0.05] * 8 + [0.0, -0.05, 1e-9, 1e-300, 3.0, 20.0, -1e5, np.nan]), min_size=60),
    strange=st.dictionaries(st.integers(0, 59), st.tuples(*[odd] * 7), max_size=12),
)
def test_whatever_comes_is_read_without_a_fault_of_ours(
    steps: list[float], strange: dict[int, tuple[float, ...]]
) -> None:
    stream, t = PoseStream(MODEL), 0.0
    for n, step in enumerate(steps):
        pose = strange.get(n, (0.05 * n, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
        stream.add(t + step, pose[:3], pose[3:])
        t += step if np.isfinite(step) else 0.0
        if n % 20 == 19:
            stream.at(np.array([t - 0.3, t]))
            stream.forget(t - 0.5)
    stream.settle()
    tail = stream.tail(ALL)
    assert len(tail.t) == len(stream) <= len(steps)
    assert all(np.isfinite(each).all() for each in tail)
    assert (np.diff(tail.t) > 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(tail.quat_xyzw, axis=1), 1.0, atol=1e-9)


# Stray stamps and frozen poses


@pytest.mark.parametrize("away", [86400.0, -86400.0, 20.0])
@pytest.mark.parametrize("place", [1, 5, 150])
def test_one_pose_stamped_far_away_is_set_aside(away: float, place: int) -> None:
    rows = rows_of(walk(hz=30.0))
    wrong = (rows[place][0] + away, *rows[place][1:])
    stream = fed([*rows[:place], wrong, *rows[place + 1 :]])
    assert_equal(stream.tail(ALL), fed(rows[:place] + rows[place + 1 :]).tail(ALL))
    assert stream.take_events() == [SetAside(wrong[0], wrong[0], 1, "stray")]


@pytest.mark.parametrize("first", [0.0, 3e9])
def test_a_first_pose_stamped_otherwise_than_the_rest_is_set_aside(first: float) -> None:
    rows = [(t + 1.7e9, *pose) for t, *pose in rows_of(walk(hz=30.0))]
    stream = fed([(first, *rows[0][1:]), *rows])
    assert_equal(stream.tail(ALL), fed(rows).tail(ALL))
    assert stream.take_events() == [SetAside(first, first, 1, "stray")]
    assert stream.set_aside == 1


def test_a_gap_is_no_stray_stamp() -> None:
    track = walk(seconds=60.0)
    rows = rows_of(without(track, (track.t < 20.0) | (track.t > 45.0)))
    stream = fed(rows)
    assert len(stream) == len(rows)
    assert stream.take_events() == []


@with_cases
@pytest.mark.parametrize("case", ["future_one", "zero_first"])
def test_cases_of_stray_stamps_are_seen_as_in_the_whole_track(case: str) -> None:
    for file in sorted((CASES / case / "tracks").glob("*.tum")):
        lines = [[float(word) for word in line.split()] for line in file.read_text().splitlines()]
        stream = fed([(line[0], line[1:4], line[4:]) for line in lines])
        stray = stray_poses(read_tum(file), MODEL)
        assert stream.set_aside == stray.sum()
        np.testing.assert_array_equal(stream.tail(ALL).t, read_tum(file).t[~stray])


@with_cases
def test_frozen_poses_are_doubted_and_leave_a_gap() -> None:
    for file in sorted((CASES / "frozen" / "tracks").glob("*.tum")):
        track = read_tum(file)
        frozen = frozen_poses(track, MODEL)
        stream, doubted = PoseStream(MODEL), []
        for row in rows_of(track):
            stream.add(*row)
            doubted.append(stream.suspect is not None)
        kept = without(track, ~frozen)
        np.testing.assert_array_equal(stream.tail(ALL).t, kept.t)
        np.testing.assert_array_equal(stream.tail(ALL).position, kept.position)
        assert stream.set_aside == frozen.sum()
        late = frozen & np.concatenate([np.zeros(40, dtype=bool), frozen[:-40]])  # 0.6 s and more into a stretch
        assert np.array(doubted)[late].all() or track.t[40] > 2.0
        assert not np.array(doubted)[~frozen].any()


def test_slam_that_froze_has_paused_and_one_that_stood_has_not() -> None:
    track = walk(hz=30.0)
    position = track.position.copy()
    position[100:200] = position[100]
    stands = position.copy()
    stands[200:] -= stands[200] - stands[100]
    goes_on = settled(Track(track.t, position, track.quat_xyzw))
    assert goes_on.set_aside > 0
    assert goes_on.resumed_at == track.t[200]
    assert settled(Track(track.t, stands, track.quat_xyzw)).resumed_at == -np.inf


def test_a_device_that_stops_dead_is_doubted_and_then_believed() -> None:
    track = walk(hz=30.0)
    position = track.position.copy()
    position[100:200] = position[100]
    position[200:] -= position[200] - position[100]
    stream = settled(Track(track.t, position, track.quat_xyzw))
    np.testing.assert_array_equal(stream.tail(ALL).position, position)
    assert [type(event) for event in stream.take_events()] == [Dismissed]


def test_a_device_that_stands_still_throughout_is_beyond_doubt() -> None:
    track = walk(speed=0.0)
    stream = settled(track)
    assert stream.suspicions == 0
    assert len(stream) == len(track)


def test_stamps_rise_and_ways_grow() -> None:
    tail = settled(relocalised(walk(turning=0.5), 100, (5.0, 0.0, 0.0), about(2, 0.4))).tail(2.0)
    assert all(later > earlier for earlier, later in pairwise(tail.t.tolist()))
    assert np.diff(tail.travelled).min() >= 0.0
    way: Array = np.linalg.norm(np.diff(tail.position, axis=0), axis=1)
    np.testing.assert_allclose(np.diff(tail.travelled), way, atol=1e-9)


def test_poses_at_times_are_interpolated_as_those_of_a_track() -> None:
    random = np.random.default_rng(7)
    stamps = np.cumsum(random.uniform(0.02, 0.3, 50))
    stamps[30:] += 3.0  # a gap
    quat = normalized_quaternions(random.normal(size=(50, 4)))
    table = np.column_stack([random.normal(size=50), stamps, random.normal(size=(50, 3)), quat])
    t = np.concatenate([random.uniform(stamps[0] - 0.5, stamps[-1] + 0.5, 200), stamps])
    expected = interpolated(stamps, table[:, 2:5], quat, t, 0.5)
    position, attitude, valid = poses_at(table, (1, 2, 5), t, 0.5)
    np.testing.assert_array_equal(valid, expected.valid)
    np.testing.assert_allclose(position, expected.position, atol=1e-14)
    np.testing.assert_allclose(attitude, expected.quat_xyzw, atol=1e-14)
    with pytest.raises(ValueError, match="no such column"):
        poses_at(table, (1, 2, 6), t, 0.5)


def test_ranges_are_read_by_their_ends_as_poses_at_their_times_say() -> None:
    random = np.random.default_rng(5)
    parameters = Parameters()
    longest, reach = parameters.slam.longest_pose_gap, VELOCITY_REACH
    streams: list[PoseStream | None] = [PoseStream(parameters), None, PoseStream(parameters), PoseStream(parameters)]
    clocks = np.array([0.3, 0.0, -0.2, 0.0])
    for u in (0, 2):
        stream = streams[u]
        assert stream is not None
        for t in np.arange(0.0, 3.0, 1.0 / 30.0).tolist():
            place = (math.sin(t + u), t, 0.1 * math.cos(3.0 * t))
            stream.add(
                float(clocks[u]) + t, place, normalized_quaternions(np.array([[0.1 * t, 0.2, 0.3, 1.0]]))[0].tolist()
            )
    t = random.uniform(-0.05, 3.1, 60)
    users = np.array([random.choice(4, 2, replace=False) for _ in t], dtype=np.int32)
    levers, wanted = random.normal(0.0, 0.2, (60, 2, 3)), random.uniform(size=60) < 0.8
    ends, known = ends_of_ranges(streams, clocks, t, users, levers, wanted, longest)
    for n in range(60):
        there = bool(wanted[n])
        for end in range(2):
            u = int(users[n, end])
            stream = streams[u]
            if stream is None:
                np.testing.assert_array_equal(ends[n, end], 0.0)
                continue
            at = t[n] + clocks[u]
            poses = stream.at(np.array([at, at - reach, min(at + reach, max(stream.newest, at))]))
            there = there and bool(poses.valid[0])
            if not there:
                continue
            arms = rotate_by_quaternions(poses.quat_xyzw, np.tile(levers[n, end], (3, 1)))
            antennas = poses.position + arms
            stamps = np.array([at, at - reach, min(at + reach, max(stream.newest, at))])
            begin, until = 1 if poses.valid[1] else 0, 2 if poses.valid[2] else 0
            velocity = (antennas[until] - antennas[begin]) / max(stamps[until] - stamps[begin], 1e-3)
            np.testing.assert_allclose(ends[n, end], [poses.position[0], arms[0], velocity], atol=1e-9)
        assert known[n] == there
    assert 10 < known.sum() < 50


def test_ranges_of_users_and_levers_that_are_not_there_are_refused() -> None:
    streams: list[PoseStream | None] = [None, None]
    t, users = np.zeros(1), np.array([[0, 2]], dtype=np.int32)
    with pytest.raises(ValueError, match="user"):
        ends_of_ranges(streams, np.zeros(2), t, users, np.zeros((1, 2, 3)), np.ones(1, dtype=bool), 1.0)
    with pytest.raises(ValueError, match="levers"):
        ends_of_ranges(streams, np.zeros(2), t, users // 2, np.zeros((2, 2, 3)), np.ones(1, dtype=bool), 1.0)
