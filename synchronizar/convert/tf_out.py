"""Writes an answer as ROS's static transforms: a message for /tf_static, or a launch file of ROS 2.

Each is `common` -> `<user>/slam`, the frame that the user's own SLAM has its poses in, at the user's last pose: what
takes points in that frame, y up where it is y up, to the common one. Only registered users are written, the others are
named in a comment with the reason. TF knows no scale: where SLAM's is not 1 the comment tells it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from synchronizar.data.exported import Exported
from synchronizar.data.registration import Registration, State
from synchronizar.errors import InputError, os_faults
from synchronizar.quaternions import IDENTITY

COMMON = "common"


class _Transform(NamedTuple):
    """`common_from_slam` of one user."""

    child: str
    translation: list[float]
    """m."""
    quat_xyzw: list[float]
    remark: str


def write_tf_yaml(path: Path, exported: Exported) -> None:
    """Write a tf2_msgs/TFMessage as YAML. Raises InputError where there is no answer, or it cannot be written."""
    lines = [*_remarks(path, exported.registration), "transforms:"]
    for transform in _transforms(path, exported.registration):
        translation = ", ".join(f"{axis}: {_plain(x)}" for axis, x in zip("xyz", transform.translation, strict=True))
        rotation = ", ".join(f"{axis}: {_plain(x)}" for axis, x in zip("xyzw", transform.quat_xyzw, strict=True))
        lines += [
            f"  # {transform.remark}",
            f'  - header: {{stamp: {{sec: 0, nanosec: 0}}, frame_id: "{COMMON}"}}',
            f"    child_frame_id: {json.dumps(transform.child)}",
            "    transform:",
            f"      translation: {{{translation}}}",
            f"      rotation: {{{rotation}}}",
        ]
    if lines[-1] == "transforms:":
        lines[-1] = "transforms: []"
    _write(path, lines)


def write_tf_launch(path: Path, exported: Exported) -> None:
    """Write a launch file of ROS 2, one static_transform_publisher a user. Raises InputError as the YAML does."""
    rows: list[str] = []
    for transform in _transforms(path, exported.registration):
        numbers = ", ".join(map(_plain, (*transform.translation, *transform.quat_xyzw)))
        rows += [f"    # {transform.remark}", f"    ({transform.child!r}, ({numbers})),"]
    lines = [
        *_remarks(path, exported.registration),
        "from launch import LaunchDescription",
        "from launch_ros.actions import Node",
        "",
        "TRANSFORMS = [  # child frame; x y z (m), qx qy qz qw",
        *rows,
        "]",
        'OPTIONS = ("--x", "--y", "--z", "--qx", "--qy", "--qz", "--qw")',
        "",
        "",
        "def generate_launch_description():",
        "    return LaunchDescription(",
        "        [",
        "            Node(",
        '                package="tf2_ros",',
        '                executable="static_transform_publisher",',
        '                name=f"common_from_slam_{number}",',
        "                arguments=[",
        "                    *(text for option, x in zip(OPTIONS, numbers) for text in (option, str(x))),",
        f'                    *("--frame-id", "{COMMON}", "--child-frame-id", child),',
        "                ],",
        "            )",
        "            for number, (child, numbers) in enumerate(TRANSFORMS)",
        "        ]",
        "    )",
    ]
    _write(path, lines)


def _transforms(path: Path, registration: Registration | None) -> Iterator[_Transform]:
    for name, user in _answer(path, registration).users.items():
        frame = user.common_from_user
        if user.state is not State.REGISTERED or frame is None:
            continue
        rotation = np.asarray(IDENTITY, dtype=float)[None, :]
        quat = rotation if user.static else frame.rotate_quaternions(rotation)
        remark = f"{name!r} at its last pose"
        if abs(frame.scale - 1.0) > 1e-9:
            remark += f"; its points have to be multiplied by {frame.scale:.6g} before, which TF cannot say"
        yield _Transform(f"{name}/slam", frame.translation.tolist(), quat[0].tolist(), remark)


def _remarks(path: Path, registration: Registration | None) -> Iterator[str]:
    answer = _answer(path, registration)
    yield f"# What synchronizar registered, reference {answer.reference!r}: m, quaternions x y z w, z up."
    for name, user in answer.users.items():
        if user.state is not State.REGISTERED:
            yield f"# Left out: {name!r} is {user.state}: {' '.join(user.reason.split())}"


def _answer(path: Path, registration: Registration | None) -> Registration:
    if registration is None:
        raise InputError(path, "needs an answer, whose transforms it holds: say --answer DIR")
    return registration


def _plain(x: float) -> str:
    """A number that YAML's and Python's readers take for one with a fraction."""
    return f"{x + 0.0:.9f}"


def _write(path: Path, lines: list[str]) -> None:
    with os_faults(path):
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
