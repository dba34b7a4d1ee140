"""Frames about the centroid of each user's walk instead of its SLAM origin, and back.

A walk may lie far from its SLAM origin. Then an error in yaw moves the walk as much as one in position, and priors and
optimiser steps on the frame's position no longer describe that of the walk. So frames are solved about the centroid m
of the walk, p' = p - m, and the result is transformed back to the origin:

    p_common = R p' + t'  =  R p + (t' - R m),   and about the reference's own origin + m_reference
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from synchronizar.arrays import Array
from synchronizar.preprocessing.range_measurements import RangeMeasurements


def centroids(measurements: RangeMeasurements, users: int) -> Array:
    """(k, 3) m: horizontal centroid of each user's antennas in its own frame.

    0 in height, which has its own prior, and for users without ranges.
    """
    ends = np.concatenate([measurements.i, measurements.j])
    places = np.concatenate([measurements.p_i, measurements.p_j])
    count = np.maximum(np.bincount(ends, minlength=users), 1)
    sums = [np.bincount(ends, weights=places[:, axis], minlength=users) for axis in (0, 1)]
    return np.column_stack([sums[0] / count, sums[1] / count, np.zeros(users)])


def centered(measurements: RangeMeasurements, middle: Array) -> RangeMeasurements:
    """The same ranges, antenna positions about the users' centroids `middle` (k, 3) m."""
    return replace(
        measurements, p_i=measurements.p_i - middle[measurements.i], p_j=measurements.p_j - middle[measurements.j]
    )


def about_origins(frames: Array, middle: Array, reference: int) -> Array:
    """Frames (k, 4) x, y, z, yaw about the users' origins from those about centroids; common is the reference's own."""
    out = frames.copy()
    out[:, :2] += middle[reference, :2] - _rotated(frames, middle)
    return out


def errors_about_origins(frames: Array, middle: Array) -> Array:
    """(k, 4, 4) derivatives of x, y, z, yaw about the origins by those about the centroids."""
    out = np.tile(np.eye(4), (len(frames), 1, 1))
    rotated = _rotated(frames, middle)
    out[:, 0, 3], out[:, 1, 3] = rotated[:, 1], -rotated[:, 0]
    return out


def _rotated(frames: Array, middle: Array) -> Array:
    """(k, 2) m: R(yaw) m of each user."""
    c, s = np.cos(frames[:, 3]), np.sin(frames[:, 3])
    return np.column_stack([c * middle[:, 0] - s * middle[:, 1], s * middle[:, 0] + c * middle[:, 1]])
