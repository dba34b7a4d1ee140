"""Two devices that carry each other's radio, found by what their ranges fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.findings import Code, Finding
from synchronizar.data.recording import Recording
from synchronizar.diagnosis.pair_fits import Groups, PairFits, fit_pairs
from synchronizar.parameters import DiagnosisParameters, Parameters


def swapped_radio_findings(recording: Recording, in_metres: PairFits, parameters: Parameters) -> list[Finding]:
    """Of the two devices (the finding is the first one's) whose ranges fit far better with their radios exchanged.

    By fits with all lengths in metres.
    """
    groups, spread, limits = in_metres.groups, in_metres.spread, parameters.diagnosis
    users = groups.users
    taking_part = [u for u in np.unique(users).tolist() if not recording.users[u].static]
    if len(taking_part) > limits.most_users or not len(users):
        return []
    best: tuple[float, int, int, float, float] | None = None
    for u, v in combinations(taking_part, 2):
        theirs = (users == u).any(axis=1) ^ (users == v).any(axis=1)
        affected, others = theirs & np.isfinite(spread), ~theirs & np.isfinite(spread)
        before = float(np.median(spread[affected])) if affected.any() else 0.0
        if affected.sum() < limits.fewest_stretches or before < _misfit(spread[others], limits):
            continue
        of = Groups(users[affected], groups.row[affected], groups.there[affected])
        exchanged = fit_pairs(recording, of, parameters, free=False, swapped=(u, v)).spread
        share = exchanged / np.maximum(spread[affected], 1e-9)
        if np.isnan(share).any() or share.max() > limits.swap_worse:
            continue
        left = float(np.exp(np.log(np.maximum(share, 1e-9)).mean()))
        if left < limits.misfit_left and (best is None or left < best[0]):
            best = left, u, v, before, float(np.median(exchanged))
    if best is None:
        return []
    _, u, v, before, after = best
    one, other = recording.users[u].name, recording.users[v].name
    return [
        Finding(
            Code.SWAPPED_RADIOS,
            one,
            f"{one} and {other} likely carry each other's radio: with the two names exchanged their "
            f"ranges fit to {after:.2f} m, otherwise to {before:.2f} m",
            f"exchange the names {one} and {other} in ranges.csv",
            (other,),
        )
    ]


def _misfit(others: Array, limits: DiagnosisParameters) -> float:
    """How far (m) ranges are from fitting if radios are exchanged, by the fits of those that stay the same (n,).

    Good radios in a small room fit to centimetres even where they are exchanged, only not as well as the others.
    """
    return min(limits.misfit, float(np.median(others)) / limits.misfit_left) if len(others) else limits.misfit


def without_swapped_radios(recording: Recording, found: Sequence[Finding]) -> Recording:
    """The same recording, with NaN for the ranges of devices that were `found` to carry each other's radio.

    They would lay themselves elsewhere, and bend everybody else's track towards it.
    """
    who = {name for f in found if f.code is Code.SWAPPED_RADIOS for name in (f.user, *f.others)}
    if not who:
        return recording
    r = recording.ranges
    theirs = np.array([user.name in who for user in recording.users])
    return replace(recording, ranges=replace(r, distance=np.where(theirs[r.a] | theirs[r.b], np.nan, r.distance)))
