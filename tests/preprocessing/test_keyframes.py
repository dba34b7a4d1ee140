from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.solver_scenes import recording_of

from synchronizar.arrays import Array, Indices
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.geometry import rotation_2d
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.keyframes import STATIC_KEYFRAME, Keyframes, RangeEnds, keyframes_of, range_ends
from synchronizar.preprocessing.range_measurements import RangeMeasurements
from synchronizar.preprocessing.relocalizations import RepairedTrack
from synchronizar.quaternions import yaw_of_quaternions, yaw_quaternion
from synchronizar.simulation.simulate import Scene, simulate

MODEL = Parameters().changed(
    slam={
        "drift_m_per_sqrt_s": 0.3,
        "drift_m_per_sqrt_m": 0.4,
        "drift_rad_per_sqrt_s": 0.05,
        "drift_rad_per_sqrt_m": 0.12,
        "jump_sigma_m": 0.7,
        "jump_sigma_rad": 0.9,
        "longest_pose_gap": 1.0,
    }
)


def level(t: Array, position: Array) -> Track:
    return Track(t, position, np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))


def straight(t: Array, speed: float = 1.0) -> Track:
    """Along x."""
    return level(t, speed * np.column_stack([t - t[0], 0.0 * t, 0.0 * t + 0.5]))


def repaired_tracks(track: Track, begins: tuple[int, ...] = (), knew_up: tuple[bool, ...] = ()) -> RepairedTrack:
    """A track whose segments after the first begin at these poses."""
    segment = np.searchsorted(np.array(begins, dtype=int), np.arange(len(track)), side="right").astype(np.int32)
    count = len(begins) + 1
    identity = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    return RepairedTrack(track, (), segment, identity, np.array(knew_up or (True,) * count))


# ---- keyframes_of ----


def test_keyframes_are_evenly_spread_from_end_to_end() -> None:
    t = 100.0 + np.arange(0, 401) / 40.0
    keyframes = keyframes_of(repaired_tracks(straight(t)), 1.0, MODEL)
    np.testing.assert_allclose(keyframes.t, 100.0 + np.arange(11.0))
    np.testing.assert_allclose(keyframes.place, np.column_stack([np.arange(11.0), np.zeros(11), np.full(11, 0.5)]))
    assert len(keyframes) == 11
    np.testing.assert_allclose(keyframes.anchor, [0.0, 0.0, 0.0])


@settings(deadline=None)
@given(
    gaps=st.lists(st.floats(0.01, 1.6), min_size=0, max_size=60),
    interval=st.floats(0.05, 4.0),
    jump=st.integers(0, 60),
)
def test_keyframes_are_poses_about_as_far_apart_as_asked_for(gaps: list[float], interval: float, jump: int) -> None:
    t = np.concatenate([[5.0], 5.0 + np.cumsum(gaps)])
    track = straight(t)
    begins = (jump,) if 0 < jump < len(t) else ()
    keyframes = keyframes_of(repaired_tracks(track, begins), interval, MODEL)
    at = np.searchsorted(t, keyframes.t)
    np.testing.assert_array_equal(t[at], keyframes.t)
    np.testing.assert_array_equal(track.position[at], keyframes.place)
    assert (np.diff(at) > 0).all()
    assert keyframes.step_sigma.shape == (len(at) - 1, 3)
    picked = set(at.tolist())
    broken = set((np.flatnonzero(np.diff(t) > MODEL.slam.longest_pose_gap) + 1).tolist()) | set(begins)
    assert {0, len(t) - 1} | broken | {n - 1 for n in broken} <= picked
    # None is due within half an interval of either end, and a keyframe is the first pose after it is due.
    assert (np.diff(keyframes.t) <= 2.0 * interval + np.diff(t, prepend=t[0]).max() + 1e-9).all()
    assert (np.diff(keyframes.until) >= 0.0).all()


def test_on_both_sides_of_a_jump_and_of_a_gap_there_is_one() -> None:
    t = np.concatenate([np.arange(0, 30) / 10.0, 5.0 + np.arange(0, 30) / 10.0])
    keyframes = keyframes_of(repaired_tracks(straight(t), begins=(13,)), 10.0, MODEL)
    np.testing.assert_allclose(keyframes.t, [0.0, 1.2, 1.3, 2.9, 5.0, 7.9])


def test_a_segment_of_a_single_pose_is_one_keyframe() -> None:
    keyframes = keyframes_of(repaired_tracks(straight(np.arange(10) / 10.0), begins=(4, 5)), 10.0, MODEL)
    np.testing.assert_allclose(keyframes.t, [0.0, 0.3, 0.4, 0.5, 0.9])
    np.testing.assert_allclose(keyframes.step_sigma[[1, 2]], [[0.7, 0.7, 0.9], [0.7, 0.7, 0.9]])


def test_a_rebuilt_step_is_as_good_as_the_tracks_steps_are_predicted() -> None:
    repaired = replace(repaired_tracks(straight(np.arange(10) / 10.0), begins=(5,)), rebuilt_sigma=(0.02, 1.5))
    keyframes = keyframes_of(repaired, 10.0, MODEL)
    np.testing.assert_allclose(keyframes.step_sigma[1], [0.02, 0.02, 0.9])
    in_half_metres = keyframes_of(repaired, 10.0, MODEL, unit=0.5)
    np.testing.assert_allclose(in_half_metres.step_sigma[1], [0.02, 0.02, 0.9])


def test_a_single_pose_is_one_keyframe_without_steps() -> None:
    keyframes = keyframes_of(repaired_tracks(straight(np.array([3.0]))), 1.0, MODEL)
    assert len(keyframes) == 1
    assert keyframes.step_sigma.shape == (0, 3)


def test_a_device_that_stands_still_drifts_with_time_alone() -> None:
    keyframes = keyframes_of(repaired_tracks(straight(np.arange(0, 81) / 10.0, speed=0.0)), 4.0, MODEL)
    # 4 s: sqrt(0.09 * 4) m and sqrt(0.0025 * 4) rad.
    np.testing.assert_allclose(keyframes.step_sigma, [[0.6, 0.6, 0.1], [0.6, 0.6, 0.1]])


def test_drift_grows_with_the_way_gone_not_with_the_distance() -> None:
    """To and fro: in 4 s it walks 4 m and is back where it was."""
    t = np.arange(0, 81) / 10.0
    x = np.abs((t + 2.0) % 4.0 - 2.0)
    keyframes = keyframes_of(repaired_tracks(level(t, np.column_stack([x, 0.0 * t, 0.0 * t]))), 4.0, MODEL)
    np.testing.assert_allclose(keyframes.place[:, 0], 0.0, atol=1e-12)
    metres, radians = np.sqrt(0.09 * 4 + 0.16 * 4), np.sqrt(0.0025 * 4 + 0.0144 * 4)
    np.testing.assert_allclose(keyframes.step_sigma, [[metres, metres, radians]] * 2)


def test_a_step_that_was_rebuilt_is_as_good_as_rebuilding_is() -> None:
    keyframes = keyframes_of(repaired_tracks(straight(np.arange(0, 41) / 10.0), begins=(20,)), 10.0, MODEL)
    usual = np.sqrt([0.09 * 1.9 + 0.16 * 1.9, 0.0025 * 1.9 + 0.0144 * 1.9])
    np.testing.assert_allclose(keyframes.step_sigma[0], usual[[0, 0, 1]])
    np.testing.assert_allclose(keyframes.step_sigma[1], [0.7, 0.7, 0.9])


def test_of_a_step_without_gravity_the_length_alone_is_known() -> None:
    track = straight(np.arange(0, 41) / 10.0)
    keyframes = keyframes_of(repaired_tracks(track, begins=(21,), knew_up=(False, True)), 10.0, MODEL)
    # In the first segment it goes 2 m in 2 s.
    metres, radians = np.sqrt(0.09 * 2 + 0.16 * 2 + 2.0**2), np.sqrt(0.0025 * 2 + 0.0144 * 2)
    np.testing.assert_allclose(keyframes.step_sigma[0], [metres, metres, radians])
    np.testing.assert_allclose(keyframes.step_sigma[1], [0.7, 0.7, 0.9])
    assert keyframes.step_sigma[2, 0] < 1.0
    np.testing.assert_array_equal(keyframes.rebuilt, [True, True, False])


def test_a_noisier_slam_has_longer_sigmas_but_for_steps_that_are_rebuilt() -> None:
    track = repaired_tracks(straight(np.arange(0, 41) / 10.0), begins=(21,))
    usual, noisy = keyframes_of(track, 10.0, MODEL), keyframes_of(track, 10.0, MODEL, (2.0, 3.0))
    np.testing.assert_array_equal(usual.rebuilt, [False, True, False])
    np.testing.assert_allclose(noisy.step_sigma[[0, 2]], usual.step_sigma[[0, 2]] * [2.0, 2.0, 3.0])
    np.testing.assert_array_equal(noisy.step_sigma[1], usual.step_sigma[1])


def test_a_track_in_centimetres_drifts_as_far_as_it_does_in_metres() -> None:
    """Its steps are in its own unit, its turns are not: without the unit they would be ten times as uncertain."""
    metres = straight(np.linspace(0.0, 10.0, 101))
    centimetres = replace(metres, position=100.0 * metres.position)
    usual = keyframes_of(repaired_tracks(metres), 1.0, MODEL).step_sigma
    found = keyframes_of(repaired_tracks(centimetres), 1.0, MODEL, unit=0.01).step_sigma
    np.testing.assert_allclose(found, usual * [100.0, 100.0, 1.0], rtol=1e-9)


def test_the_anchor_is_the_first_place_at_the_height_of_the_origin() -> None:
    keyframes = Keyframes(
        np.arange(2.0),
        np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]),
        np.ones((1, 3)),
        np.array([0.5]),
        np.zeros(1, dtype=bool),
        np.zeros(2),
    )
    np.testing.assert_array_equal(keyframes.anchor, [1.0, 2.0, 0.0])
    np.testing.assert_array_equal(STATIC_KEYFRAME.anchor, np.zeros(3))


# ---- nearest ----


@settings(deadline=None)
@given(
    begin=st.floats(-3.0, 3.0),
    gaps=st.lists(st.floats(0.01, 0.3), min_size=0, max_size=60),
    t=st.lists(st.floats(-5.0, 20.0), min_size=1, max_size=20),
)
def test_the_keyframe_whose_turn_it_is_is_the_nearest_but_for_its_delay(
    begin: float, gaps: list[float], t: list[float]
) -> None:
    """A keyframe is the first pose after it was due."""
    stamps = np.concatenate([[begin], begin + np.cumsum(gaps)])
    keyframes = keyframes_of(repaired_tracks(straight(stamps)), 1.0, MODEL)
    turn = keyframes.nearest(np.array(t))
    assert turn.dtype == np.int32
    away = np.abs(np.array(t)[:, None] - keyframes.t)
    assert (away[np.arange(len(t)), turn] <= away.min(axis=1) + max([0.0, *gaps]) + 1e-9).all()


def test_devices_change_their_keyframes_at_the_same_times() -> None:
    """Though their tracks begin and end at other times and have other stamps: ranges fall into few blocks."""
    early, late = (straight(t) for t in (np.arange(0.0, 10.0, 0.1), np.arange(2.37, 12.0, 0.033)))
    a, b = (keyframes_of(repaired_tracks(track), 1.0, MODEL).until for track in (early, late))
    inner_a, inner_b = a[(a > 4.0) & (a < 8.0)], b[(b > 4.0) & (b < 8.0)]
    np.testing.assert_allclose(inner_a, [4.5, 5.5, 6.5, 7.5])
    np.testing.assert_allclose(inner_b, inner_a)


# ---- ends_of ----


def samples_at(t: Array, row: Indices | None = None) -> RangeMeasurements:
    """Samples of the users 0 and 1 at these times."""
    n = len(t)
    zeros, points = np.zeros(n), np.zeros((n, 3))
    i = np.zeros(n, dtype=np.int32)
    row = np.arange(n, dtype=np.int32) if row is None else row
    return RangeMeasurements(i, i + 1, t, points, points, zeros, zeros + 0.1, zeros, row)


def one_user(track: Track, t: Array, user: User | None = None, antenna: Array | None = None) -> Recording:
    """A user `a` of that track that ranges to a radio `b` at times t."""
    columns = {} if antenna is None else {"antenna_a": antenna.astype(np.int32)}
    return recording_of(
        {"a": track, "b": None}, [(at, "a", "b", 1.0) for at in t.tolist()], [user] if user else [], **columns
    )


def ends_of_one(
    track: Track, t: Array, keyframes: Keyframes, offset: float = 0.0, user: User | None = None
) -> RangeEnds:
    measurements = samples_at(t)
    return range_ends(
        one_user(track, t, user), measurements, measurements.i, [keyframes, STATIC_KEYFRAME], np.array([offset, 0.0])
    )


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 10_000), clock=st.floats(-0.3, 0.3), antennas=st.integers(0, 3))
def test_keyframe_offset_and_lever_give_the_antenna_back(seed: int, clock: float, antennas: int) -> None:
    scene = Scene(seed=seed, users=3, seconds=4.0, rate_hz=3.0, antennas=antennas, clock_offset_sigma=0.1)
    recording = simulate(scene).recording
    t = recording.ranges.t
    # The rows in any order, each end in any order.
    row = np.random.default_rng(seed).permutation(len(t)).astype(np.int32)
    points = np.zeros((len(t), 3))
    i, j = recording.ranges.a[row], recording.ranges.b[row]
    measurements = RangeMeasurements(i, j, t[row], points, points, *np.ones((3, len(t))), row)
    keyframes = [keyframes_of(repaired_tracks(recording.tracks[u.name]), 0.7, Parameters()) for u in recording.users]
    offsets = clock * np.array([1.0, -0.5, 0.0])
    for who, antenna in (
        (i, recording.ranges.antenna_a[row]),
        (j, recording.ranges.antenna_b[row]),
    ):
        ends = range_ends(recording, measurements, who, keyframes, offsets)
        for u, user in enumerate(recording.users):
            mine = who == u
            track = recording.tracks[user.name]
            own = np.clip(measurements.t[mine] + offsets[u], track.t[0], track.t[-1])
            expected, _ = recording.antenna_positions(u, own, antenna[mine], np.inf)
            rebuilt = keyframes[u].place[ends.keyframe[mine]] + ends.offset[mine] + ends.lever[mine]
            np.testing.assert_allclose(rebuilt, expected, atol=1e-12)
            np.testing.assert_array_equal(ends.keyframe[mine], keyframes[u].nearest(measurements.t[mine]))
            place = track.at(own, np.inf).position
            np.testing.assert_allclose(ends.lever[mine], expected - place, atol=1e-12)


def test_the_velocity_of_a_straight_steady_walk_is_its_own() -> None:
    track = straight(np.arange(0, 101) / 10.0, speed=1.3)
    keyframes = keyframes_of(repaired_tracks(track), 1.0, MODEL)
    t = np.array([0.0, 0.02, 3.0, 3.33, 9.99, 10.0])
    np.testing.assert_allclose(ends_of_one(track, t, keyframes).velocity, [[1.3, 0.0, 0.0]] * 6, atol=1e-12)


def test_an_antenna_of_a_device_that_turns_on_the_spot_moves_about_it() -> None:
    rate = 0.5
    t = np.arange(0, 201) / 20.0
    q = np.array([yaw_quaternion(each) for each in (rate * t).tolist()])
    track = Track(t, np.tile([1.0, 2.0, 0.0], (201, 1)), q)
    user = User("a", antennas={"0": (0.2, 0.0, 0.1)})
    at = np.array([2.0, 5.0])
    recording = one_user(track, at, user, antenna=np.zeros(2))
    keyframes = keyframes_of(repaired_tracks(track), 1.0, MODEL)
    measurements = samples_at(at)
    ends = range_ends(recording, measurements, measurements.i, [keyframes, STATIC_KEYFRAME], np.zeros(2))
    for n, yaw in enumerate((rate * at).tolist()):
        np.testing.assert_allclose(ends.lever[n], [*(rotation_2d(yaw) @ [0.2, 0.0]), 0.1], atol=1e-9)
        np.testing.assert_allclose(
            ends.velocity[n], [*(rotation_2d(yaw) @ [0.0, 0.2 * rate]), 0.0], rtol=1e-3, atol=1e-9
        )
    np.testing.assert_allclose(ends.offset, 0.0, atol=1e-12)


def test_a_range_that_names_no_antenna_is_measured_at_the_origin() -> None:
    track = straight(np.arange(0, 101) / 10.0)
    user = User("a", antennas={"0": (0.2, 0.0, 0.1), "1": (0.0, 0.3, 0.0)})
    at = np.array([1.0, 2.0, 3.0])
    recording = one_user(track, at, user, antenna=np.array([-1, 1, 0]))
    measurements = samples_at(at)
    keyframes = keyframes_of(repaired_tracks(track), 1.0, MODEL)
    ends = range_ends(recording, measurements, measurements.i, [keyframes, STATIC_KEYFRAME], np.zeros(2))
    np.testing.assert_allclose(ends.lever, [[0.0, 0.0, 0.0], [0.0, 0.3, 0.0], [0.2, 0.0, 0.1]], atol=1e-12)


def test_beyond_its_track_a_device_is_at_the_end_of_it() -> None:
    track = straight(np.arange(0, 101) / 10.0)
    keyframes = keyframes_of(repaired_tracks(track), 1.0, MODEL)
    ends = ends_of_one(track, np.array([0.2, 9.9]), keyframes, offset=-0.5)
    assert (ends.keyframe[0], ends.offset[0].tolist()) == (0, [0.0, 0.0, 0.0])
    np.testing.assert_allclose(ends.velocity, [[1.0, 0.0, 0.0]] * 2, atol=1e-12)
    ends = ends_of_one(track, np.array([0.2, 9.9]), keyframes, offset=0.5)
    assert (ends.keyframe[1], ends.offset[1].tolist()) == (10, [0.0, 0.0, 0.0])
    # Its velocity is taken inwards: the device did not stop there.
    np.testing.assert_allclose(ends.velocity, [[1.0, 0.0, 0.0]] * 2, atol=1e-12)


def test_a_track_of_one_pose_does_not_move() -> None:
    track = straight(np.array([3.0]))
    ends = ends_of_one(track, np.array([2.0, 3.0, 4.0]), keyframes_of(repaired_tracks(track), 1.0, MODEL))
    for column in (ends.offset, ends.lever, ends.velocity):
        np.testing.assert_array_equal(column, np.zeros((3, 3)))


def test_a_radio_that_stands_still_is_at_its_own_origin() -> None:
    track = straight(np.arange(0, 101) / 10.0)
    measurements = samples_at(np.array([1.0, 2.0]))
    keyframes = [keyframes_of(repaired_tracks(track), 1.0, MODEL), STATIC_KEYFRAME]
    ends = range_ends(one_user(track, measurements.t), measurements, measurements.j, keyframes, np.zeros(2))
    np.testing.assert_array_equal(ends.keyframe, [0, 0])
    for column in (ends.offset, ends.lever, ends.velocity):
        np.testing.assert_array_equal(column, np.zeros((2, 3)))


def test_lever_arms_stand_in_their_order_with_the_origin_at_the_end() -> None:
    user = User("a", antennas={"left": (0.1, 0.2, 0.3), "right": (0.1, -0.2, 0.3)})
    np.testing.assert_array_equal(user.levers, [[0.1, 0.2, 0.3], [0.1, -0.2, 0.3], [0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(replace(user, antennas={}).levers, np.zeros((1, 3)))


@given(yaw=st.floats(-3.1, 3.1), tilt=st.floats(0.0, 2.5), way=st.floats(-3.1, 3.1))
def test_the_yaw_of_an_attitude_is_what_the_shortest_tilt_leaves(yaw: float, tilt: float, way: float) -> None:
    """First turned by yaw, then tilted about a level axis."""
    x, y, w = np.sin(0.5 * tilt) * np.cos(way), np.sin(0.5 * tilt) * np.sin(way), np.cos(0.5 * tilt)
    c, s = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    q = np.array([[x * c + y * s, y * c - x * s, w * s, w * c]])
    for sign in (1.0, -1.0):
        assert yaw_of_quaternions(sign * q)[0] == pytest.approx(yaw, abs=1e-9)


# ---- how level a walk is ----


def test_a_level_walk_counts_as_one_height_for_each_time_that_a_deviation_lasts() -> None:
    t = np.arange(0.0, 60.05, 0.1)
    keyframes = keyframes_of(repaired_tracks(straight(t)), 1.0, MODEL)
    p = MODEL.priors
    assert keyframes.level_information.sum() == pytest.approx(60.0 / p.level_duration / p.level_sigma**2, rel=1e-3)
    assert (STATIC_KEYFRAME.level_information == 0.0).all()


def test_where_slam_has_a_device_go_up_and_down_it_is_not_held_to_one_height() -> None:
    t = np.arange(0.0, 60.05, 0.1)
    waved = straight(t)
    position = waved.position.copy()
    position[:, 2] += np.where(t < 20.0, 0.5 * np.sin(2.0 * t), 0.0)
    level = keyframes_of(repaired_tracks(replace(waved, position=position)), 1.0, MODEL).level_information
    usual = keyframes_of(repaired_tracks(waved), 1.0, MODEL).level_information
    # The variance of a sine of 0.5 m.
    share = MODEL.priors.level_sigma**2 / (MODEL.priors.level_sigma**2 + 0.5**3)
    np.testing.assert_allclose(level[5:15] / usual[5:15], share, rtol=0.2)
    np.testing.assert_allclose(level[26:] / usual[26:], 1.0, rtol=1e-9)


def test_a_tracks_unit_does_not_change_how_level_it_is() -> None:
    t = np.arange(0.0, 30.05, 0.1)
    metres = straight(t)
    waved = replace(metres, position=metres.position + np.outer(np.sin(t), [0.0, 0.0, 0.2]))
    centimetres = replace(waved, position=100.0 * waved.position)
    usual = keyframes_of(repaired_tracks(waved), 1.0, MODEL).level_information
    found = keyframes_of(repaired_tracks(centimetres), 1.0, MODEL, unit=0.01).level_information
    np.testing.assert_allclose(found, usual, rtol=1e-9)
