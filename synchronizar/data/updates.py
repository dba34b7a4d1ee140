"""Registration while people walk: the state of every user at each update."""

from __future__ import annotations

from typing import NamedTuple

from synchronizar.arrays import Array
from synchronizar.data.registration import Registration, State
from synchronizar.data.track import Track
from synchronizar.geometry import YawFrame


class UserUpdate(NamedTuple):
    """One user at one update."""

    state: State
    common_from_user: YawFrame | None
    """Its frame in the common frame at its last pose; None where it is disconnected."""
    covariance: Array | None
    """(4, 4) of additive errors in x, y, z (m) and yaw (rad), as of the last solve; None where unknown."""
    progress: float
    """0 to 1: how near it is to being registered."""
    static: bool
    """Whether it is a static radio, which has no heading."""
    cue: str | None
    """The walk that would reduce the uncertainty most, as a sentence; None where none is needed."""


class Update(NamedTuple):
    """All users at one moment."""

    t: float
    """s, range clock."""
    seconds: float
    """s: wall time that the update took."""
    users: dict[str, UserUpdate]
    events: list[str]
    """What changed with this update, one sentence each."""


class Replay(NamedTuple):
    """The result of a replay."""

    updates: list[Update]
    tracks: dict[str, Track]
    """Causal tracks in the common frame: each pose as known at its own moment, where its user was registered then."""
    registration: Registration
    """At the end."""
