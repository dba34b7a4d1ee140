from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synchronizar.estimation.incremental.range_log import RangeLog
from synchronizar.parameters import Parameters


def log_of(*rows: tuple[float, int, int, float]) -> RangeLog:
    """Rows t, a, b, distance."""
    log = RangeLog(Parameters())
    for serial, (t, a, b, distance) in enumerate(rows):
        log.add(serial, t, a, b, distance, {})
    return log


def test_columns_that_are_not_told_are_not_known() -> None:
    log = RangeLog(Parameters())
    log.add(0, 0.5, 0, 1, 5.0, {"sigma": 0.2, "antenna_a": 0.0})
    log.add(1, 0.6, 1, 0, 6.0, {"rx_power": -80.0, "fp_power": -90.0, "nlos": 1.0})
    ranges = log.ranges(log.rows)
    np.testing.assert_array_equal(ranges.a, [0, 1])
    np.testing.assert_array_equal(ranges.b, [1, 0])
    np.testing.assert_array_equal(ranges.antenna_a, [0, -1])
    np.testing.assert_array_equal(ranges.antenna_b, [-1, -1])
    np.testing.assert_array_equal(ranges.sigma, [0.2, np.nan])
    np.testing.assert_array_equal(ranges.rx_power, [np.nan, -80.0])
    np.testing.assert_array_equal(ranges.fp_power, [np.nan, -90.0])
    np.testing.assert_array_equal(ranges.nlos, [np.nan, 1.0])


@pytest.mark.parametrize("distance", [-6e5, 6e5, -1.01, 1000.1])
def test_what_cannot_be_a_distance_is_left_out(distance: float) -> None:
    log = RangeLog(Parameters())
    assert not log.add(0, 0.5, 0, 1, distance, {})
    assert log.add(1, 0.5, 0, 1, 1.0, {})
    np.testing.assert_array_equal(log.rows[:, -1], [1.0])


def test_what_comes_again_counts_once() -> None:
    log = log_of((0.1, 0, 1, 2.0), (0.1, 0, 1, 2.0), (0.1, 1, 0, 2.0), (0.1, 0, 1, 2.1))
    np.testing.assert_array_equal(log.rows[:, -1], [0.0, 2.0, 3.0])
    log.forget(0.1)
    assert not log.add(4, 0.1, 0, 1, 2.0, {})


def test_the_first_of_a_followed_pair_has_the_smaller_index() -> None:
    log = RangeLog(Parameters())
    log.add(7, 0.5, 2, 1, 5.0, {"antenna_a": 1.0, "antenna_b": 0.0})
    (new,) = [log.to_follow(log.rows)]
    assert (new.i[0], new.j[0], new.antenna_i[0], new.antenna_j[0], new.serial[0]) == (1, 2, 0, 1, 7)
    assert new.sigma[0] == Parameters().ranges.sigma


@given(st.lists(st.one_of(st.floats(0.0, 20.0), st.just("take"), st.floats(-20.0, -0.1)), max_size=60))
def test_each_range_is_taken_once_whatever_was_forgotten_meanwhile(steps: list[float | str]) -> None:
    """Positive: a range comes; negative: what is older than that is forgotten."""
    log = RangeLog(Parameters())
    waiting: list[tuple[int, float]] = []
    for serial, step in enumerate(steps):
        if step == "take":
            assert log.take()[:, -1].tolist() == [float(s) for s, _ in waiting]
            waiting = []
        elif isinstance(step, float) and step >= 0.0:
            if log.add(serial, step, 0, 1, 1.0, {}):
                waiting.append((serial, step))
        else:
            assert isinstance(step, float)
            log.forget(-step)
            waiting = [(s, t) for s, t in waiting if t >= -step]
    assert log.taken == len(log.rows) - len(waiting)


def test_more_ranges_than_a_table_first_holds_are_kept() -> None:
    log = log_of(*((0.01 * n, 0, 1, 1.0) for n in range(1000)))
    np.testing.assert_allclose(log.rows[:, 0], 0.01 * np.arange(1000))


def test_what_is_restored_goes_on() -> None:
    log = log_of((0.1, 0, 1, 2.0), (0.2, 0, 1, 2.0))
    log.take()
    log.add(2, 0.3, 0, 1, 2.0, {})
    again = RangeLog(Parameters())
    again.restore(log.rows.copy(), log.taken)
    np.testing.assert_array_equal(again.take(), log.take())
    assert not again.add(3, 0.2, 0, 1, 2.0, {})
    with pytest.raises(ValueError, match="columns"):
        again.restore(np.zeros((2, 3)), 0)
