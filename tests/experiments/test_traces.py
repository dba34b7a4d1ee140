from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("scipy", reason="the pairwise method and the tests need scipy")
pytest.importorskip("statsmodels", reason="power and equivalence are statsmodels'")
pytest.importorskip("matplotlib", reason="experiments draw figures")

from experiments.common.methods import METHODS
from experiments.paper.traces import (
    LENGTH_M,
    MARGIN_M,
    PAPER,
    SAMPLED_M,
    STRAY_M,
    SWAY_M,
    WIDTH_M,
    evenly,
    follow,
    modified_hausdorff,
    row,
    trace,
    walked,
)
from synchronizar.arrays import Array


def test_modified_hausdorff_is_the_larger_mean_of_nearest_distances() -> None:
    a = np.array([[0.0, 0.0], [4.0, 0.0]])
    b = np.array([[0.0, 3.0], [4.0, 1.0], [4.0, 6.0]])
    # From a: 3 and 1, mean 2. From b: 3, 1 and 6, mean 10 / 3.
    assert modified_hausdorff(a, b) == pytest.approx(10.0 / 3.0)
    assert modified_hausdorff(b, a) == pytest.approx(10.0 / 3.0)
    assert modified_hausdorff(a, a) == 0.0


def test_one_far_point_counts_by_its_share_and_not_alone() -> None:
    a = np.column_stack([np.arange(10.0), np.zeros(10)])
    b = np.vstack([a, [[0.0, 11.0]]])
    assert modified_hausdorff(a, b) == pytest.approx(1.0)


def test_a_line_beside_a_line_is_as_far_as_it_lies_away() -> None:
    line = evenly(np.array([[0.0, 0.0], [3.0, 4.0]]))
    beside = line + 0.2 * np.array([-0.8, 0.6])
    assert modified_hausdorff(line, beside) == pytest.approx(0.2, abs=1e-9)


@pytest.mark.parametrize("name", PAPER)
def test_a_trace_lies_in_its_box_and_is_sampled_evenly(name: str) -> None:
    line = trace(name)
    assert np.all(np.abs(line) <= np.array([0.5 * LENGTH_M, 0.5 * WIDTH_M]) + 1e-9)
    assert np.ptp(line[:, 0]) == pytest.approx(LENGTH_M)
    assert np.ptp(line[:, 1]) > 0.5 * WIDTH_M
    assert_allclose(np.linalg.norm(np.diff(line, axis=0), axis=1), SAMPLED_M, rtol=0.3)


def test_the_l_is_eight_metres_long() -> None:
    assert len(trace("L")) == round(8.0 / SAMPLED_M) + 1


def straying(seed: int) -> Array:
    """How far to the left somebody walks who follows a straight line of 50 m along x."""
    path = walked(np.random.default_rng(seed), evenly(np.array([[0.0, 0.0], [50.0, 0.0]])))
    return path[:, 1]


def test_people_stray_as_far_as_is_said_and_smoothly() -> None:
    stray = np.array([np.interp(np.arange(5000), np.arange(len(y)), y) for y in map(straying, range(20))])
    # A sine has the mean square of half its amplitude's.
    assert stray.std() == pytest.approx(np.hypot(STRAY_M, SWAY_M / np.sqrt(2.0)), rel=0.15)
    steps = np.diff(stray, axis=1)
    assert np.abs(steps).max() < 0.5 * SAMPLED_M
    assert np.corrcoef(steps[:, :-1].ravel(), steps[:, 1:].ravel())[0, 1] > 0.95


def test_who_follows_is_the_same_for_the_same_seed() -> None:
    one, again = follow((5, 0, "S")), follow((5, 0, "S"))
    assert one.perfect == again.perfect
    assert_allclose(one.estimated, again.estimated)
    assert one.estimated.shape == (len(METHODS),)
    assert one.perfect < MARGIN_M
    assert one.estimated[list(METHODS).index("rigid")] < 0.2


def test_walks_of_one_kind_are_told_equal_and_walks_that_are_apart_are_not() -> None:
    random = np.random.default_rng(0)
    perfect, other = 0.05 + 0.01 * random.standard_normal((2, 4, 22))
    same, apart = row("L", "joint", perfect, other), row("L", "joint", perfect, other + 0.1)
    assert same["reproduced"] == "yes"
    assert same["p_equal"] < 0.05
    assert apart["reproduced"] == "no"
    assert apart["significant"] == 1.0
    assert apart["p_equal"] > 0.95
    assert apart["d"] == pytest.approx(10.0, rel=0.15)
    assert same["power"] > 0.99
    # What 22 against 22 find with 80 % power is 0.87 sd (Cohen 1988, by interpolation).
    assert same["finds"] == pytest.approx(0.87 * 0.01, rel=0.15)


def test_few_scattered_walks_tell_neither_difference_nor_equality() -> None:
    random = np.random.default_rng(1)
    perfect, other = 0.3 + 0.3 * random.standard_normal((2, 1, 22))
    told = row("S", "pairwise", perfect, other)
    assert told["reproduced"] == "undecided"
    assert told["significant"] == 0.0
    assert told["p_equal"] > 0.05
    assert told["power"] < 0.2


def test_a_difference_that_is_found_is_told_even_where_it_is_within_the_margin() -> None:
    random = np.random.default_rng(2)
    perfect, other = 0.05 + 0.01 * random.standard_normal((2, 4, 22))
    told = row("L", "joint", perfect, other + 0.4 * MARGIN_M)
    assert told["p_equal"] < 0.05
    assert told["significant"] >= 0.5
    assert told["reproduced"] == "no"
