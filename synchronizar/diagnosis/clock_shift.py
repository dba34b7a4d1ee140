"""Clocks that are seconds off while tracks and ranges overlap: the shift with which ranges fit far better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from synchronizar.data.findings import Code, Finding
from synchronizar.data.recording import Recording
from synchronizar.diagnosis.pair_fits import Groups, PairFits, fit_pairs, groups_of
from synchronizar.parameters import Parameters


def clock_shift_findings(recording: Recording, parameters: Parameters) -> list[Finding]:
    """Of the one device, or of all (user None), whose clock is likely seconds off; nothing where that is not plain.

    The one shift that explains most is reported: of several clocks that are wrong each in its own way, none is.
    """
    limits = parameters.diagnosis
    groups = groups_of(recording, parameters)
    fits = fit_pairs(recording, groups, parameters, free=False)
    spread = fits.spread
    moving = [u for u, user in enumerate(recording.users) if not user.static and (groups.users == u).any()]
    if len(moving) > limits.shift_most_users or not np.isfinite(spread).any():
        return []
    best: tuple[float, list[int], float, float, float] | None = None
    for who in ([u] for u in moving) if len(moving) == 1 else (*([u] for u in moving), moving):
        mine = np.flatnonzero(np.isin(groups.users, who).any(axis=1) & np.isfinite(spread))
        if not len(mine) or np.median(spread[mine]) < limits.misfit:
            continue
        mine = mine[np.linspace(0, len(mine) - 1, min(len(mine), limits.shift_most_groups)).astype(int)]
        of = Groups(groups.users[mine], groups.row[mine], groups.there[mine])
        as_is = PairFits(of, fits.square[mine], fits.sigma[mine], fits.rows[mine], spread[mine])
        shift, left = _best_shift(recording, as_is, who, parameters)
        if left < limits.misfit_left and abs(shift) >= limits.shift_least and (best is None or left < best[0]):
            before = float(np.median(spread[mine]))
            best = left, who, shift, before, left * before
    if best is None:
        return []
    _, who, shift, before, after = best
    name = recording.users[who[0]].name if len(who) == 1 else None
    whose = "its clock is" if name is not None else "all devices' clocks are"
    side = "ahead of" if shift > 0.0 else "behind"
    change = "subtract {} from" if shift > 0.0 else "add {} to"
    return [
        Finding(
            Code.CLOCK,
            name,
            f"{whose} likely {abs(shift):.1f} s {side} that of the ranges: with that corrected the ranges "
            f"fit to {after:.2f} m, otherwise to {before:.2f} m",
            f"{change.format(f'{abs(shift):.2f} s')} the stamps of {'its track' if name is not None else 'all tracks'}",
        )
    ]


def _best_shift(recording: Recording, as_is: PairFits, who: list[int], parameters: Parameters) -> tuple[float, float]:
    """The shift (s) of these users' stamps with which most is gained, and the share of the misfit that it leaves."""
    longest, step = parameters.diagnosis.shift_longest, parameters.diagnosis.shift_step
    fine_step = parameters.diagnosis.shift_fine_step
    coarse = np.arange(-longest, longest + step, step)
    left = [_left(recording, as_is, who, float(shift), parameters) for shift in coarse]
    middle = float(coarse[int(np.argmin(left))])
    fine = middle + np.arange(-step, step + fine_step, fine_step)
    left = [_left(recording, as_is, who, float(shift), parameters) for shift in fine]
    return float(fine[int(np.argmin(left))]), float(np.min(left))


def _left(recording: Recording, as_is: PairFits, who: list[int], shift: float, parameters: Parameters) -> float:
    """The share of the misfit that is left, on average; 1 where half of the stretches or more lose their ranges.

    Fewer ranges fit better whatever the shift, so that stretches that lose more than a few do not count.
    """
    tracks = dict(recording.tracks)
    for u in who:
        name = recording.users[u].name
        tracks[name] = replace(tracks[name], t=tracks[name].t - shift)
    fits = fit_pairs(replace(recording, tracks=tracks), as_is.groups, parameters, free=False)
    share = fits.spread / as_is.spread
    known = np.isfinite(share) & (fits.rows >= parameters.diagnosis.shift_rows_kept * as_is.rows)
    return float(np.exp(np.log(np.maximum(share[known], 1e-9)).mean())) if 2 * known.sum() > len(share) else 1.0
