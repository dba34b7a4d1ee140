from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from experiments.common.faults import BEGIN, KINDS, ONE, REFERENCE, TWO, Fault, fault_of, in_frames, jumped, sliding
from experiments.common.full_oracle import true_frames_along, true_tracks
from experiments.live.faults import (
    Course,
    Judged,
    again_after,
    astray_from,
    course_off,
    off_seconds,
    row_of,
    share,
    walk,
)
from synchronizar.data.track import Track
from synchronizar.geometry import wrap_angle
from synchronizar.quaternions import IDENTITY, yaw_of_quaternions


def standing(t: list[float], x: float = 2.0) -> Track:
    n = len(t)
    return Track(np.array(t), np.tile([x, 1.0, 0.0], (n, 1)), np.tile(IDENTITY, (n, 1)))


def test_a_jump_moves_the_device_by_its_shift_and_turns_the_rest_about_it() -> None:
    track = Track(
        np.arange(4.0), np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], dtype=float), np.tile(IDENTITY, (4, 1))
    )
    off = in_frames(track, jumped(track, track.t >= 2.0, np.array([0.0, 5.0, 0.0]), 0.5 * np.pi))
    np.testing.assert_allclose(off.position, [[0, 0, 0], [1, 0, 0], [2, 5, 0], [2, 6, 0]], atol=1e-12)
    np.testing.assert_allclose(yaw_of_quaternions(off.quat_xyzw), [0, 0, 0.5 * np.pi, 0.5 * np.pi])


def test_a_slide_grows_and_stays() -> None:
    frames = sliding(np.array([0.0, 1.0, 2.0, 3.0, 9.0]), np.array([0.0, 0.4, 0.0]), 1.0, 3.0)
    np.testing.assert_allclose(frames[:, 1], [0.0, 0.0, 0.4, 0.8, 0.8])
    assert not frames[:, [0, 2, 3]].any()


@pytest.fixture(scope="module", params=list(KINDS))
def kind_and_fault(request: pytest.FixtureRequest) -> tuple[str, Fault]:
    return request.param, fault_of(request.param, 1)


def test_until_the_fault_all_is_as_it_was(kind_and_fault: tuple[str, Fault]) -> None:
    kind, fault = kind_and_fault
    whole = fault_of("none", 1).simulation
    for name, track in fault.simulation.recording.tracks.items():
        was, until = whole.recording.tracks[name], int((track.t < BEGIN).sum())
        np.testing.assert_array_equal(track.position[:until], was.position[:until])
        assert len(track) == len(fault.simulation.truth[name])
    early = whole.recording.ranges.t < BEGIN - 0.05  # between two poses the truth is already on its way
    np.testing.assert_allclose(
        fault.simulation.recording.ranges.distance[early], whole.recording.ranges.distance[early]
    )
    assert (fault.begin, kind == "none" or bool(fault.faulty) or kind == "train, all see the world") == (BEGIN, True)


def test_only_users_at_fault_have_tracks_that_the_truth_belies(kind_and_fault: tuple[str, Fault]) -> None:
    kind, fault = kind_and_fault
    if kind == "train, all see the world":
        for name in fault.simulation.truth:
            assert np.ptp(true_frames_along(fault.simulation, REFERENCE, name), axis=0).max() < 0.5
            assert fault.simulation.recording.tracks[name].extent() > 25.0
        return
    truth = true_tracks(fault.simulation, REFERENCE)
    astray = set()
    for name, track in fault.simulation.recording.tracks.items():
        # As if stamps were right: that a clock is not is no fault of the places.
        own = replace(track, t=fault.arrivals.get(name, track.t))
        at = astray_from(own, truth[name].position)
        assert at >= BEGIN
        astray |= {name} if np.isfinite(at) else set()
    places_right = kind in ("clock step", "swapped radios", "stray stamp")
    assert astray == (set() if places_right else set(fault.faulty))


def test_ranges_fit_the_moved_truth() -> None:
    for kind in ("train", "lift", "train, all see the world"):
        errors = fault_of(kind, 1).simulation.range_errors()
        np.testing.assert_allclose(errors, fault_of("none", 1).simulation.range_errors(), atol=1e-9)
    lifted = fault_of("lift", 1).simulation.truth[ONE].position[:, 2]
    assert abs(lifted[-1] - lifted[0]) == pytest.approx(5.0, abs=0.3)


def test_a_new_session_begins_at_its_own_origin_after_a_gap() -> None:
    fault = fault_of("new session, announced", 1)
    track = fault.simulation.recording.tracks[ONE]
    first = int((track.t < BEGIN).sum())
    assert track.t[first] - track.t[first - 1] > 2.9
    np.testing.assert_allclose(track.position[first], 0.0, atol=1e-12)
    assert [round(t, 2) for t, _ in fault.calls] == [30.0, 32.99]
    assert not fault_of("new session", 1).calls


def test_two_maps_end_in_the_first_one() -> None:
    track, was = (fault_of(kind, 0).simulation.recording.tracks[ONE] for kind in ("two maps", "none"))
    away = np.linalg.norm(track.position - was.position, axis=1) > 1e-9
    assert int(np.diff(away.astype(int)).clip(0).sum()) == 3
    assert not away[track.t > BEGIN + 10.0].any()


def test_swapped_radios_range_for_one_another() -> None:
    swapped, was = (fault_of(kind, 0).simulation.recording for kind in ("swapped radios", "none"))
    then = (was.ranges.t >= BEGIN) & (was.ranges.t < BEGIN + 10.0)
    i, j = (was.index(name) for name in TWO)
    assert (swapped.ranges.b[then & (was.ranges.b == i)] == j).all()
    np.testing.assert_array_equal(swapped.ranges.a[~then], was.ranges.a[~then])


def test_without_attitude_a_jump_does_not_show_in_it() -> None:
    track = fault_of("jump, no attitude", 1).simulation.recording.tracks[ONE]
    assert (track.quat_xyzw == IDENTITY).all()
    turned = fault_of("jump", 1).simulation
    slam = wrap_angle(
        yaw_of_quaternions(turned.recording.tracks[ONE].quat_xyzw)
        - yaw_of_quaternions(fault_of("none", 1).simulation.recording.tracks[ONE].quat_xyzw)
    )
    assert np.abs(slam[-1]) > 0.1


def test_seconds_off_are_counted_by_stretches() -> None:
    t = 0.1 * np.arange(10)
    off = np.array([0, 1, 1, 0, 0, 1, 1, 1, 0, 0], dtype=bool)
    assert off_seconds(t, off) == (pytest.approx(0.3), pytest.approx(0.5))
    assert off_seconds(t, np.zeros(10, dtype=bool)) == (0.0, 0.0)
    gap = np.array([0.0, 5.0, 5.1])
    assert off_seconds(gap, np.array([True, False, False])) == (pytest.approx(0.2), pytest.approx(0.2))


def course(registered: str, error: list[float], faulty: bool = True) -> Course:
    """Poses at 1 Hz."""
    said = np.array([c == "r" for c in registered])
    return Course("phone1", faulty, np.arange(float(len(said))), said, np.array(error))


def test_only_what_is_registered_can_be_off() -> None:
    assert course_off(course("r-rr", [9.0, 9.0, 0.1, np.nan]))[1] == pytest.approx(0.2)


def test_again_is_when_it_stays_so() -> None:
    of = course("rr-rrrrr", [0.1, 0.1, 0.1, 0.1, 0.9, 0.1, 0.1, 0.1])
    assert again_after(of, 1.0) == 4.0  # at 1 and at 3 it did not last
    assert again_after(of, 6.5) == 0.5
    assert again_after(course("r--", [0.1] * 3), 1.0) == np.inf


def test_shares_are_of_the_worst_user() -> None:
    a, b = course("rrrr", [0.1] * 4), course("r-r-", [0.1] * 4)
    assert share([a, b], 0.0, 4.0) == 0.5
    assert share([a, b], 2.0, 3.0) == 1.0
    assert np.isnan(share([], 0.0, 4.0))


def test_a_row_keeps_users_at_fault_apart() -> None:
    bad = course("r" * 30, [0.1] * 20 + [2.0] * 10)
    good = course("r" * 20 + "-" * 10, [0.1] * 30, faulty=False)
    row = row_of("slide", [Judged("slide", 0, [bad, good], 20.0, 25.0)])
    assert row["at fault: s off in all"] == pytest.approx(9 * 0.2)
    assert (row["others: s off in all"], row["registered before"], row["others registered then"]) == (0.0, 1.0, 0.0)
    assert (row["at most"], row["again by 15 s"], row["walks with > 1 s"]) == (np.inf, 0.0, 1)


def test_a_track_is_astray_from_where_it_leaves_its_first_seconds() -> None:
    t = [float(k) for k in range(40)]
    own = standing(t)
    walked = own.position + np.column_stack([np.sin(own.t), np.cos(own.t), 0.0 * own.t])
    own = replace(own, position=walked)
    assert astray_from(own, walked) == np.inf
    true = walked + np.where(own.t[:, None] >= 30.0, [0.0, 0.0, 1.0], 0.0)
    assert astray_from(own, true) == 30.0


def test_the_common_frame_stays_when_swapped_radios_speak_against_the_reference() -> None:
    """Two people's radios are swapped: what they measure fits as well without the other two as with them."""
    for course in walk(("swapped radios", 20)).courses:
        longest, _ = course_off(course)
        assert longest < 1.0, course.name


@pytest.mark.parametrize("kind", ["new session", "swapped radios"])
def test_nobody_is_told_as_registered_for_long_where_it_is_not(kind: str) -> None:
    """SLAM begins anew after a pause and does not say so; two wear each other's radio, and the reference is blamed."""
    for course in walk((kind, 0)).courses:
        longest, _ = course_off(course)
        assert longest < 1.0
        assert course.registered[course.t > 70.0].mean() > 0.95
