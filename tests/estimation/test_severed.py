"""Who was moved in a way that its SLAM did not see, and whose ranges have not fitted since."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.estimation.register import register
from synchronizar.estimation.severed import severed
from synchronizar.graph.problem import Problem
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import RangeMeasurements
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

MODEL = Parameters()
LIMIT = -np.log(MODEL.integrity.wrong_share) * MODEL.ranges.nlos_duration
"""s: as long as one line of sight may be blocked."""


def walked(users: int, seconds: float = 20.0, seed: int = 3) -> Recording:
    return simulate(Scene(users=users, seconds=seconds, rate_hz=10.0, seed=seed)).recording


def ranges_of(recording: Recording) -> RangeMeasurements:
    return Problem.of(recording, 0, MODEL).measurements


def blocked(s: RangeMeasurements, pairs: set[tuple[int, int]], since: float) -> Array:
    """(n,) of each range the probability that it is in line of sight: none of these pairs' ranges since then is."""
    between = np.array([(int(i), int(j)) in pairs for i, j in zip(s.i, s.j, strict=True)])
    return np.where(between & (s.t >= since), 0.0, 1.0)


def cut_off(s: RangeMeasurements, inlier: Array, users: int) -> set[int]:
    return set(severed(s, inlier, [0], users, MODEL))


def test_one_line_of_sight_may_be_blocked_as_long_as_chance_allows() -> None:
    s = ranges_of(walked(2))
    end = float(s.t[-1])
    assert not cut_off(s, blocked(s, {(0, 1)}, end - LIMIT + 0.3), 2)
    assert cut_off(s, blocked(s, {(0, 1)}, end - LIMIT - 0.3), 2) == {1}


def test_many_lines_of_sight_at_once_are_less_likely_to_be_blocked() -> None:
    """Two people beside two: four lines of sight, each for a quarter of the time."""
    s = ranges_of(walked(4))
    end, across = float(s.t.max()), {(0, 2), (0, 3), (1, 2), (1, 3)}
    assert not cut_off(s, blocked(s, across, end - LIMIT / 4.0 + 0.5), 4)
    assert cut_off(s, blocked(s, across, end - LIMIT / 4.0 - 0.5), 4) == {2, 3}


def test_who_is_still_tied_to_somebody_is_where_they_are() -> None:
    s = ranges_of(walked(3))
    assert not cut_off(s, blocked(s, {(0, 2)}, 0.0), 3)


def test_a_line_of_sight_that_is_free_again_ties_again() -> None:
    s = ranges_of(walked(2))
    inlier = blocked(s, {(0, 1)}, float(s.t[-1]) - 10.0)
    inlier[-8:] = 1.0
    assert not cut_off(s, inlier, 2)


def test_a_wrong_distance_is_a_right_one_now_and_then() -> None:
    s = ranges_of(walked(2))
    inlier = blocked(s, {(0, 1)}, float(s.t[-1]) - 10.0)
    inlier[-40] = 1.0
    assert cut_off(s, inlier, 2) == {1}


def test_who_only_stopped_ranging_is_not_contradicted() -> None:
    recording = walked(3)
    early = recording.ranges.t < 8.0
    mine = (recording.ranges.a == 2) | (recording.ranges.b == 2)
    s = ranges_of(replace(recording, ranges=recording.ranges.select(early | ~mine)))
    assert not cut_off(s, np.ones(len(s)), 3)


@pytest.mark.parametrize("seed", [3, 4])
def test_two_who_took_a_lift_together_are_not_registered_and_those_who_stayed_are(seed: int) -> None:
    recording = walked(4, 22.0, seed)
    r, up = recording.ranges, 4.5
    across = ((r.a >= 2) != (r.b >= 2)) & (r.t > 12.0)
    risen = replace(r, distance=np.where(across, np.hypot(r.distance, up), r.distance))
    found = register(replace(recording, ranges=risen)).users
    assert [user.state for user in found.values()] == [State.REGISTERED] * 2 + [State.UNOBSERVABLE] * 2
    assert "moved" in found["phone3"].reason
