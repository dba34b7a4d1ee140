"""Whether a radio without a track stands still, as far as devices that walk can tell."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.track import Track

MISFIT = 0.35
"""m: residuals (robust sigma) within this are those of a radio that stands still, drift and NLOS included."""
EXPLAINED = 0.75
"""Of the ranges' variance, by a radio that stands still and nothing else."""
_FEWEST = 20
_MOST = 400
"""Ranges of a pair that are looked at."""
_STANDS_M = 0.3
"""A device that moved less than this tells by how its ranges spread."""
_ITERATIONS = 25
_LONGEST_GAP = 1.0


def moves(track_ranges: Mapping[str, tuple[Track, Array, Array]]) -> bool | None:
    """Whether a radio moves, by its ranges (t, distance) to devices with tracks; None where they do not tell.

    Each device is asked alone, since frames are not known yet: does one place in its frame, with a bias, explain them?
    """
    votes = []
    for track, t, distance in track_ranges.values():
        position, valid = track.positions_at(t, _LONGEST_GAP)
        known = np.flatnonzero(valid & np.isfinite(distance))
        if len(known) < _FEWEST:
            continue
        few = known[np.linspace(0, len(known) - 1, min(len(known), _MOST)).astype(int)]
        spread = _robust_sigma(distance[few])
        if track.extent() < _STANDS_M:
            votes.append(spread > MISFIT)
        else:
            misfit = _misfit(position[few], distance[few])
            votes.append(misfit > MISFIT and misfit**2 > (1.0 - EXPLAINED) * spread**2)
    if not votes:
        return None
    return sum(votes) > len(votes) / 2


def _misfit(position: Array, distance: Array) -> float:
    """m: robust sigma of the residuals of the best place and bias, by reweighted least squares from several starts."""
    middle, reach = position.mean(axis=0), float(np.median(distance))
    best = np.inf
    for x, y in product((-1.0, 0.0, 1.0), repeat=2):
        place, bias = middle + 0.7 * reach * np.array([x, y, 0.1]), 0.0
        for _ in range(_ITERATIONS):
            line = place - position
            length = np.maximum(np.linalg.norm(line, axis=1), 1e-6)
            residual = length + bias - distance
            scale = max(_robust_sigma(residual), 0.05)
            weight = 1.0 / (1.0 + (residual / (2.0 * scale)) ** 2)
            rows = np.column_stack([line / length[:, None], np.ones(len(line))])
            # A bias of more than a metre is none, and heights are hardly seen on the level.
            prior = np.diag([1e-6, 1e-6, 0.1, 1.0])
            step = np.linalg.solve(
                rows.T @ (weight[:, None] * rows) + prior, rows.T @ (weight * residual) + prior @ [0, 0, 0, bias]
            )
            place, bias = place - step[:3], bias - step[3]
        best = min(best, _robust_sigma(np.linalg.norm(place - position, axis=1) + bias - distance))
    return best


def _robust_sigma(values: Array) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))
