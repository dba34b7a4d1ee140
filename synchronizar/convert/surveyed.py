"""Radios whose places a source tells: surveyed, as the recording has them (`position`)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from synchronizar.convert.assembling import listed
from synchronizar.convert.imported import Imported
from synchronizar.data.user import User
from synchronizar.io.text import MAX_LENGTH, MIN_SIGMA

_FURTHEST = 9999.0
"""m: numbers from here on say that a place is not known, as drivers have it."""


def add_surveyed(
    imported: Imported, places: Mapping[str, Sequence[float]], sigmas: Mapping[str, float] | None = None
) -> None:
    """Take places (x y z, m, z up) of static radios for surveyed, but those that several share or that are none."""
    known = {name: tuple(map(float, place)) for name, place in places.items() if _is_place(place)}
    shared = Counter(known.values())
    unset = sorted(name for name, place in known.items() if shared[place] > 1)
    if unset:
        imported.note(f"{listed(unset)}: told to be at one and the same place, so not taken for surveyed")
    taken = {name: place for name, place in known.items() if name not in unset}
    for name, (x, y, z) in taken.items():
        sigma = (sigmas or {}).get(name)
        sigma = None if sigma is None or not MIN_SIGMA <= sigma <= MAX_LENGTH else sigma
        user = imported.users.get(name, User(name))
        imported.users[name] = replace(user, static=True, position=(x, y, z), position_sigma=sigma)
    if taken:
        imported.note(f"{listed(sorted(taken))}: surveyed, so that the common frame is theirs")


def _is_place(place: Sequence[float]) -> bool:
    return bool(np.isfinite(place).all()) and max(map(abs, place)) < _FURTHEST
