"""Measurements about the centroid of each user's walk instead of its SLAM origin.

A walk may lie far from its SLAM origin. Then an error in yaw moves the walk as much as one in position, and priors and
optimiser steps on the frame's position no longer describe that of the walk. So frames are solved about the centroid m
of the walk, p' = p - m, and the result is transformed back to the origin (estimation/assessment.py):

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
