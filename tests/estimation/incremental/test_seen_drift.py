from __future__ import annotations

import numpy as np
import pytest

from synchronizar.arrays import Array
from synchronizar.estimation.incremental.seen_drift import SeenDrift
from synchronizar.parameters import Parameters

SLAM = Parameters().slam
STEP = np.array([0.8, 0.3])  # m, in the common frame, each slot
USED = np.array([0.014, 0.007])  # 1 sigma of it in place (m) and heading (rad)
MEASURED = np.array([0.02, 0.02, 0.02, 1e3])  # 1 sigma of what ranges say in each slot of x, y, yaw, scale


def look(seen: SeenDrift, slot: int, covariance: Array, used: float = 1.0) -> None:
    """At one user's slot when it has begun."""
    seen.look(np.array([1]), np.array([slot]), covariance[None], np.full((1, 2), used))


def followed(drift: float, slots: int, seed: int, used: float = 1.0, slip_at: int = -1, asked: int = 1) -> SeenDrift:
    """One user by a Kalman filter whose steps have `used` times the usual noise, and in truth `drift` times."""
    random, seen = np.random.default_rng(seed), SeenDrift(2, SLAM)
    forth = np.eye(4)
    forth[:2, 2:] = [[-STEP[1], STEP[0]], [STEP[0], STEP[1]]]
    error, covariance = np.zeros(4), np.diag([0.1, 0.1, 0.05, 0.01]) ** 2
    true = np.zeros(4)
    noise = np.diag([USED[0], USED[0], USED[1], 0.0])
    state = np.zeros(7)
    for slot in range(slots):
        before = state.copy()
        state[:2] += STEP
        true = forth @ true + drift * noise @ random.standard_normal(4)
        if slot == slip_at:
            true[:2] += 1.0
        error = forth @ error
        covariance = forth @ covariance @ forth.T + used**2 * noise @ noise
        seen.open(1, (slot, before), (slot + 1, state), tuple((used * USED).tolist()))
        for _ in range(asked):
            look(seen, slot + 1, covariance, used)
        gain = covariance @ np.linalg.inv(covariance + np.diag(MEASURED**2))
        change = gain @ (true + MEASURED * random.standard_normal(4) * [1, 1, 1, 0] - error)
        change[3] = 0.0
        error = error + change
        state[:3] = state[:3] + change[:3]
        covariance = covariance - gain @ covariance
    return seen


def mean_factors(drift: float, **settings: float) -> Array:
    found = [followed(drift, 40, seed, **settings).factors[1] for seed in range(12)]  # type: ignore[arg-type]
    return np.asarray(np.sqrt(np.mean(np.square(found), axis=0)))


def test_slam_that_drifts_as_is_usual_is_told_to() -> None:
    assert (mean_factors(1.0) < 1.2).all()


def test_slam_that_hardly_drifts_is_told_as_usual() -> None:
    np.testing.assert_array_equal(mean_factors(0.2), [1.0, 1.0])


@pytest.mark.parametrize("used", [1.0, 2.0])
def test_slam_that_drifts_three_times_as_far_is_told_to_whatever_was_assumed(used: float) -> None:
    factors = mean_factors(3.0, used=used)
    assert (factors > 1.9).all()
    assert (factors < 3.5).all()


def test_what_is_asked_again_within_a_slot_changes_nothing() -> None:
    once, twice = followed(3.0, 40, 4), followed(3.0, 40, 4, asked=2)
    np.testing.assert_array_equal(twice.factors, once.factors)


def test_a_slip_is_no_drift() -> None:
    assert followed(1.0, 40, 1, slip_at=20).factors[1, 0] < 1.5


def test_what_is_known_anew_is_no_drift_and_others_are_as_they_were() -> None:
    seen = followed(3.0, 40, 2)
    known = seen.factors.copy()
    assert known[1, 0] > 1.5
    np.testing.assert_array_equal(known[0], [1.0, 1.0])
    seen.begin()
    moved = np.array([50.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    seen.open(1, (40, moved), (41, moved), (0.014, 0.007))
    look(seen, 41, 0.01 * np.eye(4))
    np.testing.assert_array_equal(seen.factors, known)
    seen.forget(1)
    np.testing.assert_array_equal(seen.factors, np.ones((2, 2)))


def test_one_more_user_is_told_as_usual() -> None:
    seen = followed(3.0, 40, 3)
    known = seen.factors.copy()
    seen.add_user()
    np.testing.assert_array_equal(seen.factors, np.vstack([known, [1.0, 1.0]]))
