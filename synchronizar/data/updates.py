"""What is told while people walk, moment by moment."""

from __future__ import annotations

from typing import NamedTuple

from synchronizar.arrays import Array
from synchronizar.data.registration import Registration, State
from synchronizar.data.track import Track
from synchronizar.geometry import YawFrame


class UserUpdate(NamedTuple):
    """One user at one moment."""

    state: State
    common_from_user: YawFrame | None
    """At its last pose."""
    covariance: Array | None
    """(4, 4) of x, y, z (m) and yaw (rad), as of the last solve."""
    progress: float
    """0 .. 1: how near it is to being registered."""
    static: bool
    """A radio that stands still has no heading."""
    cue: str | None
    """Which way to walk, where that would tell what is not known yet."""


class Update(NamedTuple):
    """What was known at one moment."""

    t: float
    """s, range clock."""
    seconds: float
    """How long it took."""
    users: dict[str, UserUpdate]
    events: list[str]


class Replay(NamedTuple):
    """All that was known, each thing at its own time."""

    updates: list[Update]
    tracks: dict[str, Track]
    """In the common frame: each pose as it was known at its moment, of users that were registered then."""
    registration: Registration
    """At the end."""
