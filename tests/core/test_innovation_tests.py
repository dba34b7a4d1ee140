from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from synchronizar._core import common_shift, shifted_groups, worst_misfit
from synchronizar.arrays import Array
from synchronizar.graph.priors import bursts_of, nlos_mixture
from synchronizar.parameters import Parameters

PARAMETERS = Parameters()
LOSS, BURSTS = nlos_mixture(PARAMETERS), bursts_of(PARAMETERS)
SINCE, UNTIL = 6.0, 10.0
FEWEST, SHIFT_SIGMA, LOOKED_AT = 6.0, 2.0, 5.0
SIGMA = 0.1


def innovations(users: int, moved: frozenset[int], grows: bool, seed: int) -> Array:
    """Ranges between all for ten seconds, in the order of time; some moved by one shift in the last four."""
    random = np.random.default_rng(seed)
    place = random.uniform(-4.0, 4.0, (users, 3))
    shift = random.uniform(-1.5, 1.5, 3)
    rows = []
    for t in np.sort(random.uniform(0.0, UNTIL, 60 * users)).tolist():
        i, j = sorted(random.choice(users, 2, replace=False).tolist())
        away = place[i] - place[j]
        part = np.clip((t - SINCE) / (UNTIL - SINCE), 0.0, 1.0) if grows else float(t > SINCE)
        truth = away + part * shift * ((i in moved) - (j in moved))
        distance = np.linalg.norm(truth) + random.normal(0.0, SIGMA) + (random.uniform() < 0.1) * random.exponential()
        whitened = (np.linalg.norm(away) - distance) / SIGMA
        weight = random.uniform(0.2, 1.0)
        rows.append([t, i, j, whitened, *away, distance, SIGMA, random.uniform(0.05, 0.5), weight])
    return np.array(rows)


def by_numpy(rows: Array, grows: bool) -> list[tuple[frozenset[int], Array, float]]:
    """The same by sums over pairs of users, a group at a time."""
    rows = rows[rows[:, 0] > SINCE]
    share = np.clip((rows[:, 0] - SINCE) / (UNTIL - SINCE), 0.0, 1.0) if grows else np.ones(len(rows))
    pairs = sorted({(int(i), int(j)) for i, j in rows[:, 1:3]})
    users = sorted({u for pair in pairs for u in pair})
    of_pair = {pair: np.flatnonzero((rows[:, 1:3] == pair).all(axis=1)) for pair in pairs}
    weight = {pair: rows[which, 10].mean() for pair, which in of_pair.items()}
    least = float(np.median(list(weight.values())))
    weight = {pair: max(of, least) for pair, of in weight.items()}
    apart = np.linalg.norm(rows[:, 4:7], axis=1)
    slope = np.column_stack([rows[:, 4:7] / apart[:, None], np.ones(len(rows))]) * (share / rows[:, 8])[:, None]
    clipped = np.clip((apart - rows[:, 7]) / rows[:, 8], -3.0, 3.0)
    groups: list[frozenset[int]] = []
    for size in (1, 2) if len(users) <= 8 else (1,):
        for members in combinations(users, size):
            group = frozenset(members)
            others = frozenset(users) - group
            if others and others not in groups:
                groups.append(group)
    scores = []
    for group in groups:
        score, normal, count = np.zeros(4), np.eye(4) / SHIFT_SIGMA**2, 0
        for (i, j), which in of_pair.items():
            side = (i in group) - (j in group)
            if not side:
                continue
            of_side = slope[which] * [side, side, side, 1.0]
            score += weight[i, j] * of_side.T @ clipped[which]
            normal += weight[i, j] * of_side.T @ of_side
            count += len(which)
        scores.append(0.5 * score @ np.linalg.solve(normal, score) if count >= FEWEST else 0.0)
    found = []
    for n in np.argsort(-np.array(scores))[:2].tolist():
        if scores[n] < LOOKED_AT:
            break
        sides = {(i, j): (i in groups[n]) - (j in groups[n]) for i, j in pairs}
        own = [pair for pair in pairs if sides[pair]]
        which = np.concatenate([of_pair[pair] for pair in own])
        away = np.concatenate([sides[pair] * rows[of_pair[pair], 4:7] for pair in own])
        bounds = np.append(0, np.cumsum([len(of_pair[pair]) for pair in own])).astype(np.int32)
        columns = (rows[which, 0], away, *(rows[which, c].copy() for c in (7, 8, 9)), share[which])
        weights = np.array([weight[pair] for pair in own])
        precision, starts = np.full(3, SHIFT_SIGMA**-2), np.array([[0.0, 0.0, z] for z in (0.0, 1.0, -1.0)])
        shift, gain = common_shift(bounds, *columns, weights, precision, starts, LOSS, BURSTS)
        is_short = any(clipped[of_pair[pair]].sum() > len(of_pair[pair]) for pair in own)
        found.append((groups[n], np.asarray(shift), gain * (1.0 if grows or is_short else 0.5)))
    return sorted(found, key=lambda each: -each[2])


@pytest.mark.parametrize("users", [2, 3, 4, 6, 9])
@pytest.mark.parametrize("grows", [False, True])
def test_groups_that_moved_are_found_as_by_sums_over_pairs(users: int, grows: bool) -> None:
    told = 0
    for seed in range(8):
        moved = frozenset(range(seed % 3))
        rows = innovations(users, moved, grows, seed)
        found = shifted_groups(rows, [(SINCE, UNTIL, grows)], FEWEST, SHIFT_SIGMA, LOOKED_AT, LOSS, BURSTS)
        expected = by_numpy(rows, grows)
        assert [frozenset(group) for group, _, _ in found] == [group for group, _, _ in expected]
        for (_, shift, gain), (_, shift_expected, gain_expected) in zip(found, expected, strict=True):
            assert_allclose(shift, shift_expected, atol=1e-9)
            assert gain == pytest.approx(gain_expected, abs=1e-9)
        told += len(found)
    assert told > 2


def test_few_ranges_and_none_tell_of_no_shift() -> None:
    rows = innovations(4, frozenset({0}), False, 0)
    limits = FEWEST, SHIFT_SIGMA, LOOKED_AT
    for part in (rows[:0], rows[rows[:, 0] > SINCE][:5]):
        assert shifted_groups(part, [(SINCE, UNTIL, False)], *limits, LOSS, BURSTS) == []


def misfit_by_numpy(rows: Array, since: float, lasting: bool) -> tuple[int, float] | None:
    rows = rows[rows[:, 0] > since]
    worst: tuple[float, int, float] = (1.0, -1, 0.0)
    for user in sorted(set(rows[:, 1:3].ravel().astype(int).tolist())):
        e = rows[(rows[:, 1:3] == user).any(axis=1), 3]
        n = len(e)
        if n < FEWEST:
            continue
        short, off = float((e > 3.0).mean()), float((np.abs(e) > 3.0).mean())
        excess = short / (0.1 + 3.0 * np.sqrt(0.1 * 0.9 / n))
        if lasting and n >= 20:
            excess = max(excess, off / 0.6)
        if excess > worst[0]:
            worst = excess, user, max(short, off)
    return None if worst[1] < 0 else worst[1:]


@pytest.mark.parametrize("lasting", [False, True])
def test_who_fits_worst_is_told_as_by_counting(lasting: bool) -> None:
    told = 0
    for seed in range(20):
        rows = innovations(4, frozenset({seed % 4}), False, seed)
        found = worst_misfit(rows, [(UNTIL, False), (SINCE, lasting)], 3.0, FEWEST, 20.0, 0.1, 0.6)
        expected = misfit_by_numpy(rows, SINCE, lasting)
        assert (found is None) == (expected is None)
        if found is not None and expected is not None:
            assert found[:2] == (1, expected[0])
            assert found[2] == pytest.approx(expected[1])
            told += 1
    assert told > 2
    assert worst_misfit(rows[:0], [(SINCE, lasting)], 3.0, FEWEST, 20.0, 0.1, 0.6) is None


def test_innovations_that_make_no_sense_are_refused() -> None:
    rows = innovations(3, frozenset(), False, 0)
    limits = FEWEST, SHIFT_SIGMA, LOOKED_AT
    for column, value in ((8, 0.0), (9, -1.0), (1, -1.0), (4, np.nan)):
        wrong = rows.copy()
        wrong[3, column] = value
        with pytest.raises(ValueError, match=r"sigma|user|finite"):
            shifted_groups(wrong, [(SINCE, UNTIL, False)], *limits, LOSS, BURSTS)
    with pytest.raises(ValueError, match="columns"):
        worst_misfit(rows[:, :5], [(SINCE, False)], 3.0, FEWEST, 20.0, 0.1, 0.6)
    with pytest.raises(ValueError, match="stretch"):
        shifted_groups(rows, [(UNTIL, SINCE, False)], *limits, LOSS, BURSTS)
