"""The rigid model: SLAM is trusted, one frame per user and nothing else; the paper's own model, all users at once."""

from __future__ import annotations

from functools import partial
from time import perf_counter

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.estimation.hypotheses import hypotheses
from synchronizar.estimation.initialisation import connected, joint_placements
from synchronizar.estimation.integrity import verdicts
from synchronizar.estimation.outcome import Outcome
from synchronizar.estimation.residual_statistics import ResidualStatistics, residual_statistics
from synchronizar.estimation.rigid_optima import LocalOptimum, solve
from synchronizar.graph.rigid_graph import RigidGraph, blocks_of
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.centering import about_origins, centered, centroids, errors_about_origins
from synchronizar.preprocessing.extent import extent_points
from synchronizar.preprocessing.range_measurements import RangeMeasurements, range_measurements


def register_rigid(recording: Recording, reference: int, parameters: Parameters) -> Outcome:
    """Everybody's frame, SLAM's poses taken as they are."""
    users = recording.users
    measurements = range_measurements(recording, parameters)
    active_users = connected(measurements, len(users), reference)
    measurements = measurements[np.isin(measurements.i, active_users)]
    middle = centroids(measurements, len(users))
    measurements = centered(measurements, middle)
    graph = RigidGraph(blocks_of(measurements), users, active_users, reference, parameters)
    starts = joint_placements(measurements, users, active_users, reference, parameters)
    searched = perf_counter()
    optimum = solve(measurements, graph, active_users, starts, parameters)
    best = optimum[0]
    extent = extent_points(recording) - middle[:, None]
    fit = _fits(best, measurements)
    found = hypotheses(optimum, partial(_inflated, fit=fit), extent, parameters)
    errors = errors_about_origins(found[0].frames, middle)
    return Outcome(
        searched=searched,
        said=verdicts(found, fit, graph, extent, parameters),
        costs=[placement.cost for placement in found],
        frames=[about_origins(placement.frames, middle, reference) for placement in found],
        covariances=errors @ found[0].covariances @ errors.transpose(0, 2, 1),
        errors=errors,
        scale=np.ones(len(users)),
        measurements=measurements,
        weight=best.graph.weights(best.values) / measurements.sigma**2,
        inlier_probability=best.graph.inlier_probability(best.values),
        residual=best.graph.residuals(best.values),
    )


def _fits(optimum: LocalOptimum, measurements: RangeMeasurements) -> dict[int, ResidualStatistics]:
    """How the samples fit a minimum, user by user."""
    graph = optimum.graph
    residual, inlier_probability = graph.residuals(optimum.values), graph.inlier_probability(optimum.values)
    weight = graph.weights(optimum.values) / measurements.sigma**2
    return {
        u: residual_statistics(
            measurements,
            optimum.frames,
            residual,
            weight,
            inlier_probability,
            u,
            graph.parameters.integrity.residual_pieces,
        )
        for u in graph.free
    }


def _inflated(optimum: LocalOptimum, fit: dict[int, ResidualStatistics]) -> Array:
    """The covariances (k, 4, 4) with what the ranges say worth 1 / inflation of what it seems; priors are worth theirs.

    With the information H = R + P of ranges and priors, and scores of covariance f R + P, the sandwich
    H^-1 (f R + P) H^-1 is f H^-1 - (f - 1) H^-1 P H^-1; no number is known worse than before any range.
    """
    out = optimum.graph.covariances(optimum.values)
    for u, of_user in fit.items():
        variances = optimum.graph.prior_variances(u)
        out[u] = of_user.inflation * out[u] - (of_user.inflation - 1.0) * out[u] @ np.diag(1.0 / variances) @ out[u]
        no_worse = np.sqrt(np.minimum(1.0, variances / np.maximum(np.diag(out[u]), 1e-300)))
        out[u] *= np.outer(no_worse, no_worse)
    return out
