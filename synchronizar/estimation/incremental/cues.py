"""Which way a user should walk for its place to be known soonest: what ranges there would add to what is known.

Ranges along a straight walk are put to the covariance as they would be measured, in each of some directions, and the
one after which the user would be nearest to being registered is told.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.estimation.hypotheses import Hypothesis
from synchronizar.estimation.integrity import nearness, nearness_of
from synchronizar.parameters import Parameters

_DIRECTIONS = 16
_LENGTHS = (1.0, 2.0, 3.0)  # m
_BESIDE = 0.5  # m: side by side
_FARTHEST = 8.0  # m: nobody is asked to walk further
_SAME_WAY = 12.0  # deg: a way that was told is told again while it is nearly as good
_SPACING = 0.5  # m: ranges closer than this share their reflections
_ENOUGH = 0.8  # of what the longest walk would gain
_LEAST_GAIN = 0.01  # of nearness: less is not worth a walk
_WALKING = 0.2  # m/s


class Cue(NamedTuple):
    """A walk that would tell most."""

    direction: float
    """rad, in the common frame."""
    length: float
    """m."""
    sentence: str


def cue_of(
    best: Hypothesis,
    user: int,
    here: Array,
    others: Array,
    velocity: Array,
    extent: Array,
    names: list[str],
    before: Cue | None,
    parameters: Parameters,
) -> Cue | None:
    """None where no walk of a few metres would help.

    `here` (3,) m and `velocity` (2,) m/s of the user in the common frame, `others` (k, 3) where those are to whom it
    ranges, `names` theirs; `extent` (c, 3) bound its walk about its last keyframe. The way
    that was told `before` is told again while it is nearly as good.
    """
    if not len(others):
        return None
    now = nearness(best, user, False, extent, parameters)
    if now >= 1.0:
        return None
    walks = []
    for directions, lengths in _walks(here, others):
        after = _after(best.covariances[user], here, others, directions, lengths, parameters)
        near = nearness_of(after.reshape(-1, 4, 4), float(best.frames[user, 3]), False, extent, parameters)
        each = ((phi, length) for phi in directions.tolist() for length in lengths)
        walks += [(phi, length, gain - now) for (phi, length), gain in zip(each, near.tolist(), strict=True)]
    most = max(gain for _, _, gain in walks)
    if most < _LEAST_GAIN:
        return None
    good = [(n, -gain, phi) for phi, n, gain in walks if gain >= _ENOUGH * most]
    length, _, direction = min(good)
    if before is not None:
        same = [(n, phi) for n, _, phi in good if abs(float(_degrees(np.asarray(phi - before.direction)))) < _SAME_WAY]
        length, direction = min(same, default=(length, direction))
    return Cue(direction, length, f"walk {length:.0f} m {_towards(direction, here, others, velocity, names)}")


def _walks(here: Array, others: Array) -> list[tuple[Array, tuple[float, ...]]]:
    """Directions (d,) rad and lengths (m) of walks: a few metres any way, and up to the side of each of the others.

    Beside somebody the direction to it changes most.
    """
    out: list[tuple[Array, tuple[float, ...]]] = [(np.arange(_DIRECTIONS) * 2.0 * np.pi / _DIRECTIONS, _LENGTHS)]
    for x, y in (others - here)[:, :2].tolist():
        length = float(np.hypot(x, y)) - _BESIDE
        if _LENGTHS[-1] < length <= _FARTHEST:
            out.append((np.array([np.arctan2(y, x)]), (length,)))
    return out


def _after(
    covariance: Array, here: Array, others: Array, directions: Array, lengths: Sequence[float], parameters: Parameters
) -> Array:
    """(d, lengths, 4, 4) what becomes of a user's covariance by straight walks of any of these lengths."""
    steps = np.arange(_SPACING, lengths[-1] + 0.5 * _SPACING, _SPACING)
    ways = np.stack([np.cos(directions), np.sin(directions), np.zeros(len(directions))], axis=1)
    away = steps[:, None] * ways[:, None]
    lines = (here + away)[:, :, None] - others
    lines /= np.maximum(np.linalg.norm(lines, axis=-1, keepdims=True), 1e-6)
    turned = np.stack([-away[..., 1], away[..., 0]], axis=-1)
    rows = np.concatenate([lines, (lines[..., :2] * turned[:, :, None]).sum(axis=-1, keepdims=True)], axis=-1)
    variance = parameters.ranges.sigma**2 + parameters.ranges.multipath_sigma**2
    information = np.cumsum(rows.swapaxes(-1, -2) @ rows, axis=1) / variance
    walked = [len(np.arange(_SPACING, length + 0.5 * _SPACING, _SPACING)) - 1 for length in lengths]
    # Not by the covariance's inverse: it may be all but singular.
    return np.asarray(np.linalg.solve(np.eye(4) + covariance @ information[:, walked], covariance))


def _towards(direction: float, here: Array, others: Array, velocity: Array, names: list[str]) -> str:
    """In the words of who walks, or beside the nearest of the others."""
    if np.hypot(*velocity) > _WALKING:
        turn = float(_degrees(direction - np.arctan2(velocity[1], velocity[0])))
        if abs(turn) <= 30.0:
            return "straight on"
        if abs(turn) >= 150.0:
            return "back"
        side = "left" if turn > 0.0 else "right"
        return (
            f"to your {side}"
            if 60.0 <= abs(turn) <= 120.0
            else f"{'ahead' if abs(turn) < 60.0 else 'back'} to your {side}"
        )
    nearest = int(np.argmin(np.linalg.norm(others - here, axis=1)))
    to = others[nearest] - here
    turn = float(_degrees(direction - np.arctan2(to[1], to[0])))
    if abs(turn) <= 45.0:
        return f"towards {names[nearest]}"
    if abs(turn) >= 135.0:
        return f"away from {names[nearest]}"
    return f"to the {'left' if turn > 0.0 else 'right'}, as you look at {names[nearest]}"


def _degrees(angle: Array) -> Array:
    """-180 .. 180."""
    return np.asarray((np.degrees(angle) + 180.0) % 360.0 - 180.0)
