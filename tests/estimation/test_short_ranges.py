"""Ranges that are too short, which nothing makes them, or foreign: who is not where it seems."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from synchronizar.arrays import Array, Indices
from synchronizar.estimation.contradicted import contradicted_by_ranges
from synchronizar.parameters import Parameters

PAIRS = list(combinations(range(4), 2))
RANGES = 100  # of each pair
Stretches = dict[tuple[int, int], tuple[int, int]]


def contradicted(
    short: dict[tuple[int, int], int],
    foreign: Stretches | None = None,
    cut: Sequence[int] = (),
    unfit: Sequence[int] = (),
) -> set[int]:
    """Of four users, the first of whom is the reference, by how many of each pair's ranges are a metre too short.

    Between those numbers of its ranges each pair's are `foreign`, and too short.
    """
    i, j = np.repeat(np.array(PAIRS, dtype=np.int32), RANGES, axis=0).T
    residuals, own = np.zeros(len(i)), np.ones(len(i))
    for pair, count in short.items():
        begin = PAIRS.index(pair) * RANGES
        residuals[begin : begin + count] = 1.0
    for pair, (since, until) in (foreign or {}).items():
        begin = PAIRS.index(pair) * RANGES
        residuals[begin + since : begin + until], own[begin + since : begin + until] = 1.0, 0.0
    graph: Any = SimpleNamespace(
        parameters=Parameters(),
        measurements=_Measurements(i, j, np.tile(np.arange(float(RANGES)), len(PAIRS))),
        users=range(4),
        active_users=[0, 1, 2, 3],
        reference=0,
        sigma=np.full(len(i), 0.1),
        residuals=lambda _: residuals,
    )
    em_weights: Any = SimpleNamespace(own_probability=own)
    states: Any = None  # residuals are given
    return set(contradicted_by_ranges(graph, states, em_weights, True, cut, unfit))


class _Measurements:
    def __init__(self, i: Indices, j: Indices, t: Array) -> None:
        self.i, self.j, self.t = i, j, t

    def __len__(self) -> int:
        return len(self.i)


@pytest.mark.parametrize(
    ("short", "who"),
    [
        ({(1, 2): 10, (1, 3): 10, (0, 1): 10}, {1}),
        ({(1, 2): 4, (1, 3): 4, (0, 1): 4}, set[int]()),
        ({(1, 2): 4, (1, 3): 4, (0, 1): 4, (2, 3): 6, (0, 2): 4}, {1, 2}),
        ({(1, 2): 30, (1, 3): 30, (2, 3): 8}, {1}),
    ],
)
def test_a_radio_that_is_short_for_a_while_is_alone_and_exchanged_ones_are_two(
    short: dict[tuple[int, int], int], who: set[int]
) -> None:
    assert contradicted(short) == who


def of_one(since: int, until: int) -> Stretches:
    """All ranges of the second user."""
    return {(0, 1): (since, until), (1, 2): (since, until), (1, 3): (since, until)}


def test_foreign_ranges_that_are_over_contradict_nobody() -> None:
    assert contradicted({}, of_one(20, 60)) == set()
    exchanged = {(0, 1): (30, 70), (0, 2): (30, 70), (1, 3): (30, 70), (2, 3): (30, 70)}
    assert contradicted({}, exchanged) == set()


def test_who_is_foreign_still_is_not_where_it_seems() -> None:
    assert contradicted({}, of_one(60, 100)) == {1}
    assert contradicted({}, of_one(54, 94)) == {1}


def test_who_is_cut_off_does_not_contradict_those_who_are_not() -> None:
    moved = {(0, 2): (60, 100), (0, 3): (60, 100), (1, 2): (60, 100), (1, 3): (60, 100)}
    assert len(contradicted({}, moved)) == 2
    assert contradicted({}, moved, cut=[2, 3]) == set()


def test_who_is_foreign_for_most_of_the_time_is_not_where_it_seems() -> None:
    assert contradicted({}, of_one(10, 65)) == {1}


def test_who_is_foreign_now_and_then_is_not_where_it_seems() -> None:
    assert contradicted({}, of_one(10, 20) | {(1, 3): (60, 80)}) == {1}


def test_ranges_that_are_too_short_beside_foreign_ones_count() -> None:
    assert contradicted({(0, 1): 20, (1, 2): 20}, {(1, 3): (20, 60)}) == {1}


def test_who_disagrees_throughout_with_who_is_not_where_it_seems_may_be_wrong_itself() -> None:
    one, other = [(0, 1), (2, 3)], [(0, 2), (1, 3)]
    throughout = dict.fromkeys(one, (0, 15)) | dict.fromkeys(other, (85, 100))
    assert contradicted({}, throughout) == {0, 1, 2, 3}
    for_a_while = dict.fromkeys(one, (50, 65)) | dict.fromkeys(other, (85, 100))
    assert len(contradicted({}, for_a_while)) == 2


def test_who_disagrees_only_with_somebody_whom_nothing_fits_is_not_doubted() -> None:
    assert contradicted({}, of_one(0, 80)) == {0, 1, 2, 3}
    assert contradicted({}, of_one(0, 80), unfit=[1]) == {1}
    nobody_else_agrees = [0, 1, 2, 3]
    assert contradicted({}, of_one(0, 80), unfit=nobody_else_agrees) == {0, 1, 2, 3}


def test_nobody_is_known_where_most_ranges_may_be_foreign() -> None:
    assert contradicted({}, dict.fromkeys(PAIRS[:-1], (20, 70))) == {0, 1, 2, 3}
