"""Residual statistics of a user: share of rejected ranges, and covariance inflation by systematic residuals."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.geometry import apply_frames
from synchronizar.preprocessing.range_measurements import RangeMeasurements


class ResidualStatistics(NamedTuple):
    """How a user's ranges fit the solution."""

    inflation: float
    """Factor on its covariance, at least 1: above 1 where residuals are no independent noise (drift, a wrong clock)."""
    rejected: float
    """Share of its ranges that are more likely NLOS or too short than line-of-sight."""


def residual_statistics(
    measurements: RangeMeasurements,
    frames: Array,
    residual: Array,
    weight: Array,
    inlier_probability: Array,
    user: int,
    pieces: int,
) -> ResidualStatistics:
    """Residual statistics of one user at frames (k, 4) x, y, z (m), yaw (rad).

    `residual` (n,) m, measured minus predicted; `weight` (n,) 1/m^2; `inlier_probability` (n,). The inflation is that
    of a sandwich estimator with clusters (Liang and Zeger 1986): scores g = J' w r are summed over clusters, the ranges
    of one pair in one of `pieces` equal parts of the recording. If residuals are independent with variance 1 / w, the
    g have the total covariance H = J' w J, and f = sum g' H^-1 g / rank(H) is 1 on average. f counts only as far as it
    exceeds 1 by more than two of its standard deviations.
    """
    rows = np.flatnonzero((measurements.i == user) | (measurements.j == user))
    s = measurements[rows.astype(np.int32)]
    is_i = (s.i == user)[:, None]
    q_i, q_j = apply_frames(frames[s.i], s.p_i), apply_frames(frames[s.j], s.p_j)
    baseline = np.where(is_i, q_i - q_j, q_j - q_i)
    direction = baseline / np.maximum(np.linalg.norm(baseline, axis=1), 1e-9)[:, None]
    arm = np.where(is_i, q_i, q_j) - frames[user, :3]
    jacobian = np.column_stack([direction, direction[:, 1] * arm[:, 0] - direction[:, 0] * arm[:, 1]])
    w = weight[rows]
    information = (jacobian * w[:, None]).T @ jacobian
    values, vectors = np.linalg.eigh(information)
    observed = values > 1e-9 * max(values[-1], 1e-300)
    rejected = float((inlier_probability[rows] < 0.5).mean())
    if not observed.any():
        return ResidualStatistics(1.0, rejected)

    span = max(float(np.ptp(measurements.t)), 1e-9)
    piece = np.minimum((s.t - measurements.t.min()) / span * pieces, pieces - 1).astype(int)
    other = np.where(s.i == user, s.j, s.i)
    cluster, which = np.unique(other * pieces + piece, return_inverse=True)
    scores = np.zeros((len(cluster), 4))
    np.add.at(scores, which, jacobian * (w * residual[rows])[:, None])
    rank = int(observed.sum())
    f = float((((scores @ vectors[:, observed]) ** 2) / values[observed]).sum() / rank)
    by_chance = 1.0 + 2.0 * np.sqrt(2.0 / (rank * len(cluster)))
    return ResidualStatistics(max(1.0, f / by_chance), rejected)
