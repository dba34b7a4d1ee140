"""What can be said of each user's placement, and how sure it is."""

from __future__ import annotations

from typing import NamedTuple

import gtsam
import numpy as np

from synchronizar.arrays import Array
from synchronizar.batch import Settled, moved
from synchronizar.graph import RigidGraph, keys_of
from synchronizar.model import Model
from synchronizar.registration import State


class Verdict(NamedTuple):
    """One user's."""

    state: State
    reason: str
    covariance: Array
    unseen_direction: Array | None = None
    prior_dominated: tuple[str, ...] = ()


def verdicts(graph: RigidGraph, settled: list[Settled], corners: Array, model: Model) -> dict[int, Verdict]:
    """The verdict on each placed user but the reference, at the best of the settled placements."""
    best = settled[0]
    likely = [s for s in settled[1:] if s.cost - best.cost < model.cost_excluded]
    away = np.zeros(len(graph.users))
    for s in likely:
        away = np.fmax(away, moved(best.frames, s.frames, corners))
    out = {}
    for u, covariance in covariances(graph, best).items():
        if away[u] > model.largest_error:
            out[u] = Verdict(State.AMBIGUOUS, f"{1 + len(likely)} placements explain the ranges", covariance)
            continue
        spread, direction = _largest_spread(covariance, best.frames[u, 3], corners[u])
        yaw_sigma = float(np.sqrt(covariance[3, 3]))
        quantile = np.sqrt(-2.0 * np.log(model.wrong_share))
        static = graph.users[u].static
        if spread * quantile > model.largest_error:
            out[u] = Verdict(State.UNOBSERVABLE, f"placed to {spread:.2f} m only (1 sigma)", covariance, direction)
        elif not static and yaw_sigma * quantile > model.largest_yaw_error:
            out[u] = Verdict(State.UNOBSERVABLE, f"heading known to {yaw_sigma:.2f} rad only (1 sigma)", covariance, direction)
        else:
            out[u] = Verdict(State.REGISTERED, f"placed to {spread:.2f} m (1 sigma)", covariance)
    return out


def covariances(graph: RigidGraph, settled: Settled) -> dict[int, Array]:
    """(4, 4) of additive errors in x, y, z (m, common axes) and yaw (rad), for each free user; from the joint marginals."""
    marginals = gtsam.Marginals(graph.factors(), settled.values)
    out = {}
    for u in graph.free:
        keys = keys_of(u)
        joint = marginals.jointMarginalCovariance(keys.keys())
        body = np.block([[joint.at(a, b) for b in keys.keys()] for a in keys.keys()])
        # Pose2's tangent is (v in its own axes, yaw), then the height: turned into the common axes and put in order.
        c, s = np.cos(settled.frames[u, 3]), np.sin(settled.frames[u, 3])
        common_from_body = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 0, 1], [0, 0, 1, 0]])
        out[u] = common_from_body @ body @ common_from_body.T
    return out


def _largest_spread(covariance: Array, yaw: float, corners: Array) -> tuple[float, Array]:
    """The largest 1 sigma (m) of the place of any of the user's corners (c, 3), and the frame's error that makes it."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = c * corners[:, 0] - s * corners[:, 1], s * corners[:, 0] + c * corners[:, 1]
    jacobians = np.zeros((len(corners), 3, 4))
    jacobians[:, :3, :3] = np.eye(3)
    jacobians[:, 0, 3], jacobians[:, 1, 3] = -y, x
    variances, directions = np.linalg.eigh(jacobians @ covariance @ jacobians.transpose(0, 2, 1))
    worst = int(np.argmax(variances[:, -1]))
    error = covariance @ jacobians[worst].T @ directions[worst, :, -1]
    return float(np.sqrt(variances[worst, -1])), error / np.linalg.norm(error)
