from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.reference_kernel import loss_value

from synchronizar._core import Cauchy, GemanMcClure, Huber, NlosMixture, RangeBlock, Squared, UserPose

if TYPE_CHECKING:
    from synchronizar._core import Loss

LATE = NlosMixture(scale=1.0, early_odds=0.002)
LOSSES: dict[str, Loss] = {
    "squared": Squared(),
    "huber": Huber(),
    "cauchy": Cauchy(),
    "geman_mcclure": GemanMcClure(),
    "late": LATE,
}

errors = st.floats(-30.0, 30.0)
sigmas = st.floats(0.01, 0.5)
odds = st.floats(1e-6, 10.0)
annealings = st.floats(1.0, 10.0)
repeatable = settings(derandomize=True, deadline=None, max_examples=150)


@pytest.fixture(scope="module", params=sorted(LOSSES))
def loss(request: pytest.FixtureRequest) -> Loss:
    return LOSSES[request.param]


def annealed(loss: Loss, e: float, sigma: float, nlos_odds: float, annealing: float) -> tuple[float, float]:
    """(rho, weight) of a single range with the whitened residual e, which only a block anneals."""
    block = RangeBlock(
        np.zeros((1, 3)), np.array([[50.0, 0.0, 0.0]]), *np.array([[50.0 - e * sigma], [sigma], [nlos_odds]])
    )
    i, j = UserPose(), UserPose()
    return block.cost(i, j, loss, annealing), float(block.weights(i, j, loss, annealing)[0])


def test_a_perfect_range_costs_nothing(loss: Loss) -> None:
    rho, weight, curvature = loss(0.0, 0.1, 0.25)
    assert rho == 0.0
    # A range is never known to be honest: the late loss's weight at 0 is the probability that it is, and a little.
    assert weight == pytest.approx(1.0, abs=1e-3)
    assert curvature == weight


@given(e=errors, sigma=sigmas, nlos_odds=odds)
@repeatable
def test_weight_and_curvature_are_derivatives_of_the_cost(loss: Loss, e: float, sigma: float, nlos_odds: float) -> None:
    expected = loss_value(loss, e, sigma, nlos_odds)
    rho, weight, curvature = loss(e, sigma, nlos_odds)
    assert rho == pytest.approx(expected[0], rel=1e-9, abs=1e-14)
    if abs(e) > 1e-6:  # below, rho' itself is lost among the digits of the numerical one
        assert weight == pytest.approx(expected[1], rel=1e-6, abs=1e-12)
    assert curvature == pytest.approx(expected[2], rel=1e-6, abs=1e-8)


@given(e=errors, sigma=sigmas, nlos_odds=odds)
@repeatable
def test_a_larger_error_never_costs_less(loss: Loss, e: float, sigma: float, nlos_odds: float) -> None:
    rho, weight, _ = loss(e, sigma, nlos_odds)
    assert rho >= 0.0
    assert 0.0 <= weight <= 1.0 + 1e-12
    assert rho <= loss(1.01 * e, sigma, nlos_odds)[0] + 1e-12


def test_weights_have_their_limit_at_zero(loss: Loss) -> None:
    for side in (-1.0, 1.0):
        _, at_once, _ = loss(side * 1e-200, 0.1, 0.25)
        _, near, _ = loss(side * 1e-5, 0.1, 0.25)
        assert at_once == pytest.approx(near, abs=1e-9)


def test_values_by_hand() -> None:
    assert Squared()(3.0) == (4.5, 1.0, 1.0)
    assert Huber(2.0)(-1.5) == (1.125, 1.0, 1.0)
    assert Huber(2.0)(-4.0) == (6.0, 0.5, 0.0)
    assert Cauchy(2.0)(2.0) == pytest.approx((2.0 * np.log(2.0), 0.5, 0.0))
    assert GemanMcClure(3.0)(3.0) == pytest.approx((2.25, 0.25, -0.25))


def test_only_the_late_loss_knows_a_side(loss: Loss) -> None:
    alike = loss(-2.5, 0.1, 0.25) == loss(2.5, 0.1, 0.25)
    assert alike == (not isinstance(loss, NlosMixture))


def test_the_late_cost_is_the_mixtures_negative_logarithm() -> None:
    e, sigma, nlos_odds = -4.0, 0.1, 0.25
    inlier_probability = np.exp(-(e**2) / 2.0) / (np.sqrt(2.0 * np.pi) * sigma)
    late = 2.0 / (np.pi * LATE.scale * (1.0 + (e * sigma / LATE.scale) ** 2))
    honest_at_0, late_at_0 = 1.0 / (np.sqrt(2.0 * np.pi) * sigma), 2.0 / (np.pi * LATE.scale)
    expected = np.log((honest_at_0 + nlos_odds * late_at_0) / (inlier_probability + nlos_odds * late))
    assert LATE(e, sigma, nlos_odds)[0] == pytest.approx(expected, rel=1e-12)
    block = RangeBlock(
        np.zeros((1, 3)), np.array([[5.0, 0.0, 0.0]]), np.array([5.4]), np.array([sigma]), np.array([0.25])
    )
    posterior = inlier_probability / (inlier_probability + nlos_odds * late)
    assert block.inlier_probability(UserPose(), UserPose(), LATE)[0] == pytest.approx(posterior, rel=1e-9)


def test_both_densities_of_the_late_loss_are_of_measure_one() -> None:
    """Its tail over the honest density at 0, summed up over lengths, is the odds times the honest density's own sum."""
    sigma, nlos_odds, scale = 0.2, 1e9, 0.7  # of an all but certainly late range the cost is that of lateness alone
    loss = NlosMixture(scale, 0.0)
    x = np.tan(np.linspace(0.0, np.pi / 2.0, 20001)[:-1])
    density = np.array([np.exp(-loss(-length * scale / sigma, sigma, nlos_odds)[0]) for length in x])
    at_zero = 2.0 / (np.pi * scale)
    total = at_zero * scale * np.trapezoid(density * (1.0 + x**2), np.arctan(x))
    assert total == pytest.approx(1.0, abs=1e-3)


def test_what_is_late_soon_stops_to_matter_and_what_is_early_much_later() -> None:
    def gives_up(side: float) -> float:
        e = np.linspace(0.0, 10.0, 1001)
        weight = np.array([LATE(side * x, 0.1, 0.25)[1] for x in e])
        return float(e[np.argmax(weight < 0.5)])

    assert 2.0 < gives_up(-1.0) < 3.0
    assert gives_up(1.0) > gives_up(-1.0) + 1.0
    assert LATE(-20.0, 0.1, 0.25)[0] < LATE(20.0, 0.1, 0.25)[0]
    # From 1 m late to 2 m late is a matter of the tail alone.
    assert LATE(-20.0, 0.1, 0.25)[0] - LATE(-10.0, 0.1, 0.25)[0] == pytest.approx(np.log(5.0 / 2.0), abs=1e-6)


@pytest.mark.parametrize("e", [-1e-3, -1.0, -5.0, -30.0, -45.0, -1e3])
def test_a_range_that_cannot_be_late_is_squared_on_that_side(e: float) -> None:
    assert LATE(e, 0.1, 0.0) == pytest.approx(Squared()(e), rel=1e-9, abs=1e-12)
    assert NlosMixture(1.0, 0.0)(-e, 0.1, 0.25) == pytest.approx(Squared()(e), rel=1e-9, abs=1e-12)


@given(e=st.floats(-1e4, 1e4), sigma=st.floats(1e-3, 10.0), nlos_odds=st.floats(0.0, 1e12), scale=st.floats(0.01, 10.0))
@repeatable
def test_the_late_loss_is_finite_whatever_the_error(e: float, sigma: float, nlos_odds: float, scale: float) -> None:
    assert np.isfinite(NlosMixture(scale, 0.0)(e, sigma, nlos_odds)).all()


@given(e=errors, sigma=sigmas, nlos_odds=odds, annealing=annealings)
@repeatable
def test_annealing_widens_the_loss(loss: Loss, e: float, sigma: float, nlos_odds: float, annealing: float) -> None:
    expected = loss_value(loss, e, sigma, nlos_odds, annealing)
    rho, weight = annealed(loss, e, sigma, nlos_odds, annealing)
    assert rho == pytest.approx(expected[0], rel=1e-9, abs=1e-10)
    if abs(e) > 1e-4:  # below, the error is lost among the digits of the distance
        assert weight == pytest.approx(expected[1], rel=1e-6, abs=1e-9)


def test_annealing_keeps_the_parabola_at_zero(loss: Loss) -> None:
    parabola = loss(1e-3, 0.1, 0.25)[0]
    for annealing in (1.0, 3.0, 10.0):
        assert annealed(loss, 1e-3, 0.1, 0.25, annealing)[0] == pytest.approx(parabola, rel=1e-5)
    weight_at_zero = loss(-1e-9, 0.1, 0.25)[1]
    assert annealed(loss, -5.0, 0.1, 0.25, 1e4)[0] == pytest.approx(12.5 * weight_at_zero, rel=1e-4)


@pytest.mark.parametrize("annealing", [0.0, 0.99, float("nan")])
def test_a_loss_is_never_annealed_to_be_narrower(annealing: float) -> None:
    with pytest.raises(ValueError, match="annealing"):
        annealed(LATE, 1.0, 0.1, 0.25, annealing)
