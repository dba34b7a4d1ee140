from __future__ import annotations

import numpy as np
import pytest

from synchronizar.live.round_trips import WINDOW_S, RoundTrips

AHEAD = 1000.0
"""s: the room's clock minus the device's."""


def ping(trips: RoundTrips, t: float, there: float, back: float, ahead: float = AHEAD) -> None:
    trips.pong(t, t + there + ahead, t + there + back)


def test_quick_ways_of_different_pings_are_put_together() -> None:
    trips = RoundTrips()
    assert trips.offset is None
    ping(trips, 0.0, 0.2, 1.7)
    ping(trips, 2.0, 0.9, 0.21)
    assert trips.offset == pytest.approx(AHEAD, abs=0.01)
    assert trips.quickest == pytest.approx(0.41)
    trips.heard(3.0 + AHEAD, 3.15)
    assert trips.quickest == pytest.approx(0.35)


def test_what_is_old_is_forgotten() -> None:
    trips = RoundTrips()
    ping(trips, 0.0, 0.01, 0.01)
    for n in range(20):
        ping(trips, 1.0 + n, 0.1, 0.1)
    assert WINDOW_S < 20.0
    assert trips.quickest == pytest.approx(0.2)


@pytest.mark.parametrize("step", [60.0, -60.0])
def test_a_clock_that_stood_still_or_was_set_is_known_with_the_next_word(step: float) -> None:
    trips = RoundTrips()
    for n in range(5):
        ping(trips, 2.0 * n, 0.05, 0.05)
    ping(trips, 10.0, 0.05, 0.05, AHEAD + step)
    assert trips.offset == pytest.approx(AHEAD + step)


def test_far_more_is_lost_than_comes_and_it_is_right_all_the_same() -> None:
    random = np.random.default_rng(0)
    trips = RoundTrips()
    begun = 0.5 * np.arange(200)
    there, back = 0.2 + random.exponential(1.0, (2, 200))
    for n in np.argsort(begun + there + back):
        ping(trips, begun[n], there[n], back[n])
    assert trips.offset == pytest.approx(AHEAD, abs=0.1)
