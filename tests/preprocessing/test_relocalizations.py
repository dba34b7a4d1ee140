from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from support.relocalised import about, glitched, real, relocalised, walk, with_recordings, without

from synchronizar.arrays import Array
from synchronizar.data.track import Track
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.relocalizations import RepairedTrack, repair_relocalizations
from synchronizar.quaternions import multiply_quaternions, rotate_by_quaternions, yaw_quaternion
from synchronizar.simulation.simulate import Scene, simulate

MODEL = Parameters()
UP = np.array([0.0, 0.0, 1.0])
DEGREE = np.pi / 180.0


def inverse(q: Array) -> Array:
    return np.asarray(q * np.array([-1.0, -1.0, -1.0, 1.0]))


def angle(q: Array) -> Array:
    return np.asarray(2.0 * np.arctan2(np.linalg.norm(q[..., :3], axis=-1), np.abs(q[..., 3])))


def poses_of(repaired_tracks: RepairedTrack) -> list[int]:
    return [jump.pose for jump in repaired_tracks.jumps]


def assert_same(repaired_tracks: Track, true: Track, metres: float = 1e-6, radians: float = 1e-6) -> None:
    np.testing.assert_array_equal(repaired_tracks.t, true.t)
    assert np.linalg.norm(repaired_tracks.position - true.position, axis=1).max() < metres
    assert angle(multiply_quaternions(inverse(repaired_tracks.quat_xyzw), true.quat_xyzw)).max() < radians


@pytest.mark.parametrize("hz", [10.0, 20.0, 60.0, 200.0])
def test_a_jump_of_a_straight_walk_is_found_and_undone(hz: float) -> None:
    true = walk(hz=hz)
    pose = len(true) // 2
    repaired_tracks = repair_relocalizations(relocalised(true, pose, (0.0, 0.2, 0.0)), MODEL)
    (jump,) = repaired_tracks.jumps
    assert (jump.t, jump.pose) == (true.t[pose], pose)
    assert (jump.distance, jump.turn, jump.tilt) == pytest.approx((0.2, 0.0, 0.0), abs=1e-6)
    np.testing.assert_array_equal(repaired_tracks.segment, np.arange(len(true)) >= pose)
    assert_same(repaired_tracks.track, true)


@pytest.mark.parametrize("turn", [0.3, -1.0, 3.0])
def test_where_slam_s_heading_jumped_too_the_path_goes_on_as_it_did(turn: float) -> None:
    true = walk(turning=0.5)
    repaired_tracks = repair_relocalizations(relocalised(true, 90, (0.5, -1.0, 0.1), yaw_quaternion(turn)), MODEL)
    (jump,) = repaired_tracks.jumps
    assert jump.distance == pytest.approx(np.linalg.norm([0.5, -1.0, 0.1]), abs=1e-6)
    assert (jump.pose, jump.turn, jump.tilt) == pytest.approx((90, turn, 0.0), abs=1e-6)
    assert_same(repaired_tracks.track, true)
    np.testing.assert_allclose(angle(repaired_tracks.repaired_from_slam), [0.0, abs(turn)], atol=1e-6)


@pytest.mark.parametrize("pose", [40, 160])
def test_the_vertical_that_held_longer_is_the_level_one(pose: int) -> None:
    true = walk(turning=0.3)
    tilt = about(0, 13.0 * DEGREE)
    repaired_tracks = repair_relocalizations(relocalised(true, pose, (0.3, 0.0, 0.2), tilt), MODEL)
    (jump,) = repaired_tracks.jumps
    assert (jump.pose, jump.tilt) == pytest.approx((pose, 13.0 * DEGREE), abs=1e-6)
    assert jump.turn == pytest.approx(0.0, abs=1e-6)
    if pose == 160:  # SLAM lost gravity at the end
        np.testing.assert_array_equal(repaired_tracks.level, [True, False])
        assert_same(repaired_tracks.track, true)
    else:  # it had not found it at the beginning: all turns until what followed is level
        np.testing.assert_array_equal(repaired_tracks.level, [False, True])
        straightened = inverse(tilt)
        np.testing.assert_allclose(angle(repaired_tracks.repaired_from_slam), [13.0 * DEGREE, 0.0], atol=1e-6)
        expected = rotate_by_quaternions(tilt, true.position - true.position[0])
        # SLAM has the first level pose 0.2 m up; what was before tells no heights.
        expected[:, 2] = 0.2 + np.where(np.arange(len(true)) < pose, 0.0, expected[:, 2] - expected[pose, 2])
        np.testing.assert_allclose(repaired_tracks.track.position, expected, atol=1e-6)
        assert angle(multiply_quaternions(repaired_tracks.repaired_from_slam[0], straightened)) < 1e-6


def test_gravity_that_was_lost_for_a_while_is_put_right_in_between_alone() -> None:
    true = walk(turning=0.3)
    tilt = multiply_quaternions(about(2, 0.4), about(1, 0.3))
    tilted = relocalised(relocalised(true, 80, (0.3, 0.0, 0.2), tilt), 120, (0.0, 1.0, 0.0), inverse(tilt))
    repaired_tracks = repair_relocalizations(tilted, MODEL)
    assert poses_of(repaired_tracks) == [80, 120]
    assert [jump.tilt for jump in repaired_tracks.jumps] == pytest.approx([0.3, 0.3], abs=1e-6)
    assert_same(repaired_tracks.track, true)


def climbing(track: Track, speed: float) -> Track:
    """The same, going up (m/s) besides, from 1 m."""
    return replace(track, position=track.position + np.outer(1.0 + speed * track.t, UP))


def test_without_gravity_steps_tell_no_heights() -> None:
    true = climbing(walk(turning=0.3), 0.2)
    tilt = about(1, 0.3)
    lost = relocalised(relocalised(true, 80, (0.3, 0.0, 0.2), tilt), 120, (0.0, 1.0, 0.0), inverse(tilt))
    repaired_tracks = repair_relocalizations(lost, MODEL)
    np.testing.assert_array_equal(repaired_tracks.level, [True, False, True])
    heights = repaired_tracks.track.position[:, 2]
    np.testing.assert_allclose(heights[:81], true.position[:81, 2], atol=1e-6)
    np.testing.assert_allclose(heights[80:121], true.position[80, 2], atol=1e-6)
    np.testing.assert_allclose(np.diff(heights[120:]), np.diff(true.position[120:, 2]), atol=1e-6)
    np.testing.assert_allclose(repaired_tracks.track.position[:, :2], true.position[:, :2], atol=1e-6)


def test_heights_begin_where_slam_has_its_first_level_pose() -> None:
    """Gravity is not known at the beginning: only from the second jump on are heights SLAM's own, and as they are."""
    true = climbing(walk(seconds=20.0, turning=0.3), 0.2)
    slam = relocalised(relocalised(true, 40, (0.0, 0.0, 0.0), about(0, -0.5)), 70, (0.0, 0.6, 0.4), about(0, 0.5))
    slam = relocalised(slam, 100, (0.0, 0.0, 0.7), yaw_quaternion(0.4))
    # From the first level pose on, SLAM's axes are those of the true walk again: take the beginning's away from it.
    begun = relocalised(true, 0, (0.0, 0.0, 0.0), about(1, 0.5))
    track = replace(
        slam,
        position=np.vstack([begun.position[:40], slam.position[40:]]),
        quat_xyzw=np.vstack([begun.quat_xyzw[:40], slam.quat_xyzw[40:]]),
    )
    repaired_tracks = repair_relocalizations(track, MODEL)
    np.testing.assert_array_equal(repaired_tracks.level, [False, False, True, True])
    heights = repaired_tracks.track.position[:, 2]
    np.testing.assert_allclose(heights[:71], track.position[70, 2], atol=1e-6)
    np.testing.assert_allclose(heights[70:100], track.position[70:100, 2], atol=1e-6)
    np.testing.assert_allclose(np.diff(heights[70:]), np.diff(true.position[70:, 2]), atol=1e-6)
    np.testing.assert_array_equal(repaired_tracks.track.position[0, :2], track.position[0, :2])


def test_a_heading_that_jumped_leaves_slam_level() -> None:
    slam = relocalised(climbing(walk(turning=0.3), 0.2), 60, (0.5, 0.0, 0.3), yaw_quaternion(0.8))
    np.testing.assert_array_equal(repair_relocalizations(slam, MODEL).level, [True, True])
    np.testing.assert_array_equal(repair_relocalizations(walk(), MODEL).level, [True])


def test_a_tilt_as_small_as_noise_leaves_gravity_as_slam_says() -> None:
    slam = relocalised(walk(turning=0.3), 60, (0.5, 0.0, 0.0), about(1, 2.0 * DEGREE))
    repaired_tracks = repair_relocalizations(slam, MODEL)
    (jump,) = repaired_tracks.jumps
    assert jump.tilt == 0.0
    assert repaired_tracks.level.all()
    vertical = rotate_by_quaternions(repaired_tracks.repaired_from_slam, UP)
    np.testing.assert_allclose(vertical, [UP, UP], atol=1e-12)


def test_many_small_tilts_do_not_add_up() -> None:
    slam = walk(seconds=30.0)
    for pose in range(50, 600, 50):
        slam = relocalised(slam, pose, (0.0, 0.4, 0.0), about(0, 3.0 * DEGREE))
    repaired_tracks = repair_relocalizations(slam, MODEL)
    assert len(repaired_tracks.jumps) == 11
    np.testing.assert_allclose(
        rotate_by_quaternions(repaired_tracks.repaired_from_slam, UP), np.tile(UP, (12, 1)), atol=1e-12
    )


@pytest.mark.parametrize("speed", [0.0, 0.4, 1.5, 6.0])
@pytest.mark.parametrize("poses", [slice(100, 101), slice(100, 103), slice(100, 112)])
@pytest.mark.parametrize("turn", [0.7, 1.4, -2.5])
def test_an_attitude_that_comes_back_at_once_was_no_jump(speed: float, poses: slice, turn: float) -> None:
    track = glitched(walk(hz=30.0, speed=speed), poses, yaw_quaternion(turn))
    assert repair_relocalizations(track, MODEL).track is track


def test_an_attitude_that_stays_wrong_was_no_jump_where_the_path_goes_on() -> None:
    track = glitched(walk(turning=0.2), slice(100, None), yaw_quaternion(1.2))
    assert repair_relocalizations(track, MODEL).track is track


def test_a_position_that_jumps_with_an_attitude_gone_wrong_does_not_turn_the_path() -> None:
    true = walk(turning=0.2)
    slam = relocalised(glitched(true, slice(100, None), yaw_quaternion(1.2)), 100, (0.0, 0.0, 0.6))
    repaired_tracks = repair_relocalizations(slam, MODEL)
    assert poses_of(repaired_tracks) == [100]
    np.testing.assert_allclose(repaired_tracks.repaired_from_slam, np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)), atol=1e-9)
    np.testing.assert_allclose(repaired_tracks.track.position, true.position, atol=0.02)


def test_axes_that_turn_with_the_velocity_did_jump_though_the_position_did_not() -> None:
    true = walk(turning=0.2)
    repaired_tracks = repair_relocalizations(relocalised(true, 100, (0.0, 0.0, 0.0), yaw_quaternion(1.2)), MODEL)
    (jump,) = repaired_tracks.jumps
    assert (jump.pose, jump.turn) == pytest.approx((100, 1.2), abs=1e-6)
    assert_same(repaired_tracks.track, true)


def test_axes_that_turn_for_good_under_a_device_at_rest_did_jump() -> None:
    true = walk(speed=0.0)
    repaired_tracks = repair_relocalizations(relocalised(true, 100, (0.0, 0.0, 0.0), yaw_quaternion(-1.0)), MODEL)
    assert [(jump.pose, jump.turn) for jump in repaired_tracks.jumps] == [(100, pytest.approx(-1.0))]
    assert_same(repaired_tracks.track, true)


@pytest.mark.parametrize("hz", [5.0, 10.0, 20.0, 30.0, 60.0, 200.0])
def test_a_hand_that_turns_a_phone_at_ten_radians_a_second_makes_no_jump(hz: float) -> None:
    t = np.arange(0.0, 20.0, 1.0 / hz)
    yaw = 10.0 / (2.0 * np.pi) * np.sin(2.0 * np.pi * t)
    arm = 0.1 * np.column_stack([np.cos(yaw), np.sin(yaw), 0.0 * yaw])
    track = Track(t, arm, np.array([yaw_quaternion(each) for each in yaw.tolist()]))
    assert repair_relocalizations(track, MODEL).jumps == ()


def test_a_phone_that_is_turned_between_two_poses_makes_no_jump() -> None:
    track = glitched(walk(hz=10.0, speed=0.0), slice(50, None), yaw_quaternion(0.9))
    assert repair_relocalizations(track, MODEL).track is track


def test_what_was_before_a_long_gap_says_nothing_of_what_is_after() -> None:
    t = np.concatenate([np.arange(50) * 0.1, 15.0 + np.arange(4) * 0.1, 25.0 + np.arange(50) * 0.1])
    x = np.where(t > 15.05, 0.2, 0.0)  # it stands but for a moment, of which there are too few poses to tell
    track = Track(t, np.column_stack([x, 0.0 * x, 0.0 * x]), np.tile(yaw_quaternion(0.0), (len(t), 1)))
    assert repair_relocalizations(track, MODEL).track is track


@pytest.mark.parametrize("hz", [5.0, 10.0, 30.0, 200.0])
def test_a_robot_that_starts_and_stops_makes_no_jump(hz: float) -> None:
    t = np.arange(0.0, 30.0, 1.0 / hz)
    speed = np.where(t % 3.0 < 1.7, 1.5, 0.0)
    position = np.column_stack([np.cumsum(speed) / hz, 0.0 * t, 0.0 * t])
    track = Track(t, position, np.tile(yaw_quaternion(0.0), (len(t), 1)))
    assert repair_relocalizations(track, MODEL).jumps == ()


@pytest.mark.parametrize("hz", [10.0, 30.0, 100.0])
@pytest.mark.parametrize("jitter", [0.003, 0.02, 0.08])
def test_jitter_and_dropped_poses_make_no_jump(hz: float, jitter: float) -> None:
    random = np.random.default_rng(0)
    true = walk(seconds=60.0, hz=hz, turning=0.7)
    wobble = np.column_stack([0.25 * jitter * random.standard_normal((len(true), 3)), np.ones(len(true))])
    wobble /= np.linalg.norm(wobble, axis=1, keepdims=True)
    q = multiply_quaternions(true.quat_xyzw, wobble)
    position = true.position + jitter * random.standard_normal((len(true), 3))
    jittery = Track(true.t, position, q / np.linalg.norm(q, axis=1, keepdims=True))
    kept = (random.uniform(size=len(true)) > 0.1) & (true.t % 7.0 > 0.5)
    assert repair_relocalizations(without(jittery, kept), MODEL).jumps == ()


def test_two_poses_stamped_a_tenth_of_a_millisecond_apart_make_no_jump() -> None:
    track = walk(hz=30.0)
    t = track.t.copy()
    t[150] = t[149] + 1e-4
    assert repair_relocalizations(replace(track, t=t), MODEL).jumps == ()


def test_a_gap_is_walked_through_and_a_jump_beside_it_found() -> None:
    true = walk(hz=30.0, turning=0.5)
    kept = (np.arange(300) < 100) | (np.arange(300) >= 115)
    assert repair_relocalizations(without(true, kept), MODEL).jumps == ()
    for pose in (99, 116):
        repaired_tracks = repair_relocalizations(
            without(relocalised(true, pose, (0.0, 0.3, 0.0), yaw_quaternion(0.2)), kept), MODEL
        )
        assert [jump.t for jump in repaired_tracks.jumps] == [true.t[pose]]
        assert_same(repaired_tracks.track, without(true, kept), metres=0.05)


@pytest.mark.parametrize("apart", [1, 2, 3, 5])
def test_jumps_close_to_one_another_are_told_apart(apart: int) -> None:
    true = walk(turning=0.5)
    once = relocalised(true, 100, (0.4, 0.0, 0.0), yaw_quaternion(0.3))
    repaired_tracks = repair_relocalizations(
        relocalised(once, 100 + apart, (-0.2, 0.3, 0.0), yaw_quaternion(-0.5)), MODEL
    )
    assert poses_of(repaired_tracks) == [100, 100 + apart]
    assert_same(repaired_tracks.track, true)


@pytest.mark.parametrize("turn", [0.3, 1.3])
@pytest.mark.parametrize("pose", [1, 2, 197, 199])
def test_a_jump_at_either_end_is_found(pose: int, turn: float) -> None:
    true = walk(turning=0.5)
    repaired_tracks = repair_relocalizations(relocalised(true, pose, (0.4, 0.0, 0.0), yaw_quaternion(turn)), MODEL)
    assert poses_of(repaired_tracks) == [pose]
    assert_same(repaired_tracks.track, true)


@pytest.mark.parametrize("pose", [1, 60])
def test_a_jump_at_either_end_is_mended_where_attitudes_tell_nothing(pose: int) -> None:
    t = 0.05 * np.arange(61)
    position = np.column_stack([0.5 * t, np.zeros((61, 2))])
    position[pose:] += [0.0, 0.4, 0.0]
    repaired = repair_relocalizations(Track(t, position, np.tile([0.0, 0.0, 0.0, 1.0], (61, 1))), Parameters())
    assert len(repaired.jumps) == 1
    np.testing.assert_allclose(np.diff(repaired.track.position, axis=0), [[0.025, 0.0, 0.0]] * 60, atol=1e-9)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_a_few_poses_tell_of_no_jump(count: int) -> None:
    t = np.arange(count, dtype=float) / 10.0
    track = Track(t, 5.0 * np.column_stack([t > 0.05, t, t]), np.tile(yaw_quaternion(0.0), (count, 1)))
    repaired_tracks = repair_relocalizations(track, MODEL)
    assert repaired_tracks.track is track
    assert repaired_tracks.jumps == ()
    np.testing.assert_array_equal(repaired_tracks.segment, np.zeros(count))
    np.testing.assert_array_equal(repaired_tracks.repaired_from_slam, [[0.0, 0.0, 0.0, 1.0]])


@settings(deadline=None, max_examples=30)
@given(
    seed=st.integers(0, 10_000),
    hz=st.floats(10.0, 60.0),
    metres=st.floats(0.3, 5.0),
    turn=st.floats(0.0, 0.6),
    kind=st.sampled_from(["free", "still"]),
)
@example(seed=470, hz=10.0, metres=1.0, turn=0.0, kind="free")
def test_random_jumps_are_all_found_and_mended(seed: int, hz: float, metres: float, turn: float, kind: str) -> None:
    scene = Scene(
        seed=seed, seconds=20.0, walk=(kind,), rate_hz=1.0, track_rate_hz=hz, jumps=2, jump_m=metres, jump_rad=turn
    )
    simulation = simulate(scene)
    for name, slam in simulation.recording.tracks.items():
        true = simulation.truth[name]
        step_error = rotate_by_quaternions(inverse(slam.quat_xyzw[:-1]), np.diff(slam.position, axis=0))
        step_error -= rotate_by_quaternions(inverse(true.quat_xyzw[:-1]), np.diff(true.position, axis=0))
        distance = np.linalg.norm(step_error, axis=1)
        planted = np.flatnonzero(distance > 0.05) + 1
        assume((distance[planted - 1] > 0.29).all())  # two that fall on one step may undo one another

        repaired_tracks = repair_relocalizations(slam, MODEL)
        assert poses_of(repaired_tracks) == planted.tolist()
        # Of every step, its way and its turn, each in its own body axes, are those of the truth.
        got, expected = repaired_tracks.track, true
        way = rotate_by_quaternions(inverse(got.quat_xyzw[:-1]), np.diff(got.position, axis=0))
        true_way = rotate_by_quaternions(inverse(expected.quat_xyzw[:-1]), np.diff(expected.position, axis=0))
        # The first step and the last are known from one side alone.
        most = np.full(len(way), 0.1)
        most[[0, -1]] = 0.3
        assert (np.linalg.norm(way - true_way, axis=1) < most).all()
        turned = multiply_quaternions(inverse(got.quat_xyzw[:-1]), got.quat_xyzw[1:])
        true_turned = multiply_quaternions(inverse(expected.quat_xyzw[:-1]), expected.quat_xyzw[1:])
        assert (angle(multiply_quaternions(inverse(turned), true_turned)) < most).all()

        # Each piece is carried along as it is; the first stays where SLAM has it.
        np.testing.assert_array_equal(got.position[0], slam.position[0])
        attitude = multiply_quaternions(repaired_tracks.repaired_from_slam[repaired_tracks.segment], slam.quat_xyzw)
        assert angle(multiply_quaternions(inverse(attitude), got.quat_xyzw)).max() < 1e-6
        for piece in range(len(repaired_tracks.jumps) + 1):
            own = repaired_tracks.segment == piece
            carried = rotate_by_quaternions(repaired_tracks.repaired_from_slam[piece], slam.position[own])
            assert np.ptp(got.position[own] - carried, axis=0).max() < 1e-9


@pytest.mark.parametrize("hz", [5.0, 12.0, 30.0, 120.0])
@pytest.mark.parametrize("kind", ["free", "line", "still"])
def test_drift_alone_makes_no_jump(hz: float, kind: str) -> None:
    scene = Scene(
        seconds=60.0,
        walk=(kind,),
        rate_hz=1.0,
        track_rate_hz=hz,
        scale_sigma=0.1,
        drift_m_per_sqrt_s=0.05,
        drift_rad_per_sqrt_s=0.02,
    )
    for track in simulate(scene).recording.tracks.values():
        assert repair_relocalizations(track, MODEL).track is track


def rmse_xy(track: Track, truth: Track) -> float:
    """After the best yaw, translation and scale in the plane, as complex numbers."""
    there = truth.at(track.t, 0.5)
    a, b = ((p[there.valid] - p[there.valid].mean(axis=0)) @ [1.0, 1j, 0.0] for p in (track.position, there.position))
    factor = np.vdot(a, b) / np.vdot(a, a)
    return float(np.sqrt(np.mean(np.abs(factor * a - b) ** 2)))


@with_recordings
@pytest.mark.parametrize(
    ("recording", "users"),
    [
        ("vub_exp4", "tb2 tb3"),
        ("tiers5_cora", "A B C D"),
        ("miluv_hist", "ifo001 ifo002 ifo003"),
        ("tiers_case4_k7", "r1 r2 r3 r4 r5 r6 r7"),
    ],
)
def test_recordings_without_jumps_show_none(recording: str, users: str) -> None:
    for user in users.split():
        track = real(recording, user)
        assert repair_relocalizations(track, MODEL).track is track


@with_recordings
def test_a_robot_whose_slam_relocalised_five_times_gets_its_walk_back() -> None:
    slam, truth = real("vub_exp2", "tb2"), real("vub_exp2", "tb2", "truth")
    repaired_tracks = repair_relocalizations(slam, MODEL)
    assert [jump.t for jump in repaired_tracks.jumps] == pytest.approx(
        [4.2, 4.3, 29.1, 87.4, 87.5, 88.0, 89.4], abs=1e-3
    )
    distances = [jump.distance for jump in repaired_tracks.jumps]
    assert distances == pytest.approx([0.26, 0.13, 3.71, 0.07, 0.19, 0.16, 1.08], abs=0.03)
    assert rmse_xy(slam, truth) > 0.7
    assert rmse_xy(repaired_tracks.track, truth) < 0.12


@with_recordings
def test_a_robot_whose_slam_began_without_gravity_is_level_from_the_start() -> None:
    slam = real("vub_exp2", "tb2")
    repaired_tracks = repair_relocalizations(slam, MODEL)
    assert [round(jump.tilt, 2) for jump in repaired_tracks.jumps] == [1.54] + 6 * [0.0]
    # The robot drives on a floor, so the vertical in its body's axes never changes.
    vertical = rotate_by_quaternions(inverse(repaired_tracks.track.quat_xyzw), UP)
    begun = (slam.t > 2.0) & (slam.t < 4.15)
    late = np.median(vertical[slam.t > 10.0], axis=0)
    late /= np.linalg.norm(late)
    assert np.arccos(vertical[begun] @ late).max() < 4.0 * DEGREE
    assert np.ptp(repaired_tracks.track.position[begun, 2]) < 0.02 < 0.09 < np.ptp(slam.position[begun, 2])


@with_recordings
@pytest.mark.parametrize(
    ("user", "known"),
    [
        ("phone0", [(16.991, 1.38), (24.989, 0.18), (79.144, 0.17), (168.180, 0.19), (192.774, 0.23)]),
        ("phone1", [(71.912, 0.18), (83.810, 0.24)]),
        ("phone2", [(6.989, 0.31), (66.579, 0.34), (104.371, 0.42)]),
        ("phone3", [(14.673, 0.64), (23.020, 0.27), (70.311, 0.45)]),
    ],
)
def test_the_jumps_of_phones_in_a_hall_are_found(user: str, known: list[tuple[float, float]]) -> None:
    found = {round(jump.t, 3): jump.distance for jump in repair_relocalizations(real("cmu_scott", user), MODEL).jumps}
    for t, distance in known:
        assert found.pop(t) == pytest.approx(distance, abs=0.03)
    assert all(distance < 0.18 for distance in found.values())
    assert len(found) <= 5
