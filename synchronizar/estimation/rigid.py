"""The rigid model: SLAM is trusted, one frame per user and nothing else; the paper's own model, all users at once."""

from __future__ import annotations

from functools import partial
from time import perf_counter

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.estimation.hypotheses import placements
from synchronizar.estimation.initialisation import connected, joint_placements
from synchronizar.estimation.integrity import verdicts
from synchronizar.estimation.outcome import Outcome
from synchronizar.estimation.residual_statistics import Misfit, misfit
from synchronizar.estimation.rigid_optima import Settled, solve
from synchronizar.graph.rigid_graph import RigidGraph, blocks_of
from synchronizar.parameters import Model
from synchronizar.preprocessing.centering import about_origins, centred, errors_about_origins, middles
from synchronizar.preprocessing.extent import corners_of
from synchronizar.preprocessing.range_measurements import Samples, samples_of


def register_rigid(recording: Recording, reference: int, model: Model) -> Outcome:
    """Everybody's frame, SLAM's poses taken as they are."""
    users = recording.users
    samples = samples_of(recording, model)
    placed = connected(samples, len(users), reference)
    samples = samples[np.isin(samples.i, placed)]
    middle = middles(samples, len(users))
    samples = centred(samples, middle)
    graph = RigidGraph(blocks_of(samples), users, placed, reference, model)
    starts = joint_placements(samples, users, placed, reference, model)
    searched = perf_counter()
    settled = solve(samples, graph, placed, starts, model)
    best = settled[0]
    corners = corners_of(recording) - middle[:, None]
    fit = _fits(best, samples)
    found = placements(settled, partial(_inflated, fit=fit), corners, model)
    errors = errors_about_origins(found[0].frames, middle)
    return Outcome(
        searched=searched,
        said=verdicts(found, fit, graph, corners, model),
        costs=[placement.cost for placement in found],
        frames=[about_origins(placement.frames, middle, reference) for placement in found],
        covariances=errors @ found[0].covariances @ errors.transpose(0, 2, 1),
        errors=errors,
        scale=np.ones(len(users)),
        samples=samples,
        weight=best.graph.weights(best.values) / samples.sigma**2,
        honest=best.graph.honest(best.values),
        residual=best.graph.residuals(best.values),
    )


def _fits(settled: Settled, samples: Samples) -> dict[int, Misfit]:
    """How the samples fit a minimum, user by user."""
    graph = settled.graph
    residual, honest = graph.residuals(settled.values), graph.honest(settled.values)
    weight = graph.weights(settled.values) / samples.sigma**2
    return {u: misfit(samples, settled.frames, residual, weight, honest, u) for u in graph.free}


def _inflated(settled: Settled, fit: dict[int, Misfit]) -> Array:
    """The covariances (k, 4, 4) with what the ranges say worth 1 / inflation of what it seems; priors are worth theirs.

    With the information H = R + P of ranges and priors, and scores of covariance f R + P, the sandwich
    H^-1 (f R + P) H^-1 is f H^-1 - (f - 1) H^-1 P H^-1; no number is known worse than before any range.
    """
    out = settled.graph.covariances(settled.values)
    for u, of_user in fit.items():
        variances = settled.graph.prior_variances(u)
        out[u] = of_user.inflation * out[u] - (of_user.inflation - 1.0) * out[u] @ np.diag(1.0 / variances) @ out[u]
        no_worse = np.sqrt(np.minimum(1.0, variances / np.maximum(np.diag(out[u]), 1e-300)))
        out[u] *= np.outer(no_worse, no_worse)
    return out
