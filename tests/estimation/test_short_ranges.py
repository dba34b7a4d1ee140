"""Ranges that are too short, which nothing makes them: who is not where it seems."""

from __future__ import annotations

from itertools import combinations
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from synchronizar.arrays import Indices
from synchronizar.estimation.assessment import _contradicted
from synchronizar.parameters import Parameters

PAIRS = list(combinations(range(4), 2))
RANGES = 100  # of each pair


def contradicted(short: dict[tuple[int, int], int]) -> set[int]:
    """Of four users, the first of whom is the reference, by how many of each pair's ranges are a metre too short."""
    i, j = np.repeat(np.array(PAIRS, dtype=np.int32), RANGES, axis=0).T
    residuals = np.zeros(len(i))
    for pair, count in short.items():
        begin = PAIRS.index(pair) * RANGES
        residuals[begin : begin + count] = 1.0
    graph: Any = SimpleNamespace(
        parameters=Parameters(),
        measurements=_Measurements(i, j),
        users=range(4),
        reference=0,
        sigma=np.full(len(i), 0.1),
        residuals=lambda _: residuals,
    )
    return set(_contradicted(graph, None, whole=True))  # type: ignore[arg-type] # residuals are given


class _Measurements:
    def __init__(self, i: Indices, j: Indices) -> None:
        self.i, self.j = i, j

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
