from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.nlos_chain import (
    BURSTS,
    FLUCTUATION,
    KEEPS_LENGTH,
    LATE,
    PRIOR,
    SHARE,
    TYPICAL_ODDS,
    emission,
    late_by_the_loss,
    stamps,
    transition,
)

from synchronizar._core import Bursts, NlosMixture, burst_nlos_odds
from synchronizar.arrays import Array


def every_path(
    t: Array, e: Array, sigma: Array, nlos_odds: Array, loss: NlosMixture, share: float, duration: float
) -> tuple[Array, float]:
    """P(late) of up to three ranges and the negative log likelihood, by summing over every path of states."""
    paths = np.array([1.0 - share, *(share * PRIOR)]) * emission(e[0], sigma[0], nlos_odds[0], loss, share)
    for k in range(1, len(t)):
        arrives = transition(t[k] - t[k - 1], share, duration) * emission(e[k], sigma[k], nlos_odds[k], loss, share)
        paths = paths[..., None] * arrives
    total = paths.sum()
    inlier_probability = np.array([np.take(paths, 0, axis=k).sum() for k in range(len(t))])
    return 1.0 - inlier_probability / total, float(-np.log(total))


def judged(e: Array, dt: float = 0.1, sigma: float = 0.1, nlos_odds: float = TYPICAL_ODDS) -> Array:
    """P(late) of ranges every dt s."""
    n = len(e)
    odds, _ = burst_nlos_odds(stamps(n, dt), e, np.full(n, sigma), np.full(n, nlos_odds), LATE, BURSTS)
    return late_by_the_loss(e, np.full(n, sigma), odds)


# An honest density below e^-12.5 meets the floor that keeps the chain from dividing by zero, which the paths here lack.
residual = st.floats(-5.0, 5.0)


@st.composite
def chains(draw: st.DrawFn) -> tuple[Array, Array, Array, Array]:
    n = draw(st.integers(1, 3))

    def column(elements: st.SearchStrategy[float]) -> Array:
        return np.array(draw(st.lists(elements, min_size=n, max_size=n)))

    return (
        np.cumsum(column(st.floats(0.0, 3.0))),
        column(residual),
        column(st.floats(0.05, 0.3)),
        column(st.floats(0.01, 10.0)),
    )


@given(
    chain=chains(),
    scale=st.floats(0.5, 2.0),
    early_odds=st.floats(0.001, 0.01),
    share=st.floats(0.02, 0.5),
    duration=st.floats(0.2, 5.0),
)
@settings(derandomize=True, deadline=None, max_examples=150)
def test_the_chain_is_the_sum_over_every_path(
    chain: tuple[Array, Array, Array, Array], scale: float, early_odds: float, share: float, duration: float
) -> None:
    t, e, sigma, nlos_odds = chain
    loss = NlosMixture(scale, early_odds)
    is_late, cost = every_path(t, e, sigma, nlos_odds, loss, share, duration)
    odds, found_cost = burst_nlos_odds(t, e, sigma, nlos_odds, loss, Bursts(share, duration, KEEPS_LENGTH, FLUCTUATION))
    assert found_cost == pytest.approx(cost, rel=1e-4, abs=1e-4)
    found = late_by_the_loss(e, sigma, odds, loss)
    late_side = e < 0.0
    np.testing.assert_allclose(found[late_side], is_late[late_side], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(1.0 - found[late_side], 1.0 - is_late[late_side], rtol=1e-3, atol=1e-6)
    assert (odds > 0.0).all()


def test_honest_ranges_without_residual_cost_little() -> None:
    n = 100
    _, cost = burst_nlos_odds(stamps(n, 0.1), np.zeros(n), np.full(n, 0.1), np.full(n, TYPICAL_ODDS), LATE, BURSTS)
    assert abs(cost) < 0.03 * n


def test_a_burst_among_clean_ranges_is_found() -> None:
    e = np.random.default_rng(2).normal(size=60)
    e[25:35] -= 4.0  # 0.4 m
    is_late = judged(e)
    assert is_late[26:34].min() > 0.9
    assert is_late[:24].max() < 0.5
    assert is_late[36:].max() < 0.5


def test_a_range_is_more_suspect_inside_a_burst_than_among_honest_neighbours() -> None:
    lone, inside = np.zeros(41), np.zeros(41)
    inside[15:26] = -4.0
    lone[20] = inside[20] = -2.5
    assert judged(lone)[20] < 0.4
    assert judged(inside)[20] > 0.9


def test_neighbours_in_time_speak_and_those_long_past_do_not() -> None:
    e = np.full(11, -4.0)
    e[5] = -2.0
    in_a_burst, hours_apart = judged(e, dt=0.1), judged(e, dt=3600.0)
    alone = judged(np.array([-2.0]))
    assert in_a_burst[5] > hours_apart[5] + 0.3
    assert hours_apart[5] == pytest.approx(alone[0], rel=1e-4)


def test_a_chain_reads_alike_in_both_directions() -> None:
    random = np.random.default_rng(4)
    n = 50
    t = np.cumsum(random.exponential(0.2, n))
    e = random.normal(-1.0, 2.0, n)
    sigma, nlos_odds = random.uniform(0.05, 0.2, n), random.uniform(0.05, 0.5, n)
    odds, cost = burst_nlos_odds(t, e, sigma, nlos_odds, LATE, BURSTS)
    backward, backward_cost = burst_nlos_odds((t[-1] - t)[::-1], e[::-1], sigma[::-1], nlos_odds[::-1], LATE, BURSTS)
    assert backward_cost == pytest.approx(cost, rel=1e-4)
    is_late, is_late_backward = (late_by_the_loss(e, sigma, o) for o in (odds, backward[::-1]))
    np.testing.assert_allclose(is_late_backward, is_late, rtol=1e-3, atol=1e-6)


def test_a_single_range_is_judged_by_its_own_residual() -> None:
    for e in (-4.0, -1.0, 0.0, 2.0):
        one = np.array([e]), np.array([0.1]), np.array([TYPICAL_ODDS])
        odds, cost = burst_nlos_odds(np.zeros(1), *one, LATE, BURSTS)
        weights = np.array([1.0 - SHARE, *(SHARE * PRIOR)]) * emission(e, 0.1, TYPICAL_ODDS, LATE, SHARE)
        assert cost == pytest.approx(-np.log(weights.sum()), rel=1e-4, abs=1e-6)
        if e < 0.0:
            assert late_by_the_loss(*one[:2], odds)[0] == pytest.approx(1.0 - weights[0] / weights.sum(), rel=1e-4)


def test_what_the_radio_says_of_a_range_is_heard() -> None:
    e = np.full(3, -2.0)
    t, sigma = stamps(3, 10.0), np.full(3, 0.1)
    clear, _ = burst_nlos_odds(t, e, sigma, np.full(3, 0.05), LATE, BURSTS)
    blocked, _ = burst_nlos_odds(t, e, sigma, np.full(3, 9.0), LATE, BURSTS)
    assert (late_by_the_loss(e, sigma, clear) < 0.4).all()
    assert (late_by_the_loss(e, sigma, blocked) > 0.9).all()


def test_the_longer_a_detour_the_surer_its_neighbours_are_that_it_is_late() -> None:
    """The odds of being late are what the neighbours say, and they say no less of a range that is later still."""
    for e in (-4.0, -7.0, -10.0, -20.0, -50.0):
        chain = np.zeros(31)
        chain[10:21] = e
        n = len(chain)
        odds, _ = burst_nlos_odds(stamps(n, 0.1), chain, np.full(n, 0.1), np.full(n, TYPICAL_ODDS), LATE, BURSTS)
        assert odds[15] > 1.0


def test_ranges_of_one_moment_that_are_all_late_by_far_give_numbers() -> None:
    n = 8
    for e in (-10.0, -40.0, -1000.0):
        odds, cost = burst_nlos_odds(np.zeros(n), np.full(n, e), np.full(n, 0.1), np.full(n, 0.25), LATE, BURSTS)
        assert np.isfinite(odds).all()
        assert np.isfinite(cost)
        assert (late_by_the_loss(np.full(n, e), np.full(n, 0.1), odds) > 0.99).all()


@pytest.mark.parametrize("e", [0.0, -2.0, -40.0, 40.0])
def test_a_chain_of_any_length_stays_finite_and_fast(e: float) -> None:
    n = 200_000
    columns = stamps(n, 0.01), np.full(n, e), np.full(n, 0.1), np.full(n, 0.25)
    begin = time.process_time()
    odds, cost = burst_nlos_odds(*columns, LATE, BURSTS)
    assert time.process_time() - begin < 2.0
    assert np.isfinite(odds).all()
    assert np.isfinite(cost)
    # Far from the ends every range is like every other.
    middle = odds[n // 2 - 100 : n // 2 + 100]
    np.testing.assert_allclose(middle, middle[0], rtol=1e-3)


@pytest.mark.parametrize(("share", "duration"), [(0.0, 1.0), (1.0, 1.0), (np.nan, 1.0), (0.1, 0.0), (0.1, -1.0)])
def test_what_makes_no_chain_is_refused(share: float, duration: float) -> None:
    with pytest.raises(ValueError, match="share"):
        Bursts(share, duration, KEEPS_LENGTH, FLUCTUATION)


@pytest.mark.parametrize("short", range(4))
def test_columns_of_different_lengths_are_refused(short: int) -> None:
    t, e, sigma, nlos_odds = (np.ones(2 if k == short else 3) for k in range(4))
    with pytest.raises(ValueError, match="columns"):
        burst_nlos_odds(t, e, sigma, nlos_odds, LATE, BURSTS)
