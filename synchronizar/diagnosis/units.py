"""Lengths that are no metres: of the ranges, or of a track."""

from __future__ import annotations

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.data.findings import Code, Finding
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.diagnosis.pair_fits import Groups, PairFits, fit_pairs
from synchronizar.parameters import DiagnosisParameters, Parameters

UNITS = {"millimetres": 1e3, "centimetres": 1e2, "feet": 1.0 / 0.3048}
"""How many of each make a metre."""
FACTORS = {"metres": 1.0} | UNITS | {f"/{unit}": 1.0 / per_metre for unit, per_metre in UNITS.items()}
"""What ranges change by where tracks change by 1; with a stroke: the tracks are in that unit."""


def unit_findings(recording: Recording, fits: PairFits, in_metres: PairFits, parameters: Parameters) -> list[Finding]:
    """Of ranges (user None) and of tracks whose lengths are likely no metres.

    By fits with all factors free, and by those with all lengths in metres.
    """
    limits = parameters.diagnosis
    everything = fits.square[np.isfinite(fits.square)], fits.sigma[np.isfinite(fits.square)]
    unit, seen = _range_unit(recording, fits, *everything, parameters)
    found = []
    if unit is not None:
        found.append(
            Finding(
                Code.RANGE_UNIT,
                None,
                f"the ranges are likely in {unit}: {seen}",
                f"divide the column range by {UNITS[unit]:.5g}",
            )
        )
    of_all = _likely_unit(*everything, limits, inverse=True)
    for u, user in enumerate(recording.users):
        if user.static:
            continue
        square, sigma = _of_user(fits, u)
        likely = of_all or _likely_unit(square, sigma, limits, inverse=True)
        if unit is None and likely is None and _misfit(in_metres, u) > limits.unit_misfit:
            # The others are taken for right: then more is known of this one.
            alone = _alone(recording, in_metres, u, parameters)
            if _misfit(alone, u) < limits.misfit_left * _misfit(in_metres, u):
                square, sigma = _of_user(alone, u)
                likely = _likely_unit(square, sigma, limits, inverse=True, least_odds=limits.unit_odds_one)
        unit_of_track, seen = _track_unit(recording.tracks[user.name], likely, square, sigma, limits)
        if unit_of_track is not None:
            found.append(
                Finding(
                    Code.TRACK_UNIT,
                    user.name,
                    f"its positions are likely in {unit_of_track}: {seen}",
                    f"divide the positions of its track by {UNITS[unit_of_track]:.5g}",
                )
            )
    return found


def _range_unit(
    recording: Recording, fits: PairFits, square: Array, sigma: Array, parameters: Parameters
) -> tuple[str | None, str]:
    """By how far ranges change while the devices move; where they do not move, by the ranges' own noise."""
    limits = parameters.diagnosis
    unit = _likely_unit(square, sigma, limits, inverse=False)
    if unit is not None:
        return unit, _change(square, UNITS[unit], limits)
    if not np.isfinite(fits.spread).any():
        return None, ""
    noise = float(np.nanmedian(fits.spread))
    middle = float(np.median(np.abs(recording.ranges.distance[fits.groups.row[fits.groups.there]])))
    moved = (square > limits.unit_known_sigmas * sigma).any()
    if noise < limits.largest_noise or (moved and middle < limits.farthest):
        return None, ""
    misfit = {
        u: np.log(noise / UNITS[u] / parameters.ranges.sigma) ** 2
        + np.log(max(middle, 1e-3) / UNITS[u] / limits.usual_distance) ** 2
        for u in ("millimetres", "centimetres")
    }
    return min(
        misfit, key=lambda u: misfit[u]
    ), f"in metres their noise would be {noise:.3g} m and their median {middle:.4g} m"


def _track_unit(
    track: Track, unit: str | None, square: Array, sigma: Array, limits: DiagnosisParameters
) -> tuple[str | None, str]:
    """The likely unit where a device's own fits do not speak against it, else that of its speed; and what was seen."""
    if unit is not None and len(square) and _log_odds(square, sigma, 1.0 / UNITS[unit], 1.0, limits) > 0.0:
        return unit, _change(square, 1.0 / UNITS[unit], limits)
    speed = _speed(track, limits.speed_interval)
    if not speed > limits.fastest:
        return None, ""
    unit = min(("millimetres", "centimetres"), key=lambda u: abs(np.log(speed / UNITS[u] / limits.usual_speed)))
    return unit, f"in metres it would move at {speed:.4g} m/s"


def _change(square: Array, factor: float, limits: DiagnosisParameters) -> str:
    near = square[_near(square, factor, limits)]
    return (
        f"where a track moves by 1 m, ranges change by {np.sqrt(np.median(near)) if len(near) else factor:.4g} m "
        f"(in {len(near)} of {len(square)} stretches of up to {limits.stretch:g} s)"
    )


def _likely_unit(
    square: Array, sigma: Array, limits: DiagnosisParameters, *, inverse: bool, least_odds: float | None = None
) -> str | None:
    """The unit of ranges, or (inverse) of tracks, that the fits make far likelier than any other, metres among them."""
    best, odds = _most_likely(square, sigma, limits)
    if best in ("metres", "") or best.startswith("/") is not inverse:
        return None
    if odds < (limits.unit_odds if least_odds is None else least_odds):
        return None
    weight = (square / sigma) ** 2
    weight = np.minimum(weight, limits.unit_largest_weight * np.median(weight))
    near = _near(square, FACTORS[best], limits)
    return best.removeprefix("/") if weight[near].sum() > limits.unit_share * weight.sum() else None


def _most_likely(square: Array, sigma: Array, limits: DiagnosisParameters) -> tuple[str, float]:
    """The likeliest of FACTORS, and its log odds against the next; no name where nothing is known."""
    if not len(square):
        return "", 0.0
    likelihood = sorted(((_log_likelihood(square, sigma, f, limits), u) for u, f in FACTORS.items()), reverse=True)
    return likelihood[0][1], likelihood[0][0] - likelihood[1][0]


def _misfit(in_metres: PairFits, user: int) -> float:
    """How far (m) a user's ranges are from fitting with all lengths in metres, in the middle of its stretches."""
    mine = (in_metres.groups.users == user).any(axis=1) & np.isfinite(in_metres.spread)
    return float(np.median(in_metres.spread[mine])) if mine.any() else 0.0


def _alone(recording: Recording, in_metres: PairFits, user: int, parameters: Parameters) -> PairFits:
    """The fits to a user's stretches, its own factor free and the others' 1."""
    groups = in_metres.groups
    mine = (groups.users == user).any(axis=1)
    of = Groups(groups.users[mine], groups.row[mine], groups.there[mine])
    return fit_pairs(recording, of, parameters, of.users == user)


def _log_odds(square: Array, sigma: Array, factor: float, other: float, limits: DiagnosisParameters) -> float:
    return _log_likelihood(square, sigma, factor, limits) - _log_likelihood(square, sigma, other, limits)


def _log_likelihood(square: Array, sigma: Array, factor: float, limits: DiagnosisParameters) -> float:
    """Of squared factors (n,) where the true one is `factor`^2, to within a constant."""
    scale = np.hypot(limits.unit_fit_inflation * sigma, limits.unit_scale_sigma * factor**2)
    z, dof = (square - factor**2) / scale, limits.unit_fit_dof
    return float(np.sum(-0.5 * (dof + 1.0) * np.log1p(z**2 / dof) - np.log(scale)))


def _near(square: Array, factor: float, limits: DiagnosisParameters) -> Mask:
    """(n,) which squared factors agree with a factor."""
    return np.asarray(np.abs(np.log(np.maximum(square, 1e-300)) / 2.0 - np.log(factor)) < np.log(limits.unit_factor))


def _of_user(fits: PairFits, user: int) -> tuple[Array, Array]:
    mine = (fits.groups.users == user) & np.isfinite(fits.square)
    return fits.square[mine], fits.sigma[mine]


def _speed(track: Track, seconds: float) -> float:
    """m/s, the median of motion over so many `seconds`; 0 where the track is too short to tell."""
    end = np.searchsorted(track.t, track.t + seconds)
    begin = np.flatnonzero(end < len(track))
    if not len(begin):
        return 0.0
    end = end[begin]
    return float(
        np.median(np.linalg.norm(track.position[end] - track.position[begin], axis=1) / (track.t[end] - track.t[begin]))
    )
