from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from synchronizar._core import (
    Bursts,
    NlosMixture,
    burst_nlos_odds,
    burst_nlos_odds_of_pairs,
    neighbour_counts,
    neighbour_sums,
)
from synchronizar.arrays import Array, Indices

BOUNDS = np.array([0, 30, 31, 90], dtype=np.int32)
REACH, GAP, MOST = 0.7, 0.4, 4


def stamps(seed: int = 0) -> Array:
    """(90,) s, sorted within each pair, some of them equal."""
    random = np.random.default_rng(seed)
    return np.concatenate([np.sort(np.round(random.uniform(0.0, 6.0, n), 1)) for n in np.diff(BOUNDS)])


def pair_of(n: int) -> int:
    return int(np.searchsorted(BOUNDS, n, side="right")) - 1


def test_neighbours_are_counted_one_by_one() -> None:
    t = stamps()
    expected = [
        sum(pair_of(m) == pair_of(n) and t[n] - REACH <= t[m] <= t[n] + REACH for m in range(90)) for n in range(90)
    ]
    np.testing.assert_array_equal(neighbour_counts(BOUNDS, t, REACH), expected)


def test_sums_are_those_over_all_neighbours() -> None:
    random, t = np.random.default_rng(1), stamps()
    link: Indices = random.integers(0, 3, 90).astype(np.int32)
    score, weight = random.normal(size=90), random.uniform(size=90)
    product = both = 0.0
    for begin, end in pairwise(BOUNDS.tolist()):
        squares, weights = (score[begin:end] ** 2).sum(), (weight[begin:end] ** 2).sum()
        for which in range(3):
            rows = [n for n in range(begin, end) if link[n] == which]
            for a, n in enumerate(rows):
                for m in rows[a + 1 : a + MOST]:
                    if t[m] - t[n] < GAP:
                        product += score[n] * score[m] / (squares / weights)
                        both += weight[n] * weight[m]
    found_squares, found_weights, found_product, found_both = neighbour_sums(BOUNDS, t, link, score, weight, GAP, MOST)
    np.testing.assert_allclose(found_squares, np.add.reduceat(score**2, BOUNDS[:-1]))
    np.testing.assert_allclose(found_weights, np.add.reduceat(weight**2, BOUNDS[:-1]))
    assert found_product == pytest.approx(product)
    assert found_both == pytest.approx(both)


def test_each_pairs_bursts_are_a_chain_of_their_own() -> None:
    random, t = np.random.default_rng(2), stamps()
    columns = random.normal(0.0, 3.0, 90), random.uniform(0.05, 0.2, 90), random.uniform(0.05, 0.5, 90)
    model = NlosMixture(1.0, 0.002), Bursts(0.1, 1.0, 0.9, 0.1)
    odds, costs = burst_nlos_odds_of_pairs(BOUNDS, t, *columns, *model)
    for n, (begin, end) in enumerate(pairwise(BOUNDS.tolist())):
        alone, cost = burst_nlos_odds(t[begin:end], *(c[begin:end] for c in columns), *model)
        np.testing.assert_array_equal(odds[begin:end], alone)
        assert costs[n] == cost


@pytest.mark.parametrize("bounds", [[0, 30], [1, 90], [0, 50, 40, 90], []])
def test_bounds_must_hold_all_ranges(bounds: list[int]) -> None:
    with pytest.raises(ValueError, match="bounds"):
        neighbour_counts(np.array(bounds, dtype=np.int32), stamps(), REACH)


def test_no_pair_has_no_neighbours() -> None:
    assert len(neighbour_counts(np.zeros(1, dtype=np.int32), np.zeros(0), REACH)) == 0
