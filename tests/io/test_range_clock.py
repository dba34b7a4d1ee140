"""The line that is fitted to all datagrams."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog
from support.clocks import LEAST_DELAY, delays, heard

from synchronizar.io.range_clock import MAX_SKEW, RangeClock


@pytest.mark.parametrize(
    ("seconds", "ppm"), [(12.0, 0.0), (12.0, 20.0), (3600.0, 20.0), (3600.0, -40.0), (86400.0, 35)]
)
def test_a_clock_that_drifts_is_followed(seconds: float, ppm: float) -> None:
    """72 ms in an hour at 20 ppm; what is left is the least delay."""
    random = np.random.default_rng(int(seconds) + int(ppm))
    t = np.sort(random.uniform(0.0, seconds, 2000))
    epoch, time_ns = heard(t, 10**15, ppm, 77)
    clock = RangeClock(epoch, time_ns, t + delays(random, len(t)))
    error = clock.seconds(epoch, time_ns) - t - LEAST_DELAY
    assert np.abs(error).max() < 0.0005


def test_every_epoch_is_brought_to_the_same_clock() -> None:
    """Two networks that begin at odd times and merge into a third."""
    random = np.random.default_rng(3)
    t = [np.sort(random.uniform(*span, 500)) for span in ((0.0, 20.0), (5.0, 20.0), (20.0, 40.0))]
    told = [heard(t[0], 0, 10.0, 1), heard(t[1], 10**12, -15.0, 2), heard(t[2], 5 * 10**17, 3.0, 2**32 - 1)]
    epoch, time_ns = (np.concatenate(column) for column in zip(*told, strict=True))
    true = np.concatenate(t)
    order = random.permutation(len(true))
    clock = RangeClock(epoch[order], time_ns[order], (true + delays(random, len(true)))[order])
    error = clock.seconds(epoch, time_ns) - true - LEAST_DELAY
    assert np.abs(error).max() < 0.0008


def test_a_clock_goes_on_without_a_jump() -> None:
    random = np.random.default_rng(4)
    t = np.linspace(0.0, 600.0, 3000)
    epoch, time_ns = heard(t, 0, 20.0, 1)
    clock = RangeClock(epoch, time_ns, t + delays(random, len(t)))
    fine = np.arange(0, 600 * 10**9, 10**7)
    steps = np.diff(clock.seconds(np.full(len(fine), 1, dtype=np.uint32), fine))
    np.testing.assert_allclose(steps, 0.01, rtol=2e-4)
    assert np.ptp(steps) < 1e-9


def test_one_datagram_gives_a_clock() -> None:
    clock = RangeClock(np.array([4], dtype=np.uint32), np.array([2 * 10**9]), np.array([50.0]))
    seconds = clock.seconds(np.full(3, 4, dtype=np.uint32), np.array([10**9, 2 * 10**9, 3 * 10**9]))
    np.testing.assert_allclose(seconds, [49.0, 50.0, 51.0], rtol=0, atol=1e-9)


@given(st.lists(st.tuples(st.integers(0, 10**10), st.floats(0.0, 0.5)), min_size=1, max_size=12), st.floats(-60, 60))
def test_the_line_is_the_best_that_no_datagram_lies_below(points: list[tuple[int, float]], ppm: float) -> None:
    """Against a linear program: least sum of delays, none below zero, skew within its bound."""
    time_ns = np.array([ns for ns, _ in points], dtype=np.int64)
    x = 1e-9 * time_ns
    arrived = x * (1.0 + 1e-6 * ppm) + [delay for _, delay in points]
    epoch = np.zeros(len(points), dtype=np.uint32)
    delay = arrived - RangeClock(epoch, time_ns, arrived).seconds(epoch, time_ns)
    assert delay.min() > -1e-9
    best = linprog(
        [-len(x), -x.sum()],
        A_ub=np.column_stack([np.ones(len(x)), x]),
        b_ub=arrived - x,
        bounds=[(None, None), (-MAX_SKEW, MAX_SKEW)],
        method="highs",
    )
    # The program keeps each row to 1e-7 alone, so its sum may be that much too small for each of them.
    assert delay.sum() == pytest.approx((arrived - x).sum() + best.fun, abs=1e-6 + 1e-7 * len(x))
