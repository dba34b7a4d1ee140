"""Whether some users are somewhere else than they are followed to be: likelihoods of one shift of theirs.

Ranges of the last moments are looked at as they came, before they were used. If a group of users is off by one shift,
their ranges to the others show it, and those among themselves do not. A linear score of every group that may be, from
sums over pairs, says which are worth a closer look; for these the shift is fitted, and its likelihood is set beside
that of no shift, with what bursts of NLOS may do in both (factors/common_shift.h).
"""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np

from synchronizar._core import common_shift
from synchronizar.arrays import Array, Indices
from synchronizar.estimation.incremental.innovations import Innovations
from synchronizar.graph.priors import bursts_of, nlos_mixture
from synchronizar.parameters import Parameters

_CLIPPED = 3.0  # sigmas: in scores, which know nothing of NLOS, no range counts for more
_LOOKED_AT = 2  # groups whose shifts are fitted
_LONG_ALONE = 0.5  # of its gain counts where a shift stays, and no pair's ranges are too short
_NEAREST = 0.1  # m: nearer, a direction is not known
_MOST_IN_PAIRS = 8  # users, for each two of them to be a group: of more, it is those that a chain of fits makes


class Shifted(NamedTuple):
    """Users who may be somewhere else, all by one shift."""

    users: frozenset[int]
    shift: Array
    """(3,) m, now."""
    gain: float
    """Log likelihood that the shift gains."""


def shifted(recent: Innovations, now: float, window: float, grows: bool, parameters: Parameters) -> list[Shifted]:
    """Groups of users whose ranges of the last `window` s (s) one shift explains better, the best first.

    `grows`: the shift begins at the window's begin and grows evenly, or else it is there all along.
    """
    m = parameters.integrity
    late = recent.t > now - window
    if late.sum() < m.innovation_fewest:
        return []
    part = recent.part(late)
    part = part.part(np.lexsort((part.t, part.j, part.i)))
    new = np.append(True, (np.diff(part.i) != 0) | (np.diff(part.j) != 0))
    first = np.flatnonzero(new)
    bounds = np.append(first, len(part.t))
    count = np.diff(bounds)
    pair = np.cumsum(new) - 1
    ends = np.stack([part.i[first], part.j[first]], axis=1)
    share = np.clip((part.t - (now - window)) / window, 0.0, 1.0) if grows else np.ones(len(part.t))
    weight = np.add.reduceat(part.weight, first) / count
    weight = np.maximum(weight, np.median(weight))  # ranges that misfit are worth little: no excuse for those who move
    groups = _groups(ends)
    side = np.array([[(a in group) - (b in group) for a, b in ends.tolist()] for group in groups], dtype=float)
    # Scores: in the plane and upwards, and one more: who goes up or down gets away from all that are about it.
    apart = np.linalg.norm(part.away, axis=1)
    slope = part.away / np.maximum(apart, _NEAREST)[:, None]
    slope = np.column_stack([slope, np.ones(len(slope))]) * (share / part.sigma)[:, None]
    counts = weight[pair]
    clipped = counts * np.clip((apart - part.distance) / part.sigma, -_CLIPPED, _CLIPPED)
    short = np.add.reduceat(clipped, first) > np.add.reduceat(counts, first)
    score = np.add.reduceat(slope * clipped[:, None], first)
    normal = np.add.reduceat(slope[:, :, None] * (slope * counts[:, None])[:, None, :], first)
    across = np.abs(side)
    scores = np.concatenate([side @ score[:, :3], across @ score[:, 3:]], axis=1)
    normals = np.einsum("gp,pab->gab", across, normal)
    normals[:, :3, 3] = normals[:, 3, :3] = side @ normal[:, :3, 3]
    normals += np.eye(4) / m.shift_sigma**2
    height = 0.5 * np.einsum("ga,ga->g", scores, np.linalg.solve(normals, scores[:, :, None])[:, :, 0])
    height[across @ count < m.innovation_fewest] = 0.0
    found = []
    loss, bursts = nlos_mixture(parameters), bursts_of(parameters)
    precision = np.full(3, 1.0 / m.shift_sigma**2)
    starts = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    for n in np.argsort(-height)[:_LOOKED_AT].tolist():
        if height[n] < m.shift_looked_at:
            break
        of_pair = across[n] > 0.0
        which = of_pair[pair]
        mine = part.part(which)
        shift, gain = common_shift(
            np.append(0, np.cumsum(count[of_pair])).astype(np.int32),
            mine.t,
            mine.away * side[n][pair][which][:, None],
            mine.distance,
            mine.sigma,
            mine.nlos_odds,
            share[which],
            weight[of_pair],
            precision,
            starts,
            loss,
            bursts,
        )
        # A body in between makes all of somebody's ranges too long, for a moment, by lengths that stay.
        sure = 1.0 if grows or (short & of_pair).any() else _LONG_ALONE
        found.append(Shifted(groups[n], np.asarray(shift), sure * float(gain)))
    return sorted(found, key=lambda each: -each.gain)


def _groups(ends: Indices) -> list[frozenset[int]]:
    """Groups of the users of pairs (p, 2) that may be off together; of a group and all others but one."""
    users = np.unique(ends).tolist()
    sizes = (1, 2) if len(users) <= _MOST_IN_PAIRS else (1,)
    out: dict[frozenset[int], None] = {}
    for size in sizes:
        for group in combinations(users, size):
            own, others = frozenset(group), frozenset(users).difference(group)
            if others and others not in out:
                out[own] = None
    return list(out)
