from __future__ import annotations

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
    TYPICAL_ODDS,
    emission,
    late_by_the_loss,
    stamps,
    transition,
)
from support.reference_kernel import honest_density

from synchronizar._core import Bursts, burst_nlos_odds_of_pairs, foreign_or_nlos_of_pairs
from synchronizar.arrays import Array
from synchronizar.graph.priors import bursts_with_foreign
from synchronizar.parameters import Parameters

FOREIGN_SHARE, FOREIGN_DURATION, SPEED, SCALE, LEAST = 0.01, 3.0, 1.0, 10.0, 0.4
FOREIGN = BURSTS.with_foreign(FOREIGN_SHARE, FOREIGN_DURATION, SPEED, SCALE, LEAST)


def drawn_anew(d: float, sigma: float) -> float:
    """The density of a foreign distance over that of a perfect honest range."""
    return float(2.0 / (np.pi * SCALE * (1.0 + (d / SCALE) ** 2)) / honest_density(0.0, sigma))


def goes_on(d: Array, t: Array, sigma: Array, k: int) -> float:
    """The same, given the one before."""
    dt = t[k] - t[k - 1]
    spread = np.sqrt(sigma[k] ** 2 + sigma[k - 1] ** 2 + (SPEED * dt) ** 2)
    near = honest_density((d[k] - d[k - 1]) / spread, spread) / honest_density(0.0, sigma[k])
    kept = np.exp(-dt / FOREIGN_DURATION)
    return float(kept * near + (1.0 - kept) * drawn_anew(float(d[k]), float(sigma[k])))


def every_path(
    t: Array, d: Array, e: Array, sigma: Array, nlos_odds: Array, worth: float, share: float, duration: float
) -> tuple[Array, Array, float]:
    """P(late | not foreign), P(foreign) of up to three ranges and the cost, by summing over every path of states."""
    seen = 1.0 - 0.9 * np.exp(-0.5 * (e * sigma / LEAST) ** 2)
    at_first = np.array([1.0 - share, *(share * PRIOR)])

    def own(k: int) -> Array:
        return emission(e[k], sigma[k], nlos_odds[k], LATE, share)

    paths = np.append(
        (1.0 - FOREIGN_SHARE) * at_first * own(0), FOREIGN_SHARE ** (1.0 / worth) * seen[0] * drawn_anew(d[0], sigma[0])
    )
    for k in range(1, len(t)):
        dt = t[k] - t[k - 1]
        fades = np.exp(-dt / (FOREIGN_DURATION * (1.0 - FOREIGN_SHARE)))
        enters, leaves = (FOREIGN_SHARE * (1.0 - fades)) ** (1.0 / worth), (1.0 - FOREIGN_SHARE) * (1.0 - fades)
        step = np.zeros((26, 26))
        step[:25, :25] = (1.0 - enters) * transition(dt, share, duration) * own(k)
        step[:25, 25] = enters * seen[k] * drawn_anew(d[k], sigma[k])
        step[25, :25] = leaves * at_first * own(k)
        step[25, 25] = (1.0 - leaves) * seen[k] * goes_on(d, t, sigma, k)
        paths = paths[..., None] * step
    total = paths.sum()
    of = [np.moveaxis(paths, k, 0).reshape(26, -1).sum(axis=1) / total for k in range(len(t))]
    is_foreign = np.array([p[25] for p in of])
    return 1.0 - np.array([p[0] for p in of]) / (1.0 - is_foreign), is_foreign, float(-np.log(total))


@st.composite
def chains(draw: st.DrawFn) -> tuple[Array, ...]:
    n = draw(st.integers(1, 3))

    def column(least: float, most: float) -> Array:
        return np.array(draw(st.lists(st.floats(least, most), min_size=n, max_size=n)))

    return np.cumsum(column(0.0, 3.0)), column(0.0, 12.0), column(-5.0, 5.0), column(0.05, 0.3), column(0.01, 10.0)


def judged(
    t: Array, d: Array, e: Array, sigma: Array, nlos_odds: Array, bursts: Bursts, worth: float = 1.0
) -> tuple[Array, Array, float]:
    bounds = np.array([0, len(t)], dtype=np.int32)
    odds, foreign, cost = foreign_or_nlos_of_pairs(bounds, t, d, e, sigma, nlos_odds, np.array([worth]), LATE, bursts)
    return odds, foreign, float(cost[0])


@given(chain=chains(), worth=st.floats(0.3, 1.0), share=st.floats(0.02, 0.5), duration=st.floats(0.2, 5.0))
@settings(derandomize=True, deadline=None, max_examples=150)
def test_the_chain_with_foreign_ranges_is_the_sum_over_every_path(
    chain: tuple[Array, ...], worth: float, share: float, duration: float
) -> None:
    t, d, e, sigma, nlos_odds = chain
    is_late, is_foreign, cost = every_path(t, d, e, sigma, nlos_odds, worth, share, duration)
    bursts = Bursts(share, duration, KEEPS_LENGTH, FLUCTUATION).with_foreign(
        FOREIGN_SHARE, FOREIGN_DURATION, SPEED, SCALE, LEAST
    )
    odds, foreign, found = judged(t, d, e, sigma, nlos_odds, bursts, worth)
    assert found == pytest.approx(cost, rel=1e-4, abs=1e-4)
    np.testing.assert_allclose(foreign, is_foreign, rtol=1e-3, atol=1e-6)
    late = e < 0.0
    np.testing.assert_allclose(late_by_the_loss(e, sigma, odds)[late], is_late[late], rtol=1e-3, atol=1e-5)


def walked(n: int, seed: int = 3) -> tuple[Array, Array]:
    """Stamps of n ranges, and honest distances between two who walk."""
    t = stamps(n, 0.1)
    return t, 4.0 + np.sin(t) + 0.1 * np.random.default_rng(seed).standard_normal(n)


def test_seconds_of_another_pairs_distances_are_foreign_and_cost_less_than_one_by_one() -> None:
    t, d = walked(100)
    e = (4.0 + np.sin(t) - d) / 0.1
    d[40:70] -= 2.0 + 0.5 * np.cos(t[40:70])
    e[40:70] += 20.0 + 5.0 * np.cos(t[40:70])
    columns = t, d, e, np.full(100, 0.1), np.full(100, TYPICAL_ODDS)
    _, foreign, cost = judged(*columns, FOREIGN)
    _, none, apart = judged(*columns, BURSTS)
    assert foreign[41:69].min() > 0.99
    assert max(foreign[:39].max(), foreign[71:].max()) < 0.05
    assert not none.any()
    assert cost < apart - 100.0


def test_a_single_range_too_short_is_not_foreign_and_costs_what_it_did() -> None:
    t, d = walked(60)
    e = (4.0 + np.sin(t) - d) / 0.1
    d[30], e[30] = d[30] - 2.0, e[30] + 20.0
    columns = t, d, e, np.full(60, 0.1), np.full(60, TYPICAL_ODDS)
    _, foreign, cost = judged(*columns, FOREIGN)
    _, _, before = judged(*columns, BURSTS)
    assert foreign.max() < 0.05
    assert abs(cost - before) < 0.1


def test_honest_ranges_are_not_foreign_though_these_fit_one_another() -> None:
    t, d = walked(200)
    columns = t, d, (4.0 + np.sin(t) - d) / 0.1, np.full(200, 0.1), np.full(200, TYPICAL_ODDS)
    _, foreign, cost = judged(*columns, FOREIGN)
    assert foreign.max() < 0.01
    assert cost == pytest.approx(judged(*columns, BURSTS)[2], abs=0.1)


def test_a_pair_that_is_foreign_throughout_is_not_free() -> None:
    """For one wrong place to be as good as a right one, its pairs' ranges must not be foreign at no cost."""
    t, d = walked(100)
    columns = np.full(100, 0.1), np.full(100, TYPICAL_ODDS)
    honest = judged(t, d, (4.0 + np.sin(t) - d) / 0.1, *columns, FOREIGN)[2]
    wrong = judged(t, d, (6.0 + np.sin(t) - d) / 0.1, *columns, FOREIGN)
    assert wrong[1].min() > 0.9
    assert wrong[2] > honest + 20.0


def test_without_foreign_ranges_the_chain_is_the_one_of_bursts() -> None:
    random, n = np.random.default_rng(4), 70
    t, e = np.cumsum(random.exponential(0.2, n)), random.normal(-1.0, 3.0, n)
    d, sigma, nlos_odds = random.uniform(1.0, 9.0, n), random.uniform(0.05, 0.2, n), random.uniform(0.05, 0.5, n)
    bounds = np.array([0, 30, n], dtype=np.int32)
    t[30:] -= t[30]
    odds, foreign, costs = foreign_or_nlos_of_pairs(bounds, t, d, e, sigma, nlos_odds, np.ones(2), LATE, BURSTS)
    without = burst_nlos_odds_of_pairs(bounds, t, e, sigma, nlos_odds, LATE, BURSTS)
    np.testing.assert_array_equal(odds, without[0])
    np.testing.assert_array_equal(costs, without[1])
    assert not foreign.any()


@pytest.mark.parametrize("e", [0.0, -40.0, 40.0, 1000.0])
def test_a_long_chain_that_may_be_foreign_gives_numbers(e: float) -> None:
    n = 100_000
    d = np.random.default_rng(5).uniform(0.0, 500.0, n)
    odds, foreign, cost = judged(stamps(n, 0.01), d, np.full(n, e), np.full(n, 0.1), np.full(n, TYPICAL_ODDS), FOREIGN)
    assert np.isfinite(odds).all()
    assert np.isfinite(cost)
    assert ((foreign >= 0.0) & (foreign <= 1.0)).all()


def test_an_error_that_reflections_make_too_is_not_foreign_however_long_it_stays() -> None:
    t, d = walked(150)
    e = (4.0 + np.sin(t) - d) / 0.1
    d[50:100] -= 0.2
    e[50:100] += 2.0
    _, foreign, _ = judged(t, d, e, np.full(150, 0.1), np.full(150, TYPICAL_ODDS), bursts_with_foreign(Parameters()))
    assert foreign.max() < 0.1


def test_to_be_foreign_is_one_event_whatever_each_range_is_worth() -> None:
    t, d = walked(60)
    e = (4.0 + np.sin(t) - d) / 0.1
    d[20:40], e[20:40] = d[20:40] - 2.0, e[20:40] + 20.0
    columns = t, d, e, np.full(60, 0.1), np.full(60, TYPICAL_ODDS)
    of_one, of_another = (judged(*columns, FOREIGN, worth)[2] for worth in (1.0, 0.5))
    enters = FOREIGN_SHARE * (1.0 - np.exp(-0.1 / FOREIGN_DURATION / (1.0 - FOREIGN_SHARE)))
    assert of_another - of_one == pytest.approx(-np.log(enters), rel=0.02)


@pytest.mark.parametrize("wrong", range(5))
def test_what_makes_no_foreign_ranges_is_refused(wrong: int) -> None:
    of = [FOREIGN_SHARE, FOREIGN_DURATION, SPEED, SCALE, LEAST]
    of[wrong] = (1.0, 0.0, -1.0, 0.0, 0.0)[wrong]
    with pytest.raises(ValueError, match=r"share|speed"):
        BURSTS.with_foreign(of[0], of[1], of[2], of[3], of[4])


def test_chains_are_worth_something() -> None:
    t, d = walked(9)
    with pytest.raises(ValueError, match="worth"):
        judged(t, d, np.zeros(9), np.full(9, 0.1), np.full(9, TYPICAL_ODDS), FOREIGN, 0.0)
