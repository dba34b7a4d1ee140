"""Takes devices' poses to the common frame: all at once, by frames that change less often than anybody moves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from synchronizar.geometry import QUATERNION_Z_UP_FROM_Y_UP
from synchronizar.live.messages import Quaternion, UserFrame, Vector
from synchronizar.live.pose_wire import DOWN, STATES
from synchronizar.quaternions import IDENTITY, multiply_quaternions, yaw_quaternions

OwnPose = tuple[float, Vector, Quaternion]
"""s by the room's clock; position and attitude in the device's own axes."""
AT_ITS_ORIGIN: OwnPose = (np.inf, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
"""What stands still, at any time."""


class Shown(NamedTuple):
    """A device whose frame is known."""

    member: int
    frame: UserFrame
    y_up: bool
    static: bool


class Placing:
    """Where devices are in the common frame, while their frames stay as they are."""

    def __init__(self, shown: Sequence[Shown]) -> None:
        n = len(shown)
        self._matrix = np.array([one.frame.matrix for one in shown], dtype=float).reshape(n, 4, 4)
        turned = yaw_quaternions(np.array([one.frame.yaw or 0.0 for one in shown]))
        tilted = np.array([QUATERNION_Z_UP_FROM_Y_UP if one.y_up and not one.static else IDENTITY for one in shown])
        self._rotation = multiply_quaternions(turned, tilted.reshape(n, 4))
        self._rows = np.zeros(n, DOWN)
        self._rows["member"] = [one.member for one in shown]
        self._rows["state"] = [STATES.index(one.frame.state) for one in shown]
        self._rows["frame"] = [one.frame.frame for one in shown]

    def rows(self, t: float, poses: Sequence[OwnPose | None]) -> NDArray[np.void]:
        """Those of its devices, in their order, that have a pose, at `t` (s)."""
        there = [n for n, pose in enumerate(poses) if pose is not None]
        rows = self._rows[there]
        if not there:
            return rows
        stamp, position, quat = map(np.array, zip(*(pose for pose in poses if pose is not None), strict=True))
        matrix = self._matrix[there]
        rows["age"] = np.maximum(0.0, t - stamp)
        rows["position"] = np.einsum("nij,nj->ni", matrix[:, :3, :3], position) + matrix[:, :3, 3]
        unit = quat / np.linalg.norm(quat, axis=1, keepdims=True)
        rows["quat_xyzw"] = multiply_quaternions(self._rotation[there], unit)
        return rows
