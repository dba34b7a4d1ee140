"""The clock that is followed as datagrams come, beside truth and the line that is fitted to all of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.clocks import LEAST_DELAY, delays, heard

from synchronizar.arrays import Array
from synchronizar.io import live_clock
from synchronizar.io.live_clock import FORGET_S, FUTURE_S, HEIGHT_S, MOST_EPOCHS, SET_S, SKEW_S, SLEW, LiveClock
from synchronizar.io.range_clock import MAX_SKEW, RangeClock

EPOCH = 77


@dataclass
class Followed:
    """What a clock told of each datagram as it came; NaN before it was set, and where it was refused."""

    clock: LiveClock
    seconds: Array
    refused: int


def follow(time_ns: np.ndarray, arrived: Array, reporter: np.ndarray | int = 1) -> Followed:
    """Datagrams of one epoch, in the order in which they come in."""
    clock, seconds, refused = LiveClock(), np.full(len(arrived), np.nan), 0
    reporters = np.broadcast_to(reporter, arrived.shape)
    for i in np.argsort(arrived, kind="stable").tolist():
        if not clock.hear(EPOCH, int(reporters[i]), int(time_ns[i]), float(arrived[i])):
            refused += 1
        elif clock.is_set(EPOCH):
            seconds[i] = clock.seconds(EPOCH, time_ns[i : i + 1])[0]
    return Followed(clock, seconds, refused)


@pytest.mark.parametrize(
    ("seconds", "hz", "ppm"), [(12.0, 50.0, 20.0), (300.0, 10.0, -40.0), (3600.0, 5.0, 35.0), (900.0, 20.0, 60.0)]
)
def test_a_clock_that_drifts_is_followed_as_well_as_by_the_line_of_all(seconds: float, hz: float, ppm: float) -> None:
    random = np.random.default_rng(int(seconds))
    t = np.sort(random.uniform(0.0, seconds, round(hz * seconds)))
    epoch, time_ns = heard(t, 10**15, ppm, EPOCH)
    arrived = t + delays(random, len(t))
    told = follow(time_ns, arrived)
    error = told.seconds - t - LEAST_DELAY
    late = RangeClock(epoch, time_ns, arrived).seconds(epoch, time_ns) - t - LEAST_DELAY
    assert told.refused == 0
    assert np.isfinite(error[t > 2.0]).all()
    assert np.nanmax(np.abs(error)) < 0.005, "from the first on that is told: the least delay of half a second"
    assert np.nanmax(np.abs(error[t > 10.0])) < 0.0015
    assert np.abs(error[t > 30.0]).max(initial=0.0) < 0.0005
    assert np.nanmedian(np.abs(error)) < 0.0005
    assert np.abs(late).max() < 0.0005, "of the line that knows all from its beginning"


@settings(max_examples=60)
@given(
    st.lists(st.tuples(st.floats(0.001, 1.0), st.floats(0.0, 0.4), st.integers(1, 4)), min_size=2, max_size=200),
    st.floats(-90.0, 90.0),
)
def test_stamps_rise_with_the_times_of_a_clock(steps: list[tuple[float, float, int]], ppm: float) -> None:
    """Whatever the delays, from one datagram in the order of time to the next, while nothing jumps."""
    t = np.cumsum([step for step, _, _ in steps])
    _, time_ns = heard(t, 10**12, ppm, EPOCH)
    clock, told = LiveClock(), -np.inf
    for at, ns, (_, delay, reporter) in zip(t.tolist(), time_ns.tolist(), steps, strict=True):
        clock.hear(EPOCH, reporter, ns, at + delay)
        if clock.is_set(EPOCH):
            (stamp,) = clock.seconds(EPOCH, np.array([ns])).tolist()
            assert stamp > told
            told = stamp


@settings(max_examples=40)
@given(st.integers(0, 2**32), st.floats(-60.0, 60.0))
def test_no_stamp_is_earlier_than_the_measurement_by_more_than_noise(seed: int, ppm: float) -> None:
    random = np.random.default_rng(seed)
    t = np.sort(random.uniform(0.0, 30.0, 600))
    _, time_ns = heard(t, 0, ppm, EPOCH)
    told = follow(time_ns, t + delays(random, len(t)), random.integers(1, 4, len(t)))
    assert np.nanmin(told.seconds - t) > LEAST_DELAY - 0.002


def test_a_correction_is_spread_over_time() -> None:
    """Wi-Fi gets faster by 10 ms: stamps do not jump, and follow after 5 s, but for a skew that it looks like."""
    t = np.arange(0.0, 60.0, 0.05)
    _, time_ns = heard(t, 0, 10.0, EPOCH)
    told = follow(time_ns, t + np.where(t < 30.0, 0.013, 0.003)).seconds - t
    steps = np.diff(told[np.isfinite(told)])
    assert np.abs(steps).max() < 0.05 * (SLEW + MAX_SKEW) + 1e-6
    assert told[t < 30.0][-1] == pytest.approx(0.013, abs=1e-4)
    assert np.abs(told[t > 30.0 + 0.01 / SLEW + 0.1] - 0.003).max() < MAX_SKEW * HEIGHT_S


def test_a_busy_spell_changes_nothing_and_a_slower_way_is_taken_up() -> None:
    t = np.arange(0.0, 200.0, 0.05)
    _, time_ns = heard(t, 0, 0.0, EPOCH)
    slow = ((t > 50.0) & (t < 70.0)) | (t > 120.0)
    told = follow(time_ns, t + np.where(slow, 0.043, 0.003)).seconds - t
    assert np.nanmax(np.abs(told[t < 120.0] - 0.003)) < 1e-4
    assert told[-1] == pytest.approx(0.043, abs=1e-3)


# ---- who tells wrong times ----


@pytest.mark.parametrize("wrong", [-3600.0, -0.4, -0.02, 0.02, 5.0, 3600.0])
def test_of_three_reporters_one_that_tells_wrong_times_moves_nobody(wrong: float) -> None:
    random = np.random.default_rng(5)
    t = np.arange(0.0, 60.0, 0.01)
    _, time_ns = heard(t, 10**13, 15.0, EPOCH)
    reporter = np.arange(len(t)) % 3
    arrived = t + delays(random, len(t))
    honest = follow(time_ns[reporter > 0], arrived[reporter > 0], reporter[reporter > 0]).seconds
    # Its times are ahead where `wrong` is below zero: then its datagrams take less time than none.
    lying = np.where(reporter == 0, time_ns - round(wrong * 1e9), time_ns)
    told = follow(lying, arrived, reporter)
    error = (told.seconds - t - LEAST_DELAY)[reporter > 0]
    assert np.nanmax(np.abs(error)[t[reporter > 0] > 2.0]) < 0.002
    assert np.nanmax(np.abs(told.seconds[reporter > 0] - honest)) < 0.003


def test_a_time_from_the_future_counts_for_nothing() -> None:
    t = np.arange(0.0, 20.0, 0.05)
    _, time_ns = heard(t, 0, 0.0, EPOCH)
    time_ns[200] += 2 * 10**9
    told = follow(time_ns, t + 0.003)
    assert told.refused == 1
    assert np.nanmax(np.abs(told.seconds - t - 0.003)) < 1e-5


def test_a_clock_that_jumped_is_followed_after_a_second() -> None:
    """The receiver's computer slept for an hour, and its clock stood still meanwhile."""
    t = np.arange(0.0, 30.0, 0.05)
    slept = np.where(t < 15.0, 0.0, 3600.0)
    _, time_ns = heard(t + slept, 0, 0.0, EPOCH)
    told = follow(time_ns, t + 0.003)
    assert 20 <= told.refused <= 22
    error = told.seconds - t - 0.003
    assert np.nanmax(np.abs(error)) < 1e-5
    assert np.isfinite(error[t > 16.1]).all()


# ---- memory ----


def test_nothing_grows_with_time() -> None:
    t = np.arange(0.0, 3.0 * SKEW_S, 0.1)
    _, time_ns = heard(t, 0, 0.0, EPOCH)
    clock = follow(time_ns, t + 0.003, np.arange(len(t)) % 3).clock
    (epoch,) = clock._epochs.values()
    assert all(len(floor.x) <= SKEW_S / live_clock.BUCKET_S + 1 for floor in epoch.floors.values())


def test_epochs_unheard_of_for_long_are_forgotten() -> None:
    clock = LiveClock()
    clock.hear(1, 1, 0, 0.0)
    for k in range(30):
        clock.hear(2, 1, k * 10**10, 10.0 * k)
    assert clock.knows(1)
    clock.hear(2, 1, 10**12, 1.2 * FORGET_S)
    assert not clock.knows(1)
    assert clock.knows(2)


def test_a_reporter_has_only_so_many_epochs_and_takes_none_of_others() -> None:
    clock = LiveClock()
    clock.hear(0, 1, 0, 0.0)
    clock.hear(0, 2, 0, 0.0)
    for epoch in range(1, 1000):
        clock.hear(epoch, 1, 0, 0.001 * epoch)
    assert len(clock) == MOST_EPOCHS + 1
    assert clock.knows(0), "2 is still in it"


def test_a_clock_is_set_after_half_a_second_at_the_earliest() -> None:
    clock = LiveClock()
    assert not clock.is_set(1)
    for k, expected in enumerate([False, False, False, False, True]):
        clock.hear(1, 1, k * 10**9, 0.25 * SET_S * k)
        assert clock.is_set(1) == expected
    assert FUTURE_S > 0.25 * SET_S, "what the times above are ahead by"
    alone = LiveClock()
    alone.hear(1, 1, 0, 0.0)
    alone.hear(1, 1, 2 * 10**9, 2.0)
    assert alone.is_set(1)
