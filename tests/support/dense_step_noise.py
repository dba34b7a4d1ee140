"""The noise of SLAM's steps by gtsam's factors and dense matrices: what the core's solver must find."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import gtsam
import numpy as np

from synchronizar.arrays import Array, Indices
from synchronizar.graph import keys
from synchronizar.graph.em_weights import EmWeights
from synchronizar.graph.gtsam_form import GtsamForm
from synchronizar.graph.pose_graph import PoseGraph
from synchronizar.graph.states import States, steps

OF_ROW = [0, 0, 1, 2]


class Noise(NamedTuple):
    """About one common factor."""

    factors: Array
    """(k, 2) in place and heading."""
    evidence: float
    determined: float


def dense_step_noise(
    graph: PoseGraph, states: States, em_weights: EmWeights, tried: Sequence[float], rounds: int
) -> list[Noise]:
    """For each common factor `tried`, with all keyframes in one dense matrix."""
    form = GtsamForm(graph)
    weights, counted, whose = list(em_weights.step_weight), gtsam.NonlinearFactorGraph(), []
    for u in graph.active_users:
        frames = graph.keyframes[u]
        squares = (steps(states.keyframe_poses[u], frames) ** 2).sum(axis=1)
        ordinary = ~frames.rebuilt & (squares < graph.parameters.slam.slip_sigmas**2)
        weights[u] = np.where(ordinary, 1.0, weights[u])
        of_user = gtsam.NonlinearFactorGraph()
        form.add_steps(of_user, u, weights[u])
        # Each step is two factors: in the plane, and in height.
        for n in np.flatnonzero(ordinary).tolist():
            counted.push_back(of_user.at(2 * n))
            counted.push_back(of_user.at(2 * n + 1))
            whose.append(u)
    values, ordering = form.values(states), form.ordering()
    columns = [ordering.at(n) for n in range(ordering.size())]
    linear = counted.linearize(values)
    present = set(linear.keys())
    jacobian, wanted = linear.jacobian(keys.ordering([key for key in columns if key in present]))
    spans = zip(columns, keys.rows(columns), strict=True)
    at = np.concatenate([np.arange(s.start, s.stop) for key, s in spans if key in present])
    rows = np.zeros((len(jacobian), keys.rows(columns)[-1].stop))
    rows[:, at] = jacobian
    factors = form.factors(states.anchor_poses, replace(em_weights, step_weight=weights))
    information, slope = factors.linearize(values).hessian(ordering)
    system = (information - rows.T @ rows, slope - rows.T @ wanted, rows, wanted)
    of_steps, weight = np.array(whose, dtype=np.int32), graph.parameters.slam.drift_weight
    return [most_likely_noise(system, of_steps, len(graph.users), about, weight, rounds) for about in tried]


def most_likely_noise(
    system: tuple[Array, Array, Array, Array], whose: Indices, users: int, about: float, weight: float, rounds: int
) -> Noise:
    """All factors but the steps cost 0.5 d' information d - slope' d; step n's four rows are rows d - wanted."""
    information, slope, rows, wanted = system
    noise, count = np.full((users, 3), about), np.bincount(whose, minlength=users)
    for n in range(rounds + 1):
        sigma = noise[whose][:, OF_ROW].ravel()
        matrix = information + rows.T @ (rows / sigma[:, None] ** 2)
        covariance = np.linalg.inv(matrix)
        pulled = slope + rows.T @ (wanted / sigma**2)
        step = covariance @ pulled
        variance = ((rows @ covariance) * rows).sum(axis=1)
        if n == rounds:
            break
        x, y, heading, _ = (
            np.bincount(whose, s, users) for s in ((rows @ step - wanted) ** 2 + variance).reshape(-1, 4).T
        )
        prior = weight * about**2
        noise[:, 0] = np.sqrt((2.0 * prior + x + y) / (2.0 * (weight + count)))
        noise[:, 1] = np.sqrt((prior + heading) / (weight + count))
    # The prior of own factors: as if `weight` steps with the common one had been seen, 0 at it.
    ratio = noise[:, :2] / about
    of_factors = -weight * (np.log(ratio) + 0.5 * (ratio**-2 - 1.0)) @ [2.0, 1.0]
    quadratic = float((wanted / sigma) @ (wanted / sigma) - pulled @ step)
    evidence = -0.5 * quadratic - np.log(sigma).sum() - 0.5 * np.linalg.slogdet(matrix)[1] + of_factors.sum()
    return Noise(noise[:, :2], float(evidence), float((1.0 - variance / sigma**2).sum()))
