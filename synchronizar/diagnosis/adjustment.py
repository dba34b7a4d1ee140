"""A solution adjusted once more, with heights and antenna delays free or held: what the ranges themselves say of these.

Every user's corrected track is taken for rigid and may move by x, y, z, a turn about z, a scale and its radio's bias;
the reference keeps its place. Gauss-Newton with a robust loss begins at the solution, at the same with one origin
higher or lower, and at the same with all ranges longer or shorter: two devices that walk level feel a height by its
square alone, so that zero is always a stationary point. How much worse it fits with heights (or delays) held at what
the priors expect while the delays (or heights) are free is the evidence that heights (or delays) are others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from synchronizar._core import Adjustment as CoreAdjustment
from synchronizar.arrays import Array, Indices, Mask
from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration
from synchronizar.parameters import DiagnosisParameters, Parameters
from synchronizar.preprocessing.raised import raised_by

X, Y, Z, YAW, BIAS, SCALE = range(6)
TERMS = 6

_LONGEST_STEP, _SHORTEST_STEP = 0.5, 1e-3  # m, rad and log scale: of each variable


@dataclass(frozen=True)
class Adjustment:
    """What fits k users' ranges best."""

    height: Array
    """(k,) m: of each user's SLAM origin above the reference's; NaN where it has no ranges."""
    height_sigma: Array
    bias: Array
    """(k,) m: what each radio adds to its ranges; NaN where it has none."""
    bias_sigma: Array
    mean_bias: float
    """m: by how much ranges are too long on average, both radios together."""
    against_heights: float
    """Log likelihood that is lost when heights are held by their priors, delays free;"""
    against_biases: float
    """and when delays are, heights free."""
    either_side: bool
    """Whether the heights with the other sign fit nearly as well."""


def adjusted(recording: Recording, registration: Registration, parameters: Parameters) -> Adjustment | None:
    """The adjustment of a solution; None where there is too little to adjust, or too much."""
    k, limits = len(recording.users), parameters.diagnosis
    if k > limits.most_users or registration.reference is None or registration.reference not in registration.users:
        return None
    tracks = registration.tracks(recording)
    ends = _ends(recording, registration, parameters)
    if len(ends.i) < limits.adjustment_fewest_ranges:
        return None
    count = np.bincount(np.concatenate([ends.i, ends.j]), minlength=k)
    reference = recording.index(registration.reference)
    static = np.array([user.static for user in recording.users])
    free = np.zeros((k, TERMS), dtype=bool)
    free[count > 0] = True
    free[reference, :BIAS] = False
    free[static, YAW] = free[static, SCALE] = False

    # Heights of the origins as the solution has them, and biases: both are what the priors speak of.
    origin, centre, raised = np.zeros(k), np.zeros((k, 3)), raised_by(recording, parameters)
    for u, user in enumerate(recording.users):
        if user.name not in tracks:
            continue
        centre[u] = tracks[user.name].position.mean(axis=0)
        own = 0.0 if user.static else float(recording.tracks[user.name].position[0, 2] - raised[u])
        origin[u] = tracks[user.name].position[0, 2] - own
    origin -= origin[reference]
    start = np.zeros((k, TERMS))
    start[:, BIAS] = [registration.users[user.name].range_bias for user in recording.users]
    mean = np.zeros((k, TERMS))
    mean[:, Z] = -origin
    mean[:, SCALE] = [
        0.0 if frame is None else -np.log(frame.scale)
        for frame in (registration.users[user.name].common_from_user for user in recording.users)
    ]
    wide = np.tile(limits.adjustment_sigmas, (k, 1))
    wide[static, Z] = limits.adjustment_static_factor * parameters.priors.static_height_sigma
    level, exact = wide.copy(), wide.copy()
    level[~static, Z] = limits.adjustment_held_sigma
    exact[:, BIAS] = limits.adjustment_held_sigma

    least_sigma = limits.adjustment_least_sigma
    begun = _core_of(ends, centre, 1.0, limits.soft_sigmas)
    scale = max(_spread(begun.residuals(start)), least_sigma)
    problem = _Problem(ends, free, centre, mean, scale, limits)
    starts = _starts(start, free, static, limits)
    found = sorted((problem.solved(one, wide) for one in starts), key=lambda one: one.cost)[: limits.adjustment_kept]
    problem = replace(problem, scale=max(_spread(begun.residuals(found[0].correction)), least_sigma))
    found = [problem.solved(one.correction, wide) for one in found]
    best = min(found, key=lambda one: one.cost)
    begin = [start, *(one.correction for one in found)]
    held = [min(problem.solved(one, sigmas).misfit for one in begin) for sigmas in (level, exact)]
    correlation = limits.adjustment_correlation
    sigma = np.sqrt(correlation * np.diag(best.covariance)).reshape(k, TERMS)
    verdicts = registration.ranges
    rejected = 1.0 - verdicts.used.sum() / verdicts.usable.sum()
    doubt = correlation * (1.0 + limits.adjustment_rejected * rejected)
    there = count > 0
    height = origin + best.correction[:, Z]
    c = best.correction
    return Adjustment(
        np.where(there, height, np.nan),
        np.where(there, sigma[:, Z], np.nan),
        np.where(there, c[:, BIAS], np.nan),
        np.where(there, sigma[:, BIAS], np.nan),
        float((c[ends.i, BIAS] + c[ends.j, BIAS]).mean()),
        (held[0] - best.misfit) / doubt,
        (held[1] - best.misfit) / doubt,
        any(
            one.cost - best.cost < limits.mirror_evidence * correlation
            and _mirrored(one.correction, c, origin, free, limits.mirror_share)
            for one in found
        ),
    )


class _Ends(NamedTuple):
    """Where n ranges were measured, in the common frame, and what."""

    i: Indices
    j: Indices
    p: Array
    """(n, 3) m: the antenna of i."""
    q: Array
    """(n, 3) m: that of j."""
    distance: Array
    """(n,) m."""


class _Solved(NamedTuple):
    correction: Array
    """(k, 6)"""
    covariance: Array
    """(5 k, TERMS k)"""
    misfit: float
    """Robust negative log likelihood of the ranges,"""
    cost: float
    """and with the priors."""


@dataclass(frozen=True)
class _Problem:
    ends: _Ends
    free: Mask
    """(k, 6)"""
    centre: Array
    """(k, 3) m: what each user turns about."""
    mean: Array
    """(k, 6) of the priors."""
    scale: float
    """m, 1 sigma of a range."""
    limits: DiagnosisParameters

    def solved(self, c: Array, sigmas: Array) -> _Solved:
        """The minimum near corrections c (k, 6), with priors of these sigmas (k, 6)."""
        k, limits = len(c), self.limits
        where = np.flatnonzero(self.free.ravel()).astype(np.int32)
        weight_of_prior, mean = 1.0 / sigmas.ravel()[where] ** 2, self.mean.ravel()[where]
        steps = limits.adjustment_steps
        c, normal = self.core.adjust(c, where, mean, weight_of_prior, steps, _LONGEST_STEP, _SHORTEST_STEP)
        covariance = np.zeros((TERMS * k, TERMS * k))
        covariance[np.ix_(where, where)] = np.linalg.inv(normal)
        z = self.core.residuals(c) / (limits.soft_sigmas * self.scale)
        misfit = float(0.5 * limits.soft_sigmas**2 * np.log1p(z**2).sum())
        away = (c.ravel()[where] - mean) ** 2 * weight_of_prior
        return _Solved(c, covariance, misfit, misfit + 0.5 * float(away.sum()))

    @cached_property
    def core(self) -> CoreAdjustment:
        """The ranges as the core has them."""
        return _core_of(self.ends, self.centre, self.scale, self.limits.soft_sigmas)


def _core_of(e: _Ends, centre: Array, scale: float, soft_sigmas: float) -> CoreAdjustment:
    i, j = (who.astype(np.int32) for who in (e.i, e.j))
    return CoreAdjustment(i, j, e.p, e.q, e.distance, centre, scale, soft_sigmas * scale)


def _starts(start: Array, free: Mask, static: Mask, limits: DiagnosisParameters) -> list[Array]:
    """The solution, the same with one origin higher or lower, and with longer or shorter ranges."""
    starts = [start]
    for u in np.flatnonzero(~static & free[:, BIAS]).tolist():
        for height in limits.adjustment_heights:
            tried = start.copy()
            if free[u, Z]:
                tried[u, Z] += height
            else:
                tried[free[:, Z], Z] -= height
            starts.append(tried)
    for bias in limits.adjustment_biases:
        tried = start.copy()
        tried[free[:, BIAS], BIAS] = bias
        starts.append(tried)
    return starts


def _ends(recording: Recording, registration: Registration, parameters: Parameters) -> _Ends:
    """Both ends of the ranges that the solution uses, evenly chosen, in the common frame."""
    tracks = registration.tracks(recording)
    usable = np.flatnonzero(registration.ranges.used)
    most = parameters.diagnosis.adjustment_most_ranges
    if len(usable) > most:
        usable = usable[np.linspace(0, len(usable) - 1, most).astype(int)]
    r = recording.ranges.select(usable)
    longest_gap = parameters.slam.longest_pose_gap
    common = replace(recording, tracks={n: tracks.get(n, track) for n, track in recording.tracks.items()})
    place, known = np.zeros((2, len(r), 3)), np.ones(len(r), dtype=bool)
    for u, user in enumerate(recording.users):
        for end, (who, antenna) in enumerate(((r.a, r.antenna_a), (r.b, r.antenna_b))):
            mine = np.flatnonzero(who == u)
            if user.name not in tracks:
                known[mine] = False
            elif user.static:
                place[end, mine] = tracks[user.name].position[0]
            else:
                own = tracks[user.name].t
                t = np.clip(r.t[mine] + (registration.users[user.name].clock_offset or 0.0), own[0], own[-1])
                place[end, mine], valid = common.antenna_positions(u, t, antenna[mine], longest_gap)
                known[mine[~valid]] = False
    return _Ends(r.a[known], r.b[known], place[0][known], place[1][known], r.distance[known])


def _mirrored(one: Array, best: Array, origin: Array, free: Mask, share: float) -> bool:
    """Whether the largest height of the best lies on the other side of 0 in `one`, at least this share as far."""
    heights = np.where(free[:, Z], origin + best[:, Z], 0.0)
    u = int(np.argmax(np.abs(heights)))
    other = origin[u] + one[u, Z]
    return bool(other * heights[u] < 0.0 and abs(other) > share * abs(heights[u]))


def _spread(residual: Array) -> float:
    return 1.4826 * float(np.median(np.abs(residual - np.median(residual))))
