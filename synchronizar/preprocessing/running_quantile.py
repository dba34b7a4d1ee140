"""Quantiles of ever more numbers."""

from __future__ import annotations

import numpy as np

from synchronizar.arrays import Array

_LEAST, _DECADES, _PER_DECADE = 1e-9, 15, 64
_BINS = _DECADES * _PER_DECADE + 1


class RunningQuantile:
    """Quantiles of positive numbers, all that were ever added, to 4 %: counts in bins of equal ratio."""

    def __init__(self) -> None:
        self.counts = np.zeros(_BINS, dtype=np.int64)
        """Numbers in each bin; the first has all below 1e-9."""
        self.count = 0

    def add(self, values: Array) -> None:
        """(n,) more."""
        bins = np.ceil(_PER_DECADE * np.log10(np.maximum(values, _LEAST) / _LEAST)).astype(np.int64)
        np.add.at(self.counts, np.minimum(bins, _BINS - 1), 1)
        self.count += len(values)

    def quantile(self, share: float) -> float:
        """What this share of them does not exceed; 0 where there are none."""
        if not self.count:
            return 0.0
        rank = share * (self.count - 1)
        below = np.cumsum(self.counts)
        chosen = int(np.searchsorted(below, rank, side="right"))
        if chosen == 0:
            return 0.0
        inside = (rank - below[chosen - 1] + 0.5) / self.counts[chosen]
        return float(_LEAST * 10.0 ** ((chosen - 1 + min(inside, 1.0)) / _PER_DECADE))
