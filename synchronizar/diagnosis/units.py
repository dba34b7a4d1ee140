"""Lengths that are no metres: of the ranges, or of a track."""

from __future__ import annotations

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.findings import Code, Finding
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.diagnosis.pair_fits import Groups, PairFits, fit_pairs

UNITS = {"millimetres": 1e3, "centimetres": 1e2, "feet": 1.0 / 0.3048}
"""How many of each make a metre."""
FACTORS = {"metres": 1.0} | UNITS | {f"/{unit}": 1.0 / per_metre for unit, per_metre in UNITS.items()}
"""What ranges change by where tracks change by 1; with a stroke: the tracks are in that unit."""
SCALE_SIGMA = 0.3
"""1 sigma, relative, of a squared factor besides the fit's own: SLAM's scale may be 15 % off."""
FIT_SIGMA = 1.5
"""By how much the fits' own 1 sigma is too small where signals are late,"""
TAIL = 3.0
"""and degrees of freedom of Student's t, as which their errors are distributed."""
PLAIN = 8.0
"""A unit is e^8 times as likely as any other, metres among them, before it is reported."""
LEAST_SHARE = 0.5
"""Of the fits at least so many, by weight, agree with the unit within a factor of 1.35 (of lengths)."""
FACTOR = 1.35
FASTEST = 15.0
"""m/s: nobody walks, flies or drives faster among others whom a radio reaches."""
PLAIN_ALONE = 3.0
"""The same of one track among others, which besides has to take away most of its misfit:"""
BETTER = 0.5
"""at most so much of it is left."""
MISFIT = 0.15
"""m: ranges of devices whose lengths are metres fit better."""
USUAL_SPEED = 0.7
"""m/s."""
SPEED_STEP_S = 1.0
KNOWN = 4.0
"""sigmas from 0: a squared factor that is reported by the devices' own motion."""
USUAL_NOISE, USUAL_DISTANCE = 0.1, 5.0
"""m, of ranges."""
FARTHEST = 100.0
"""m: where devices move, their ranges are reported by noise only if they are usually longer than this."""
LARGEST_NOISE = 3.0
"""m: what spreads more is not measured in metres."""


def unit_findings(recording: Recording, fits: PairFits, in_metres: PairFits) -> list[Finding]:
    """Of ranges (user None) and of tracks whose lengths are likely no metres.

    By fits with all factors free, and by those with all lengths in metres.
    """
    everything = fits.square[np.isfinite(fits.square)], fits.sigma[np.isfinite(fits.square)]
    unit, seen = _range_unit(recording, fits, *everything)
    found = []
    if unit is not None:
        found.append(
            Finding(
                Code.RANGE_UNIT,
                None,
                f"the ranges are likely in {unit}: {seen}",
                f"divide the column range by {UNITS[unit]:.5g}: ranges are read as metres",
            )
        )
    of_all = _likely_unit(*everything, inverse=True)
    for u, user in enumerate(recording.users):
        if user.static:
            continue
        square, sigma = _of_user(fits, u)
        likely = of_all or _likely_unit(square, sigma, inverse=True)
        if unit is None and likely is None and _misfit(in_metres, u) > MISFIT:
            # The others are taken for right: then more is known of this one.
            alone = _alone(recording, in_metres, u)
            if _misfit(alone, u) < BETTER * _misfit(in_metres, u):
                square, sigma = _of_user(alone, u)
                likely = _likely_unit(square, sigma, inverse=True, plain=PLAIN_ALONE)
        unit_of_track, seen = _track_unit(recording.tracks[user.name], likely, square, sigma)
        if unit_of_track is not None:
            found.append(
                Finding(
                    Code.TRACK_UNIT,
                    user.name,
                    f"its positions are likely in {unit_of_track}: {seen}",
                    f"divide the positions of its track by {UNITS[unit_of_track]:.5g}: they are read as metres",
                )
            )
    return found


def _range_unit(recording: Recording, fits: PairFits, square: Array, sigma: Array) -> tuple[str | None, str]:
    """By how far ranges change while the devices move; where they do not move, by the ranges' own noise."""
    unit = _likely_unit(square, sigma, inverse=False)
    if unit is not None:
        return unit, _change(square, UNITS[unit])
    if not np.isfinite(fits.spread).any():
        return None, ""
    noise = float(np.nanmedian(fits.spread))
    middle = float(np.median(np.abs(recording.ranges.distance[fits.groups.row[fits.groups.there]])))
    moved = (square > KNOWN * sigma).any()
    if noise < LARGEST_NOISE or (moved and middle < FARTHEST):
        return None, ""
    misfit = {
        u: np.log(noise / UNITS[u] / USUAL_NOISE) ** 2 + np.log(max(middle, 1e-3) / UNITS[u] / USUAL_DISTANCE) ** 2
        for u in ("millimetres", "centimetres")
    }
    return min(misfit, key=lambda u: misfit[u]), f"their noise is {noise:.3g} and their median {middle:.4g}"


def _track_unit(track: Track, unit: str | None, square: Array, sigma: Array) -> tuple[str | None, str]:
    """The likely unit where a device's own fits do not speak against it, else that of its speed; and what was seen."""
    if unit is not None and len(square) and _log_odds(square, sigma, 1.0 / UNITS[unit], 1.0) > 0.0:
        return unit, _change(square, 1.0 / UNITS[unit])
    speed = _speed(track)
    if not speed > FASTEST:
        return None, ""
    unit = min(("millimetres", "centimetres"), key=lambda u: abs(np.log(speed / UNITS[u] / USUAL_SPEED)))
    return unit, f"it moves at {speed:.4g} m/s"


def _change(square: Array, factor: float) -> str:
    near = square[np.abs(np.log(np.maximum(square, 1e-300)) / 2.0 - np.log(factor)) < np.log(FACTOR)]
    return (
        f"where a device moves by 1 they change by {np.sqrt(np.median(near)) if len(near) else factor:.3g} "
        f"(in {len(near)} of {len(square)} stretches)"
    )


def _likely_unit(square: Array, sigma: Array, *, inverse: bool, plain: float = PLAIN) -> str | None:
    """The unit of ranges, or (inverse) of tracks, that the fits make far likelier than any other, metres among them."""
    best, odds = _most_likely(square, sigma)
    if best in ("metres", "") or best.startswith("/") is not inverse or odds < plain:
        return None
    weight = (square / sigma) ** 2
    weight = np.minimum(weight, 4.0 * np.median(weight))
    near = np.abs(np.log(np.maximum(square, 1e-300)) / 2.0 - np.log(FACTORS[best])) < np.log(FACTOR)
    return best.removeprefix("/") if weight[near].sum() > LEAST_SHARE * weight.sum() else None


def _most_likely(square: Array, sigma: Array) -> tuple[str, float]:
    """The likeliest of FACTORS, and its log odds against the next; no name where nothing is known."""
    if not len(square):
        return "", 0.0
    likelihood = sorted(((_log_likelihood(square, sigma, f), u) for u, f in FACTORS.items()), reverse=True)
    return likelihood[0][1], likelihood[0][0] - likelihood[1][0]


def _misfit(in_metres: PairFits, user: int) -> float:
    """How far (m) a user's ranges are from fitting with all lengths in metres, in the middle of its stretches."""
    mine = (in_metres.groups.users == user).any(axis=1) & np.isfinite(in_metres.spread)
    return float(np.median(in_metres.spread[mine])) if mine.any() else 0.0


def _alone(recording: Recording, in_metres: PairFits, user: int) -> PairFits:
    """The fits to a user's stretches, its own factor free and the others' 1."""
    groups = in_metres.groups
    mine = (groups.users == user).any(axis=1)
    of = Groups(groups.users[mine], groups.row[mine], groups.there[mine])
    return fit_pairs(recording, of, of.users == user)


def _log_odds(square: Array, sigma: Array, factor: float, other: float) -> float:
    return _log_likelihood(square, sigma, factor) - _log_likelihood(square, sigma, other)


def _log_likelihood(square: Array, sigma: Array, factor: float) -> float:
    """Of squared factors (n,) where the true one is `factor`^2, to within a constant."""
    scale = np.hypot(FIT_SIGMA * sigma, SCALE_SIGMA * factor**2)
    z = (square - factor**2) / scale
    return float(np.sum(-0.5 * (TAIL + 1.0) * np.log1p(z**2 / TAIL) - np.log(scale)))


def _of_user(fits: PairFits, user: int) -> tuple[Array, Array]:
    mine = (fits.groups.users == user) & np.isfinite(fits.square)
    return fits.square[mine], fits.sigma[mine]


def _speed(track: Track) -> float:
    """Median of how far the device comes in a second, per second; 0 where the track is too short to tell."""
    end = np.searchsorted(track.t, track.t + SPEED_STEP_S)
    begin = np.flatnonzero(end < len(track))
    if not len(begin):
        return 0.0
    end = end[begin]
    return float(
        np.median(np.linalg.norm(track.position[end] - track.position[begin], axis=1) / (track.t[end] - track.t[begin]))
    )
