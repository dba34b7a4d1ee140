"""Tracks: timed poses of a device, and their interpolation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from synchronizar.arrays import Array, Mask, freeze_arrays


class Poses(NamedTuple):
    """Poses of a track at n times, interpolated."""

    position: Array
    """(n, 3) m, in the track's frame."""
    quat_xyzw: Array
    """(n, 4) attitudes: body axes into the track's frame."""
    valid: Mask
    """(n,) whether the track covers that time; elsewhere the pose is meaningless."""


@dataclass(frozen=True)
class Track:
    """n > 0 poses of one device in one frame, by the device's own clock; as SLAM gives them, the frame is its own.

    Raises ValueError where shapes disagree, a number is not finite, or the stamps do not rise strictly.
    """

    t: Array
    """(n,) s, strictly rising."""
    position: Array
    """(n, 3) m."""
    quat_xyzw: Array
    """(n, 4) unit quaternions: body axes into the track's frame."""

    def __post_init__(self) -> None:
        n = len(self.t)
        if n == 0 or self.t.shape != (n,) or self.position.shape != (n, 3) or self.quat_xyzw.shape != (n, 4):
            raise ValueError("a track needs t (n,), position (n, 3) and quat_xyzw (n, 4) with n > 0")
        if not all(np.isfinite(a).all() for a in (self.t, self.position, self.quat_xyzw)):
            raise ValueError("a track's numbers must be finite")
        if n > 1 and np.diff(self.t).min() <= 0.0:
            raise ValueError("a track's stamps must rise strictly")
        if np.abs(np.linalg.norm(self.quat_xyzw, axis=1) - 1.0).max() > 1e-6:
            raise ValueError("a track's quaternions must be of unit length")
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.t)

    def at(self, t: Array, max_gap: float) -> Poses:
        """The poses at times t (n,) s: positions interpolated linearly, attitudes along the shorter chord.

        A time before the first stamp, after the last, or inside a gap longer than `max_gap` s is not valid.
        """
        return interpolated(self.t, self.position, self.quat_xyzw, t, max_gap)

    def positions_at(self, t: Array, max_gap: float) -> tuple[Array, Mask]:
        """(n, 3) the positions alone, and (n,) which are valid."""
        between = _between(self.t, t, max_gap)
        return between.mix(self.position), between.valid

    def extent(self) -> float:
        """m: diagonal of the positions' bounding box; the two furthest are apart by this over sqrt(3) at least."""
        return float(np.linalg.norm(np.ptp(self.position, axis=0)))


def interpolated(stamps: Array, positions: Array, quats_xyzw: Array, t: Array, max_gap: float) -> Poses:
    """The poses at times t (n,) s among some with rising stamps, as `Track.at` has them."""
    between = _between(stamps, t, max_gap)
    q0, q1 = quats_xyzw[between.before], quats_xyzw[between.after]
    sign = np.where(np.sum(q0 * q1, axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    u = between.share[:, None]
    chord = (1.0 - u) * q0 + u * sign * q1
    return Poses(between.mix(positions), chord / np.linalg.norm(chord, axis=1, keepdims=True), between.valid)


class _Between(NamedTuple):
    """Where n times lie among some stamps."""

    before: NDArray[np.intp]
    after: NDArray[np.intp]
    share: Array
    """(n,) 0 to 1: how far from the one to the other."""
    valid: Mask

    def mix(self, values: Array) -> Array:
        """(n, c): values (m, c) at the stamps, interpolated linearly."""
        u = self.share[:, None]
        return np.asarray((1.0 - u) * values[self.before] + u * values[self.after])


def _between(stamps: Array, t: Array, max_gap: float) -> _Between:
    after = np.clip(np.searchsorted(stamps, t, side="left"), min(1, len(stamps) - 1), len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    t0, t1 = stamps[before], stamps[after]
    gap = t1 - t0
    valid = (t >= stamps[0]) & (t <= stamps[-1]) & ((gap <= max_gap) | (t == t0) | (t == t1))
    share = np.divide(t - t0, gap, out=np.zeros(len(t)), where=gap > 0.0)
    return _Between(before, after, np.clip(share, 0.0, 1.0), valid)
