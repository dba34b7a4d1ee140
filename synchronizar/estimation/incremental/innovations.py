"""Residuals of ranges before they were used."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from synchronizar.arrays import Array, Indices


class Innovations(NamedTuple):
    """n ranges before they were used."""

    t: Array
    """s."""
    i: Indices
    j: Indices
    whitened: Array
    """Predicted minus measured over what is expected, 1 sigma: positive where the range is too short."""
    away: Array
    """(n, 3) m: from j's antenna to i's, as predicted."""
    distance: Array
    """m: as measured, without what radios add."""
    sigma: Array
    """m, 1 sigma: what is expected, by how much the pair's ranges were off lately."""
    nlos_odds: Array
    """Prior odds of each by itself."""
    weight: Array
    """What such a range of the pair is worth."""

    def part(self, which: Any) -> Innovations:
        """Those selected by a mask, or in another order."""
        columns: Any = self
        return Innovations(*(column[which] for column in columns))

    @classmethod
    def none(cls) -> Innovations:
        """Not one."""
        zero = np.zeros(0)
        users = zero.astype(np.int32)
        return cls(zero, users, users, zero, np.zeros((0, 3)), zero, zero, zero, zero)
