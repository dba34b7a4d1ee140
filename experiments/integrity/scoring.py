"""Who is off, by how much, while called registered; how sure a share of so many is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from experiments.integrity.trial import TrueWalk
from synchronizar.arrays import Array, Mask
from synchronizar.data.registration import State
from synchronizar.data.track import Track
from synchronizar.geometry import YawFrame, wrap_angle
from synchronizar.parameters import IntegrityParameters

LIMITS = IntegrityParameters()
CONFIDENCE = 0.95
MOST_POINTS = 64
"""Of a walk, that errors are looked at, evenly chosen, and its last."""


class Off(NamedTuple):
    """How far off a placement is."""

    place: float
    """m: anywhere on the user's walk that is asked for, in space, as the reference's device has it."""
    yaw: float
    """rad; 0 of a radio that stands still."""
    sigma: float
    """m, 1 sigma that was told of the user's last place, along its longest axis; NaN where nothing was. The
    frame's covariance, of which it is, has no scale: of tracks that begin kilometres away it says nothing."""

    @property
    def wrong(self) -> bool:
        """Whether such a placement must not be called registered."""
        return not (self.place <= LIMITS.largest_error and self.yaw <= LIMITS.largest_yaw_error)


class Told(NamedTuple):
    """What was said of one user at one moment."""

    state: State
    frame: YawFrame | None
    """`common_from_user`."""
    covariance: Array | None


class Episode(NamedTuple):
    """One stretch in which a user was called registered while people walked."""

    user: str
    begin: float
    """s after the first range."""
    end: float
    off: Off
    """At its worst moment."""
    off_s: float
    """s of it that it was wrong for."""

    @property
    def wrong(self) -> bool:
        """Whether it was wrong at any moment."""
        return self.off.wrong


def row_at(walk: TrueWalk, own: Track | None, t: float) -> int:
    """Which of a device's true poses is that of the last pose that had come by t (s); the first before there is any."""
    if own is None:
        return 0
    came = int(np.searchsorted(own.t, t, side="right")) - 1
    if came < 0:
        return 0
    return max(int(np.searchsorted(walk.t, own.t[came], side="right")) - 1, 0)


def off_by(
    told: Told,
    reference: Told,
    of_user: tuple[TrueWalk, int],
    of_reference: tuple[TrueWalk, int],
    static: bool,
    since: int = 0,
) -> Off:
    """How far off a user's placement is through the reference; each one's true walk with the row of its newest pose.

    Anywhere on the user's walk from the row `since` on.
    """
    assert told.frame is not None
    assert reference.frame is not None
    (walk, row), (other, at) = of_user, of_reference
    found = reference.frame.z_up.inverse() @ told.frame.z_up
    true = _frame(other, at).inverse() @ _frame(walk, row)
    chosen = np.unique(np.linspace(since, row, min(row - since + 1, MOST_POINTS)).astype(int))
    own = _frame(walk, row).inverse() @ walk.position[chosen]
    if static:
        own = np.zeros((1, 3))
    place = _frame(other, at).scale * float(np.linalg.norm(found @ own - true @ own, axis=1).max())
    yaw = 0.0 if static else abs(float(wrap_angle(found.yaw - true.yaw)))
    return Off(place, yaw, _sigma(told, own[-1], static))


def _sigma(told: Told, own: Array, static: bool) -> float:
    """m, 1 sigma of the place of a point (3,) in the user's own axes, along its longest axis."""
    if told.covariance is None or told.frame is None:
        return np.nan
    if static:
        covariance = told.covariance[:3, :3]
    else:
        frame = told.frame.z_up
        x, y, _ = (frame @ own - np.array([frame.x, frame.y, frame.z])).tolist()
        jacobian = np.column_stack([np.eye(3), [-y, x, 0.0]])
        covariance = jacobian @ told.covariance @ jacobian.T
    if not np.isfinite(covariance).all():
        return np.nan
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))


def _frame(walk: TrueWalk, row: int) -> YawFrame:
    return YawFrame(*walk.frames[min(row, len(walk.frames) - 1)].tolist())


def stretches(registered: Mask) -> Iterator[slice]:
    """Of moments one after the other in which a user was registered."""
    edges = np.diff(registered.astype(int), prepend=0, append=0)
    for begin, end in zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True):
        yield slice(begin, end)


def episodes(user: str, t: Sequence[float], offs: Sequence[Off | None]) -> list[Episode]:
    """A user's episodes; `offs` of each moment t (s), None where it was not registered."""
    out = []
    for stretch in stretches(np.array([off is not None for off in offs], dtype=bool)):
        mine = [off for off in offs[stretch] if off is not None]
        until = t[stretch.stop] if stretch.stop < len(t) else t[-1]
        lasts = np.diff([*t[stretch], until])
        worst = max(mine, key=lambda off: (off.wrong, off.place / LIMITS.largest_error, off.yaw))
        wrong_s = float(sum(s for s, off in zip(lasts.tolist(), mine, strict=True) if off.wrong))
        out.append(Episode(user, t[stretch.start], until, worst, wrong_s))
    return out


def share_bounds(wrong: int, n: int) -> tuple[float, float]:
    """Of a share of n that so many are: lower and upper end, each of its own one-sided 95 % interval.

    Clopper and Pearson (1934). Without any to count nothing is known: 0 and 1.
    """
    from scipy.stats import beta

    low = 0.0 if wrong == 0 else float(beta.ppf(1.0 - CONFIDENCE, wrong, n - wrong + 1))
    high = 1.0 if wrong >= n else float(beta.ppf(CONFIDENCE, wrong + 1, n - wrong))
    return low, high
