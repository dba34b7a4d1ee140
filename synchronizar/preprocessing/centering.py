"""Frames about the middle of each user's walk instead of its SLAM origin, and back.

A walk may lie far from the origin of its own SLAM. There, an error in heading moves the walk as much as one in place,
and neither a prior on the frame's place nor a step of an optimiser means what it says. So everything is solved about
the middle m of the walk, p' = p - m, and the answer is told about the origin again:

    p_common = R p' + t'  =  R p + (t' - R m),   and about the reference's own origin + m_reference
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from synchronizar.arrays import Array
from synchronizar.preprocessing.range_measurements import RangeMeasurements


def centroids(measurements: RangeMeasurements, users: int) -> Array:
    """(k, 3) m: the mean place in the plane of each user's antennas in its own frame.

    0 in height, which has its own prior, and for users without samples.
    """
    ends = np.concatenate([measurements.i, measurements.j])
    places = np.concatenate([measurements.p_i, measurements.p_j])
    count = np.maximum(np.bincount(ends, minlength=users), 1)
    sums = [np.bincount(ends, weights=places[:, axis], minlength=users) for axis in (0, 1)]
    return np.column_stack([sums[0] / count, sums[1] / count, np.zeros(users)])


def centered(measurements: RangeMeasurements, middle: Array) -> RangeMeasurements:
    """The same samples about the users' middles (k, 3)."""
    return replace(
        measurements, p_i=measurements.p_i - middle[measurements.i], p_j=measurements.p_j - middle[measurements.j]
    )


def about_origins(frames: Array, middle: Array, reference: int) -> Array:
    """Frames (k, 4) x, y, z, yaw about the middles -> about the origins, the common one being the reference's own."""
    out = frames.copy()
    out[:, :2] += middle[reference, :2] - _turned(frames, middle)
    return out


def errors_about_origins(frames: Array, middle: Array) -> Array:
    """(k, 4, 4) derivatives of x, y, z, yaw about the origins by those about the middles."""
    out = np.tile(np.eye(4), (len(frames), 1, 1))
    turned = _turned(frames, middle)
    out[:, 0, 3], out[:, 1, 3] = turned[:, 1], -turned[:, 0]
    return out


def _turned(frames: Array, middle: Array) -> Array:
    c, s = np.cos(frames[:, 3]), np.sin(frames[:, 3])
    return np.column_stack([c * middle[:, 0] - s * middle[:, 1], s * middle[:, 0] + c * middle[:, 1]])
