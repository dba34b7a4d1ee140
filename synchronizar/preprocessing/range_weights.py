"""What a range is worth: errors that hang together in time tell less than their number.

A range's error is part noise and part reflections, antennas and bodies, which stay for seconds. Of n ranges in the time
for which errors hang together, correlated by rho, the mean has not the variance s^2 / n but about
s^2 (1 + rho (n - 1)) / n, so each counts for 1 / (1 + rho (n - 1)) only. That is a composite likelihood (Varin, Reid
and Firth, Statistica Sinica 21, 2011, 5-42), whose size is put right; rho is measured on the residuals.
"""

from __future__ import annotations

import numpy as np

from synchronizar.arrays import Array, Indices
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import RangeMeasurements, pairs


def neighbour_counts(measurements: RangeMeasurements, parameters: Parameters) -> Array:
    """(n,) how many ranges of the same pair there are within `multipath_duration` to either side, itself included."""
    out = np.ones(len(measurements))
    half = parameters.ranges.multipath_duration
    for pair in pairs(measurements):
        t = measurements.t[pair.measurements]
        out[pair.measurements] = np.searchsorted(t, t + half, side="right") - np.searchsorted(t, t - half, side="left")
    return out


def prior_range_weights(measurements: RangeMeasurements, parameters: Parameters) -> Array:
    """(n,) as how many independent ranges each counts, before any residual is known."""
    return np.asarray(
        1.0 / (1.0 + parameters.ranges.multipath_correlation * (neighbour_counts(measurements, parameters) - 1.0))
    )


def measured_range_weights(
    measurements: RangeMeasurements,
    judged_sigma: Array,
    whitened: Array,
    weight: Array,
    links: Indices,
    parameters: Parameters,
) -> Array:
    """(n,) as how many independent ranges with an error of `judged_sigma` each counts.

    `whitened` (n,) are residuals over judged_sigma, `weight` (n,) what the loss gives them. How large errors are is
    measured pair by pair, and never taken for less than the recording's own sigma; how they hang together is measured
    on those that follow each other within `multipath_neighbours` between the same antennas (`links` (n,) numbers
    these), in all pairs together. Where a share r of them is late, some of these pass for honest and some that are
    honest do not: what is left is worth 1 / (1 + 4 r (1 - r)).
    """
    score = weight * whitened
    product = both = 0.0
    squares, weights = [], []
    for pair in pairs(measurements):
        k = pair.measurements
        order = np.lexsort((measurements.t[k], links[k]))
        t, link, s, w = measurements.t[k][order], links[k][order], score[k][order], weight[k][order]
        squares.append(float((s**2).sum()))
        weights.append(float((w**2).sum()))
        own = max(squares[-1] / max(weights[-1], 1e-9), 1e-9)
        for lag in range(1, min(parameters.ranges.multipath_most_neighbours, len(t))):
            near = (t[lag:] - t[:-lag] < parameters.ranges.multipath_neighbour_gap) & (link[lag:] == link[:-lag])
            product += float((s[lag:] * s[:-lag])[near].sum()) / own
            both += float((w[lag:] * w[:-lag])[near].sum())
    weight_of_all = parameters.ranges.multipath_weight + both
    correlation = (
        parameters.ranges.multipath_weight * parameters.ranges.multipath_correlation + product
    ) / weight_of_all
    # What chance alone might show is none (the positive part of James and Stein's shrinkage).
    by_chance = parameters.ranges.multipath_chance / np.sqrt(weight_of_all)
    correlation = min(
        max(correlation - by_chance**2 / max(correlation, by_chance), 0.0),
        parameters.ranges.multipath_largest_correlation,
    )
    independent = 1.0 / (1.0 + correlation * (neighbour_counts(measurements, parameters) - 1.0))

    nominal = (measurements.sigma / judged_sigma) ** 2
    of_all = sum(squares) / max(sum(weights), 1e-9)
    late_of_all = float((weight < 0.5).mean()) if len(weight) else 0.0
    variance = np.empty(len(measurements))
    for pair, square, count in zip(pairs(measurements), squares, weights, strict=True):
        k = pair.measurements
        late = (parameters.ranges.pair_weight * late_of_all + float((weight[k] < 0.5).sum())) / (
            parameters.ranges.pair_weight + k.stop - k.start
        )
        variance[k] = np.maximum(
            (parameters.ranges.pair_weight * of_all + square) / (parameters.ranges.pair_weight + count), nominal[k]
        )
        variance[k] *= 1.0 + parameters.ranges.nlos_confusion * late * (1.0 - late)
    return np.asarray(independent / variance)
