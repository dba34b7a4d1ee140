"""Entries of a survey that the ranges contradict."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.findings import Code, Finding
from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration, State
from synchronizar.parameters import Parameters

_NEAR = 0.25
"""Of the distance between two entries: how near to the other one each radio is that was exchanged; of what a third is
off without an exchange, how much may be left with it.

A mirror image may have one too low or too high.
"""


def survey_findings(recording: Recording, registration: Registration, parameters: Parameters) -> list[Finding]:
    """Of each surveyed radio that a solution has somewhere else than its entry says, or of two that were exchanged."""
    said, there = dict[str, Array](), dict[str, Array]()
    for user in recording.users:
        one = registration.users[user.name]
        if user.position is None or one.state is not State.UNOBSERVABLE or one.common_from_user is None:
            continue
        if np.linalg.norm(one.common_from_user.translation - user.position) >= parameters.integrity.survey_contradicted:
            said[user.name], there[user.name] = np.array(user.position), one.common_from_user.translation
    if pair := _exchanged_of_three(recording, said, there):
        (odd,) = said
        return [_exchanged(*pair, f"with that the ranges have {odd} where it was surveyed to be, otherwise not")]
    found, exchanged = [], set[str]()
    for a, b in combinations(said, 2):
        off = max(_apart(there[a], said[b]), _apart(there[b], said[a]))
        if off < _NEAR * _apart(said[a], said[b]):
            seen = f"their ranges have each where the other was surveyed to be, to within {off:.1f} m"
            found.append(_exchanged(a, b, seen))
            exchanged |= {a, b}
    return [*found, *(_elsewhere(name, said[name], there[name]) for name in said if name not in exchanged)]


def _apart(one: Array, other: Array) -> float:
    return float(np.linalg.norm(one - other))


def _exchanged_of_three(
    recording: Recording, said: Mapping[str, Array], there: Mapping[str, Array]
) -> tuple[str, str] | None:
    """The two of three surveyed radios that are likely exchanged, where the third alone is contradicted.

    Two fit an exchange of theirs too, all turned by half about their middle: then the third is where it was surveyed.
    """
    entries = {user.name: np.array(user.position) for user in recording.users if user.position is not None}
    if len(entries) != 3 or len(said) != 1:
        return None
    (odd,) = said
    a, b = (name for name in entries if name != odd)
    turned = entries[a][:2] + entries[b][:2] - there[odd][:2]
    return (a, b) if _apart(turned, said[odd][:2]) < _NEAR * _apart(there[odd], said[odd]) else None


def _exchanged(one: str, other: str, seen: str) -> Finding:
    return Finding(
        Code.SWAPPED_RADIOS,
        one,
        f"{one} and {other} are likely exchanged: {seen}",
        f"exchange `position` under [users.{one}] and [users.{other}] in recording.toml, or the two radios",
        (other,),
    )


def _elsewhere(name: str, said: Array, there: Array) -> Finding:
    entry, at = (", ".join(f"{x:.2f}" for x in place) for place in (said.tolist(), there.tolist()))
    return Finding(
        Code.SURVEY,
        name,
        f"its ranges say that it is at [{at}], {_apart(said, there):.1f} m from its position [{entry}]",
        f"survey it again, or correct `position` under [users.{name}] in recording.toml",
    )
