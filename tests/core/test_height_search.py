from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synchronizar._core import NlosMixture, RangeBlock, Squared, UserPose, search_heights
from synchronizar.arrays import Array, Mask

STEP, REACH = 0.05, 4.0  # m, and sigmas: of the grid that heights are sought on
LATE = NlosMixture(scale=1.0, early_odds=0.002)
SIGMA = 0.15 / np.sqrt(2.0)
Pairs = list[tuple[int, int, RangeBlock]]
repeatable = settings(derandomize=True, deadline=None, max_examples=25)
seeds = st.integers(0, 2**32 - 1)


def level_walks(seed: int, heights: Array, bob: float = 0.0, noise: float = 0.05, n: int = 30) -> Pairs:
    """Ranges of all pairs of walkers whose frames lie in the common one but for their heights."""
    random = np.random.default_rng(seed)
    walks = random.uniform(-3.0, 3.0, (len(heights), n, 3))
    walks[:, :, 2] = bob * random.standard_normal((len(heights), n))
    out = []
    for i in range(len(heights)):
        for j in range(i + 1, len(heights)):
            between = walks[i] - walks[j] + [0.0, 0.0, heights[i] - heights[j]]
            measured = np.linalg.norm(between, axis=1) + noise * random.standard_normal(n)
            out.append((i, j, RangeBlock(walks[i], walks[j], measured, np.full(n, 0.05), np.full(n, 0.25))))
    return out


def close_walks(seed: int, heights: Array) -> Pairs:
    """Level walks so close to each other that the size of a difference in height is seen well."""
    random = np.random.default_rng(seed)
    walks = np.zeros((len(heights), 60, 3))
    walks[:, :, :2] = random.uniform(-0.4, 0.4, (len(heights), 60, 2))
    out = []
    for i in range(len(heights)):
        for j in range(i + 1, len(heights)):
            measured = np.linalg.norm(walks[i] - walks[j] + [0.0, 0.0, heights[i] - heights[j]], axis=1)
            out.append((i, j, RangeBlock(walks[i], walks[j], measured, np.full(60, 0.02), np.full(60, 0.25))))
    return out


def search(
    pairs: Pairs,
    users: int,
    free: Mask | None = None,
    begin: Array | None = None,
    sigma: Array | float = SIGMA,
    most_above: float = 20.0,
    most: int = 8,
) -> list[tuple[Array, float]]:
    frames = np.zeros((users, 4))
    if begin is not None:
        frames[:, 2] = begin
    everybody = np.ones(users, dtype=bool)
    sigmas = np.broadcast_to(np.asarray(sigma, dtype=float), users).copy()
    return search_heights(frames, sigmas, everybody if free is None else free, pairs, LATE, most_above, most)


def cost_of(heights: Array, pairs: Pairs, sigma: Array | float = SIGMA) -> float:
    """By definition: all losses, and half the squared distances to the likeliest level over their variances."""
    losses = 0.0
    for i, j, block in pairs:
        pose_i, pose_j = (UserPose(frame_height=float(heights[u])) for u in (i, j))
        losses += block.cost(pose_i, pose_j, LATE)
    weight = np.broadcast_to(np.asarray(sigma, dtype=float), heights.shape) ** -2.0
    level = weight @ heights / weight.sum()
    return float(losses + 0.5 * weight @ (heights - level) ** 2)


def grid(sigma: float = SIGMA) -> Array:
    most = int(np.ceil(REACH * sigma / STEP))
    return np.asarray(STEP * np.arange(-most, most + 1.0))


@given(seed=seeds, bob=st.sampled_from([0.0, 0.1, 0.3]))
@repeatable
def test_the_best_of_three_users_heights_is_the_best_of_the_whole_grid(seed: int, bob: float) -> None:
    true = np.append(0.0, np.random.default_rng(seed).normal(0.0, 0.15, 2))
    pairs = level_walks(seed, true, bob)
    best, cost = search(pairs, 3, np.array([False, True, True]))[0]
    everywhere = {c: cost_of(np.array([0.0, *c]), pairs) for c in product(grid(), grid())}
    assert cost == pytest.approx(min(everywhere.values()), rel=1e-9)
    assert cost == pytest.approx(cost_of(best, pairs), rel=1e-9)
    np.testing.assert_allclose(best / STEP, np.round(best / STEP), atol=1e-9)


@given(seed=seeds)
@repeatable
def test_every_answer_costs_what_it_says_and_they_come_best_first(seed: int) -> None:
    true = np.append(0.0, np.random.default_rng(seed).normal(0.0, 0.15, 4))
    pairs = level_walks(seed, true)
    found = search(pairs, 5, np.array([False, True, True, True, True]))
    costs = [cost for _, cost in found]
    assert costs == sorted(costs)
    assert costs[-1] <= costs[0] + 20.0
    for heights, cost in found:
        assert cost == pytest.approx(cost_of(heights, pairs), rel=1e-9)
    assert len({tuple(np.round(heights, 3)) for heights, _ in found}) == len(found)


@given(seed=seeds)
@repeatable
def test_no_answer_gets_better_by_moving_one_user_within_its_reach(seed: int) -> None:
    """The level is held at what it is while a user moves, so none of its moves gains more than the prior can."""
    true = np.append(0.0, np.random.default_rng(seed).normal(0.0, 0.15, 2))
    pairs = level_walks(seed, true)
    for heights, cost in search(pairs, 3, np.array([False, True, True])):
        for u in (1, 2):
            for height in heights[u] + np.array([-STEP, STEP]):
                moved = heights.copy()
                moved[u] = height
                # Of the level's own move a third of a step's prior, (STEP / SIGMA)^2 / 6, can be won.
                assert cost_of(moved, pairs) > cost - (STEP / SIGMA) ** 2 / 6.0


@pytest.mark.parametrize("height", [0.25, -0.35])
def test_walkers_on_the_level_get_both_signs(height: float) -> None:
    found = search(close_walks(1, np.array([0.0, height])), 2, np.array([False, True]), most_above=0.5)
    np.testing.assert_allclose(sorted(h[1] for h, _ in found), [-abs(height), abs(height)], atol=1e-9)
    assert found[0][1] == pytest.approx(found[1][1])


def test_whoever_bobs_enough_gets_the_true_sign_alone() -> None:
    pairs = level_walks(2, np.array([0.0, 0.3]), bob=0.5, noise=0.0)
    ((heights, _),) = search(pairs, 2, np.array([False, True]))
    np.testing.assert_allclose(heights, [0.0, 0.3], atol=1e-9)


def test_the_heights_of_many_on_the_level_are_found_and_all_of_them_turned_over() -> None:
    true = np.array([0.0, 0.2, -0.25, 0.3, -0.15])
    found = search(close_walks(3, true), 5, np.arange(5) > 0)
    best = sorted((h for h, _ in found[:2]), key=lambda h: -h[1])
    np.testing.assert_allclose(best, [true, -true], atol=1e-9)
    assert found[0][1] == pytest.approx(found[1][1])


@given(seed=seeds, held=st.lists(st.integers(-8, 8), min_size=4, max_size=4))
@repeatable
def test_held_users_stay(seed: int, held: list[int]) -> None:
    begin = STEP * np.array(held)
    free = np.array([False, True, False, True])
    pairs = level_walks(seed, np.zeros(4))
    found = search(pairs, 4, free, begin)
    assert found
    for heights, _ in found:
        np.testing.assert_allclose(heights[~free], begin[~free], atol=1e-9)


def test_nobody_free_gives_the_heights_as_they_are() -> None:
    begin = np.array([0.0, 0.1, -0.2])
    pairs = level_walks(4, begin)
    ((heights, cost),) = search(pairs, 3, np.zeros(3, dtype=bool), begin)
    np.testing.assert_allclose(heights, begin, atol=1e-9)
    assert cost == pytest.approx(cost_of(begin, pairs), rel=1e-9)


def test_a_user_in_no_pair_has_no_say() -> None:
    pairs = level_walks(5, np.array([0.0, 0.2]), bob=0.5, n=60)
    ((two, cost),) = search(pairs, 2, np.array([False, True]))
    ((three, also_cost),) = search(pairs, 3, np.array([False, True, False]), begin=np.array([0.0, 0.0, 5.0]))
    np.testing.assert_array_equal(two, three[:2])
    assert cost == also_cost


def test_many_ranges_are_judged_by_an_even_selection_of_them() -> None:
    pairs = level_walks(6, np.array([0.0, 0.25]), bob=0.3, n=640)
    heights, cost = search(pairs, 2, np.array([False, True]))[0]
    np.testing.assert_allclose(heights, [0.0, 0.25], atol=STEP + 1e-9)
    assert cost == pytest.approx(cost_of(heights, pairs), rel=0.25)


def test_answers_and_costs_are_limited_as_asked() -> None:
    pairs = level_walks(1, np.array([0.0, 0.25]), noise=0.0)  # so far apart that hardly anything is seen of heights
    free = np.array([False, True])
    everything = search(pairs, 2, free)
    assert len(everything) > 2
    assert [c for _, c in search(pairs, 2, free, most=3)] == [c for _, c in everything[:3]]
    limit = 0.5 * (everything[0][1] + everything[-1][1])
    close = search(pairs, 2, free, most_above=limit - everything[0][1])
    assert [c for _, c in close] == [c for _, c in everything if c <= limit]
    assert len(close) < len(everything)


def test_the_same_ranges_give_the_same_heights() -> None:
    pairs = level_walks(7, np.array([0.0, 0.2, -0.1, 0.3]))
    once, again = search(pairs, 4), search(pairs, 4)
    for (heights, cost), (also, also_cost) in zip(once, again, strict=True):
        np.testing.assert_array_equal(heights, also)
        assert cost == also_cost


def test_a_height_is_sought_as_far_as_its_own_prior_reaches() -> None:
    """A radio under the roof is 2 m up; nobody who carries a phone is."""
    pairs = level_walks(8, np.array([0.0, 2.0]), noise=0.0)
    free = np.array([False, True])
    radio = search(pairs, 2, free, sigma=np.array([SIGMA, 3.0]))[0][0]
    assert abs(radio[1]) == pytest.approx(2.0, abs=STEP)
    phone = search(pairs, 2, free)[0][0]
    assert abs(phone[1]) <= grid().max() + 1e-9


def test_what_makes_no_search_is_refused() -> None:
    pairs = level_walks(9, np.zeros(2))
    frames, free = np.zeros((2, 4)), np.ones(2, dtype=bool)
    with pytest.raises(ValueError):
        search_heights(frames, np.ones(3), free, pairs, Squared(), 1.0, 8)
    with pytest.raises(ValueError):
        search_heights(frames, np.zeros(2), free, pairs, Squared(), 1.0, 8)
    with pytest.raises(ValueError, match="user that is not there"):
        search_heights(frames, np.ones(2), free, [(0, 2, pairs[0][2])], Squared(), 1.0, 8)
