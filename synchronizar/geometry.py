"""Gravity-aligned frames and angles: mapping points and attitudes from one frame to another, on arrays.

Every frame is right-handed, z up unless stated otherwise, in m and rad.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, overload

import numpy as np
from numpy.typing import ArrayLike

from synchronizar.arrays import Array
from synchronizar.quaternions import inverse_quaternions, multiply_quaternions, yaw_quaternion

Up = Literal["z", "y"]
"""The vertical axis of a frame."""

Z_UP_FROM_Y_UP: Array = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""(3, 3): axes with y up (ARKit, ARCore, WebXR, OpenXR) into axes with z up: x = -z, y = -x, z = y."""
QUATERNION_Z_UP_FROM_Y_UP: Array = np.array([0.5, -0.5, -0.5, 0.5])
"""(4,) x y z w: the same rotation."""


@dataclass(frozen=True)
class YawFrame:
    """`a_from_b` of two gravity-aligned frames, each z up or y up.

    With both z up: p_a = Rz(yaw) (scale p_b) + (x, y, z); m and rad. Points of a y-up frame b are first converted to
    z up (x = -z, y = -x, z = y), results for a y-up frame a back to y up: each frame keeps its own axes.
    """

    x: float = 0.0
    """m; x, y, z and yaw are in z-up axes, also where a frame's own are y up."""
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0
    """rad."""
    scale: float = 1.0
    """Length in a over length in b."""
    up_b: Up = "z"
    """Vertical axis of b, in whose axes `a_from_b @ points` takes points."""
    up_a: Up = "z"
    """Vertical axis of a, in whose axes the results are."""

    @property
    def translation(self) -> Array:
        """(3,) m: the origin of b in a."""
        return _from_z_up(np.array([self.x, self.y, self.z]), self.up_a)

    @property
    def matrix(self) -> Array:
        """(4, 4) homogeneous matrix of `a_from_b`, scale included."""
        m = np.eye(4)
        m[:3, :3] = (self.apply(np.eye(3)) - self.translation).T
        m[:3, 3] = self.translation
        return m

    @property
    def z_up(self) -> YawFrame:
        """The same transform between z-up axes of both frames."""
        return replace(self, up_a="z", up_b="z")

    def inverse(self) -> YawFrame:
        """`b_from_a`."""
        origin = np.array([self.x, self.y, self.z])
        x, y, z = (-YawFrame(yaw=-self.yaw, scale=1.0 / self.scale).apply(origin)).tolist()
        return YawFrame(x, y, z, -self.yaw, 1.0 / self.scale, self.up_a, self.up_b)

    def apply(self, points: ArrayLike) -> Array:
        """(..., 3) m: points (..., 3) of b, in a. Raises ValueError for another shape."""
        p = np.asarray(points, dtype=float)
        if p.shape[-1:] != (3,):
            raise ValueError(f"points must have shape (..., 3), not {p.shape}")
        p = _to_z_up(p, self.up_b)
        out = np.empty(p.shape)
        out[..., :2] = self.scale * (p[..., :2] @ rotation_2d(self.yaw).T)
        out[..., 2] = self.scale * p[..., 2]
        return _from_z_up(out + np.array([self.x, self.y, self.z]), self.up_a)

    @overload
    def __matmul__(self, other: YawFrame) -> YawFrame: ...
    @overload
    def __matmul__(self, other: ArrayLike) -> Array: ...
    def __matmul__(self, other: YawFrame | ArrayLike) -> YawFrame | Array:
        """`a_from_b @ b_from_c` is `a_from_c`; `a_from_b @ points` (..., 3) are the points in a.

        Raises ValueError where the two transforms disagree on which axis of b points up.
        """
        if not isinstance(other, YawFrame):
            return self.apply(other)
        if self.up_b != other.up_a:
            raise ValueError(f"the frame in between is {self.up_b} up in the one and {other.up_a} up in the other")
        x, y, z = self.z_up.apply(np.array([other.x, other.y, other.z])).tolist()
        scale = self.scale * other.scale
        return YawFrame(x, y, z, wrap_angle(self.yaw + other.yaw), scale, other.up_b, self.up_a)

    def rotate_quaternions(self, quat_xyzw: Array) -> Array:
        """(n, 4) x y z w: attitudes (n, 4) in b, in a; body axes stay as they are."""
        rotation = yaw_quaternion(self.yaw)
        if self.up_b == "y":
            rotation = multiply_quaternions(rotation, QUATERNION_Z_UP_FROM_Y_UP)
        if self.up_a == "y":
            rotation = multiply_quaternions(inverse_quaternions(QUATERNION_Z_UP_FROM_Y_UP), rotation)
        return multiply_quaternions(rotation, quat_xyzw)


def _to_z_up(points: Array, up: Up) -> Array:
    """(..., 3) m: points in axes with `up` up, in axes with z up."""
    return points @ Z_UP_FROM_Y_UP.T if up == "y" else points


def _from_z_up(points: Array, up: Up) -> Array:
    """(..., 3) m: points in axes with z up, in axes with `up` up."""
    return points @ Z_UP_FROM_Y_UP if up == "y" else points


@overload
def wrap_angle(angle: float) -> float: ...
@overload
def wrap_angle(angle: Array) -> Array: ...
def wrap_angle(angle: float | Array) -> float | Array:
    """The same angle, or angles, in rad within [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def apply_frames(frames: Array, points: Array) -> Array:
    """(..., 3) m: points (..., 3), each of a frame (..., 4) x, y, z, yaw, in the frame that those are given in."""
    c, s = np.cos(frames[..., 3]), np.sin(frames[..., 3])
    x, y = points[..., 0], points[..., 1]
    out = frames[..., :3] + points
    out[..., 0] = frames[..., 0] + (c * x - s * y)
    out[..., 1] = frames[..., 1] + (s * x + c * y)
    return np.asarray(out)


def difference(frames: Array, others: Array) -> Array:
    """(..., 4): x, y, z (m) and yaw (rad, within [-pi, pi)) of frames minus those of others."""
    out = frames - others
    out[..., 3] = wrap_angle(out[..., 3])
    return np.asarray(out)


def rotation_2d(yaw: float) -> Array:
    """(2, 2) rotation matrix of yaw (rad)."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s], [s, c]])


def frame_between(points_a: Array, points_b: Array, weight: Array) -> YawFrame:
    """`a_from_b`, z up and of scale 1, by least squares of the same points (n, 3) in both, with weights (n,) of sum 1.

    The closed form of Umeyama (Least-squares estimation of transformation parameters between two point patterns, IEEE
    PAMI 1991) in the plane; heights are fitted by their means.
    """
    mean_a, mean_b = weight @ points_a, weight @ points_b
    a, b = points_a - mean_a, points_b - mean_b
    dot = weight @ (b[:, 0] * a[:, 0] + b[:, 1] * a[:, 1])
    cross = weight @ (b[:, 0] * a[:, 1] - b[:, 1] * a[:, 0])
    yaw = float(np.arctan2(cross, dot))
    x, y = (mean_a[:2] - rotation_2d(yaw) @ mean_b[:2]).tolist()
    return YawFrame(x, y, float(mean_a[2] - mean_b[2]), yaw)


def relative_to(frames: Array, reference: int) -> Array:
    """(k, 4) x, y, z, yaw: frames (k, 4) as seen from the one at index `reference`."""
    x, y, z, yaw = frames[reference]
    c, s = np.cos(yaw), np.sin(yaw)
    dx, dy = frames[:, 0] - x, frames[:, 1] - y
    out = np.stack([c * dx + s * dy, -s * dx + c * dy, frames[:, 2] - z, frames[:, 3] - yaw], axis=1)
    out[:, 3] = wrap_angle(out[:, 3])
    return out


def moved_frames(common: Array, frames: Array) -> Array:
    """(k, 4) x, y, z, yaw: frames (k, 4) of a frame at `common` (4,), in the frame that `common` is given in."""
    out = frames.copy()
    out[:, :3] = apply_frames(np.broadcast_to(common, out.shape), frames[:, :3])
    out[:, 3] = wrap_angle(frames[:, 3] + common[3])
    return out
