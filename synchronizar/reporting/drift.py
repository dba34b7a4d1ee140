"""Drift of SLAM: its own track against the corrected one, in distance and heading."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.track import Track
from synchronizar.geometry import YawFrame
from synchronizar.quaternions import inverse_quaternions, multiply_quaternions, yaw_of_quaternions
from synchronizar.reporting.answer import Answer


@dataclass(frozen=True)
class Drift:
    """SLAM's own track against the corrected one, at each of n poses."""

    uncorrected: Track
    """SLAM's own track in the common frame, at the estimated scale, aligned to the corrected one at the first pose."""
    distance: Array
    """(n,) m between SLAM's position and the corrected one."""
    turn: Array
    """(n,) rad: corrected heading minus SLAM's, unwrapped over time."""


def common_from_user_at_start(answer: Answer, name: str) -> YawFrame:
    """A user's frame in the common one at its first pose; it differs from that at the last pose as SLAM drifts.

    A static radio has one frame for all times. The user must not be disconnected.
    """
    frame = answer.registration.users[name].common_from_user
    assert frame is not None
    if name not in answer.slam:
        return frame
    slam, corrected = answer.slam[name], answer.tracks[name]
    turned = YawFrame(yaw=float(_yaw_between(slam.quat_xyzw[:1], corrected.quat_xyzw[:1])[0]), scale=frame.scale)
    x, y, z = (corrected.position[0] - turned @ slam.position[0]).tolist()
    return replace(turned, x=x, y=y, z=z)


def drift_of(answer: Answer, name: str) -> Drift:
    """Drift of a user that is neither static nor disconnected."""
    slam, corrected, frame = answer.slam[name], answer.tracks[name], common_from_user_at_start(answer, name)
    uncorrected = replace(slam, position=frame @ slam.position, quat_xyzw=frame.rotate_quaternions(slam.quat_xyzw))
    return Drift(
        uncorrected,
        np.linalg.norm(corrected.position - uncorrected.position, axis=1),
        np.unwrap(_yaw_between(uncorrected.quat_xyzw, corrected.quat_xyzw)),
    )


def _yaw_between(before: Array, after: Array) -> Array:
    """(n,) rad within [-pi, pi): rotation about the vertical from attitudes (n, 4) to others (n, 4)."""
    return yaw_of_quaternions(multiply_quaternions(after, inverse_quaternions(before)))
