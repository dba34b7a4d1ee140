"""Jumps of SLAM: re-localisations."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Jump:
    """A step in which SLAM's pose moved and the device did not."""

    t: float
    """s, own clock: stamp of the first pose after it."""
    pose: int
    """Index of that pose, among those of its track that are used."""
    distance: float
    """m: how far the position jumped, beyond the motion that neighbouring steps predict."""
    turn: float
    """rad: how far SLAM's heading jumped, about the vertical."""
    tilt: float
    """rad: how far SLAM's vertical jumped; 0 where that is within the noise of attitudes."""
