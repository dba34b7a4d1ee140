from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synchronizar.arrays import Array
from synchronizar.data.user import User
from synchronizar.estimation.incremental.stream import Stream, Stretch

USERS = (User("alice", antennas={"left": (0.1, 0.0, 0.0)}), User("bob"), User("post", static=True))
EVER = np.full(3, -np.inf)
AS_IT_IS = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
FLAT = np.zeros(3)
MEAN_HEIGHT = (0.0, 0.0, 0.0, 1.0)


def walk(stream: Stream, user: str, stamps: list[float], speed: float = 1.0) -> None:
    """Along x from the origin."""
    for t in stamps:
        stream.add_pose(user, t, (speed * t, 0.0, 0.0), MEAN_HEIGHT)


def everything(stream: Stream) -> Stretch:
    return stream.stretch(EVER, AS_IT_IS, FLAT)


def rotation(quat_xyzw: Array) -> Array:
    """(3, 3) by axis and angle: Rodrigues' formula."""
    axis, angle = quat_xyzw[:3], 2.0 * np.arccos(quat_xyzw[3])
    n = axis / np.linalg.norm(axis)
    K = np.array([[0.0, -n[2], n[1]], [n[2], 0.0, -n[0]], [-n[1], n[0], 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)


# ---- poses ----


def test_poses_that_come_out_of_order_are_read_by_time() -> None:
    stream = Stream(USERS)
    walk(stream, "alice", [0.2, 0.0, 0.3, 0.1])
    track = everything(stream).recording.tracks["alice"]
    np.testing.assert_array_equal(track.t, [0.0, 0.1, 0.2, 0.3])
    np.testing.assert_array_equal(track.position[:, 0], [0.0, 0.1, 0.2, 0.3])


def test_of_two_poses_with_one_stamp_the_first_that_came_counts() -> None:
    stream = Stream(USERS)
    walk(stream, "alice", [0.0, 0.2])
    stream.add_pose("alice", 0.1, (5.0, 0.0, 0.0), MEAN_HEIGHT)
    walk(stream, "alice", [0.1, 0.0])
    np.testing.assert_array_equal(everything(stream).recording.tracks["alice"].position[:, 0], [0.0, 5.0, 0.2])
    assert stream.faults == 0


def test_an_attitude_need_not_be_of_unit_length() -> None:
    stream = Stream(USERS)
    stream.add_pose("bob", 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 3.0, 4.0))
    np.testing.assert_allclose(everything(stream).recording.tracks["bob"].quat_xyzw, [[0.0, 0.0, 0.6, 0.8]])


@pytest.mark.parametrize(
    "pose",
    [
        ("nobody", 0.0, (0.0, 0.0, 0.0), MEAN_HEIGHT),
        ("post", 0.0, (0.0, 0.0, 0.0), MEAN_HEIGHT),
        ("alice", np.nan, (0.0, 0.0, 0.0), MEAN_HEIGHT),
        ("alice", 0.0, (0.0, np.inf, 0.0), MEAN_HEIGHT),
        ("alice", 0.0, (0.0, 0.0, 0.0), (0.0, np.nan, 0.0, 1.0)),
        ("alice", 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
        ("alice", 0.0, (0.0, 0.0), MEAN_HEIGHT),
    ],
)
def test_a_pose_that_is_none_is_a_fault_and_left_out(pose: Any) -> None:
    stream = Stream(USERS)
    walk(stream, "alice", [1.0])
    stream.add_pose(*pose)
    assert stream.faults == 1
    stretch = everything(stream)
    np.testing.assert_array_equal(stretch.recording.tracks["alice"].t, [1.0])
    assert set(stretch.recording.tracks) == {"alice", "bob"}


def test_more_poses_than_a_table_first_holds_are_kept() -> None:
    stream = Stream(USERS)
    stamps = np.arange(1000) / 30.0
    walk(stream, "alice", stamps.tolist())
    np.testing.assert_array_equal(everything(stream).recording.tracks["alice"].position[:, 0], stamps)


def test_the_last_pose_is_the_latest_whenever_it_came() -> None:
    stream = Stream(USERS)
    assert stream.last_pose(0) is None
    walk(stream, "alice", [0.1, 0.3, 0.2])
    np.testing.assert_array_equal(stream.last_pose(0), [0.3, 0.3, 0.0, 0.0, *MEAN_HEIGHT])
    assert stream.last_pose(1) is None


# ---- ranges ----


def test_ranges_that_come_out_of_order_are_read_by_time_and_keep_their_numbers() -> None:
    stream = Stream(USERS)
    walk(stream, "alice", [0.0, 1.0])
    for t, distance in ((0.5, 5.0), (0.2, 2.0), (0.9, 9.0)):
        stream.add_range(t, "alice", "post", distance, {})
    stretch = everything(stream)
    np.testing.assert_array_equal(stretch.recording.ranges.t, [0.2, 0.5, 0.9])
    np.testing.assert_array_equal(stretch.recording.ranges.distance, [2.0, 5.0, 9.0])
    np.testing.assert_array_equal(stretch.serial, [1, 0, 2])


def test_columns_that_are_not_told_are_not_known() -> None:
    stream = Stream(USERS)
    stream.add_range(0.5, "alice", "bob", 5.0, {"sigma": 0.2, "antenna_a": 0.0})
    stream.add_range(0.6, "bob", "alice", 6.0, {"rx_power": -80.0, "fp_power": -90.0, "nlos": 1.0})
    ranges = everything(stream).recording.ranges
    np.testing.assert_array_equal(ranges.a, [0, 1])
    np.testing.assert_array_equal(ranges.b, [1, 0])
    np.testing.assert_array_equal(ranges.antenna_a, [0, -1])
    np.testing.assert_array_equal(ranges.antenna_b, [-1, -1])
    np.testing.assert_array_equal(ranges.sigma, [0.2, np.nan])
    np.testing.assert_array_equal(ranges.rx_power, [np.nan, -80.0])
    np.testing.assert_array_equal(ranges.fp_power, [np.nan, -90.0])
    np.testing.assert_array_equal(ranges.nlos, [np.nan, 1.0])


@pytest.mark.parametrize(
    "measured",
    [
        (0.5, "alice", "nobody", 1.0),
        (0.5, "nobody", "alice", 1.0),
        (0.5, "alice", "alice", 1.0),
        (np.nan, "alice", "bob", 1.0),
        (np.inf, "alice", "bob", 1.0),
        (0.5, "alice", "bob", np.nan),
        (0.5, "alice", "bob", np.inf),
    ],
)
def test_a_range_that_is_none_is_a_fault_left_out_and_numbered(measured: Any) -> None:
    stream = Stream(USERS)
    t, a, b, distance = measured
    stream.add_range(t, a, b, distance, {})
    stream.add_range(0.7, "alice", "bob", 2.0, {})
    assert stream.faults == 1
    stretch = everything(stream)
    np.testing.assert_array_equal(stretch.recording.ranges.distance, [2.0])
    np.testing.assert_array_equal(stretch.serial, [1])


@pytest.mark.parametrize("optional", [{"antenna_a": 1.0}, {"antenna_b": 0.0}, {"sigma": 0.0}, {"sigma": -0.1}])
def test_a_range_with_a_column_that_cannot_be_is_a_fault(optional: dict[str, float]) -> None:
    stream = Stream(USERS)
    stream.add_range(0.5, "alice", "bob", 1.0, optional)
    assert len(everything(stream).recording.ranges) == 0
    assert stream.faults == 1


def test_ranges_since_are_those_that_are_later() -> None:
    stream = Stream(USERS)
    for t, a, b in ((0.3, "bob", "alice"), (0.1, "alice", "bob"), (0.2, "alice", "post")):
        stream.add_range(t, a, b, 1.0, {})
    np.testing.assert_array_equal(stream.ranges_since(-np.inf), [[0.1, 0, 1], [0.2, 0, 2], [0.3, 1, 0]])
    np.testing.assert_array_equal(stream.ranges_since(0.1), [[0.2, 0, 2], [0.3, 1, 0]])
    assert len(stream.ranges_since(0.3)) == 0


# ---- stretches ----


@pytest.mark.parametrize(("begin", "first"), [(-1.0, 0.0), (0.2, 0.2), (0.25, 0.3)])
def test_a_stretch_begins_at_the_first_pose_at_or_after_its_begin(begin: float, first: float) -> None:
    stream = Stream(USERS)
    for user in ("alice", "bob"):
        walk(stream, user, [0.0, 0.1, 0.2, 0.3, 0.4])
    stretch = stream.stretch(np.array([begin, 0.1, -np.inf]), AS_IT_IS, FLAT)
    assert stretch.recording.tracks["alice"].t[0] == first
    assert stretch.recording.tracks["bob"].t[0] == 0.1
    np.testing.assert_array_equal(stretch.end, [0.4, 0.4, np.nan])


def test_ranges_are_left_out_that_either_device_had_no_pose_for_yet() -> None:
    stream = Stream(USERS)
    walk(stream, "alice", [0.0, 1.0])
    walk(stream, "bob", [0.5, 1.0])
    for t in (0.3, 0.5, 0.6):
        stream.add_range(t, "alice", "bob", t, {})
        stream.add_range(t, "alice", "post", 10.0 + t, {})
    ranges = stream.stretch(np.array([0.0, 0.5, -np.inf]), AS_IT_IS, FLAT).recording.ranges
    np.testing.assert_array_equal(np.sort(ranges.distance), [0.6, 10.3, 10.5, 10.6])


def test_who_has_no_pose_has_one_long_ago() -> None:
    stream = Stream(USERS)
    walk(stream, "alice", [0.0, 1.0])
    walk(stream, "bob", [0.0])
    stretch = stream.stretch(np.array([0.0, 0.5, -np.inf]), AS_IT_IS, FLAT)
    assert len(stretch.recording.tracks["bob"]) == 1
    assert not stretch.recording.tracks["bob"].at(np.array([0.0, 0.5, 1.0]), 1.0).valid.any()
    np.testing.assert_array_equal(stretch.end, [1.0, np.nan, np.nan])


def test_a_quarter_turn_of_the_axes_turns_a_track_about_its_first_pose() -> None:
    stream = Stream(USERS)
    for t, x, y, z in ((0.0, 7.0, 7.0, 7.0), (0.1, 1.0, 2.0, 3.0), (0.2, 2.0, 2.0, 3.0), (0.3, 2.0, 5.0, 3.5)):
        stream.add_pose("alice", t, (x, y, z), MEAN_HEIGHT)
    axes = AS_IT_IS.copy()
    axes[0] = 0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)
    stretch = stream.stretch(np.array([0.1, 0.0, 0.0]), axes, FLAT)
    track = stretch.recording.tracks["alice"]
    np.testing.assert_allclose(track.position, [[1.0, 2.0, 3.0], [1.0, 3.0, 3.0], [-2.0, 3.0, 3.5]], atol=1e-12)
    np.testing.assert_allclose(track.quat_xyzw, np.tile(axes[0], (3, 1)), atol=1e-12)
    # Where SLAM itself has it, nothing turned.
    np.testing.assert_array_equal(stretch.last[0], [2.0, 5.0, 3.5])


def test_axes_turn_places_and_attitudes_as_rotation_matrices_do() -> None:
    random = np.random.default_rng(3)
    position, quat = random.normal(size=(5, 3)), random.normal(size=(5, 4))
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    stream = Stream(USERS)
    for n in range(5):
        stream.add_pose("bob", 0.1 * n, position[n], quat[n])
    axes = AS_IT_IS.copy()
    axes[1] = np.array([0.3, -0.2, 0.5, 0.8]) / np.linalg.norm([0.3, -0.2, 0.5, 0.8])
    track = stream.stretch(EVER, axes, FLAT).recording.tracks["bob"]
    R = rotation(axes[1])
    np.testing.assert_allclose(track.position, position[0] + (position - position[0]) @ R.T, atol=1e-12)
    for found, own in zip(track.quat_xyzw, quat, strict=True):
        np.testing.assert_allclose(rotation(found), R @ rotation(own), atol=1e-9)


# ---- what is forgotten ----


def test_what_lies_before_is_forgotten_and_what_lies_at_or_after_is_not() -> None:
    stream = Stream(USERS)
    walk(stream, "alice", [0.3, 0.0, 0.1, 0.2])
    walk(stream, "bob", [0.0, 0.1])
    for t in (0.4, 0.1, 0.2, 0.3):
        stream.add_range(t, "alice", "post", 10.0 * t, {})
    stream.forget(np.array([0.1, -np.inf, -np.inf]), 0.3)
    stretch = everything(stream)
    np.testing.assert_array_equal(stretch.recording.tracks["alice"].t, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(stretch.recording.tracks["bob"].t, [0.0, 0.1])
    np.testing.assert_array_equal(stretch.recording.ranges.distance, [3.0, 4.0])
    np.testing.assert_array_equal(stretch.serial, [3, 0])
    walk(stream, "alice", [0.25, 0.4])
    np.testing.assert_array_equal(everything(stream).recording.tracks["alice"].t, [0.1, 0.2, 0.25, 0.3, 0.4])


def test_a_stretch_stays_as_it_was_read() -> None:
    stream = Stream(USERS)
    walk(stream, "alice", [0.0, 0.2, 0.4])
    stream.add_range(0.3, "alice", "post", 3.0, {})
    stretch = everything(stream)
    walk(stream, "alice", [0.1], speed=9.0)
    stream.add_range(0.2, "alice", "post", 2.0, {})
    everything(stream)
    stream.forget(np.array([0.2, 0.0, 0.0]), 0.25)
    np.testing.assert_array_equal(stretch.recording.tracks["alice"].t, [0.0, 0.2, 0.4])
    np.testing.assert_array_equal(stretch.recording.tracks["alice"].position[:, 0], [0.0, 0.2, 0.4])
    np.testing.assert_array_equal(stretch.recording.ranges.distance, [3.0])


# ---- any order ----

Add = Callable[[Stream], None]


def _pose(user: str, n: int) -> Add:
    return lambda stream: stream.add_pose(user, 0.1 * n, (float(n), 2.0 * n, -float(n)), (0.0, 0.0, 0.1 * n, 1.0))


def _range(n: int) -> Add:
    a, b = [("alice", "bob"), ("bob", "post"), ("post", "alice")][n % 3]
    return lambda stream: stream.add_range(0.07 * n, a, b, float(n), {"sigma": 0.1 + n})


POSES = [_pose(user, n) for user in ("alice", "bob") for n in range(8)]
RANGES = [_range(n) for n in range(9)]


@settings(max_examples=60, deadline=None)
@given(
    order=st.permutations([*POSES, *POSES[:4], *RANGES]),
    looks=st.sets(st.integers(0, 28)),
    begin=st.floats(-0.1, 0.9),
)
def test_any_order_of_the_same_data_gives_the_same_stretch(order: list[Add], looks: set[int], begin: float) -> None:
    """Whenever it is looked at in between, and some poses coming twice."""
    sorted_stream, stream = Stream(USERS), Stream(USERS)
    for add in (*POSES, *RANGES):
        add(sorted_stream)
    for n, add in enumerate(order):
        add(stream)
        if n in looks:
            stream.ranges_since(0.2)
            stream.last_pose(0)
            everything(stream)
    begins = np.array([begin, 0.3, -np.inf])
    found, expected = stream.stretch(begins, AS_IT_IS, FLAT), sorted_stream.stretch(begins, AS_IT_IS, MEAN_HEIGHT)
    for name, track in expected.recording.tracks.items():
        np.testing.assert_array_equal(found.recording.tracks[name].t, track.t)
        np.testing.assert_array_equal(found.recording.tracks[name].position, track.position)
        np.testing.assert_array_equal(found.recording.tracks[name].quat_xyzw, track.quat_xyzw)
    for column in ("t", "a", "b", "distance", "sigma"):
        np.testing.assert_array_equal(
            getattr(found.recording.ranges, column), getattr(expected.recording.ranges, column)
        )
    np.testing.assert_array_equal(found.last, expected.last)
    np.testing.assert_array_equal(found.end, expected.end)
    came = [add for add in order if add in RANGES]
    assert [came[n] for n in found.serial] == [RANGES[n] for n in expected.serial]
    assert stream.faults == 0
