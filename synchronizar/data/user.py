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

    Raises ValueError where a sigma is not positive, or one that moves has a position.
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
    position: tuple[float, float, float] | None = None
    """m, z up, in the survey's frame: where a static radio was surveyed to be; None: it was not."""
    position_sigma: float | None = None
    """m, 1 sigma of that on each axis; None: the model's default; 0 of the survey's own origin alone."""
    range_bias: float | None = None
    """m: what its radio is known to add to a range; None: it is not known."""
    range_bias_sigma: float | None = None
    """m, 1 sigma of that; None: the model's default where `range_bias` is given."""

    @property
    def is_survey_origin(self) -> bool:
        """Whether it is no device, but the origin of the survey's frame."""
        return self.position_sigma == 0.0

    @property
    def levers(self) -> Array:
        """(m + 1, 3) m: the antennas' lever arms in their order, then zeros for the antenna -1, the origin."""
        return np.array([*self.antennas.values(), (0.0, 0.0, 0.0)])

    def __post_init__(self) -> None:
        if self.height_sigma is not None and not 0.0 < self.height_sigma < float("inf"):
            raise ValueError("a height_sigma must be positive")
        if self.position is not None and not self.static:
            raise ValueError("only a static radio has a position")
        if self.position is None and self.position_sigma is not None:
            raise ValueError("a position_sigma needs a position")
        if self.position_sigma is not None and not 0.0 <= self.position_sigma < float("inf"):
            raise ValueError("a position_sigma must be positive")
        if self.range_bias_sigma is not None and not 0.0 < self.range_bias_sigma < float("inf"):
            raise ValueError("a range_bias_sigma must be positive")
