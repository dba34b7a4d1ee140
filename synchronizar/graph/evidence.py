"""The evidence for how far SLAM drifts and how long ranges' errors last, by Laplace's approximation at an optimum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from synchronizar.arrays import Array
from synchronizar.graph.marginals import mean_curvature
from synchronizar.graph.pose_graph import LocalOptimum


def evidence_against(optimum: LocalOptimum, range_weight: Array, noise: Array) -> float:
    """Negative log evidence for the drift that an optimum's keyframes have, up to a constant.

    With keyframes at the same times and the same range weights (n,), optima can be compared whatever drift they allow:
    where it is wide, steps are improbable each for itself, and left free by what does not determine them. `noise`
    (k, 2) are the factors of the keyframes: their binary logarithms have a Cauchy prior of scale 1 about 0.
    """
    graph, states = optimum.graph, optimum.states
    em_weights, cost = graph.e_step(states, replace(optimum.em_weights, range_weight=range_weight))
    walks, drifting = graph.walks, graph.drifting()
    determinant = walks.solver.log_determinant(
        walks.places(states),
        states.calibration[walks.users],
        graph.lasting_of(states),
        graph.walk_noise(states.anchor_poses, em_weights),
        graph.loss,
        mean_curvature(graph, graph.height_curvature(states, em_weights)),
    )
    sigmas = sum(float(np.log(graph.keyframes[u].step_sigma[:, [0, 0, 1, 2]]).sum()) for u in drifting)
    sigmas += float(np.log(graph.lasting_steps).sum())
    prior = float(np.log1p((np.log(noise[drifting]) / np.log(2.0)) ** 2).sum())
    return cost + float(range_weight @ np.log(graph.sigma)) + sigmas + 0.5 * determinant + prior
