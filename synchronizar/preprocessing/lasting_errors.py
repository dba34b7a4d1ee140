"""Errors of ranges that last: of each pair of users in each slot of time, correlated with the slot before.

Reflections, antennas and bodies make a pair's ranges too long or too short for seconds. Such an error is a
first-order autoregression over slots, which is the Ornstein-Uhlenbeck process seen at times: its correlation falls as
exp(-dt / T), T = `ranges.multipath_duration`. After a gap longer than T it is another one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from synchronizar.arrays import Array, Indices, freeze_arrays
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import RangeMeasurements


@dataclass(frozen=True)
class LastingErrors:
    """Which of v lasting errors each of n ranges has, and which of them follow one another."""

    of_range: Indices
    """(n,)."""
    follows: Indices
    """(v,) the error before, or -1."""
    decay: Array
    """(v,) correlation with that one; 0 where there is none."""
    first_range: Indices
    """(v,) the first range that has it."""

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.follows)


def lasting_errors(measurements: RangeMeasurements, parameters: Parameters) -> LastingErrors:
    """The lasting errors of ranges, which are sorted by pair and within a pair by time."""
    r, n = parameters.ranges, len(measurements)
    pair = np.repeat(np.arange(len(measurements.bounds) - 1), np.diff(measurements.bounds))
    slot = np.floor(measurements.t / r.multipath_slot)
    new = np.ones(n, dtype=bool)
    new[1:] = (np.diff(pair) > 0) | (np.diff(slot) > 0.0)
    first = np.flatnonzero(new)
    gap = np.diff(slot[first], prepend=-np.inf) * r.multipath_slot
    gap[1:][np.diff(pair[first]) > 0] = np.inf
    tied = gap <= r.multipath_duration
    return LastingErrors(
        (np.cumsum(new) - 1).astype(np.int32),
        np.where(tied, np.arange(len(first)) - 1, -1).astype(np.int32),
        np.where(tied, np.exp(-gap / r.multipath_duration), 0.0),
        first.astype(np.int32),
    )
