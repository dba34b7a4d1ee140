"""Ranges of followed users by slot: blocks for the graph, bursts judged anew, what is known by running index."""

from __future__ import annotations

import numpy as np
import pytest

from synchronizar._core import burst_nlos_odds, mixture_terms, rows_by_serial
from synchronizar.arrays import Array
from synchronizar.estimation.incremental.slot_ranges import (
    DISTANCE,
    END_I,
    END_J,
    NLOS_ODDS,
    ODDS,
    SIGMA,
    SLOT,
    USER_I,
    USER_J,
    WEIGHT,
    T,
    block_of,
)
from synchronizar.estimation.incremental.slot_states import SlotStates
from synchronizar.graph.priors import bursts_of, nlos_mixture
from synchronizar.parameters import Parameters

PARAMETERS = Parameters()
LOSS, BURSTS = nlos_mixture(PARAMETERS), bursts_of(PARAMETERS)
USERS, COLUMNS = 4, 29
SUREST, CHANGED = 27.0, 0.1
CALIBRATION = np.zeros((USERS, 3))


def followed(seed: int, slots: int = 4, n: int = 200) -> tuple[SlotStates, Array]:
    """Users that stand, and ranges between them, some of them NLOS; odds are those of each by itself still."""
    random = np.random.default_rng(seed)
    states = SlotStates(USERS)
    place = random.uniform(-5.0, 5.0, (USERS, 3))
    for slot in range(slots):
        for user in range(USERS):
            x, y, z = place[user].tolist()
            states.add(user, slot, float(slot), place[user], np.array([x, y, 0.0, z, 0.0, 0.0, 0.0]))
    rows = np.zeros((n, COLUMNS))
    rows[:, T] = random.uniform(0.0, slots, n)
    rows[:, SLOT] = np.floor(rows[:, T])
    pairs = np.sort([random.choice(USERS, 2, replace=False) for _ in range(n)], axis=1)
    rows[:, USER_I], rows[:, USER_J] = pairs.T
    apart = np.linalg.norm(place[pairs[:, 0]] - place[pairs[:, 1]], axis=1)
    rows[:, DISTANCE] = apart + random.normal(0.0, 0.1, n) + 0.6 * ((pairs.sum(axis=1) + rows[:, SLOT]) % 3 == 0)
    rows[:, SIGMA], rows[:, WEIGHT] = 0.18, random.uniform(0.1, 1.0, n)
    rows[:, ODDS] = rows[:, NLOS_ODDS] = random.uniform(0.05, 0.4, n)
    return states, rows


def test_a_slots_block_has_its_ranges_pair_by_pair() -> None:
    states, rows = followed(0)
    rows = rows[(rows[:, SLOT] == 2) & (rows[:, USER_I] != 1) & (rows[:, USER_J] != 1)]
    rows[:, END_I : END_I + 9] = np.random.default_rng(1).normal(size=(len(rows), 9))
    users, block = block_of(rows)
    assert users == [0, 2, 3]
    assert len(block) == len(rows)
    assert sorted(block.pairs) == [(0, 1), (0, 2), (1, 2)]
    poses = np.zeros((3, 8))
    poses[:, :4] = [states.state(user, 2)[:4] for user in users]
    ordered = rows[np.lexsort([rows[:, USER_J], rows[:, USER_I]])]
    np.testing.assert_allclose(block.residuals(poses, CALIBRATION[:3]), states.residuals(ordered), atol=1e-12)


def test_a_block_of_ranges_that_make_no_sense_is_refused() -> None:
    _, rows = followed(0)
    for column, value in ((SIGMA, 0.0), (NLOS_ODDS, -1.0), (WEIGHT, 0.0), (USER_I, -1.0), (END_J, np.nan)):
        wrong = rows.copy()
        wrong[5, column] = value
        with pytest.raises(ValueError, match=r"positive|odds|user|finite"):
            block_of(wrong)
    with pytest.raises(ValueError, match="at least one"):
        block_of(rows[:0])


@pytest.mark.parametrize("seed", range(4))
def test_bursts_are_judged_anew_as_chain_by_chain(seed: int) -> None:
    states, rows = followed(seed)
    sizes = np.random.default_rng(seed).uniform(0.6, 1.0, (USERS, USERS))
    slots, which, odds = states.judged(rows, 1, sizes, LOSS, BURSTS, SUREST, CHANGED)
    expected, changed = rows[:, ODDS].copy(), set()
    late = rows[:, SLOT] >= 1
    for i in range(USERS):
        for j in range(i + 1, USERS):
            of = np.flatnonzero(late & (rows[:, USER_I] == i) & (rows[:, USER_J] == j))
            of = of[np.argsort(rows[of, T])]
            if not len(of):
                continue
            size, sigma = sizes[i, j], rows[of, SIGMA].copy()
            whitened = states.residuals(rows[of]) / sigma
            prior = rows[of, ODDS].copy()
            chain, _ = burst_nlos_odds(rows[of, T].copy(), whitened / size, sigma * size, prior, LOSS, BURSTS)
            narrower = 0.5 * np.minimum(whitened, 0.0) ** 2 * (size**-2 - 1.0)
            expected[of] = np.minimum(chain * size * np.exp(np.minimum(narrower, SUREST)), np.exp(SUREST))
            inlier, before = (mixture_terms(whitened, sigma, o, LOSS)[2] for o in (expected[of].copy(), prior))
            changed |= set(rows[of[np.abs(inlier - before) > CHANGED], SLOT].astype(int).tolist())
    assert slots == sorted(changed)
    assert slots
    assert sorted(which.tolist()) == np.flatnonzero(np.isin(rows[:, SLOT], slots)).tolist()
    np.testing.assert_allclose(odds, expected[which], rtol=1e-9)
    rows[which, NLOS_ODDS] = odds
    assert states.judged(rows, 1, sizes, LOSS, BURSTS, SUREST, CHANGED)[0] == []
    assert states.judged(rows, 9, sizes, LOSS, BURSTS, SUREST, CHANGED)[0] == []


def test_what_is_known_of_a_range_is_what_the_last_table_says_that_knows_it() -> None:
    serial = np.array([4, 9, 2, 7], dtype=np.int32)
    tables = [
        (np.array([2, 3, 4], dtype=np.int32), np.array([[0.2, 2.0], [0.3, 3.0], [0.4, 4.0]])),
        (np.array([100, 4], dtype=np.int32), np.array([[0.0, 0.0], [0.5, 5.0]])),
    ]
    known, values = rows_by_serial(serial, tables, np.array([0.0, np.nan]))
    assert known.tolist() == [True, False, True, False]
    np.testing.assert_array_equal(values, [[0.5, 5.0], [0.0, np.nan], [0.2, 2.0], [0.0, np.nan]])
    assert len(rows_by_serial(serial[:0], tables, np.zeros(2))[0]) == 0
    with pytest.raises(ValueError, match="as many columns"):
        rows_by_serial(serial, tables, np.zeros(3))
