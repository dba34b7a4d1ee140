"""Pairs of devices that range, those with the largest residuals first."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from synchronizar.reporting.answer import Answer


class Pair(NamedTuple):
    """Two users with usable ranges between them."""

    a: str
    b: str
    rows: NDArray[np.intp]
    """Indices of its usable ranges."""
    rms: float
    """m: RMS residual of its used ranges; NaN where none was used."""


def pairs(answer: Answer) -> list[Pair]:
    """All pairs with usable ranges: those without a used range first, then by RMS residual, largest first."""
    verdicts, ranges, count = answer.registration.ranges, answer.ranges, len(answer.names)
    pair = np.minimum(ranges.a, ranges.b).astype(np.int64) * count + np.maximum(ranges.a, ranges.b)
    found = []
    for key in np.unique(pair[verdicts.usable]).tolist():
        rows = np.flatnonzero(verdicts.usable & (pair == key))
        squares = verdicts.residual[rows[verdicts.used[rows]]] ** 2
        rms = float(np.sqrt(squares.mean())) if len(squares) else np.nan
        found.append(Pair(answer.names[key // count], answer.names[key % count], rows, rms))
    return sorted(found, key=lambda pair: -np.inf if np.isnan(pair.rms) else -pair.rms)
