"""Times of networks' clocks, and delays of datagrams."""

from __future__ import annotations

import numpy as np

from synchronizar.arrays import Array

LEAST_DELAY = 0.003


def delays(random: np.random.Generator, n: int) -> Array:
    """s: of Wi-Fi, as it may be."""
    return LEAST_DELAY + random.exponential(0.004, n) + (random.random(n) < 0.02) * random.uniform(0.0, 0.5, n)


def heard(t: Array, begin_ns: int, ppm: float, epoch: int) -> tuple[np.ndarray, np.ndarray]:
    """Epochs and times of a clock that is fast by `ppm`, at the true times t."""
    return np.full(len(t), epoch, dtype=np.uint32), begin_ns + np.round(t * (1.0 + 1e-6 * ppm) * 1e9).astype(np.int64)
