"""Ranges as datagrams carry them."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from synchronizar.io.datagrams import RANGE, SIGHT_UNKNOWN, UNKNOWN_CLOCK, UNKNOWN_POWER, UNKNOWN_SIGMA


def some_ranges(peer: ArrayLike, distance_mm: ArrayLike, **known: ArrayLike) -> NDArray[np.void]:
    """(n,) of RANGE, measured by modules, of which nothing is known but what is given by its field's name."""
    unknown: dict[str, ArrayLike] = {
        "clock_ppb": UNKNOWN_CLOCK,
        "sigma_mm": UNKNOWN_SIGMA,
        "rx_power_cdbm": UNKNOWN_POWER,
        "fp_power_cdbm": UNKNOWN_POWER,
        "sight": SIGHT_UNKNOWN,
    }
    ranges = np.zeros(np.broadcast_shapes(np.shape(peer), np.shape(distance_mm)), RANGE)
    for name, column in (unknown | {"peer": peer, "distance_mm": distance_mm} | known).items():
        ranges[name] = column
    return ranges
