"""The rigid model: SLAM is trusted, one frame per user and nothing else; the paper's own model, all users at once."""

from __future__ import annotations

from functools import partial
from time import perf_counter

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.estimation.assessment import about_own, errors_about_own
from synchronizar.estimation.hypotheses import hypotheses
from synchronizar.estimation.initialisation import connected
from synchronizar.estimation.integrity import verdicts
from synchronizar.estimation.local_optima import LocalOptimum, excluded_above, find_optima
from synchronizar.estimation.outcome import Outcome
from synchronizar.estimation.residual_statistics import ResidualStatistics, residual_statistics
from synchronizar.estimation.segments import starts_of
from synchronizar.graph.marginals import marginals
from synchronizar.graph.rigid_graph import RigidGraph
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.centering import centroids
from synchronizar.preprocessing.extent import extent_points
from synchronizar.preprocessing.range_measurements import range_measurements
from synchronizar.progress import Progress, stage


def register_rigid(recording: Recording, reference: int, parameters: Parameters, progress: Progress) -> Outcome:
    """Everybody's frame, SLAM's poses taken as they are."""
    k = len(recording.users)
    measurements = range_measurements(recording, parameters)
    active_users = connected(measurements, k, reference)
    measurements = measurements[np.isin(measurements.i, active_users)]
    anchors = centroids(measurements, k)
    graph = RigidGraph(recording, measurements, anchors, active_users, reference, parameters)
    starts = starts_of(graph, parameters)
    searched = perf_counter()
    progress(0.1)
    minima = find_optima(graph, starts, parameters, stage(progress, 0.1, 0.9))
    best = minima[0]
    minima = [s for s in minima if s.cost <= best.cost + excluded_above(best, parameters)]
    weight, inlier_probability = graph.inlier_probability(best.states, best.em_weights)
    weight = weight / graph.sigma**2
    residual = graph.residuals(best.states)
    ranges, pieces = graph.to_rigid_ranges(best.states), parameters.integrity.residual_pieces
    fit = {
        u: residual_statistics(ranges, best.frames, residual, weight, inlier_probability, u, pieces) for u in graph.free
    }
    extent = extent_points(recording) - anchors[:, None]
    found = hypotheses(minima, partial(_inflated, fit=fit), extent, parameters)
    errors = errors_about_own(found[0].frames, np.ones(k), anchors)[:, :, :4]
    frames = [about_own(placement.frames, np.zeros(k), np.ones(k), anchors) for placement in found]
    for of_placement in frames:
        of_placement[:, :3] += anchors[reference]
    return Outcome(
        searched=searched,
        said=verdicts(found, fit, graph, extent, parameters),
        costs=[placement.cost for placement in found],
        frames=frames,
        covariances=errors @ found[0].covariances @ errors.transpose(0, 2, 1),
        errors=errors,
        scale=np.ones(k),
        measurements=measurements,
        weight=weight,
        inlier_probability=inlier_probability,
        residual=-residual,
    )


def _inflated(optimum: LocalOptimum, fit: dict[int, ResidualStatistics]) -> Array:
    """The covariances (k, 4, 4) with what the ranges say worth 1 / inflation of what it seems; priors are worth theirs.

    With the information H = R + P of ranges and priors, and scores of covariance f R + P, the sandwich
    H^-1 (f R + P) H^-1 is f H^-1 - (f - 1) H^-1 P H^-1; no number is known worse than before any range.
    """
    out = marginals(optimum.graph, optimum.states, optimum.em_weights).relative
    for u, of_user in fit.items():
        variances = optimum.graph.prior_variances(u)
        prior = 1.0 / variances
        prior[3] /= len(optimum.graph.free)  # all headings share one
        out[u] = of_user.inflation * out[u] - (of_user.inflation - 1.0) * out[u] @ np.diag(prior) @ out[u]
        no_worse = np.sqrt(np.minimum(1.0, variances / np.maximum(np.diag(out[u]), 1e-300)))
        out[u] *= np.outer(no_worse, no_worse)
    return out
