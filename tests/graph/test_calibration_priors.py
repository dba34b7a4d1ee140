from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from synchronizar.arrays import Array
from synchronizar.graph import calibration_priors as priors
from synchronizar.graph.calibration_priors import Likelihood, measured_priors, posteriors
from synchronizar.graph.priors import CalibrationPriors
from synchronizar.graph.states import BIAS, CLOCK, SCALE
from synchronizar.parameters import Parameters

OWN, COMMON = np.array([0.03, 0.05, 0.04]), np.array([0.07, 0.03, 0.04])
USUAL = CalibrationPriors(OWN, COMMON)
SHARE, FLAWLESS = Parameters().devices.faultless_share, Parameters().devices.flawless_share


def told(values: Array, sigma: float | Array) -> Likelihood:
    """Ranges that tell each calibration (k, 3) apart, to `sigma` of its own prior's 1 sigma."""
    information = np.tile((sigma * OWN) ** -2, len(values))
    return Likelihood(np.diag(information), information * values.ravel())


def factors(likelihood: Likelihood, share: float = SHARE, flawless: float = 0.0) -> Array:
    return measured_priors(likelihood, USUAL, share, flawless).own / OWN


def test_evidence_is_the_integral_over_all_calibrations() -> None:
    root = 0.4 * np.random.default_rng(3).normal(size=(5, 3))
    likelihood = Likelihood(root.T @ root, np.array([1.0, -0.5, 2.0]))
    sigmas = np.array([[1.0, 0.5, 2.0], [0.3, 1.0, 1.0]])
    x, weight = np.polynomial.hermite_e.hermegauss(60)
    weight = weight / weight.sum()
    for n, sigma in enumerate(sigmas):
        c = np.array(list(product(x, repeat=3))) * sigma
        w = np.array(list(product(weight, repeat=3))).prod(axis=1)
        density = np.exp(c @ likelihood.vector - 0.5 * np.einsum("ni,ij,nj->n", c, likelihood.information, c))
        assert posteriors(likelihood, sigmas).evidence[n] == pytest.approx(np.log(w @ density), abs=1e-6)


def test_without_a_prior_width_there_is_nothing_to_determine() -> None:
    none = posteriors(told(np.ones((2, 3)), 1.0), np.zeros((1, 3)))
    assert none.evidence[0] == pytest.approx(0.0)
    assert not none.determined.any()


def test_one_width_determines_as_much_as_all_widths_do_on_average() -> None:
    """One device, of which ranges tell the bias alone: the average by hand."""
    for value in (0.0, 0.1, 0.3):
        sigma = np.array([1e9, 0.7, 1e9])
        found = factors(told(np.array([[0.0, value, 0.0]]), sigma))
        prior, noise = np.hypot(OWN[BIAS], COMMON[BIAS]), 0.7 * OWN[BIAS]
        average = total = 0.0
        for factor in priors._FACTORS:
            share = SHARE if factor == 0.0 else (1.0 - SHARE) * slab_of(factor)
            variance = (factor * prior) ** 2 + noise**2
            likelihood = share * np.exp(-0.5 * value**2 / variance) / np.sqrt(variance)
            total += likelihood
            average += likelihood * (factor * prior) ** 2 / variance
        width = (found[BIAS] * prior) ** 2
        assert width / (width + noise**2) == pytest.approx(average / total, rel=0.02)
        assert found[SCALE] == found[CLOCK] == 1.0


def test_the_covariance_is_told_by_the_mixture_of_all_widths() -> None:
    """By draws of widths and calibrations from the prior, weighed by their likelihood."""
    random = np.random.default_rng(4)
    likelihood = told(np.array([[0.0, 0.03, 0.0], [0.0, 0.01, 0.0]]), np.array([1e9, 0.8, 1e9]))
    found = measured_priors(likelihood, USUAL, SHARE, 0.0)
    n = 400_000
    share = np.concatenate([[SHARE], (1.0 - SHARE) * slab_of(priors._SLAB)])
    width = random.choice(priors._FACTORS, n, p=share)[:, None]
    bias = width * (OWN[BIAS] * random.standard_normal((n, 2)) + COMMON[BIAS] * random.standard_normal((n, 1)))
    which = [BIAS, 3 + BIAS]
    weight = np.exp(bias @ likelihood.vector[which] - 0.5 * bias**2 @ np.diag(likelihood.information)[which])
    assert found.to_told is not None
    information = likelihood.information[np.ix_(which, which)]
    standing_in, usual = (
        np.linalg.inv(np.linalg.inv(own**2 * np.eye(2) + common**2) + information)
        for own, common in ((found.own[BIAS], found.common[BIAS]), (OWN[BIAS], COMMON[BIAS]))
    )
    mean = standing_in @ likelihood.vector[which]
    of_widths = [weight * (width[:, 0] == factor) for factor in priors._FACTORS]
    shares = np.array([those.sum() for those in of_widths]) / weight.sum()
    squares = np.array([((bias - mean).T * those) @ (bias - mean) / those.sum() for those in of_widths])
    apart = usual @ likelihood.vector[which] - mean
    expected = priors._covariance_told(shares, squares, np.zeros((len(shares), 2)), usual + np.outer(apart, apart))
    to_told = found.to_told[np.ix_(which, which)]
    got = to_told @ standing_in @ to_told.T
    np.testing.assert_allclose(got, expected, rtol=0.02, atol=0.02 * expected[0, 0])


def test_the_map_between_two_covariances_takes_the_one_to_the_other_and_is_none_between_equals() -> None:
    random = np.random.default_rng(5)
    before, after = (root @ root.T for root in random.normal(size=(2, 6, 6)))
    found = priors._least_map(before, after)
    np.testing.assert_allclose(found @ before @ found.T, after, rtol=1e-6)
    np.testing.assert_allclose(found, found.T, atol=1e-9)
    np.testing.assert_allclose(priors._least_map(before, before), np.eye(6), atol=1e-6)


def test_what_is_told_of_a_mixture_is_its_variance_and_a_standard_deviation_of_that_up_to_a_limit() -> None:
    share, variances = np.array([0.25, 0.75]), np.array([[4.0, 1.0, 9.0], [0.0, 1.0, 1.0]])
    means, most = np.array([[2.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), np.array([10.0, 3.0, 5.0])
    turn = np.linalg.qr(np.random.default_rng(6).normal(size=(3, 3)))[0]
    covariances = np.array([turn @ np.diag(v) @ turn.T for v in variances])
    found = priors._covariance_told(share, covariances, means @ turn.T, turn @ np.diag(most) @ turn.T)
    expected = [0.25 * 8.0 + np.sqrt(0.25 * 6.0**2 + 0.75 * 2.0**2), 1.0, 5.0]
    np.testing.assert_allclose(found, turn @ np.diag(expected) @ turn.T, atol=1e-9)


def test_covariances_are_no_larger_than_under_the_usual_priors() -> None:
    """About what is told; of who is far off too, for whom wide priors are likely."""
    likelihood = told(np.full((2, 3), 0.4), 0.8)
    far = measured_priors(likelihood, USUAL, SHARE, 0.0)
    assert far.to_told is not None
    prior = np.array([np.kron(np.eye(2), np.diag(s**2)) for s in (far.own, OWN)])
    prior += np.array([np.kron(np.ones((2, 2)), np.diag(s**2)) for s in (far.common, COMMON)])
    standing_in, usual = np.linalg.inv(np.linalg.inv(prior) + likelihood.information)
    apart = (usual - standing_in) @ likelihood.vector
    most = usual + np.outer(apart, apart)
    assert np.linalg.eigvalsh(most - far.to_told @ standing_in @ far.to_told.T).min() > -1e-4 * most.max()


def slab_of(factor: Array) -> Array:
    """Half of Student's t with three degrees of freedom, by the factor's logarithm."""
    density = [f / (1.0 + 0.5 * f**2) ** 2 for f in (factor, priors._SLAB)]
    return np.asarray(density[0] / density[1].sum())


def test_who_tells_nothing_has_the_usual_priors() -> None:
    square = (1.0 - SHARE) * (priors._SLAB**2 @ slab_of(priors._SLAB))
    assert square == pytest.approx(1.0, abs=0.05)
    np.testing.assert_array_equal(factors(told(np.zeros((3, 3)), 1e9)), 1.0)
    np.testing.assert_allclose(factors(told(np.zeros((3, 3)), 100.0)), 1.0, atol=0.05)


def test_right_devices_are_taken_for_right_and_others_for_as_wrong_as_they_are() -> None:
    right = factors(told(np.zeros((4, 3)), 0.2))
    assert (right < 0.1).all()
    random = np.random.default_rng(0)
    usual = factors(told(OWN * random.standard_normal((12, 3)), 0.2))
    assert ((usual > 0.5) & (usual < 2.0)).all()
    wide = factors(told(3.0 * OWN * random.standard_normal((12, 3)), 0.2))
    assert (wide > 1.5).all()


def test_one_kind_of_fault_is_not_the_others() -> None:
    values = np.zeros((4, 3))
    values[:, SCALE] = [0.1, -0.05, 0.12, 0.02]
    found = factors(told(values, 0.2))
    assert found[SCALE] > 0.8
    assert (found[[BIAS, CLOCK]] < 0.1).all()


def test_what_all_share_widens_the_prior_too() -> None:
    values = np.zeros((4, 3))
    values[:, BIAS] = 0.1
    assert factors(told(values, 0.2))[BIAS] > 0.8


def test_radios_whose_delays_nobody_has_set_are_many_usual_sigmas_off() -> None:
    values = np.zeros((4, 3))
    values[:, BIAS] = [0.2, 0.25, 0.2, 0.5]
    assert factors(told(values, 0.2))[BIAS] > 3.0


def test_factors_grow_smoothly_with_what_is_found() -> None:
    random = np.random.default_rng(1).standard_normal((3, 3))
    found = np.array([factors(told(times * OWN * random, 0.3)) for times in np.linspace(0.0, 2.0, 41)])
    steps = np.diff(np.log(found), axis=0)
    assert (steps > -1e-3).all()
    assert steps.max() < 0.35
    assert (found[-1] > 5.0 * found[0]).all()


def test_what_may_be_flawless_as_a_whole_is_taken_for_right_sooner_and_else_as_before() -> None:
    """The odds of all widths at 0 against all others, by hand; one device, of which ranges tell the bias alone."""
    value, sigma = 0.05, np.array([1e9, 0.7, 1e9])
    likelihood = told(np.array([[0.0, value, 0.0]]), sigma)
    found = factors(likelihood, SHARE, FLAWLESS)
    prior, noise = np.hypot(OWN[BIAS], COMMON[BIAS]), 0.7 * OWN[BIAS]
    none = FLAWLESS + (1.0 - FLAWLESS) * SHARE
    average = total = 0.0
    for factor in priors._FACTORS:
        share = none if factor == 0.0 else (1.0 - none) * slab_of(factor)
        variance = (factor * prior) ** 2 + noise**2
        weight = share * np.exp(-0.5 * value**2 / variance) / np.sqrt(variance)
        total += weight
        average += weight * (factor * prior) ** 2 / variance
    width = (found[BIAS] * prior) ** 2
    assert width / (width + noise**2) == pytest.approx(average / total, rel=0.02)
    assert found[BIAS] < factors(likelihood)[BIAS]
    far = told(3.0 * OWN * np.random.default_rng(0).standard_normal((12, 3)), 0.2)
    np.testing.assert_allclose(factors(far, SHARE, FLAWLESS), factors(far), rtol=1e-3)


def test_a_share_of_none_leaves_the_slab_alone() -> None:
    likelihood = told(np.zeros((3, 3)), 0.3)
    assert (factors(likelihood, 0.0) > factors(likelihood)).all()
