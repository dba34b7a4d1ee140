"""The hidden Markov chain of NLOS bursts in plain numpy, for tests to compare with."""

from __future__ import annotations

import numpy as np

from support.reference_kernel import honest_density, stray_density
from synchronizar._core import Bursts, NlosMixture, foreign_or_nlos_of_pairs
from synchronizar.arrays import Array
from synchronizar.graph.priors import bursts_with_foreign, nlos_mixture
from synchronizar.parameters import Parameters

LATE = NlosMixture(scale=1.0, early_odds=0.002)
SHARE, DURATION = 0.1, 1.0
TYPICAL_ODDS = SHARE / (1.0 - SHARE)

KEEPS_LENGTH = 0.7
FLUCTUATION = 0.2
BURSTS = Bursts(SHARE, DURATION, KEEPS_LENGTH, FLUCTUATION)
LENGTHS = 24


def ladder() -> tuple[Array, Array, Array]:
    """Middle, variance and probability of each step of detours' lengths, in units of the loss's scale."""
    bounds = [0.0]
    for _ in range(LENGTHS):
        bounds.append(bounds[-1] + max(0.1, 0.2 * bounds[-1]))
    begin, end = np.array(bounds[:-1]), np.array(bounds[1:])
    middle = (begin + end) / 2.0
    variance = (end - begin) ** 2 / 12.0 + (FLUCTUATION * middle) ** 2
    share = np.arctan(end) - np.arctan(begin)
    return middle, variance, share / share.sum()


LENGTH, VARIANCE, PRIOR = ladder()


def transition(dt: float, share: float, duration: float) -> Array:
    """(25, 25): the probability of each state given the one before; state 0 is honest."""
    fades = np.exp(-dt / (duration * (1.0 - share)))
    late_after_late = share + (1.0 - share) * fades
    late_after_honest = share * (1.0 - fades)
    keeps = KEEPS_LENGTH * np.exp(-dt / duration)
    out = np.zeros((1 + LENGTHS, 1 + LENGTHS))
    out[0, 0], out[0, 1:] = 1.0 - late_after_honest, late_after_honest * PRIOR
    out[1:, 0] = 1.0 - late_after_late
    out[1:, 1:] = late_after_late * (keeps * np.eye(LENGTHS) + (1.0 - keeps) * PRIOR)
    return out


def emission(e: float, sigma: float, nlos_odds: float, loss: NlosMixture, share: float) -> Array:
    """(25,): the density of the residual in each state over that of a perfect honest range."""
    at_zero = honest_density(0.0, sigma)
    inlier_probability = honest_density(e, sigma)
    if e > 0.0:
        inlier_probability += loss.early_odds * stray_density(e, sigma, loss.scale)
    spread = np.sqrt(sigma**2 + VARIANCE * loss.scale**2)
    late = honest_density((e * sigma + LENGTH * loss.scale) / spread, spread)
    return np.array([inlier_probability, *(late * nlos_odds / (share / (1.0 - share)))]) / float(at_zero)


def late_by_the_loss(e: Array, sigma: Array, nlos_odds: Array, loss: NlosMixture = LATE) -> Array:
    """P(late) of each range by itself, its residual e < 0 known."""
    late = nlos_odds * stray_density(e, sigma, loss.scale)
    return np.asarray(late / (late + honest_density(e, sigma)))


def stamps(n: int, dt: float) -> Array:
    return np.asarray(dt * np.arange(n), dtype=float)


def chain_of_pair(
    ranges: tuple[Array, Array, Array, Array, Array], worth: float, parameters: Parameters
) -> tuple[Array, Array, float]:
    """NLOS odds, probabilities of being foreign and cost of one pair's chain, by the core and the model's parameters.

    `ranges` are stamps, distances, whitened residuals, sigmas and odds.
    """
    bounds = np.array([0, len(ranges[0])], dtype=np.int32)
    columns = (np.ascontiguousarray(column) for column in ranges)
    t, d, e, sigma, odds = columns
    loss, bursts = nlos_mixture(parameters), bursts_with_foreign(parameters)
    found, foreign, cost = foreign_or_nlos_of_pairs(bounds, t, d, e, sigma, odds, np.array([worth]), loss, bursts)
    return found, foreign, float(cost[0])
