"""Noise of each device's SLAM steps, estimated from the ranges by expectation maximisation.

Shumway and Stoffer (J. Time Series Analysis 3, 1982): the expected square of a step's error is the square at the most
likely states plus its posterior variance, in the graph linearised at some states. Steps are Gaussian here, and slips
are left out; with the graph's weights of Student's t, ordinary steps would get too small a noise.
"""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np

from synchronizar.arrays import Array, Indices
from synchronizar.graph import keys
from synchronizar.graph.pose_graph import EmWeights, PoseGraph
from synchronizar.graph.states import States, steps

PLACE, HEADING = range(2)
"""Columns of the noise."""

_OF_ROW = [PLACE, PLACE, HEADING]
_ROUNDS = 10
_MOST_KEYFRAMES = 400  # in the dense matrix: of a longer walk only the middle is used


def step_noise(graph: PoseGraph, states: States, em_weights: EmWeights) -> Array:
    """(k, 2): factor on each user's step sigmas in position and heading, relative to `parameters.slam`.

    1 where ranges carry no information on it: the prior counts as `drift_weight` steps with factor 1.
    """
    users = len(graph.users)
    if not len(graph.measurements):
        return np.ones((users, 2))
    middle = _middle(list(graph.keyframe_keys(set())))
    ordinary = [_ordinary(graph, states, u) for u in range(users)]
    weights = [np.where(o, 1.0, w) for o, w in zip(ordinary, em_weights.step_weight, strict=True)]
    counted, whose = gtsam.NonlinearFactorGraph(), []
    for u in graph.active_users:
        of_user = gtsam.NonlinearFactorGraph()
        graph.add_steps(of_user, u, weights[u])
        # Each step is two factors: in the plane, and in height.
        for n in np.flatnonzero(ordinary[u]).tolist():
            if all(key in middle for key in of_user.at(2 * n).keys()):  # noqa: SIM118 - gtsam's, no mapping
                counted.push_back(of_user.at(2 * n))
                whose.append(u)
    if not whose:
        return np.ones((users, 2))

    columns, values = [*middle, *graph.shared_keys()], graph.values(states)
    rows, wanted = _dense(counted.linearize(values), columns)
    linear = graph.factors(states.anchor_poses, replace(em_weights, step_weight=weights)).linearize(values)
    others = keys.ordering(list(graph.keyframe_keys(set(columns))))
    if others.size():
        _, linear = linear.eliminatePartialSequential(others)
    information, slope = linear.hessian(keys.ordering(columns))
    return most_likely_noise(
        information - rows.T @ rows,
        slope - rows.T @ wanted,
        rows.reshape(len(whose), 3, -1),
        wanted.reshape(len(whose), 3),
        np.array(whose, dtype=np.int32),
        users,
        graph.parameters.slam.drift_weight,
    )


def most_likely_noise(
    information: Array, slope: Array, rows: Array, wanted: Array, whose: Indices, users: int, weight: float
) -> Array:
    """(k, 2): the most likely factor on each user's step sigmas in position and heading.

    All factors but the steps cost 0.5 d' information d - slope' d in the variables d; step n has the whitened residual
    rows[n] d - wanted[n] (3,) in x, y and heading. The prior counts as `weight` steps whose factor is 1.
    """
    noise = np.ones((users, 2))
    count = np.bincount(whose, minlength=users)
    flat = rows.reshape(-1, rows.shape[-1])
    for _ in range(_ROUNDS):
        precision = noise[whose][:, _OF_ROW].ravel() ** -2
        covariance = np.linalg.inv(information + flat.T @ (flat * precision[:, None]))
        step = covariance @ (slope + flat.T @ (precision * wanted.ravel()))
        square = (flat @ step - wanted.ravel()) ** 2 + ((flat @ covariance) * flat).sum(axis=1)
        x, y, heading = (np.bincount(whose, s, users) for s in square.reshape(-1, 3).T)
        noise[:, PLACE] = np.sqrt((2.0 * weight + x + y) / (2.0 * (weight + count)))
        noise[:, HEADING] = np.sqrt((weight + heading) / (weight + count))
    return noise


def _ordinary(graph: PoseGraph, states: States, user: int) -> Array:
    """(m - 1,) whether a step is SLAM's own: neither rebuilt nor a slip."""
    frames = graph.keyframes[user]
    squared_error = (steps(states.keyframe_poses[user], frames) ** 2).sum(axis=1)
    return np.asarray(~frames.rebuilt & (squared_error < graph.parameters.slam.slip_sigmas**2))


def _middle(of_keyframes: list[int]) -> dict[int, None]:
    """Keys of the middle `_MOST_KEYFRAMES` keyframes; `of_keyframes` has two a keyframe, by time."""
    excess = max(len(of_keyframes) // 2 - _MOST_KEYFRAMES, 0)
    first = 2 * (excess // 2)
    return dict.fromkeys(of_keyframes[first : first + 2 * _MOST_KEYFRAMES])


def _dense(linear: gtsam.GaussianFactorGraph, columns: list[int]) -> tuple[Array, Array]:
    """The Jacobian by all `columns`, and the right-hand side; gtsam leaves out keys that no factor has."""
    present = linear.keys()
    known = [key for key in columns if present.count(key)]
    jacobian, wanted = linear.jacobian(keys.ordering(known))
    spans = keys.rows(columns)
    at = np.concatenate(
        [np.arange(s.start, s.stop) for key, s in zip(columns, spans, strict=True) if key in set(known)]
    )
    out = np.zeros((len(jacobian), spans[-1].stop))
    out[:, at] = jacobian
    return out, np.asarray(wanted)
