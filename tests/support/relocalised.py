"""Walks of one device whose SLAM relocalises, and tracks of real recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.paths import SHARED
from synchronizar.arrays import Array, Mask
from synchronizar.data.track import Track
from synchronizar.io.tum import read_tum
from synchronizar.quaternions import multiply_quaternions, rotate_by_quaternions, yaw_quaternion

RECORDINGS = SHARED / "recordings"

with_recordings = pytest.mark.skipif(
    not RECORDINGS.is_dir(), reason=f"{RECORDINGS} with the real recordings is not there"
)


def about(axis: int, angle: float) -> Array:
    """(4,) a turn about x, y or z."""
    q = np.zeros(4)
    q[axis], q[3] = np.sin(0.5 * angle), np.cos(0.5 * angle)
    return q


def walk(seconds: float = 10.0, hz: float = 20.0, speed: float = 1.0, turning: float = 0.0) -> Track:
    """Straight on, or along a circle that begins at the origin in the direction of x, facing forward."""
    t = np.arange(round(seconds * hz)) / hz
    yaw = turning * t
    x, y = (np.sin(yaw) / turning, (1.0 - np.cos(yaw)) / turning) if turning else (t, 0.0 * t)
    q = np.array([yaw_quaternion(each) for each in yaw.tolist()])
    return Track(t, speed * np.column_stack([x, y, 0.0 * t]), q)


def relocalised(track: Track, pose: int, shift: tuple[float, float, float], turn: Array | None = None) -> Track:
    """The track as SLAM gives it whose axes turn about the device at `pose` by `turn`, and which is off by `shift`."""
    turn = yaw_quaternion(0.0) if turn is None else turn
    position, q = track.position.copy(), track.quat_xyzw.copy()
    here = position[pose].copy()
    position[pose:] = here + shift + rotate_by_quaternions(turn, position[pose:] - here)
    q[pose:] = multiply_quaternions(turn, q[pose:])
    return Track(track.t, position, q)


def without(track: Track, keep: Mask) -> Track:
    return Track(track.t[keep], track.position[keep], track.quat_xyzw[keep])


def glitched(track: Track, poses: slice, turn: Array) -> Track:
    q = track.quat_xyzw.copy()
    q[poses] = multiply_quaternions(turn, q[poses])
    return replace(track, quat_xyzw=q)


def real(recording: str, user: str, folder: str = "tracks") -> Track:
    return read_tum(RECORDINGS / recording / folder / f"{user}.tum")
