"""How wide the priors of devices' calibrations are, by what the ranges of a recording say of it.

Most devices are right and some are far off, and a prior wide enough for these costs accuracy where nothing is wrong. So
the priors' width is unknown: a factor on the sigmas of all log scales, one on those of biases, one on those of clock
offsets. All are 0 with probability `devices.flawless_share`; else each is 0 with probability `devices.faultless_share`,
or else half of Student's t with three degrees of freedom (a spike and a slab). With even odds the mean square of a
factor is 1. The slab reaches far, since antenna delays that nobody has set make every range some decimetres too long;
what reaches far is improbable, so that ranges which hardly tell a bias from a scale do not widen it.

Near an optimum the likelihood of all calibrations is Gaussian, so the evidence (marginal likelihood) of each
combination of factors is known in closed form, and so is how many calibrations the ranges determine (MacKay, Neural
Computation 4, 1992), averaged over all combinations. The graph is then solved with the priors under which they
determine as many: no combination is chosen, so nothing flips. Covariances are told as those of the mixture of all
combinations, with a standard deviation of the variance more, but no larger than under the usual priors (`marginals`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.graph.em_weights import EmWeights
from synchronizar.graph.marginals import mean_curvature
from synchronizar.graph.pose_graph import PoseGraph
from synchronizar.graph.priors import CalibrationPriors, calibration_sigmas
from synchronizar.graph.states import States

_SLAB = 2.0 ** np.arange(-2.5, 4.0)
_FACTORS = np.concatenate([[0.0], _SLAB])
_TRIED = np.geomspace(0.01, _SLAB[-1], 20)
_SWEEPS = 3
_WIDE = 30.0  # sigmas of the prior that stands in for none
_LEAST_VARIANCE = 1e-12  # of the largest
_NOTHING = 1e-6  # calibrations that are determined


class Likelihood(NamedTuple):
    """The Gaussian likelihood of k calibrations c (3 k,), all else marginalised: exp(h' c - c' A c / 2)."""

    information: Array
    """(3 k, 3 k) A."""
    vector: Array
    """(3 k,) h."""

    def times(self, root: Array) -> Likelihood:
        """That of v with c = `root` v."""
        return Likelihood(root.T @ self.information @ root, root.T @ self.vector)


def with_measured_priors(graph: PoseGraph, states: States, em_weights: EmWeights) -> PoseGraph:
    """The graph with priors of calibrations as wide as the ranges make likely, at an optimum of the graph."""
    likelihood = likelihood_of_calibrations(graph, states, em_weights)
    usual = CalibrationPriors(*calibration_sigmas(graph.parameters))
    devices = graph.parameters.devices
    return graph.with_calibration_priors(
        measured_priors(likelihood, usual, devices.faultless_share, devices.flawless_share)
    )


def likelihood_of_calibrations(graph: PoseGraph, states: States, em_weights: EmWeights) -> Likelihood:
    """What ranges and steps say of the active users' calibrations, in the graph linearised at an optimum."""
    walks, k = graph.walks, len(graph.walks.users)
    calibration, weight = states.calibration[walks.users], em_weights.calibration_weight
    usual, _ = calibration_sigmas(graph.parameters)
    wide = _WIDE * usual
    free = graph.with_calibration_priors(CalibrationPriors(wide, 1e-6 * usual))  # nothing shared
    covariance = walks.solver.covariance(
        walks.places(states),
        calibration,
        graph.lasting_of(states),
        free.walk_noise(states.anchor_poses, replace(em_weights, calibration_weight=np.ones_like(weight))),
        graph.loss,
        mean_curvature(graph, graph.height_curvature(states, em_weights)),
        np.zeros(0, dtype=np.int32),
    )
    size = np.tile(wide, k)
    information = (np.linalg.inv(covariance / np.outer(size, size)) - np.eye(3 * k)) / np.outer(size, size)
    # At an optimum the ranges pull at a calibration as its prior does.
    own = graph.calibration_priors.own
    pull = weight[walks.users] * (calibration - graph.shared_calibration(states, weight)) / own**2
    return Likelihood(information, information @ calibration.ravel() + pull.ravel())


def measured_priors(
    likelihood: Likelihood, usual: CalibrationPriors, faultless: float, flawless: float
) -> CalibrationPriors:
    """The priors of k calibrations that stand in for all widths times the `usual`.

    `faultless` is the probability that one width is 0, `flawless` that all are, whatever `faultless` says.
    """
    k = len(likelihood.vector) // 3
    root = _root(usual.own, usual.common, k)
    at = likelihood.times(root)
    prior = np.concatenate([[faultless], (1.0 - faultless) * _half_student(_SLAB)])
    grid = np.stack(np.meshgrid(_FACTORS, _FACTORS, _FACTORS, indexing="ij"), axis=-1).reshape(-1, 3)
    weight = np.stack(np.meshgrid(prior, prior, prior, indexing="ij"), axis=-1).reshape(-1, 3).prod(axis=1)
    weight = (1.0 - flawless) * weight
    weight[0] += flawless
    evidence, determined, mean, covariance = posteriors(at, grid)
    weight = weight * np.exp(evidence - evidence.max())
    weight /= weight.sum()
    wanted = weight @ determined
    found = np.ones(3)
    for _ in range(_SWEEPS):
        for q in range(3):
            tried = np.tile(found, (len(_TRIED), 1))
            tried[:, q] = _TRIED
            of_tried = posteriors(at, tried).determined[:, q]
            if of_tried[-1] > _NOTHING:
                found[q] = np.exp(np.interp(np.log(wanted[q]), np.log(of_tried), np.log(_TRIED)))
    ours = posteriors(at, np.stack([found, np.ones(3)]))
    standing_in, of_usual = ours.covariance
    apart = ours.mean[1] - ours.mean[0]
    # What is wider than under the usual priors is their tail, which the graph's weights tell already.
    most = of_usual + np.outer(apart, apart)
    told = _least_map(standing_in, _covariance_told(weight, covariance, mean - ours.mean[0], most))
    to_told = np.asarray(np.linalg.solve(root.T, (root @ told).T).T, dtype=float)
    usual_variances = np.diag(root @ of_usual @ root.T).reshape(k, 3)
    return CalibrationPriors(found * usual.own, found * usual.common, to_told, usual_variances)


class Posteriors(NamedTuple):
    """Under each of m normal priors."""

    evidence: Array
    """(m,) its logarithm."""
    determined: Array
    """(m, 3) calibrations of each kind that the ranges determine: sums of 1 minus posterior over prior variance."""
    mean: Array
    """(m, 3 k)."""
    covariance: Array
    """(m, 3 k, 3 k)."""


def posteriors(likelihood: Likelihood, factors: Array) -> Posteriors:
    """With independent normal priors of 1 sigma `factors` (m, 3)."""
    k = len(likelihood.vector) // 3
    sigma = np.tile(factors, k)
    precision = np.eye(3 * k) + sigma[:, :, None] * likelihood.information * sigma[:, None, :]
    inverse = np.linalg.inv(precision)
    pulled = sigma * likelihood.vector
    mean = np.einsum("mij,mj->mi", inverse, pulled)
    evidence = 0.5 * ((mean * pulled).sum(axis=1) - np.linalg.slogdet(precision)[1])
    determined = (1.0 - np.diagonal(inverse, axis1=1, axis2=2)).reshape(-1, k, 3).sum(axis=1)
    return Posteriors(evidence, determined, sigma * mean, sigma[:, :, None] * inverse * sigma[:, None, :])


def _root(own: Array, common: Array, k: int) -> Array:
    """(3 k, 3 k) the symmetric root of the prior covariance of k calibrations: own^2 I + common^2 1 1' of each kind."""
    share = (np.sqrt(1.0 + k * (common / own) ** 2) - 1.0) / k
    return np.kron(np.eye(k), np.diag(own)) + np.kron(np.ones((k, k)), np.diag(own * share))


def _least_map(before: Array, after: Array) -> Array:
    """Symmetric A with A `before` A' = `after`, both covariances: of all such maps the one that moves errors least.

    A = B^-1 (B C B)^1/2 B^-1 with B = `before`^1/2 and C = `after` (the optimal transport between normals).
    """
    axes, sigma = _axes_of(before)
    between, turned = np.linalg.eigh(_symmetric(sigma[:, None] * (axes.T @ after @ axes) * sigma))
    root = (turned * np.sqrt(np.maximum(between, 0.0))) @ turned.T
    return np.asarray(axes @ (root / np.outer(sigma, sigma)) @ axes.T)


def _covariance_told(weight: Array, covariances: Array, means: Array, most: Array) -> Array:
    """(n, n): of a mixture of m normals about 0, in each direction up to that of `most`.

    Which of them it is, is hardly known, and gives errors with tails: so a standard deviation of the variance is added
    to the variance. Directions are those in which neither the mixture nor `most` is correlated.
    """
    total = np.einsum("m,mij->ij", weight, covariances) + (weight[:, None] * means).T @ means
    axes, sigma = _axes_of(most)
    _, turned = np.linalg.eigh(_symmetric((axes.T @ total @ axes) / np.outer(sigma, sigma)))
    along = (axes / sigma) @ turned
    of_each = ((covariances @ along) * along).sum(axis=1) + (means @ along) ** 2
    variance = weight @ of_each
    spread = np.sqrt(weight @ (of_each - variance) ** 2)
    root = (axes * sigma) @ turned * np.sqrt(np.minimum(variance + spread, 1.0))
    return np.asarray(root @ root.T)


def _axes_of(covariance: Array) -> tuple[Array, Array]:
    """(n, n) columns, (n,) 1 sigma along each."""
    variances, axes = np.linalg.eigh(covariance)
    return axes, np.sqrt(np.maximum(variances, _LEAST_VARIANCE * variances[-1]))


def _symmetric(matrix: Array) -> Array:
    return np.asarray(0.5 * (matrix + matrix.T))


def _half_student(factors: Array) -> Array:
    """Probabilities of factors that are evenly spaced in their logarithm; their mean square is 2."""
    density = factors / (1.0 + 0.5 * factors**2) ** 2
    return np.asarray(density / density.sum())
