"""Where SLAM re-localised."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Jump:
    """Where SLAM's pose moved and the device did not."""

    t: float
    """s, own stamp of the first pose after it."""
    pose: int
    """Index of that pose."""
    distance: float
    """m: how far the position jumped, beyond what its neighbours predict."""
    turn: float
    """rad: by how much SLAM's heading did, about the vertical."""
    tilt: float
    """rad: by how much its vertical did; 0 where that is within the noise of attitudes."""
