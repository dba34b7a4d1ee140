"""What a recording says of a device besides its track."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from synchronizar.arrays import Array
from synchronizar.geometry import Up


@dataclass(frozen=True)
class User:
    """A device as it is described: its name, whether it is a radio that stands still, its antennas.

    Raises ValueError where its height_sigma is not positive.
    """

    name: str
    static: bool = False
    """Whether it is a radio that stands still: it has no track and no heading."""
    height_sigma: float | None = None
    """m, 1 sigma: how far its origin may lie above or below the others'; None leaves it to the model."""
    antennas: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    """Lever arm (m) of each named antenna in the body frame; none: one antenna at the origin."""
    up: Up = "z"
    """Which axis points up in its own track file; in memory every track is z up."""

    @property
    def levers(self) -> Array:
        """(m + 1, 3) m: the lever arms in their order; the row of zeros at the end is the one that -1 reads."""
        return np.array([*self.antennas.values(), (0.0, 0.0, 0.0)])

    def __post_init__(self) -> None:
        if self.height_sigma is not None and not 0.0 < self.height_sigma < float("inf"):
            raise ValueError("a height_sigma must be positive")
