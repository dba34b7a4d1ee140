"""Range weights: each range counts as so many independent ones, since range errors are correlated in time.

A range's error is part noise and part reflections, antennas and bodies, which stay for seconds. The mean of n ranges
within the correlation time, with correlation rho, does not have the variance s^2 / n but about s^2 (1 + rho (n - 1)) /
n, so each range counts as 1 / (1 + rho (n - 1)) independent ones. That is a composite likelihood with adjusted size
(Varin, Reid and Firth, Statistica Sinica 21, 2011, 5-42); rho is measured on the residuals. The weight is not a robust
one: that comes from the loss.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from synchronizar._core import neighbour_counts as core_neighbour_counts
from synchronizar._core import neighbour_sums
from synchronizar.arrays import Array, Indices
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import RangeMeasurements, pair_bounds


def neighbour_counts(measurements: RangeMeasurements, parameters: Parameters) -> Array:
    """(n,) number of ranges of the same pair within `multipath_duration` before or after each, itself included."""
    return core_neighbour_counts(pair_bounds(measurements), measurements.t, parameters.ranges.multipath_duration)


def prior_range_weights(measurements: RangeMeasurements, parameters: Parameters) -> Array:
    """(n,) initial range weights, with the prior correlation: 1 / (1 + rho (n - 1))."""
    return np.asarray(
        1.0 / (1.0 + parameters.ranges.multipath_correlation * (neighbour_counts(measurements, parameters) - 1.0))
    )


class Correlation(NamedTuple):
    """How alike the errors of neighbouring ranges are, and what that makes of each range."""

    neighbours: float
    """Correlation of neighbours; 0 where what there is may be chance."""
    independent: Array
    """(n,) the number of independent ranges that each counts as."""
    squares: Array
    """(p,) sum of the squared errors of each pair, ..."""
    weights: Array
    """(p,) ... and of their weights."""


def measured_correlation(
    measurements: RangeMeasurements,
    whitened: Array,
    weight: Array,
    links: Indices,
    reach: float,
    parameters: Parameters,
) -> Correlation:
    """The correlation of residuals `whitened` (n,) over 1 sigma, whose weights by the loss are `weight` (n,).

    Measured over all pairs together, on neighbours: ranges between the same antennas (numbered by `links` (n,)) that
    are closer in time than `multipath_neighbour_gap`. Errors last for `reach` s.
    """
    r = parameters.ranges
    squares, weights, product, both = neighbour_sums(
        pair_bounds(measurements),
        measurements.t,
        links,
        weight * whitened,
        weight,
        r.multipath_neighbour_gap,
        r.multipath_most_neighbours,
    )
    weight_of_all = r.multipath_weight + both
    correlation = (r.multipath_weight * r.multipath_correlation + product) / weight_of_all
    # A correlation that may be chance counts as none (positive-part James-Stein shrinkage).
    by_chance = r.multipath_chance / np.sqrt(weight_of_all)
    correlation = min(
        max(correlation - by_chance**2 / max(correlation, by_chance), 0.0), r.multipath_largest_correlation
    )
    counts = core_neighbour_counts(pair_bounds(measurements), measurements.t, reach)
    return Correlation(correlation, 1.0 / (1.0 + correlation * (counts - 1.0)), squares, weights)


def measured_range_weights(
    measurements: RangeMeasurements,
    nominal: Array,
    weight: Array,
    correlation: Correlation,
    parameters: Parameters,
) -> Array:
    """(n,) range weights measured on residuals: each range counts as so many independent ones of the model's 1 sigma.

    `weight` (n,) are the loss's weights, `nominal` (n,) is what noise is said to be over that sigma. The variance of
    errors is measured for each pair, shrunk towards that of all pairs, and is at least nominal^2. Where a share r of a
    pair's ranges is NLOS, some of these pass for line-of-sight and the reverse, so the weights are divided by
    1 + c r (1 - r) with c = `nlos_confusion`.
    """
    r, bounds = parameters.ranges, pair_bounds(measurements)
    count, late = np.diff(bounds), weight < 0.5
    late_before = np.concatenate([[0], np.cumsum(late)])
    nlos_share_of_all = float(late.mean()) if len(weight) else 0.0
    nlos_share = (r.pair_weight * nlos_share_of_all + np.diff(late_before[bounds])) / (r.pair_weight + count)
    of_all = float(correlation.squares.sum()) / max(float(correlation.weights.sum()), 1e-9)
    of_pair = _variance_of_pairs(of_all, correlation.squares, correlation.weights, parameters)
    variance = np.maximum(np.repeat(of_pair, count), nominal**2)
    confused = np.repeat(1.0 + r.nlos_confusion * nlos_share * (1.0 - nlos_share), count)
    return np.asarray(correlation.independent / (variance * confused))


def measured_sizes(bounds: Indices, nominal: Array, whitened: Array, weight: Array, parameters: Parameters) -> Array:
    """(n,) how large line-of-sight errors are, over the model's 1 sigma: at least `nominal` (n,), at most 1.

    `bounds` are the first range of each pair, and the end; `whitened` (n,) residuals over the model's 1 sigma, `weight`
    (n,) the loss's weights. The model's reflections may not be there; where they are, residuals show it. Measured for
    each pair, shrunk towards all pairs, and these towards the model.
    """
    squares = np.add.reduceat((weight * whitened) ** 2, bounds[:-1])
    weights = np.add.reduceat(weight**2, bounds[:-1])
    prior = parameters.ranges.multipath_weight
    of_all = (prior + float(squares.sum())) / (prior + float(weights.sum()))
    of_pair = _variance_of_pairs(of_all, squares, weights, parameters)
    return np.clip(np.sqrt(np.repeat(of_pair, np.diff(bounds))), nominal, 1.0)


def _variance_of_pairs(of_all: float, squares: Array, weights: Array, parameters: Parameters) -> Array:
    """(p,) variance of each pair's errors from sums of squares and weights, shrunk towards that of all pairs."""
    worth = parameters.ranges.pair_weight
    return np.asarray((worth * of_all + squares) / (worth + weights))
