"""Ranges: measured distances between devices, as columns."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from synchronizar.arrays import Array, Indices, Mask, freeze_arrays

SOURCES = ("module", "overheard", "android", "apple", "simulated")
"""Who measured a range: a UWB module itself, or from frames of others that it overheard; a phone; the simulation."""


@dataclass(frozen=True)
class Ranges:
    """n measured distances as columns, stamped by the one range clock.

    Raises ValueError where the columns' lengths disagree, a distance is from a device to itself, a time is not finite,
    a sigma not positive, or a source not one of SOURCES.
    """

    t: Array
    """(n,) s."""
    a: Indices
    """(n,) index of the one device in `Recording.users`."""
    b: Indices
    """(n,) index of the other."""
    distance: Array
    """(n,) m; may be slightly negative. A value that is not finite is kept and never usable."""
    sigma: Array
    """(n,) m, 1 sigma; NaN where the recording does not say."""
    antenna_a: Indices
    """(n,) index of the antenna of `a`, in the order of `User.antennas`; -1: its origin."""
    antenna_b: Indices
    """(n,) the same of `b`."""
    rx_power: Array
    """(n,) dBm: total received power; NaN where unknown."""
    fp_power: Array
    """(n,) dBm: received power of the first path; NaN where unknown."""
    nlos: Array
    """(n,) 1 where the radio itself reports NLOS, 0 where line of sight; NaN where it does not say."""
    source: Indices
    """(n,) index in SOURCES; -1 where unknown."""

    def __post_init__(self) -> None:
        n = len(self.t)
        for f in fields(self):
            if getattr(self, f.name).shape != (n,):
                raise ValueError(f"the column {f.name} must have shape ({n},)")
        if (self.a == self.b).any():
            raise ValueError("a device cannot measure the distance to itself")
        if not np.isfinite(self.t).all():
            raise ValueError("a range's time must be finite")
        if not ((self.source >= -1) & (self.source < len(SOURCES))).all():
            raise ValueError("a range's source must be one of SOURCES, or -1 where it is not known")
        if not (np.isnan(self.sigma) | ((self.sigma > 0.0) & np.isfinite(self.sigma))).all():
            raise ValueError("a range's sigma must be positive, or NaN where it is not known")
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.t)

    def select(self, mask: Mask | NDArray[np.intp]) -> Ranges:
        """The ranges that a boolean mask or an index array picks."""
        return Ranges(**{f.name: getattr(self, f.name)[mask] for f in fields(self)})

    @classmethod
    def of(
        cls,
        t: Array,
        a: Indices,
        b: Indices,
        distance: Array,
        **optional: Array | Indices,
    ) -> Ranges:
        """Ranges from the columns that are known; the others are NaN, sources -1, antennas the origin."""
        unknown: dict[str, Array | Indices] = {
            name: np.full(len(t), np.nan) for name in ("sigma", "rx_power", "fp_power", "nlos")
        }
        unknown |= {name: np.full(len(t), -1, dtype=np.int32) for name in ("antenna_a", "antenna_b", "source")}
        return cls(t, a, b, distance, **(unknown | optional))  # type: ignore[arg-type]
