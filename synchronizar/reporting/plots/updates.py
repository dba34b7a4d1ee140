"""What a replay told while people walked, read from where `replay --out` wrote it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.errors import InputError, os_faults
from synchronizar.io.text import open_text
from synchronizar.reporting.plots.answer import MALFORMED


@dataclass(frozen=True)
class UserHistory:
    """One user at each of n updates; NaN where a number was not known."""

    static: bool
    states: list[State]
    cues: list[str | None]
    progress: Array
    """(n,) 0 .. 1."""
    sigma_xy: Array
    """(n,) m: 1 sigma in the plane, the longest way, of where the user itself was then."""
    sigma_yaw: Array
    """(n,) rad: 1 sigma of its heading."""


@dataclass(frozen=True)
class History:
    """All that was told, in the order of time."""

    t: Array
    """(n,) s since the first range."""
    events: list[tuple[float, str]]
    """When (s since the first range), and what."""
    users: Mapping[str, UserHistory]


class _Said(NamedTuple):
    """Of a user in one line."""

    state: State
    cue: str | None
    progress: float
    yaw: float
    scale: float
    covariance: Array
    """(4, 4)"""


def read_history(file: Path, recording: Recording) -> History:
    """What `replay --out` wrote into updates.jsonl about a recording.

    Raises InputError where the file is missing, a line of it is broken, or it is about other users.
    """
    names = {user.name for user in recording.users}
    t: list[float] = []
    events: list[tuple[float, str]] = []
    said: dict[str, list[_Said]] = {user.name: [] for user in recording.users}
    with os_faults(file), open_text(file) as lines:
        for number, text in enumerate(lines, start=1):
            try:
                line = json.loads(text)
                t.append(_later(line["t"], t))
                events += [(t[-1], str(event)) for event in line["events"]]
                users = {name: _said(user) for name, user in line["users"].items()}
            except MALFORMED as error:
                raise InputError(file, "is no update of a replay", number) from error
            if users.keys() != names:
                raise InputError(file, "is about another recording: its users are not the same", number)
            for name, user in users.items():
                said[name].append(user)
    stamps = np.array(t)
    began = float(recording.ranges.t.min()) if len(recording.ranges) else 0.0
    return History(
        stamps - began,
        [(at - began, event) for at, event in events],
        {u.name: _history(u, recording.tracks.get(u.name), stamps, said[u.name]) for u in recording.users},
    )


def _later(said: Any, before: list[float]) -> float:
    t = float(said)
    if not np.isfinite(t) or (before and t <= before[-1]):
        raise ValueError(said)
    return t


def _said(user: Mapping[str, Any]) -> _Said:
    progress = float(user["progress"])
    if not 0.0 <= progress <= 1.0:
        raise ValueError(progress)
    covariance = np.full((4, 4), np.nan)
    if user["covariance"] is not None:
        covariance = np.array(user["covariance"], dtype=float)
    if covariance.shape != (4, 4):
        raise ValueError(covariance)
    cue = None if user["cue"] is None else str(user["cue"])
    yaw, scale = 0.0 if user["yaw"] is None else float(user["yaw"]), float(user["scale"])
    if not np.isfinite([yaw, scale]).all():
        raise ValueError(user)
    return _Said(State(user["state"]), cue, progress, yaw, scale, covariance)


def _history(user: User, track: Track | None, t: Array, said: list[_Said]) -> UserHistory:
    covariance = np.array([of.covariance for of in said]).reshape(-1, 4, 4)
    lever = np.zeros((len(t), 2))
    if track is not None:
        # By the ranges' clock: how sure a place is does not change in the tenth of a second that clocks differ by.
        last = np.maximum(np.searchsorted(track.t, t, side="right") - 1, 0)
        yaw, scale = np.array([of.yaw for of in said]), np.array([of.scale for of in said])
        along, across = track.position[last, :2].T
        lever = np.column_stack(
            [np.cos(yaw) * along - np.sin(yaw) * across, np.sin(yaw) * along + np.cos(yaw) * across]
        )
        lever *= scale[:, None]
    yaw_variance = np.full(len(t), np.nan) if user.static else covariance[:, 3, 3]
    return UserHistory(
        user.static,
        [of.state for of in said],
        [of.cue for of in said],
        np.array([of.progress for of in said]),
        _longest_sigma(covariance, lever),
        np.sqrt(np.maximum(yaw_variance, 0.0)),
    )


def _longest_sigma(covariance: Array, lever: Array) -> Array:
    """(n,) m in the plane, of places `lever` (n, 2) m away from origins whose frames have `covariance` (n, 4, 4)."""
    x, y = lever.T
    turning = np.column_stack([-y, x])
    plane = covariance[:, :2, :2].copy()
    if np.any(lever):
        cross = turning[:, :, None] * covariance[:, None, 3, :2]
        plane += cross + cross.transpose(0, 2, 1)
        plane += turning[:, :, None] * turning[:, None, :] * covariance[:, 3, 3, None, None]
    xx, yy, xy = plane[:, 0, 0], plane[:, 1, 1], plane[:, 0, 1]
    return np.asarray(np.sqrt(np.maximum((xx + yy) / 2.0 + np.hypot((xx - yy) / 2.0, xy), 0.0)))
