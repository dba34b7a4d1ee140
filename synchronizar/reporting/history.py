"""A replay as the timeline needs it: each user's state, progress, cue and 1 sigma at every update."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.data.track import Track
from synchronizar.data.updates import Update, UserUpdate


@dataclass(frozen=True)
class UserHistory:
    """One user at each of n updates; NaN where a number was not known."""

    static: bool
    states: list[State]
    cues: list[str | None]
    progress: Array
    """(n,) 0 .. 1."""
    sigma_xy: Array
    """(n,) m: 1 sigma of the user's own position then, along the longest axis of its ellipse in the plane."""
    sigma_yaw: Array
    """(n,) rad: 1 sigma of its frame's yaw."""


@dataclass(frozen=True)
class History:
    """All n updates of a replay, in the order of time."""

    t: Array
    """(n,) s since the first range."""
    events: list[tuple[float, str]]
    """Time (s since the first range) and text of each."""
    users: Mapping[str, UserHistory]


def history_of(updates: Sequence[Update], recording: Recording) -> History:
    """The history of a replay of a recording, from its updates."""
    t = np.array([update.t for update in updates])
    began = float(recording.ranges.t.min()) if len(recording.ranges) else 0.0
    return History(
        t - began,
        [(update.t - began, event) for update in updates for event in update.events],
        {
            user.name: _user_history(
                user.static, recording.tracks.get(user.name), t, [update.users[user.name] for update in updates]
            )
            for user in recording.users
        },
    )


def _user_history(static: bool, track: Track | None, t: Array, updates: list[UserUpdate]) -> UserHistory:
    unknown = np.full((4, 4), np.nan)
    covariance = np.array([unknown if of.covariance is None else of.covariance for of in updates]).reshape(-1, 4, 4)
    lever = np.zeros((len(t), 2))
    if track is not None:
        # At stamps of the range clock: sigma changes little within a clock offset of a tenth of a second.
        last = np.maximum(np.searchsorted(track.t, t, side="right") - 1, 0)
        frames = [of.common_from_user for of in updates]
        yaw = np.array([0.0 if frame is None else frame.yaw for frame in frames])
        scale = np.array([1.0 if frame is None else frame.scale for frame in frames])
        along, across = track.position[last, :2].T
        lever = np.column_stack(
            [np.cos(yaw) * along - np.sin(yaw) * across, np.sin(yaw) * along + np.cos(yaw) * across]
        )
        lever *= scale[:, None]
    yaw_variance = np.full(len(t), np.nan) if static else covariance[:, 3, 3]
    return UserHistory(
        static,
        [of.state for of in updates],
        [of.cue for of in updates],
        np.array([of.progress for of in updates]),
        _longest_sigma(covariance, lever),
        np.sqrt(np.maximum(yaw_variance, 0.0)),
    )


def _longest_sigma(covariance: Array, lever: Array) -> Array:
    """(n,) m: 1 sigma along the longest axis in the plane, of points at `lever` (n, 2) m from origins of frames.

    `covariance` (n, 4, 4) is that of the frames' x, y, z, yaw.
    """
    x, y = lever.T
    turning = np.column_stack([-y, x])
    plane = covariance[:, :2, :2].copy()
    if np.any(lever):
        cross = turning[:, :, None] * covariance[:, None, 3, :2]
        plane += cross + cross.transpose(0, 2, 1)
        plane += turning[:, :, None] * turning[:, None, :] * covariance[:, 3, 3, None, None]
    xx, yy, xy = plane[:, 0, 0], plane[:, 1, 1], plane[:, 0, 1]
    return np.asarray(np.sqrt(np.maximum((xx + yy) / 2.0 + np.hypot((xx - yy) / 2.0, xy), 0.0)))
