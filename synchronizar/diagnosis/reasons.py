"""States that a finding explains say so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from synchronizar.data.findings import Code, Finding
from synchronizar.data.registration import Registration, State
from synchronizar.data.survey import SURVEY

CAUSES = (
    Code.TIME_UNIT,
    Code.TIME_OVERLAP,
    Code.NO_RANGES,
    Code.CLOCK,
    Code.RANGE_UNIT,
    Code.TRACK_UNIT,
    Code.UP_AXIS,
    Code.OPTICAL_AXES,
    Code.QUATERNION_ORDER,
    Code.SWAPPED_RADIOS,
    Code.SPARSE_POSES,
    Code.HEIGHT,
    Code.RANGE_BIAS,
    Code.NEVER_MOVES,
    Code.FROZEN_POSES,
)
"""What keeps a user from being registered, the gravest first."""
CONTRADICTS = (Code.SWAPPED_RADIOS,)
"""What leaves no doubt that a user is not where a solution has it; where it is the reference's, nobody is."""
SPOILS_TRACK = (Code.TRACK_UNIT, Code.UP_AXIS, Code.OPTICAL_AXES)
"""What leaves a track's lengths or directions wrong. A reference that somebody is registered beside is held to be right
all the same: a solution may have found its scale."""
CUTS_OFF = (Code.TIME_UNIT, Code.TIME_OVERLAP, Code.NO_RANGES, Code.RANGE_UNIT, Code.SWAPPED_RADIOS, Code.SPARSE_POSES)
"""What leaves a user without a usable range."""
OF_ALL = (Code.TIME_UNIT, Code.NO_RANGES, Code.CLOCK, Code.RANGE_UNIT)
"""What spoils everybody's where it is nobody's in particular."""


def with_reasons(registration: Registration, findings: Sequence[Finding]) -> Registration:
    """The registration with its findings, which stand before the reasons of users that are not registered.

    Who carries another's radio is not where the solution has it. A reference whose own track a finding contradicts is
    not registered where nobody is beside it. Of a user that is disconnected only what leaves it, or the reference,
    without ranges explains it.
    """
    reference = registration.reference
    users = {}
    doubted = {name for f in findings if f.code in CONTRADICTS for name in (f.user, *f.others)}
    registered = {name for name, user in registration.users.items() if user.state is State.REGISTERED}
    alone = registered == {reference}
    if reference == SURVEY and any(registration.users[name].static for name in registered if name in doubted):
        doubted.add(SURVEY)  # the survey's frame rests on them
    for name, user in registration.users.items():
        if user.state is State.REGISTERED and not doubted.isdisjoint((name, reference)):
            own = "its place" if name in doubted else "its place beside the reference"
            user = replace(user, state=State.UNOBSERVABLE, reason=f"{own} is that of another radio")
        if name == reference and alone and _cause(findings, name, SPOILS_TRACK) is not None:
            user = replace(user, state=State.UNOBSERVABLE, reason="nobody is placed beside it")
        if user.state is State.DISCONNECTED:
            cause, of_reference = (_cause(findings, who, CUTS_OFF) for who in (name, reference))
            if cause is not None:
                user = replace(user, reason=cause.message)
            elif of_reference is not None and of_reference.message not in user.reason:
                user = replace(user, reason=f"{user.reason}, {reference}: {of_reference.message}")
        elif user.state is not State.REGISTERED and (cause := _cause(findings, name, CAUSES)) is not None:
            user = replace(user, reason=f"{cause.message}; {user.reason}")
        users[name] = user
    return replace(registration, users=users, findings=tuple(findings))


def _cause(findings: Sequence[Finding], name: str | None, codes: Sequence[Code]) -> Finding | None:
    """The gravest of a user's own findings with these codes, else of those that are everybody's."""
    own = [
        f for f in findings if f.code in codes and (f.code in OF_ALL if f.user is None else name in (f.user, *f.others))
    ]
    return min(own, key=lambda f: (f.user is None, codes.index(f.code)), default=None)
