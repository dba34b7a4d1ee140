from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from synchronizar.arrays import Array, Mask
from synchronizar.estimation.hypotheses import hypotheses
from synchronizar.parameters import Parameters

CORNERS = np.array([[[x, y, 0.0] for x in (-1.0, 1.0) for y in (-1.0, 1.0)]] * 3)
SIGMA = np.array([0.1, 0.2, 0.3, 0.05])


class Candidate(NamedTuple):
    frames: Array
    cost: float
    held_as_usual: Mask = np.ones(3, dtype=bool)


def candidate(cost: float, x_of_second: float, x_of_third: float) -> Candidate:
    """Three users; the second and the third lie somewhere along x."""
    frames = np.zeros((3, 4))
    frames[1, 0], frames[2, 0] = x_of_second, x_of_third
    return Candidate(frames, cost)


def covariances(_: Candidate) -> tuple[Array, float]:
    return np.array([np.zeros((4, 4)), np.diag(SIGMA**2), np.diag(SIGMA**2)]), 0.0


def test_one_minimum_is_a_placement_as_it_is() -> None:
    (only,) = hypotheses([candidate(3.0, 1.0, 2.0)], covariances, CORNERS, Parameters())
    assert only.cost == 3.0
    np.testing.assert_array_equal(only.frames[:, 0], [0.0, 1.0, 2.0])
    np.testing.assert_allclose(only.covariances[1], np.diag(SIGMA**2))
    assert len(only.components_of(1)) == 1


def test_minima_that_are_near_are_one_placement_with_the_moments_of_their_mixture() -> None:
    (only,) = hypotheses(
        [candidate(0.0, 1.0, 2.0), candidate(np.log(3.0), 1.4, 2.0)], covariances, CORNERS, Parameters()
    )
    assert only.frames[1, 0] == pytest.approx(1.1)
    assert only.covariances[1, 0, 0] == pytest.approx(SIGMA[0] ** 2 + 0.75 * 0.25 * 0.4**2)
    np.testing.assert_allclose([m.weight for m in only.minima], [0.75, 0.25])


def test_a_minimum_that_repeats_another_does_not_count_twice() -> None:
    minima = [candidate(0.0, 1.0, 2.0), candidate(0.0, 1.4, 2.0), candidate(0.001, 1.4 + 1e-4, 2.0)]
    (only,) = hypotheses(minima, covariances, CORNERS, Parameters())
    assert only.frames[1, 0] == pytest.approx(1.2)


def test_who_is_near_in_all_joint_placements_is_told_by_the_mixture_of_all() -> None:
    """The third is here or two metres away; with it the second moves by 0.4 m."""
    found = hypotheses([candidate(0.0, 1.0, 2.0), candidate(np.log(3.0), 1.4, 4.0)], covariances, CORNERS, Parameters())
    assert [p.cost for p in found] == pytest.approx([0.0, np.log(3.0)])
    for placement in found:
        assert placement.frames[1, 0] == pytest.approx(1.1)
        assert placement.covariances[1, 0, 0] == pytest.approx(SIGMA[0] ** 2 + 0.75 * 0.25 * 0.4**2)
        np.testing.assert_allclose([m.weight for m in placement.components_of(1)], [0.75, 0.25])
    # The third itself is in one place or in the other.
    assert [p.frames[2, 0] for p in found] == [2.0, 4.0]
    assert found[0].covariances[2, 0, 0] == pytest.approx(SIGMA[0] ** 2)
    assert len(found[0].components_of(2)) == 1


@pytest.mark.filterwarnings("error")
def test_who_has_no_placement_is_left_alone() -> None:
    minima = [candidate(0.0, 1.0, 2.0), candidate(1.0, 1.4, 4.0)]
    for minimum in minima:
        minimum.frames[1] = np.nan
    found = hypotheses(minima, covariances, CORNERS, Parameters())
    assert len(found) == 2
    assert np.isnan(found[0].frames[1]).all()
    assert [p.frames[2, 0] for p in found] == [2.0, 4.0]
