"""Covariance inflation by systematic residuals."""

from __future__ import annotations

import numpy as np

from synchronizar.arrays import Array
from synchronizar.geometry import apply_frames
from synchronizar.preprocessing.range_measurements import RangeMeasurements


def inflations(measurements: RangeMeasurements, frames: Array, residual: Array, weight: Array, pieces: int) -> Array:
    """(k,) factor on each user's covariance, at least 1, at frames (k, 4) x, y, z (m), yaw (rad).

    Above 1 where residuals are no independent noise (drift, a wrong clock). `residual` (n,) m, measured minus
    predicted; `weight` (n,) 1/m^2. The inflation is that of a sandwich estimator with clusters (Liang and Zeger 1986):
    scores g = J' w r are summed over clusters, the ranges of one pair in one of `pieces` equal parts of the recording.
    If residuals are independent with variance 1 / w, the g have the total covariance H = J' w J, and
    f = sum g' H^-1 g / rank(H) is 1 on average. f counts only as far as it exceeds 1 by more than two of its standard
    deviations.
    """
    k, s = len(frames), measurements
    out = np.ones(k)
    if not len(s):
        return out
    # Each range is looked at from both of its ends.
    user, other = np.concatenate([s.i, s.j]), np.concatenate([s.j, s.i])
    q_i, q_j = apply_frames(frames[s.i], s.p_i), apply_frames(frames[s.j], s.p_j)
    direction = (q_i - q_j) / np.maximum(np.linalg.norm(q_i - q_j, axis=1), 1e-9)[:, None]
    direction = np.concatenate([direction, -direction])
    arm = np.concatenate([q_i, q_j]) - frames[user, :3]
    jacobian = np.stack([*direction.T, direction[:, 1] * arm[:, 0] - direction[:, 0] * arm[:, 1]])
    w = np.tile(weight, 2)
    information = np.zeros((k, 4, 4))
    for a in range(4):
        for b in range(a, 4):
            information[:, a, b] = np.bincount(user, w * jacobian[a] * jacobian[b], k)
            information[:, b, a] = information[:, a, b]
    span = max(float(np.ptp(s.t)), 1e-9)
    piece = np.tile(np.minimum((s.t - s.t.min()) / span * pieces, pieces - 1).astype(int), 2)
    cluster = (user * k + other) * pieces + piece
    count = k * k * pieces
    scored = w * np.tile(residual, 2)
    scores = np.stack([np.bincount(cluster, scored * row, count) for row in jacobian], axis=1).reshape(k, -1, 4)
    clusters = (np.bincount(cluster, minlength=count) > 0).reshape(k, -1).sum(axis=1)
    values, vectors = np.linalg.eigh(information)
    observed = values > 1e-9 * np.maximum(values[:, -1:], 1e-300)
    squares = ((scores @ vectors) ** 2).sum(axis=1)
    rank = observed.sum(axis=1)
    seen = rank > 0
    f = np.divide(squares, values, out=np.zeros((k, 4)), where=observed).sum(axis=1)[seen] / rank[seen]
    by_chance = 1.0 + 2.0 * np.sqrt(2.0 / (rank[seen] * clusters[seen]))
    out[seen] = np.maximum(1.0, f / by_chance)
    return out
