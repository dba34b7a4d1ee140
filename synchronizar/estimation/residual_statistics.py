"""Whether residuals are the noise they are taken for: what SLAM that drifts or a wrong clock leaves behind is not."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.geometry import apply_frames
from synchronizar.preprocessing.range_measurements import RangeMeasurements


class ResidualStatistics(NamedTuple):
    """How a user's ranges fit a placement."""

    inflation: float
    """By how much its covariance is larger than noise alone would make it; 1 where noise explains the rest."""
    rejected: float
    """The share of its ranges that are taken for late or for garbage."""


def residual_statistics(
    measurements: RangeMeasurements,
    frames: Array,
    residual: Array,
    weight: Array,
    inlier_probability: Array,
    user: int,
    pieces: int,
) -> ResidualStatistics:
    """How the samples of one user fit frames (k, 4) x, y, z, yaw.

    `residual` (n,) m, measured minus predicted; `weight` (n,) 1/m^2; `inlier_probability` (n,). The inflation is that
    of a sandwich estimator with clusters (Liang and Zeger 1986): scores g = J' w r, summed over what one pair measured
    in one piece of the recording, have the covariance of the information H if residuals are independent and as large
    as they should be; f = sum |g|^2 in the metric of H, over its rank, is 1 then. Only what exceeds 1 by more than two
    of its standard deviations counts.
    """
    rows = np.flatnonzero((measurements.i == user) | (measurements.j == user))
    s = measurements[rows.astype(np.int32)]
    is_i = (s.i == user)[:, None]
    q_i, q_j = apply_frames(frames[s.i], s.p_i), apply_frames(frames[s.j], s.p_j)
    between = np.where(is_i, q_i - q_j, q_j - q_i)
    direction = between / np.maximum(np.linalg.norm(between, axis=1), 1e-9)[:, None]
    arm = np.where(is_i, q_i, q_j) - frames[user, :3]
    jacobian = np.column_stack([direction, direction[:, 1] * arm[:, 0] - direction[:, 0] * arm[:, 1]])
    w = weight[rows]
    information = (jacobian * w[:, None]).T @ jacobian
    values, vectors = np.linalg.eigh(information)
    seen = values > 1e-9 * max(values[-1], 1e-300)
    rejected = float((inlier_probability[rows] < 0.5).mean())
    if not seen.any():
        return ResidualStatistics(1.0, rejected)

    span = max(float(np.ptp(measurements.t)), 1e-9)
    piece = np.minimum((s.t - measurements.t.min()) / span * pieces, pieces - 1).astype(int)
    other = np.where(s.i == user, s.j, s.i)
    cluster, which = np.unique(other * pieces + piece, return_inverse=True)
    scores = np.zeros((len(cluster), 4))
    np.add.at(scores, which, jacobian * (w * residual[rows])[:, None])
    rank = int(seen.sum())
    f = float((((scores @ vectors[:, seen]) ** 2) / values[seen]).sum() / rank)
    by_chance = 1.0 + 2.0 * np.sqrt(2.0 / (rank * len(cluster)))
    return ResidualStatistics(max(1.0, f / by_chance), rejected)
