from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from synchronizar._core import common_shift
from synchronizar.arrays import Array
from synchronizar.graph.priors import bursts_of, nlos_mixture
from synchronizar.parameters import Parameters

PARAMETERS = Parameters()
LOSS, BURSTS = nlos_mixture(PARAMETERS), bursts_of(PARAMETERS)
SIGMA, EACH = 0.1, 10
OTHERS = np.array([[3.0, 0.5, 0.2], [-2.0, 2.5, -0.3], [0.5, -4.0, 0.4], [-1.0, -1.0, 2.0]])
STARTS = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
WEAK = np.full(3, 1e-4)


def found(
    shift: Array, late: Array, share: Array | None = None, precision: Array = WEAK, seed: int = 0
) -> tuple[Array, float]:
    """One at the origin, ten ranges a second to each of the others, and `late` (p,) m too long."""
    random = np.random.default_rng(seed)
    n = len(OTHERS) * EACH
    bounds = np.arange(len(OTHERS) + 1, dtype=np.int32) * EACH
    t = np.tile(np.linspace(0.0, 0.9, EACH), len(OTHERS))
    away = np.repeat(-OTHERS, EACH, axis=0)
    there = np.ones(n) if share is None else np.tile(share, len(OTHERS))
    true = np.linalg.norm(away + there[:, None] * shift, axis=1)
    distance = true + np.repeat(late, EACH) + random.normal(0.0, SIGMA, n)
    columns = (t, away, distance, np.full(n, SIGMA), np.full(n, 0.25), there, np.ones(len(OTHERS)))
    at, gain = common_shift(bounds, *columns, precision, STARTS, LOSS, BURSTS)
    return np.asarray(at), gain


def test_a_shift_is_found_where_ranges_say_it_is() -> None:
    for true in (np.array([0.5, -0.3, 0.0]), np.array([0.0, 0.2, 1.5])):
        shift, gain = found(true, np.zeros(4))
        assert_allclose(shift, true, atol=0.2)
        assert gain > 20.0


def test_a_shift_that_grows_is_found_as_it_is_at_the_end() -> None:
    true = np.array([1.0, 0.6, -0.4])
    shift, gain = found(true, np.zeros(4), np.linspace(0.0, 1.0, EACH))
    assert_allclose(shift, true, atol=0.3)
    assert gain > 20.0


def test_the_gain_is_half_of_chi_squared_where_all_are_in_line_of_sight() -> None:
    """Small shifts: against the linear least squares by hand, whose gain is g' H^-1 g / 2."""
    random = np.random.default_rng(1)
    true, n = np.array([0.06, -0.05, 0.03]), len(OTHERS) * EACH
    away = np.repeat(-OTHERS, EACH, axis=0)
    length = np.linalg.norm(away, axis=1)
    distance = np.linalg.norm(away + true, axis=1) + random.normal(0.0, 0.3 * SIGMA, n)
    slope, off = away / length[:, None] / SIGMA, (distance - length) / SIGMA
    gradient, normal = slope.T @ off, slope.T @ slope
    expected = 0.5 * gradient @ np.linalg.solve(normal, gradient)
    bounds = np.arange(len(OTHERS) + 1, dtype=np.int32) * EACH
    t = np.tile(np.linspace(0.0, 0.9, EACH), len(OTHERS))
    columns = (t, away, distance, np.full(n, SIGMA), np.full(n, 1e-9), np.ones(n), np.ones(len(OTHERS)))
    shift, gain = common_shift(bounds, *columns, np.full(3, 1e-9), STARTS[:1], LOSS, BURSTS)
    assert_allclose(shift, np.linalg.solve(normal, gradient), atol=5e-3)
    assert_allclose(gain, expected, rtol=0.03)


def test_a_burst_of_nlos_gains_much_less_than_a_shift_as_large() -> None:
    prior = np.full(3, 1.0 / PARAMETERS.integrity.shift_sigma**2)
    late = np.array([1.2, 0.0, 0.0, 0.0])
    blocked = [found(np.zeros(3), late, precision=prior, seed=seed)[1] for seed in range(10)]
    moved = [found(np.array([1.2, 0.0, 0.0]), np.zeros(4), precision=prior, seed=seed)[1] for seed in range(10)]
    assert min(moved) > 3.0 * max(blocked)


def test_nothing_is_gained_where_all_fits() -> None:
    gains = [found(np.zeros(3), np.zeros(4), precision=np.full(3, 0.25), seed=seed)[1] for seed in range(20)]
    assert max(gains) < 6.0
    assert min(gains) >= 0.0


def test_the_prior_draws_a_shift_to_none() -> None:
    true = np.array([0.4, 0.0, 0.0])
    free, held = (found(true, np.zeros(4), precision=np.full(3, value))[0] for value in (1e-4, 1e3))
    assert np.linalg.norm(held) < 0.9 * np.linalg.norm(free)
