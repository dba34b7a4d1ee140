from __future__ import annotations

import numpy as np
import pytest

from synchronizar.live.device_clock import DeviceClock

AHEAD = 1000.0
"""s: the room's clock minus the device's."""


def heard(clock: DeviceClock, stamps: np.ndarray, delays: np.ndarray, ahead: np.ndarray | float = AHEAD) -> np.ndarray:
    """Room's time of each word, minus when it was truly said."""
    ahead = np.broadcast_to(ahead, stamps.shape)
    pairs = zip(stamps.tolist(), (stamps + ahead + delays).tolist(), strict=True)
    return np.array([clock.hear(stamp, arrived) for stamp, arrived in pairs]) - (stamps + ahead)


def test_stamps_are_too_late_by_the_least_delay_alone() -> None:
    random = np.random.default_rng(0)
    stamps = np.arange(0.0, 60.0, 1.0 / 60.0)
    off = heard(DeviceClock(), stamps, 0.003 + random.exponential(0.02, len(stamps)))
    assert off[120:].max() < 0.006
    assert off.min() > 0.0029


def test_what_the_device_knows_of_its_round_trip_is_taken_out() -> None:
    clock = DeviceClock()
    clock.offer(AHEAD, 0.2)
    stamps = np.arange(0.0, 10.0, 0.05)
    off = heard(clock, stamps, np.full(len(stamps), 0.1))
    assert np.abs(off[50:]).max() < 1e-6


def test_stamps_never_run_backwards_while_clocks_drift_apart() -> None:
    random = np.random.default_rng(1)
    stamps = np.arange(0.0, 600.0, 0.1)
    drift = 100e-6 * stamps
    off = heard(DeviceClock(), stamps, 0.005 + random.exponential(0.01, len(stamps)), AHEAD + drift)
    assert (np.diff(off) > -0.1).all()
    assert np.abs(off[50:]).max() < 0.012


@pytest.mark.parametrize("step", [5.0, -5.0])
def test_a_clock_that_is_set_anew_is_noticed_and_followed(step: float) -> None:
    clock = DeviceClock()
    stamps = np.arange(0.0, 60.0, 0.1)
    ahead = np.where(stamps < 30.0, AHEAD, AHEAD + step)
    off = heard(clock, stamps, np.full(len(stamps), 0.004), ahead)
    assert clock.steps == 1
    late = off[stamps > 30.0 + (25.0 if step > 0.0 else 1.1)]
    assert np.abs(late).max() < 0.01


def test_what_the_device_knows_is_believed_on_slow_networks_too() -> None:
    clock = DeviceClock()
    clock.offer(AHEAD, round_trip=1.2)
    stamps = np.arange(0.0, 10.0, 0.05)
    off = heard(clock, stamps, np.full(len(stamps), 0.6))
    assert np.abs(off[50:]).max() < 1e-6


def test_words_that_were_said_before_a_silence_are_stamped_when_they_were_said() -> None:
    """A stall of half a minute: all that was said meanwhile comes at its end."""
    clock = DeviceClock()
    stamps = np.arange(0.0, 90.0, 0.1)
    arrivals = np.where((stamps > 30.0) & (stamps < 60.0), 60.0 + 0.01 * (stamps - 30.0), stamps + 0.02)
    off = heard(clock, stamps, np.maximum.accumulate(arrivals) - stamps)
    assert clock.steps == 0
    assert np.abs(off).max() < 0.025


def test_a_clock_that_stood_still_while_its_device_slept_is_followed_soon() -> None:
    clock = DeviceClock()
    stamps = np.arange(0.0, 60.0, 0.1)
    ahead = np.where(stamps < 30.0, AHEAD, AHEAD + 60.0)
    off = heard(clock, stamps, np.full(len(stamps), 0.004), ahead)
    assert clock.steps == 1
    assert np.abs(off[stamps > 32.2]).max() < 0.01


def test_one_word_from_the_future_says_nothing_of_those_that_follow() -> None:
    clock = DeviceClock()
    stamps = np.arange(0.0, 10.0, 0.1)
    said = stamps + 60.0 * np.isin(np.arange(100), (50, 52, 70))
    off = np.array([clock.hear(s, t + AHEAD + 0.004) for s, t in zip(said.tolist(), stamps.tolist(), strict=True)]) - (
        said + AHEAD
    )
    assert clock.steps == 0
    assert np.abs(off).max() < 0.01


@pytest.mark.parametrize("step", [5000.0, -5000.0])
def test_who_comes_again_by_another_clock_is_followed_at_once(step: float) -> None:
    clock = DeviceClock()
    stamps = np.arange(0.0, 30.0, 0.1)
    heard(clock, stamps, np.full(len(stamps), 0.004))
    clock.reconnect()
    off = heard(clock, stamps + 30.0 - step, np.full(len(stamps), 0.004), AHEAD + step)
    assert np.abs(off).max() < 0.01


def test_who_comes_again_by_the_same_clock_keeps_its_time() -> None:
    clock = DeviceClock()
    clock.offer(AHEAD, 0.02)
    stamps = np.arange(0.0, 30.0, 0.1)
    heard(clock, stamps, np.full(len(stamps), 0.02))
    clock.reconnect()
    off = heard(clock, stamps + 30.0, np.full(len(stamps), 0.15))  # a slow network at first
    assert np.abs(off[:10]).max() < 0.01
