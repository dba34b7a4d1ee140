from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synchronizar.arrays import Array
from synchronizar.data.track import Track
from synchronizar.geometry import YawFrame, rotation_2d
from synchronizar.graph.states import (
    States,
    antennas,
    common_track,
    corrected,
    interpolated,
    slam_states,
    steps,
    to_rigid_ranges,
)
from synchronizar.preprocessing.keyframes import STATIC_KEYFRAME, Keyframes, RangeEnds
from synchronizar.preprocessing.range_measurements import RangeMeasurements
from synchronizar.quaternions import rotate_by_quaternions

seeds = pytest.mark.parametrize("seed", range(5))


def keyframes_of(t: Array, place: Array, step_sigma: Array | None = None) -> Keyframes:
    sigma = np.ones((len(t) - 1, 3)) if step_sigma is None else step_sigma
    return Keyframes(t, place, sigma, 0.5 * (t[1:] + t[:-1]), np.zeros(len(t) - 1, dtype=bool), np.zeros(len(t)))


def keyframes_at(t: Array, random: np.random.Generator) -> Keyframes:
    n = len(t)
    return keyframes_of(t, random.normal(0.0, 3.0, (n, 3)), random.uniform(0.05, 0.5, (n - 1, 3)))


def bent(random: np.random.Generator, keyframes: list[Keyframes]) -> States:
    """Anywhere, drifted, with devices that are not perfect."""
    count = len(keyframes)
    frames = random.normal(0.0, 5.0, (count, 4))
    states = slam_states(frames, keyframes, random.normal(0.0, 0.2, (count, 3)))
    keyframe_poses = [of_user + random.normal(0.0, 0.4, of_user.shape) for of_user in states.keyframe_poses]
    return states._replace(keyframe_poses=keyframe_poses)


def some_ends(random: np.random.Generator, who: Array, keyframes: list[Keyframes]) -> RangeEnds:
    n = len(who)
    at = np.array([random.integers(len(keyframes[u])) for u in who], dtype=np.int32)
    return RangeEnds(at, *random.normal(0.0, 1.0, (3, n, 3)))


def antenna_by_hand(states: States, user: int, ends: RangeEnds, n: int, assumed_clock: Array) -> Array:
    log_scale, _, clock = states.calibration[user]
    scale = np.exp(log_scale)
    x, y, z, yaw = states.keyframe_poses[user][ends.keyframe[n]]
    moved = (clock - assumed_clock[user]) * ends.velocity[n]
    return YawFrame(scale * x, scale * y, scale * z, yaw) @ (scale * ends.offset[n] + ends.lever[n] + moved)


def three(random: np.random.Generator) -> list[Keyframes]:
    return [keyframes_at(np.arange(6.0), random), STATIC_KEYFRAME, keyframes_at(np.arange(3.0), random)]


# ---- begin, antennas, flattened ----


def test_at_first_everybody_walked_as_slam_says() -> None:
    random = np.random.default_rng(0)
    keyframes = three(random)
    frames, device = random.normal(size=(3, 4)), random.normal(size=(3, 3))
    states = slam_states(frames, keyframes, device)
    for keyframe_poses, of_user in zip(states.keyframe_poses, keyframes, strict=True):
        np.testing.assert_allclose(keyframe_poses[:, :2], of_user.place[:, :2] - of_user.place[0, :2])
        np.testing.assert_array_equal(keyframe_poses[:, 2], of_user.place[:, 2])
        np.testing.assert_array_equal(keyframe_poses[:, 3], 0.0)
    np.testing.assert_array_equal(states.anchor_poses, frames)
    np.testing.assert_array_equal(states.calibration, device)
    assert states.anchor_poses is not frames
    assert states.calibration is not device


@seeds
def test_antennas_are_composed_one_by_one(seed: int) -> None:
    random = np.random.default_rng(seed)
    keyframes = three(random)
    states, who = bent(random, keyframes), random.integers(3, size=40)
    ends, assumed = some_ends(random, who, keyframes), random.normal(0.0, 0.1, 3)
    expected = [antenna_by_hand(states, int(u), ends, n, assumed) for n, u in enumerate(who)]
    np.testing.assert_allclose(antennas(states, who, ends, assumed), expected, atol=1e-12)


@seeds
def test_flattened_samples_have_the_distances_of_the_walks(seed: int) -> None:
    random = np.random.default_rng(seed)
    keyframes = three(random)
    states, n, assumed = bent(random, keyframes), 40, random.normal(0.0, 0.1, 3)
    i = random.integers(2, size=n).astype(np.int32)
    j = np.full(n, 2, dtype=np.int32)
    measurements = RangeMeasurements(
        i, j, np.arange(n) * 0.1, *np.zeros((2, n, 3)), *random.uniform(1.0, 5.0, (3, n)), i
    )
    ends = some_ends(random, i, keyframes), some_ends(random, j, keyframes)
    flat = to_rigid_ranges(measurements, states, ends, assumed)
    for k in range(n):
        a = YawFrame(*states.anchor_poses[i[k]]) @ antenna_by_hand(states, int(i[k]), ends[0], k, assumed)
        b = YawFrame(*states.anchor_poses[j[k]]) @ antenna_by_hand(states, int(j[k]), ends[1], k, assumed)
        predicted = float(np.linalg.norm(a - b)) + states.calibration[i[k], 1] + states.calibration[j[k], 1]
        p, q = YawFrame(*states.anchor_poses[i[k]]) @ flat.p_i[k], YawFrame(*states.anchor_poses[j[k]]) @ flat.p_j[k]
        residual = float(np.linalg.norm(p - q)) - flat.distance[k]
        assert residual == pytest.approx(predicted - measurements.distance[k], abs=1e-12)
    np.testing.assert_array_equal(flat.sigma, measurements.sigma)


# ---- steps ----


def test_slams_own_steps_are_not_off() -> None:
    random = np.random.default_rng(1)
    keyframes = keyframes_at(np.arange(7.0), random)
    keyframe_poses = slam_states(np.zeros((1, 4)), [keyframes], np.zeros((1, 3))).keyframe_poses[0]
    np.testing.assert_allclose(steps(keyframe_poses, keyframes), np.zeros((6, 4)), atol=1e-12)
    assert steps(np.zeros((1, 4)), STATIC_KEYFRAME).shape == (0, 4)


def test_a_walk_that_is_turned_as_a_whole_has_slams_own_steps() -> None:
    random = np.random.default_rng(1)
    keyframes = keyframes_at(np.arange(7.0), random)
    turned = np.column_stack([YawFrame(3.0, -1.0, 0.7, 2.9) @ keyframes.place, np.full(7, 2.9)])
    turned[3:, 3] -= 2.0 * np.pi  # the same headings
    np.testing.assert_allclose(steps(turned, keyframes), np.zeros((6, 4)), atol=1e-12)


def test_a_step_that_is_off_by_hand() -> None:
    """SLAM: 1 m ahead and 0.5 m up. Here the heading is a quarter to the left: ahead is y."""
    keyframes = keyframes_of(np.arange(2.0), np.array([[5.0, 5.0, 1.0], [6.0, 5.0, 1.5]]), np.array([[0.1, 0.2, 0.05]]))
    quarter = 0.5 * np.pi
    keyframe_poses = np.array([[0.0, 0.0, 1.0, quarter], [-0.4, 1.3, 1.6, quarter + 0.02]])
    # 1.3 m ahead, 0.4 m to the left, 0.6 m up, turned by 0.02 rad.
    np.testing.assert_allclose(steps(keyframe_poses, keyframes), [[3.0, 4.0, 0.5, 0.4]], atol=1e-12)


# ---- corrected ----


@settings(deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 8))
def test_at_a_keyframe_the_device_is_where_the_keyframe_is(seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    keyframes = keyframes_at(np.cumsum(random.uniform(0.1, 2.0, count)), random)
    keyframe_poses = random.normal(0.0, 2.0, (count, 4))
    place, turned = corrected(keyframe_poses, keyframes, keyframes.t, keyframes.place)
    np.testing.assert_allclose(place, keyframe_poses[:, :3], atol=1e-12)
    np.testing.assert_allclose(np.exp(1j * turned), np.exp(1j * keyframe_poses[:, 3]), atol=1e-12)


@settings(deadline=None)
@given(seed=st.integers(0, 10_000))
def test_a_track_that_was_continuous_stays_so(seed: int) -> None:
    random = np.random.default_rng(seed)
    t = np.linspace(0.0, 5.0, 5001)
    position = np.column_stack([np.sin(t), np.cos(1.3 * t), 0.1 * t])
    at = np.array([0, 700, 2100, 3333, 5000])
    keyframes = keyframes_of(t[at], position[at])
    # Wherever SLAM is thought to have been, within a turn of less than half a circle from step to step.
    headings = np.cumsum(random.uniform(-3.0, 3.0, 5))
    keyframe_poses = np.column_stack([position[at] + random.normal(0.0, 0.5, (5, 3)), headings])
    place, turned = corrected(keyframe_poses, keyframes, t, position)
    fastest = np.linalg.norm(np.diff(position, axis=0), axis=1).max() + 0.001 * 10.0 / 0.7
    assert np.linalg.norm(np.diff(place, axis=0), axis=1).max() < fastest
    assert np.abs(np.exp(1j * np.diff(turned)) - 1.0).max() < 0.001 * 3.0 / 0.7 + 1e-9


@settings(deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 6))
def test_what_is_moved_as_a_whole_is_moved_everywhere(seed: int, count: int) -> None:
    """Before the first keyframe and after the last too."""
    random = np.random.default_rng(seed)
    keyframes = keyframes_at(np.cumsum(random.uniform(0.1, 2.0, count)), random)
    frame = YawFrame(*random.normal(0.0, 2.0, 4))
    keyframe_poses = np.column_stack([frame @ keyframes.place, np.full(count, frame.yaw)])
    t, position = random.uniform(-3.0, keyframes.t[-1] + 3.0, 30), random.normal(0.0, 3.0, (30, 3))
    place, turned = corrected(keyframe_poses, keyframes, t, position)
    np.testing.assert_allclose(place, frame @ position, atol=1e-12)
    np.testing.assert_allclose(turned, frame.yaw, atol=1e-12)


def test_between_two_keyframes_the_nearer_one_weighs_more() -> None:
    """The second keyframe is 0.8 m to the left of where SLAM has it and turned by 0.4 rad."""
    keyframes = keyframes_of(np.array([0.0, 4.0]), np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]]))
    keyframe_poses = np.array([[0.0, 0.0, 0.0, 0.0], [4.0, 0.8, 0.0, 0.4]])
    place, turned = corrected(keyframe_poses, keyframes, np.array([1.0]), np.array([[1.0, 0.0, 0.0]]))
    seen_from_second = [*(np.array([4.0, 0.8]) + rotation_2d(0.4) @ [-3.0, 0.0]), 0.0]
    np.testing.assert_allclose(place[0], 0.75 * np.array([1.0, 0.0, 0.0]) + 0.25 * np.array(seen_from_second))
    assert turned[0] == pytest.approx(0.1)


def test_a_heading_is_corrected_the_short_way_round() -> None:
    keyframes = keyframes_of(np.array([0.0, 2.0]), np.zeros((2, 3)))
    keyframe_poses = np.array([[0.0, 0.0, 0.0, np.pi - 0.1], [0.0, 0.0, 0.0, -np.pi + 0.1]])
    _, turned = corrected(keyframe_poses, keyframes, np.array([1.0]), np.zeros((1, 3)))
    assert turned[0] == pytest.approx(np.pi)


# ---- interpolated ----


@seeds
def test_other_keyframes_leave_the_poses_where_they_were(seed: int) -> None:
    random = np.random.default_rng(seed)
    t, position = np.arange(41.0) / 4.0, random.normal(0.0, 3.0, (41, 3))
    coarse, fine = (keyframes_of(t[::k], position[::k]) for k in (20, 5))
    states = bent(random, [coarse, STATIC_KEYFRAME])
    finer = interpolated(states, [coarse, STATIC_KEYFRAME], [fine, STATIC_KEYFRAME])
    np.testing.assert_array_equal(finer.anchor_poses, states.anchor_poses)
    np.testing.assert_array_equal(finer.calibration, states.calibration)
    np.testing.assert_allclose(finer.keyframe_poses[0][::4], states.keyframe_poses[0], atol=1e-12)
    np.testing.assert_allclose(finer.keyframe_poses[1], states.keyframe_poses[1], atol=1e-12)
    assert [len(keyframe_poses) for keyframe_poses in finer.keyframe_poses] == [9, 1]
    place, turned = corrected(states.keyframe_poses[0], coarse, fine.t, fine.place)
    np.testing.assert_allclose(finer.keyframe_poses[0], np.column_stack([place, turned]), atol=1e-12)


# ---- common_track ----


@seeds
def test_a_walk_without_drift_is_laid_as_a_whole(seed: int) -> None:
    random = np.random.default_rng(seed)
    t = np.arange(30.0)
    q = random.normal(size=(30, 4))
    track = Track(t, random.normal(0.0, 3.0, (30, 3)), q / np.linalg.norm(q, axis=1, keepdims=True))
    keyframes = keyframes_of(t[::10], track.position[::10])
    frames = random.normal(0.0, 2.0, (1, 4))
    states = slam_states(frames, [keyframes], np.array([[0.1, 0.2, 0.3]]))
    common, yaw = common_track(states, 0, keyframes, track)
    frame = YawFrame(*frames[0], scale=float(np.exp(0.1)))
    anchor = np.array([*track.position[0, :2], 0.0])
    np.testing.assert_allclose(common.position, frame @ (track.position - anchor), atol=1e-12)
    np.testing.assert_array_equal(common.t, t)  # the device's own stamps
    np.testing.assert_allclose(yaw, frames[0, 3], atol=1e-12)
    for axis in np.eye(3):
        body = np.tile(axis, (30, 1))
        expected = YawFrame(yaw=frame.yaw) @ rotate_by_quaternions(track.quat_xyzw, body)
        np.testing.assert_allclose(rotate_by_quaternions(common.quat_xyzw, body), expected, atol=1e-12)


def test_a_heading_that_drifted_turns_the_attitudes_too() -> None:
    t = np.array([0.0, 1.0, 2.0])
    track = Track(
        t, np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]), np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    )
    keyframes = keyframes_of(t, track.position)
    keyframe_poses = np.column_stack([track.position, [0.0, 0.2, 0.5]])
    common, yaw = common_track(
        States(np.array([[0.0, 0.0, 0.0, 1.0]]), [keyframe_poses], np.zeros((1, 3))), 0, keyframes, track
    )
    np.testing.assert_allclose(yaw, [1.0, 1.2, 1.5])
    forward = rotate_by_quaternions(common.quat_xyzw, np.tile([1.0, 0.0, 0.0], (3, 1)))
    np.testing.assert_allclose(forward, np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(3)]), atol=1e-12)
