"""What the ranges of two devices say of their tracks' scale, without knowing where the devices' frames lie.

With p and q the two antennas in their own gravity-aligned frames, t and R the unknown map between these,

    d^2 = |p|^2 + |q|^2 - 2 p' R q + 2 (linear in p) + 2 (linear in q) + constant,

which is linear in everything unknown. So least squares fits it at once, from no start, and the factors before |p|^2
and |q|^2, which are 1 where all lengths are metres, can be left free: they are the squares of (unit of a track / unit
of the ranges). A radio that stands still has the terms of p alone. The fit holds for half a minute, in which SLAM
hardly drifts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from synchronizar.arrays import Array, Indices, Mask
from synchronizar.data.recording import Recording
from synchronizar.parameters import DiagnosisParameters, Parameters

TERMS = 12
"""Unknowns of a fit."""


@dataclass(frozen=True)
class Groups:
    """g stretches of the ranges of one pair of users each, padded to the same length m."""

    users: Indices
    """(g, 2)"""
    row: Indices
    """(g, m) which range of the recording; 0 where there is none."""
    there: Mask
    """(g, m)"""


@dataclass(frozen=True)
class PairFits:
    """What was fitted to g stretches."""

    groups: Groups
    square: Array
    """(g, 2) the factors before |p|^2 and |q|^2; NaN for a radio that stands still and for what cannot be told."""
    sigma: Array
    """(g, 2) their 1 sigma."""
    rows: Indices
    """(g,) how many ranges were fitted."""
    spread: Array
    """(g,) robust 1 sigma of the residuals, as errors of d in the ranges' unit."""


def groups_of(recording: Recording, parameters: Parameters) -> Groups:
    """Stretches of half a minute, evenly chosen where there are many; none between two radios that stand still."""
    r, limits = recording.ranges, parameters.diagnosis
    static = np.array([user.static for user in recording.users], dtype=bool)
    usable = np.isfinite(r.distance)
    usable[usable] &= np.abs(r.distance[usable]) < 1e3 * parameters.ranges.longest  # they may be millimetres
    usable &= ~(static[r.a] & static[r.b])
    for u, user in enumerate(recording.users):
        if not user.static:
            t = recording.tracks[user.name].t
            usable &= ((r.a != u) & (r.b != u)) | ((r.t >= t[0]) & (r.t <= t[-1]))
    rows = np.flatnonzero(usable)
    if not len(rows):
        nothing = np.zeros((0, 1), dtype=np.int32)
        return Groups(np.zeros((0, 2), dtype=np.int32), nothing, nothing.astype(bool))
    i, j = np.minimum(r.a, r.b)[rows].astype(np.int64), np.maximum(r.a, r.b)[rows].astype(np.int64)
    window = np.floor((r.t[rows] - r.t[rows].min()) / limits.stretch)
    order = np.lexsort((r.t[rows], window, j, i))
    key = np.column_stack([i, j, window.astype(np.int64)])[order]
    begin = np.flatnonzero(np.concatenate([[True], np.diff(key, axis=0).any(axis=1)]))
    count = np.diff(np.append(begin, len(order)))
    enough = count >= limits.stretch_fewest_ranges
    begin, count = begin[enough], count[enough]
    if len(begin) > limits.most_stretches:
        chosen = np.linspace(0, len(begin) - 1, limits.most_stretches).astype(int)
        begin, count = begin[chosen], count[chosen]
    m = min(limits.stretch_most_ranges, int(count.max(initial=1)))
    place = np.arange(m)
    # All of a short stretch, evenly chosen ones of a long one.
    step = np.where(count[:, None] > m, (place * (count[:, None] - 1)) // max(m - 1, 1), place)
    there = place < np.minimum(count, m)[:, None]
    at = begin[:, None] + np.where(there, step, 0)
    users = key[begin][:, :2].astype(np.int32)
    return Groups(users, rows[order[at]].astype(np.int32), there)


def fit_pairs(
    recording: Recording,
    groups: Groups,
    parameters: Parameters,
    free: Mask | bool = True,
    swapped: tuple[int, int] | None = None,
) -> PairFits:
    """The fits to all stretches.

    `free` (g, 2): whose factors are free; the others are 1, all lengths being metres. With two users `swapped`: as if
    each had carried the other's radio.
    """
    g, m = groups.row.shape
    carrier = np.arange(len(recording.users))
    if swapped is not None:
        carrier[list(swapped)] = carrier[list(reversed(swapped))]
    own = [recording.users[u].static for u in range(len(recording.users))]
    p, known = np.zeros((2, g, m, 3)), groups.there.copy()
    r = recording.ranges
    gap = parameters.slam.longest_pose_gap
    for end in (0, 1):
        labelled = np.broadcast_to(groups.users[:, end : end + 1], (g, m))
        who = carrier[labelled]
        antenna = np.where(r.a[groups.row] == labelled, r.antenna_a[groups.row], r.antenna_b[groups.row])
        for u in np.unique(who).tolist():
            if own[u]:
                continue
            mine = who == u
            of = antenna[mine] if swapped is None else np.minimum(antenna[mine], len(recording.users[u].antennas) - 1)
            place, valid = recording.antenna_positions(u, r.t[groups.row[mine]], of, gap)
            p[end][mine] = place
            known[mine] &= valid
    distance = np.where(known, r.distance[groups.row], 0.0)
    free = np.broadcast_to(free, groups.users.shape)
    return _fit(groups, p[0], p[1], distance, known, free, parameters.diagnosis)


def _fit(
    groups: Groups, p: Array, q: Array, distance: Array, known: Mask, free: Mask, limits: DiagnosisParameters
) -> PairFits:
    g, m = known.shape
    count = known.sum(axis=1)
    p, q = (x - (x * known[..., None]).sum(axis=1, keepdims=True) / np.maximum(count, 1)[:, None, None] for x in (p, q))
    p, q = p * known[..., None], q * known[..., None]
    columns = np.concatenate(
        [
            np.sum(p**2, axis=2, keepdims=True),
            np.sum(q**2, axis=2, keepdims=True),
            np.ones((g, m, 1)),
            p,
            q,
            (p[..., :1] * q[..., :1] + p[..., 1:2] * q[..., 1:2]),
            (p[..., :1] * q[..., 1:2] - p[..., 1:2] * q[..., :1]),
            p[..., 2:] * q[..., 2:],
        ],
        axis=2,
    )
    typical = np.array([np.median(np.abs(d[k])) if k.any() else 1.0 for d, k in zip(distance, known, strict=True)])
    # An error of d is one of d^2 / (2 d).
    half = 0.5 / np.maximum(np.abs(distance), np.maximum(limits.fit_nearest * typical, 1e-9)[:, None])
    a = columns * (half * known)[..., None]
    y = distance**2 * half * known
    y -= (a[..., :2] * ~free[:, None]).sum(axis=2)
    a[..., :2] *= free[:, None]
    size = np.sqrt(np.sum(a**2, axis=1))
    seen = size > 1e-9 * size.max(axis=1, keepdims=True)
    a = np.where(seen[:, None], a / np.where(seen, size, 1.0)[:, None], 0.0)
    weight = known.astype(float)
    for _ in range(limits.fit_passes):
        weighted = np.swapaxes(a * weight[..., None], 1, 2)
        normal = weighted @ a
        normal[:, np.arange(TERMS), np.arange(TERMS)] += np.where(seen, 1e-12, 1.0)
        solution = np.linalg.solve(normal, weighted @ y[..., None])[..., 0]
        residual = y - (a @ solution[..., None])[..., 0]
        spread = _spread(residual, known, seen.sum(axis=1))
        soft = limits.soft_sigmas * np.maximum(spread, 1e-12)[:, None]
        weight = known / (1.0 + (residual / soft) ** 2)
    variance = np.diagonal(np.linalg.inv(normal), axis1=1, axis2=2)
    scaled = np.where(seen, size, 1.0)
    square = np.where(seen, solution / scaled, np.nan)[:, :2]
    sigma = np.where(seen, np.sqrt(limits.fit_correlation * variance) * spread[:, None] / scaled, np.nan)[:, :2]
    few = known.sum(axis=1) < limits.stretch_fewest_ranges
    square[few], sigma[few], spread = np.nan, np.nan, np.where(few, np.nan, spread)
    return PairFits(groups, square, sigma, count.astype(np.int32), spread)


def _spread(residual: Array, known: Mask, terms: Array) -> Array:
    """(g,) 1 sigma from the median of absolute residuals, made wider by what the terms took away."""
    size = np.where(known, np.abs(residual), np.inf)
    count = known.sum(axis=1)
    middle = np.sort(size, axis=1)[np.arange(len(size)), np.maximum(count // 2 - 1, 0)]
    free = np.maximum(count - terms, 1)
    return np.where(count > 0, 1.4826 * middle * np.sqrt(np.maximum(count, 1) / free), np.nan)
