"""The problem: which ranges between which users, and its parts."""

from __future__ import annotations

from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.solver_scenes import recording_of, track_of

from synchronizar.data.recording import Recording
from synchronizar.graph.problem import Problem, ranging, reached_from
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import range_measurements

MODEL = Parameters()
STILL = track_of(np.arange(6.0), np.zeros((6, 3)))


def four() -> Recording:
    """a ranges to b all along and to c late; d ranges to nobody but a static radio."""
    rows = [(float(t), "a", "b", 2.0) for t in range(1, 5)]
    rows += [(4.5, "a", "c", 3.0), (2.5, "b", "c", 3.5), (2.0, "d", "radio", 1.0)]
    return recording_of({**dict.fromkeys("abcd", STILL), "radio": None}, rows)


@given(seed=st.integers(0, 2**31 - 1), users=st.integers(2, 9), links=st.integers(0, 9))
@settings(derandomize=True, deadline=None, max_examples=60)
def test_connected_are_those_that_a_chain_of_ranges_reaches(seed: int, users: int, links: int) -> None:
    random = np.random.default_rng(seed)
    names = [f"u{k}" for k in range(users)]
    ends = [random.choice(users, 2, replace=False) for _ in range(links)]
    rows = [(1.0, names[a], names[b], 1.0) for a, b in ends]
    measurements = range_measurements(recording_of(dict.fromkeys(names, STILL), rows), MODEL)
    touches = np.eye(users)
    for a, b in ends:
        touches[a, b] = touches[b, a] = 1.0
    reaches = np.linalg.matrix_power(touches, users) > 0.0
    for reference in range(users):
        assert (
            sorted(reached_from(reference, ranging(measurements, users))) == np.flatnonzero(reaches[reference]).tolist()
        )


@pytest.mark.parametrize(
    ("reference", "active_users", "ranges"), [(0, [0, 1, 2], 6), (2, [0, 1, 2], 6), (3, [3, 4], 1)]
)
def test_a_problem_has_the_users_that_ranges_connect_to_the_reference_and_no_other_range(
    reference: int, active_users: list[int], ranges: int
) -> None:
    problem = Problem.of(four(), reference, MODEL)
    assert problem.active_users == active_users
    assert problem.free == [u for u in active_users if u != reference]
    assert len(problem.measurements) == ranges
    assert set(problem.measurements.i) | set(problem.measurements.j) == set(active_users)
    assert len(problem.users) == 5


def test_a_part_leaves_out_whom_its_ranges_do_not_reach() -> None:
    problem = Problem.of(four(), 0, MODEL)
    early = problem.part(problem.measurements.t < 2.2)
    assert (early.active_users, len(early.measurements)) == ([0, 1], 2)
    assert (early.recording, early.reference, early.parameters) == (problem.recording, 0, MODEL)
    chain = problem.part(problem.measurements.t > 4.2)  # to c alone, who ranged to b before
    assert (chain.active_users, len(chain.measurements)) == ([0, 2], 1)
    nobody = problem.part(np.zeros(6, dtype=bool))
    assert (nobody.active_users, nobody.free, len(nobody.measurements)) == ([0], [], 0)


def test_a_widened_problem_adds_variances_and_leaves_the_first_as_it_was() -> None:
    problem = Problem.of(four(), 0, MODEL)
    before = problem.measurements.sigma.copy()
    np.testing.assert_allclose(problem.widened(0.3).measurements.sigma ** 2, before**2 + 0.09)
    np.testing.assert_array_equal(problem.measurements.sigma, before)
    np.testing.assert_array_equal(problem.widened(0.0).measurements.sigma, before)
    with pytest.raises(FrozenInstanceError):
        problem.reference = 1  # type: ignore[misc]
