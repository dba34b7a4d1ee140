from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from synchronizar.parameters import Parameters
from synchronizar.preprocessing.stamp_guard import StampGuard

MODEL = Parameters()
DAY = 86400.0


def told(stamps: list[float]) -> tuple[list[float], list[float], int]:
    """What was admitted, what was set aside, and how many times all before was."""
    guard: StampGuard[int] = StampGuard(MODEL)
    used: list[float] = []
    aside: list[float] = []
    anew = 0
    for n, t in enumerate(stamps):
        admitted = guard.admit(t, n)
        if admitted.anew:
            aside, used, anew = aside + used, [], anew + 1
        used += [stamp for stamp, item in admitted.items if stamps[item] == stamp]
        aside += admitted.aside
    return used, aside + list(guard.settle().aside), anew


@given(
    stamps=st.lists(st.floats(0.0, 9.0), min_size=1, max_size=40),
    strays=st.lists(
        st.tuples(st.integers(0, 40), st.sampled_from([-DAY, 11.0 + 9.0, DAY])), max_size=3, unique_by=lambda s: s[1]
    ),
)
def test_ranges_in_any_order_are_admitted_and_strays_among_them_are_not(
    stamps: list[float], strays: list[tuple[int, float]]
) -> None:
    mixed = [0.0, *stamps]
    for place, away in strays:
        mixed.insert(min(1 + place, len(mixed)), away)
    used, aside, anew = told(mixed)
    assert used == [0.0, *stamps]
    assert sorted(aside) == sorted(away for _, away in strays)
    assert anew == 0


def test_time_that_goes_on_elsewhere_leapt() -> None:
    before, after = [0.1 * n for n in range(20)], [500.0 + 0.1 * n for n in range(20)]
    assert told(before + after) == (before + after, [], 0)


@pytest.mark.parametrize("few", [1, 3])
def test_the_first_few_far_from_what_follows_are_stray(few: int) -> None:
    first, rest = [0.1 * n for n in range(few)], [1.7e9 + 0.1 * n for n in range(20)]
    assert told(first + rest) == (rest, first, 1)


def test_what_leaps_here_and_there_is_stray() -> None:
    good = [0.1 * n for n in range(20)]
    wild = [1e5, 3e5, 2e5, 9e5, 4e5, 8e5]
    used, aside, _ = told(good[:10] + wild + good[10:])
    assert used == good
    assert sorted(aside) == sorted(wild)


def test_many_from_long_ago_are_stray_where_there_is_a_present() -> None:
    good, old = [100.0 + 0.1 * n for n in range(20)], [0.1 * n for n in range(8)]
    used, aside, anew = told(good[:10] + old + good[10:])
    assert (used, sorted(aside), anew) == (good, old, 0)
