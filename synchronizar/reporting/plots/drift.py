"""What the answer corrected of a walk: SLAM's own track beside it, how far apart they are, and how turned."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.track import Track
from synchronizar.geometry import YawFrame
from synchronizar.quaternions import inverse_quaternions, multiply_quaternions, yaw_of_quaternions
from synchronizar.reporting.plots.answer import Answer


@dataclass(frozen=True)
class Drift:
    """SLAM's own track against the corrected one, pose by pose."""

    uncorrected: Track
    """SLAM's own track in the common frame, at the estimated scale: it begins where the corrected one does."""
    distance: Array
    """(n,) m from the corrected position."""
    turn: Array
    """(n,) rad: how far, to the left, the correction turned the heading; continuous in time."""


def common_from_user_at_start(answer: Answer, name: str) -> YawFrame:
    """The frame of a placed user at its first pose; SLAM may drift and jump away from it.

    A static radio has one frame at all times.
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
    """Of a user that walks and has a placement."""
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
