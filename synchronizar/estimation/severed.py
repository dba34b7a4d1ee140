"""Who was tied to the reference once, and whose ranges to everybody on its side have not fitted since.

A lift, a train, a trolley: a device is moved in a way that its SLAM does not see, alone or with others. From then on
every range between those who were moved and those who were not is wrong, and the model takes all of them for NLOS. That
as many lines of sight are blocked at once, for so long, is possible too, and becomes unlikely with time: a blocked line
of sight is so still after T s with probability exp(-T / nlos_duration). Where that is less than a registration may be
wrong, those on the other side are not registered: where they are now, nobody has measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import RangeMeasurements, pair_bounds


class _Tie(NamedTuple):
    """Two users between whom there are ranges."""

    i: int
    j: int
    blocked: float
    """s: since when none of their ranges fits, until the last of them; 0 where they do."""


def severed(
    measurements: RangeMeasurements,
    inlier_probability: Array,
    held: Sequence[int],
    users: int,
    parameters: Parameters,
) -> dict[int, str]:
    """The users on the other side of such a cut than those `held`, of whose places nobody doubts, and why."""
    ties = _ties(measurements, inlier_probability, parameters)
    side = np.arange(users)
    side[list(held)] = held[0]
    for tie in ties:
        if tie.blocked == 0.0:
            side[side == side[tie.j]] = side[tie.i]
    ours, limit = side[held[0]], -np.log(parameters.integrity.wrong_share)
    out: dict[int, str] = {}
    for other in np.unique(side[side != ours]).tolist():
        across = [tie.blocked for tie in ties if (side[tie.i] == other) != (side[tie.j] == other)]
        if sum(across) > limit * parameters.ranges.nlos_duration:
            reason = (
                f"none of its ranges has fitted for {max(across):.0f} s: its SLAM may not have seen that it was moved"
            )
            out |= dict.fromkeys(np.flatnonzero(side == other).tolist(), reason)
    return out


def _ties(measurements: RangeMeasurements, inlier_probability: Array, parameters: Parameters) -> list[_Tie]:
    bounds = pair_bounds(measurements)
    return [
        _Tie(
            int(measurements.i[begin]),
            int(measurements.j[begin]),
            _blocked(measurements.t[begin:end], inlier_probability[begin:end], parameters),
        )
        for begin, end in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True)
    ]


def _blocked(t: Array, inlier_probability: Array, parameters: Parameters) -> float:
    """s: how long a pair's ranges have not fitted at the end; where one does now and then, that counts against it."""
    honest = parameters.integrity.severed_honest
    score = np.cumsum(np.where(inlier_probability[::-1] < 0.5, 1.0, -honest))
    score = score[: len(score) - np.count_nonzero(np.minimum.accumulate(score) < -honest)]
    if not len(score) or score.max() < parameters.integrity.severed_fewest:
        return 0.0
    begin = len(score) - 1 - int(np.argmax(score[::-1]))
    return float(t[-1] - t[len(t) - 1 - begin])
