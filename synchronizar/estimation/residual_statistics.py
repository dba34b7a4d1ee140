"""Covariance inflation by systematic residuals."""

from __future__ import annotations

from synchronizar._core import residual_inflations
from synchronizar.arrays import Array
from synchronizar.preprocessing.range_measurements import RangeMeasurements, pair_bounds


def inflations(measurements: RangeMeasurements, frames: Array, residual: Array, weight: Array, pieces: int) -> Array:
    """(k,) factor on each user's covariance, at least 1, at frames (k, 4) x, y, z (m), yaw (rad).

    Above 1 where residuals are no independent noise (drift, a wrong clock). `residual` (n,) m, measured minus
    predicted; `weight` (n,) 1/m^2. The inflation is that of a sandwich estimator with clusters (Liang and Zeger 1986):
    scores g = J' w r are summed over clusters, the ranges of one pair in one of `pieces` equal parts of the recording.
    If residuals are independent with variance 1 / w, the g have the total covariance H = J' w J, and
    f = sum g' H^-1 g / rank(H) is 1 on average. f counts only as far as it exceeds 1 by more than two of its standard
    deviations.
    """
    bounds = pair_bounds(measurements)
    begin = bounds[:-1]
    return residual_inflations(
        bounds,
        measurements.i[begin],
        measurements.j[begin],
        measurements.t,
        measurements.p_i,
        measurements.p_j,
        frames,
        residual,
        weight,
        pieces,
    )
