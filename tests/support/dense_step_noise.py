"""The noise of SLAM's steps by gtsam's factors and dense matrices: what the core's solver must find."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np

from synchronizar.arrays import Array, Indices
from synchronizar.graph import keys
from synchronizar.graph.gtsam_form import GtsamForm
from synchronizar.graph.pose_graph import EmWeights, PoseGraph
from synchronizar.graph.states import States, steps

OF_ROW = [0, 0, 1]


def dense_step_noise(
    graph: PoseGraph,
    states: States,
    em_weights: EmWeights,
    rounds: int,
    usual: float = 1.0,
    weight: float | None = None,
) -> Array:
    """(k, 2) with all keyframes in one dense matrix."""
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
    return most_likely_noise(
        information - rows.T @ rows,
        slope - rows.T @ wanted,
        rows,
        wanted,
        np.array(whose, dtype=np.int32),
        len(graph.users),
        graph.parameters.slam.drift_weight if weight is None else weight,
        usual,
        rounds,
    )


def most_likely_noise(
    information: Array,
    slope: Array,
    rows: Array,
    wanted: Array,
    whose: Indices,
    users: int,
    weight: float,
    usual: float,
    rounds: int,
) -> Array:
    """All factors but the steps cost 0.5 d' information d - slope' d; step n's three rows are rows d - wanted."""
    noise, count = np.ones((users, 2)), np.bincount(whose, minlength=users)
    for _ in range(rounds):
        precision = noise[whose][:, OF_ROW].ravel() ** -2
        covariance = np.linalg.inv(information + rows.T @ (rows * precision[:, None]))
        step = covariance @ (slope + rows.T @ (precision * wanted))
        square = (rows @ step - wanted) ** 2 + ((rows @ covariance) * rows).sum(axis=1)
        x, y, heading = (np.bincount(whose, s, users) for s in square.reshape(-1, 3).T)
        noise[:, 0] = np.sqrt((2.0 * weight * usual**2 + x + y) / (2.0 * (weight + count)))
        noise[:, 1] = np.sqrt((weight * usual**2 + heading) / (weight + count))
    return noise
