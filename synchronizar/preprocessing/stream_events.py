"""What a stream of poses tells of itself on the way, and the same as numbers."""

from __future__ import annotations

from dataclasses import astuple
from typing import Literal, NamedTuple

from synchronizar.data.jump import Jump


class Suspicion(NamedTuple):
    """Why the poses from some moment on may not be where SLAM says."""

    t: float
    """s: the first pose in doubt."""
    kind: Literal["jump", "frozen"]
    distance: float
    """m: how far the position is from what the last steps allow."""
    turn: float
    """rad: the same of the attitude."""


class Dismissed(NamedTuple):
    """A suspicion that what came next did not confirm."""

    t: float
    """s: the pose that was in doubt."""


class Levelled(NamedTuple):
    """SLAM's vertical from some pose on held longer than the one before: from there on the track is level by it."""

    t: float
    """s: the first pose that is levelled by it; the path goes on."""
    tilt: float
    """rad: how far the track before is from level."""
    lift: float
    """m: SLAM's own height there, by which a batch repair begins, minus the track's."""


class SetAside(NamedTuple):
    """Poses that are left out."""

    first: float
    """s: the earliest stamp among them, ..."""
    last: float
    """... and the latest."""
    poses: int
    """How many."""
    reason: Literal["stray", "frozen"]


Event = Jump | Dismissed | Levelled | SetAside

_EVENTS = (Jump, Dismissed, Levelled, SetAside)
_REASONS: tuple[Literal["stray", "frozen"], ...] = ("stray", "frozen")
_SUSPICIONS: tuple[Literal["jump", "frozen"], ...] = ("jump", "frozen")


def suspicion_numbers(suspicion: Suspicion) -> list[float]:
    """The fields, the kind by its place among all."""
    return [suspicion.t, float(_SUSPICIONS.index(suspicion.kind)), suspicion.distance, suspicion.turn]


def suspicion_of(numbers: list[float]) -> Suspicion:
    """The suspicion that `suspicion_numbers` tells."""
    t, kind, distance, turn = numbers
    return Suspicion(t, _SUSPICIONS[int(kind)], distance, turn)


def event_numbers(event: Event) -> list[float]:
    """Six numbers: the kind of the event, and its fields, words by their place among all."""
    if isinstance(event, SetAside):
        numbers = [event.first, event.last, float(event.poses), float(_REASONS.index(event.reason))]
    else:
        numbers = [float(value) for value in (astuple(event) if isinstance(event, Jump) else event)]
    return [float(_EVENTS.index(type(event))), *numbers, *[0.0] * (5 - len(numbers))]


def event_of(numbers: list[float]) -> Event:
    """The event that `event_numbers` tells."""
    kind, fields = _EVENTS[int(numbers[0])], numbers[1:]
    if kind is Jump:
        return jump_of(fields)
    if kind is Dismissed:
        return Dismissed(fields[0])
    if kind is Levelled:
        return Levelled(*fields[:3])
    return SetAside(fields[0], fields[1], int(fields[2]), _REASONS[int(fields[3])])


def jump_of(fields: list[float]) -> Jump:
    """The jump that has these fields."""
    return Jump(fields[0], int(fields[1]), *fields[2:])
