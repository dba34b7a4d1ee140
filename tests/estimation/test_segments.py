"""Long recordings: what is found in a first stretch grows to the same answer as the whole at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from support.solver_scenes import offs

from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.data.track import Track
from synchronizar.estimation.register import register
from synchronizar.estimation.segments import _first_segment, coarse_interval
from synchronizar.graph.problem import Problem
from synchronizar.parameters import Parameters
from synchronizar.reporting.evaluate import evaluate
from synchronizar.simulation.simulate import Scene, simulate

SHORT = Parameters().changed(search={"first_stretch": 20.0})
WHOLE = Parameters().changed(search={"first_stretch": 1000.0})


def between(tracks: Mapping[str, Track], others: Mapping[str, Track]) -> float:
    """RMS distance (m) of two answers laid onto each other: the common frame is the reference's first pose's."""
    joint = evaluate(tracks, others, next(iter(tracks))).joint_ate
    assert joint is not None
    return joint


def test_a_walk_of_five_minutes_grows_to_the_answer_it_has_as_a_whole() -> None:
    simulation = simulate(Scene(users=3, seconds=300.0, drift_m_per_sqrt_s=0.01, drift_rad_per_sqrt_s=0.005, seed=0))
    recording = simulation.recording
    grown, whole = register(recording, parameters=SHORT), register(recording, parameters=WHOLE)
    assert between(grown.tracks(recording), whole.tracks(recording)) < 0.1
    assert evaluate(grown.tracks(recording), simulation.truth, "phone0").joint_ate_xy == pytest.approx(0.0, abs=0.15)
    assert all(user.state is State.REGISTERED for user in grown.users.values())
    for name in ("phone1", "phone2"):
        one, other = (g.users[name].common_from_user for g in (grown, whole))
        assert one is not None
        assert other is not None
        assert one.scale == pytest.approx(other.scale, abs=0.005)


def without(recording: Recording, name: str, begin: float, end: float) -> Recording:
    """A user who is there from begin to end (s) alone."""
    track, user = recording.tracks[name], recording.index(name)
    there = (track.t >= begin) & (track.t <= end)
    r = recording.ranges
    mine = (r.a == user) | (r.b == user)
    ranges: Ranges = r.select(~mine | ((r.t >= begin) & (r.t <= end)))
    kept = Track(track.t[there], track.position[there], track.quat_xyzw[there])
    return replace(recording, tracks={**recording.tracks, name: kept}, ranges=ranges)


@pytest.mark.parametrize("seed", range(3))
def test_somebody_who_comes_after_the_first_stretch_is_placed(seed: int) -> None:
    """Who leaves early keeps the first stretch early: it is where the most users hang together, the earliest such."""
    simulation = simulate(Scene(users=4, seconds=100.0, seed=seed))
    recording = without(without(simulation.recording, "phone3", 0.0, 40.0), "phone2", 60.0, 101.0)
    assert _first_segment(Problem.of(recording, 0, SHORT))[1] < 60.0
    registration, whole = register(recording, parameters=SHORT), register(recording, parameters=WHOLE)
    assert [user.state for user in registration.users.values()] == [user.state for user in whole.users.values()]
    found = offs(simulation, registration)
    assert set(found) == {"phone1", "phone2", "phone3"}
    assert max(found.values()) < 0.3
    assert between(registration.tracks(recording), whole.tracks(recording)) < 0.1
    assert registration.ranges.used.mean() > 0.9


@pytest.mark.parametrize("seed", range(3))
def test_a_reference_that_comes_late_is_where_growing_begins(seed: int) -> None:
    simulation = simulate(Scene(users=3, seconds=100.0, late_joiners=1, seed=seed))
    recording = simulation.recording
    begin, end = _first_segment(Problem.of(recording, 2, SHORT))
    assert end - begin == pytest.approx(20.0)
    assert end > 50.0
    registration = register(recording, reference="phone2", parameters=SHORT)
    assert all(user.state is State.REGISTERED for user in registration.users.values())
    assert max(offs(simulation, registration).values()) < 0.3
    tracks = registration.tracks(recording)
    assert set(tracks) == {"phone0", "phone1", "phone2"}
    assert evaluate(tracks, simulation.truth, "phone2").joint_ate_xy == pytest.approx(0.0, abs=0.1)


def test_a_pair_that_meets_the_reference_only_after_the_first_stretch_is_tied_all_the_same() -> None:
    """Two walk with the reference one after the other, never with each other."""
    simulation = simulate(Scene(users=3, seconds=90.0, seed=1))
    recording = without(without(simulation.recording, "phone1", 0.0, 44.0), "phone2", 46.0, 91.0)
    registration = register(recording, parameters=SHORT)
    assert max(offs(simulation, registration).values()) < 0.4


def test_the_first_stretch_is_the_whole_of_a_recording_of_two() -> None:
    problem = Problem.of(simulate(Scene(seconds=39.0, seed=0)).recording, 0, SHORT)
    assert _first_segment(problem) == (-np.inf, np.inf)
    longer = Problem.of(simulate(Scene(seconds=42.0, seed=0)).recording, 0, SHORT)
    begin, end = _first_segment(longer)
    assert end - begin == pytest.approx(SHORT.search.first_stretch)


def test_a_range_decades_astray_makes_no_stretch_of_the_time_in_between() -> None:
    """Stretches in between would be a hundred million."""
    problem = Problem.of(simulate(Scene(seconds=42.0, seed=0)).recording, 0, SHORT)
    measurements = problem.measurements
    astray = replace(measurements, t=np.append(measurements.t[:-1], measurements.t[-1] + 1e9))
    assert _first_segment(problem.with_measurements(astray)) == _first_segment(problem)


def test_keyframes_are_far_apart_while_placements_are_compared() -> None:
    """Twenty in the first stretch, and none closer than those of the answer."""
    recording = simulate(Scene(seconds=38.0, seed=0)).recording
    whole = Problem.of(recording, 0, WHOLE)
    ranges = whole.measurements
    assert coarse_interval(whole) == pytest.approx(float(np.ptp(ranges.t)) / 20.0)
    assert coarse_interval(Problem.of(recording, 0, SHORT)) == SHORT.slam.keyframe_interval
    assert coarse_interval(whole.with_measurements(ranges[:0])) == WHOLE.slam.keyframe_interval
