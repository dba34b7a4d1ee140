"""What goes out to ROS, as JSON: transforms, poses with covariance, diagnostics."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from synchronizar.arrays import Array
from synchronizar.convert.axes import quaternions_of_matrices
from synchronizar.live.messages import Quaternion, UserFrame, Vector

TF, POSE, DIAGNOSTICS = (
    "tf2_msgs/TFMessage",
    "geometry_msgs/PoseWithCovarianceStamped",
    "diagnostic_msgs/DiagnosticArray",
)
OK, WARN, ERROR, STALE = 0, 1, 2, 3
"""Levels of diagnostics."""


def ros_name(name: str) -> str:
    """A device's name as a part of a topic may be: letters, digits and underscores, no digit first."""
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return plain if re.match(r"[A-Za-z]", plain) else f"_{plain}"


def header(stamp: float, frame_id: str) -> dict[str, Any]:
    """std_msgs/Header; `stamp`: s."""
    nanoseconds = round(stamp * 1e9)
    return {"stamp": {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}, "frame_id": frame_id}


def common_from_ros(told: UserFrame, ros: Vector, position: Vector, own_from_ros: Array) -> tuple[Array, Array]:
    """(3,) m and (4,) x y z w: the robot's frame in the common one, as TF has it, without a scale.

    A robot's odometry measures lengths a little wrong, which `told` knows and TF cannot say: the transform is right
    where the robot is, at `ros` in its frame, which is `position` in the axes that the room has of it. `own_from_ros`:
    (3, 3), from axes of ROS's frame to those.
    """
    matrix = np.array(told.matrix)
    rotation = matrix[:3, :3] / np.cbrt(np.linalg.det(matrix[:3, :3])) @ own_from_ros
    place = matrix[:3, :3] @ np.array(position) + matrix[:3, 3]
    return place - rotation @ np.array(ros), quaternions_of_matrices(rotation[None])[0]


def transform(stamp: float, common: str, child: str, translation: Array, quat_xyzw: Array) -> dict[str, Any]:
    """tf2_msgs/TFMessage of one transform."""
    turn = dict(zip("xyzw", quat_xyzw.tolist(), strict=True))
    of = {"translation": dict(zip("xyz", translation.tolist(), strict=True)), "rotation": turn}
    return {"transforms": [{"header": header(stamp, common), "child_frame_id": child, "transform": of}]}


def covariance_at(told: UserFrame, position: Vector) -> list[float]:
    """(36,) m², rad² over x, y, z, roll, pitch, yaw of a pose in the common frame, row by row.

    `position`: where the device is in its own axes. Errors of its frame's place and yaw add up there; those of roll and
    pitch are SLAM's own and small, and nobody has told them: 0.
    """
    out = np.zeros((6, 6))
    if told.covariance is None or told.matrix is None:
        return out.ravel().tolist()
    known = np.array([[np.nan if x is None else x for x in row] for row in told.covariance])
    arm = np.array(told.matrix)[:3, :3] @ np.array(position)
    by_frame = np.eye(4)
    by_frame[0, 3], by_frame[1, 3] = -arm[1], arm[0]
    there = by_frame @ np.nan_to_num(known) @ by_frame.T
    rows = np.array([0, 1, 2, 5])
    out[np.ix_(rows, rows)] = there
    return out.ravel().tolist()


def covariance_of_sigma(sigma: float) -> list[float]:
    """(36,) m² of a place that is known to `sigma` (m, 1 sigma) on each axis, row by row; attitudes: 0, not known."""
    return np.diag([sigma * sigma] * 3 + [0.0] * 3).ravel().tolist()


def pose(stamp: float, common: str, position: Vector, quat_xyzw: Quaternion, covariance: list[float]) -> dict[str, Any]:
    """geometry_msgs/PoseWithCovarianceStamped."""
    place, turn = dict(zip("xyz", position, strict=True)), dict(zip("xyzw", quat_xyzw, strict=True))
    told = {"pose": {"position": place, "orientation": turn}, "covariance": covariance}
    return {"header": header(stamp, common), "pose": told}


def status(name: str, level: int, message: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """diagnostic_msgs/DiagnosticStatus; what is None is left out."""
    told = [{"key": key, "value": _text(value)} for key, value in values.items() if value is not None]
    return {"level": level, "name": f"synchronizar: {name}", "hardware_id": name, "message": message, "values": told}


def diagnostics(stamp: float, statuses: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """diagnostic_msgs/DiagnosticArray."""
    return {"header": header(stamp, ""), "status": list(statuses)}


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
