"""The rigid model of Huo et al. (UIST 2018), all users at once: SLAM is trusted, one frame per user is estimated."""

from __future__ import annotations

from time import perf_counter

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration
from synchronizar.estimation.answer import OwnFrames, registration_of
from synchronizar.estimation.assessment import assess
from synchronizar.estimation.comparing import not_excluded
from synchronizar.estimation.local_optima import find_optima
from synchronizar.estimation.residual_statistics import inflations
from synchronizar.estimation.segments import starts_of
from synchronizar.graph.pose_graph import LocalOptimum
from synchronizar.graph.problem import Problem
from synchronizar.graph.rigid_graph import RigidGraph
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.centering import centroids
from synchronizar.preprocessing.raised import lowered, raised_by
from synchronizar.progress import Progress, stage


def register_rigid(recording: Recording, reference: int, parameters: Parameters, progress: Progress) -> Registration:
    """The registration of a recording whose SLAM, clocks and radios are trusted."""
    began = perf_counter()
    k, raised = len(recording.users), raised_by(recording, parameters)
    recording = lowered(recording, raised)
    problem = Problem.of(recording, reference, parameters)
    anchors = centroids(problem.measurements, k)
    graph = RigidGraph(problem, anchors)
    starts = starts_of(graph)
    searched = perf_counter()
    progress(0.1)
    optima = find_optima(graph, starts, stage(progress, 0.1, 0.9))
    best, *others = optima
    optima = [best, *not_excluded(best, others)]
    inflation = _inflation(best)
    systematic = np.flatnonzero(inflation > parameters.integrity.systematic_inflation).tolist()
    assessed = assess(optima, lambda s: (_inflated(s, graph, inflation), 0.0), systematic)
    survey = recording.users[reference].position
    anchors = anchors + np.outer(raised, [0.0, 0.0, 1.0])
    origin = anchors[reference] if survey is None else np.array(survey)
    own = OwnFrames(np.ones(k), np.zeros(k), anchors, np.append(origin, 0.0), np.zeros(3))
    seconds = {"load": 0.0, "initialise": searched - began, "solve": perf_counter() - searched}
    return registration_of(assessed, own, len(recording.ranges), seconds)


def _inflation(best: LocalOptimum) -> Array:
    """(k,) by how much each user's covariance is larger than noise alone would make it (residual_statistics.py)."""
    graph = best.graph
    weight, _ = graph.inlier_probability(best.states, best.em_weights)
    weight, residual = weight / graph.sigma**2, graph.residuals(best.states)
    pieces = graph.parameters.integrity.residual_pieces
    return inflations(graph.to_rigid_ranges(best.states), best.frames, residual, weight, pieces)


def _inflated(optimum: LocalOptimum, graph: RigidGraph, inflation: Array) -> Array:
    """Covariances (k, 4, 4) beside the reference, the ranges' information divided by `inflation`, priors' kept.

    With the information H = R + P of ranges and priors, and scores of covariance f R + P, the sandwich
    H^-1 (f R + P) H^-1 is f H^-1 - (f - 1) H^-1 P H^-1; no number is known worse than before any range.
    """
    out, free = graph.covariances(optimum.frames, optimum.em_weights.nlos_odds), graph.free
    if not free:
        return out
    variances = np.array([graph.prior_variances(u) for u in free])
    prior = 1.0 / variances
    prior[:, 3] /= len(free)  # all headings share one
    own, factor = out[free], inflation[free, None, None]
    own = factor * own - (factor - 1.0) * (own * prior[:, None, :]) @ own
    no_worse = np.sqrt(np.minimum(1.0, variances / np.maximum(np.diagonal(own, axis1=1, axis2=2), 1e-300)))
    out[free] = own * no_worse[:, :, None] * no_worse[:, None, :]
    return out
