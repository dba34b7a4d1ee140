"""Residuals of ranges before they were used."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array, Indices, Mask

T, USER_I, USER_J, WHITENED, AWAY, DISTANCE, SIGMA, ODDS, WEIGHT = 0, 1, 2, 3, slice(4, 7), 7, 8, 9, 10
"""Columns of a table of innovations: s; both users; predicted minus measured over what is expected, 1 sigma, positive
where the range is too short; (3,) m from j's antenna to i's, as predicted; m as measured, without what radios add; m, 1
sigma that is expected, by how much the pair's ranges were off lately; prior odds of NLOS of each by itself; what such a
range of the pair is worth."""
COLUMNS = 11


class Innovations(NamedTuple):
    """n ranges before they were used."""

    rows: Array
    """(n, 11)."""

    @classmethod
    def none(cls) -> Innovations:
        """Not one."""
        return cls(np.zeros((0, COLUMNS)))

    @property
    def t(self) -> Array:
        """(n,) s."""
        return self.rows[:, T]

    @property
    def users(self) -> Indices:
        """(n, 2)."""
        return self.rows[:, USER_I : USER_J + 1].astype(np.int32)

    @property
    def whitened(self) -> Array:
        """(n,)."""
        return self.rows[:, WHITENED]

    def part(self, which: Mask) -> Innovations:
        """Those selected by a mask."""
        return Innovations(self.rows[which])
