"""Range weights: each range counts as so many independent ones, since range errors are correlated in time.

A range's error is part noise and part reflections, antennas and bodies, which stay for seconds. The mean of n ranges
within the correlation time, with correlation rho, does not have the variance s^2 / n but about s^2 (1 + rho (n - 1)) /
n, so each range counts as 1 / (1 + rho (n - 1)) independent ones. That is a composite likelihood with adjusted size
(Varin, Reid and Firth, Statistica Sinica 21, 2011, 5-42); rho is measured on the residuals. The weight is not a robust
one: that comes from the loss.
"""

from __future__ import annotations

import numpy as np

from synchronizar.arrays import Array, Indices
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import RangeMeasurements, pairs


def neighbour_counts(measurements: RangeMeasurements, parameters: Parameters) -> Array:
    """(n,) number of ranges of the same pair within `multipath_duration` before or after each, itself included."""
    out = np.ones(len(measurements))
    half = parameters.ranges.multipath_duration
    for pair in pairs(measurements):
        t = measurements.t[pair.measurements]
        out[pair.measurements] = np.searchsorted(t, t + half, side="right") - np.searchsorted(t, t - half, side="left")
    return out


def prior_range_weights(measurements: RangeMeasurements, parameters: Parameters) -> Array:
    """(n,) initial range weights, with the prior correlation: 1 / (1 + rho (n - 1))."""
    return np.asarray(
        1.0 / (1.0 + parameters.ranges.multipath_correlation * (neighbour_counts(measurements, parameters) - 1.0))
    )


def measured_range_weights(
    measurements: RangeMeasurements,
    model_sigma: Array,
    whitened: Array,
    weight: Array,
    links: Indices,
    parameters: Parameters,
) -> Array:
    """(n,) range weights measured on residuals: each range counts as so many independent ones of `model_sigma` (m).

    `whitened` (n,) are residuals over model_sigma, `weight` (n,) the loss's weights. The variance of errors is measured
    for each pair, shrunk towards that of all pairs, and is at least the recording's own sigma squared. Their
    correlation is measured over all pairs together, on neighbours: ranges between the same antennas (numbered by
    `links` (n,)) that are closer in time than `multipath_neighbour_gap`. Where a share r of a pair's ranges is NLOS,
    some of these pass for line-of-sight and the reverse, so the weights are divided by 1 + c r (1 - r) with
    c = `nlos_confusion`.
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
    # A correlation that may be chance counts as none (positive-part James-Stein shrinkage).
    by_chance = parameters.ranges.multipath_chance / np.sqrt(weight_of_all)
    correlation = min(
        max(correlation - by_chance**2 / max(correlation, by_chance), 0.0),
        parameters.ranges.multipath_largest_correlation,
    )
    independent = 1.0 / (1.0 + correlation * (neighbour_counts(measurements, parameters) - 1.0))

    nominal = (measurements.sigma / model_sigma) ** 2
    of_all = sum(squares) / max(sum(weights), 1e-9)
    nlos_share_of_all = float((weight < 0.5).mean()) if len(weight) else 0.0
    variance = np.empty(len(measurements))
    for pair, square, count in zip(pairs(measurements), squares, weights, strict=True):
        k = pair.measurements
        nlos_share = (parameters.ranges.pair_weight * nlos_share_of_all + float((weight[k] < 0.5).sum())) / (
            parameters.ranges.pair_weight + k.stop - k.start
        )
        variance[k] = np.maximum(
            (parameters.ranges.pair_weight * of_all + square) / (parameters.ranges.pair_weight + count), nominal[k]
        )
        variance[k] *= 1.0 + parameters.ranges.nlos_confusion * nlos_share * (1.0 - nlos_share)
    return np.asarray(independent / variance)
