"""A device's own pose in the common frame, by what the room tells of its frame."""

from __future__ import annotations

from typing import Literal

import numpy as np

from synchronizar.arrays import Array
from synchronizar.geometry import YawFrame
from synchronizar.live.messages import Quaternion, UserFrame, Vector
from synchronizar.quaternions import multiply_quaternions, yaw_quaternion


def told_frame(told: UserFrame | None, up: Literal["y", "z"], number: int) -> YawFrame | None:
    """`common_from_user` of a device's SLAM frame of that number, from the device's own axes; None: not known."""
    if told is None or told.matrix is None or told.frame != number:
        return None
    assert told.x is not None
    assert told.y is not None
    assert told.z is not None
    return YawFrame(told.x, told.y, told.z, told.yaw or 0.0, told.scale, up)


def placed(frame: YawFrame, position: Vector, quat_xyzw: Quaternion) -> tuple[Vector, Quaternion]:
    """A pose in the device's own axes, in the common frame."""
    x, y, z = (frame @ np.array(position)).tolist()
    quat: Array = np.array(quat_xyzw, dtype=float)
    quat = quat / np.linalg.norm(quat)
    if frame.up_b != "z":
        quat = YawFrame(up_b=frame.up_b).rotate_quaternions(quat)
    qx, qy, qz, qw = multiply_quaternions(yaw_quaternion(frame.yaw), quat).tolist()
    return (x, y, z), (qx, qy, qz, qw)
