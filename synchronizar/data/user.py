"""A device's settings: what a recording says of it besides its track."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from synchronizar.arrays import Array
from synchronizar.geometry import Up


@dataclass(frozen=True)
class User:
    """A device: its name, whether it is a static radio, its height prior, its antennas.

    Raises ValueError where its height_sigma is not positive.
    """

    name: str
    static: bool = False
    """Whether it is a static radio, which has no track and no heading."""
    height_sigma: float | None = None
    """m, 1 sigma: how far its origin may lie above or below the others'; None: the model's default."""
    antennas: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    """Lever arm (m) of each named antenna in the body frame; none: one antenna at the origin."""
    up: Up = "z"
    """Vertical axis of its own track file; in memory every track is z up."""

    @property
    def levers(self) -> Array:
        """(m + 1, 3) m: the antennas' lever arms in their order, then zeros for the antenna -1, the origin."""
        return np.array([*self.antennas.values(), (0.0, 0.0, 0.0)])

    def __post_init__(self) -> None:
        if self.height_sigma is not None and not 0.0 < self.height_sigma < float("inf"):
            raise ValueError("a height_sigma must be positive")
