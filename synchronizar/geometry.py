"""Gravity-aligned frames and the little quaternion arithmetic that tracks need, on arrays.

Every frame is right-handed and z up unless it says otherwise. Quaternions are unit, x y z w, and turn body axes into
the frame's axes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, overload

import numpy as np
from numpy.typing import ArrayLike

from synchronizar.arrays import Array
from synchronizar.quaternions import inverse_quaternions, multiply_quaternions, yaw_quaternion

Up = Literal["z", "y"]
"""Which axis of a frame points up."""

# Rows are the axes of z-up in those of y-up (ARKit, ARCore, WebXR, OpenXR): x = -z, y = -x, z = y.
Z_UP_FROM_Y_UP: Array = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
QUATERNION_Z_UP_FROM_Y_UP: Array = np.array([0.5, -0.5, -0.5, 0.5])


@dataclass(frozen=True)
class YawFrame:
    """`a_from_b` of two gravity-aligned frames, each z up or y up.

    With both z up: p_a = Rz(yaw) (scale p_b) + (x, y, z); m and rad. Points of a y-up frame are brought to z up before
    (x = -z, y = -x, z = y) and results for one back after, so points and attitudes are always in each frame's own axes.
    """

    x: float = 0.0
    """m; this and y, z, yaw are in z-up axes, whatever the frames' own are."""
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0
    """rad."""
    scale: float = 1.0
    """Lengths in a for each in b."""
    up_b: Up = "z"
    """Which axis of b points up: `a_from_b @ points` takes points in these axes."""
    up_a: Up = "z"
    """Which axis of a points up."""

    @property
    def translation(self) -> Array:
        """(3,) m: the origin of b in a."""
        return _from_z_up(np.array([self.x, self.y, self.z]), self.up_a)

    @property
    def matrix(self) -> Array:
        """(4, 4) homogeneous matrix of the same map, scale included."""
        m = np.eye(4)
        m[:3, :3] = (self.apply(np.eye(3)) - self.translation).T
        m[:3, 3] = self.translation
        return m

    @property
    def z_up(self) -> YawFrame:
        """The same frames with both read z up."""
        return replace(self, up_a="z", up_b="z")

    def inverse(self) -> YawFrame:
        """`b_from_a`."""
        origin = np.array([self.x, self.y, self.z])
        x, y, z = (-YawFrame(yaw=-self.yaw, scale=1.0 / self.scale).apply(origin)).tolist()
        return YawFrame(x, y, z, -self.yaw, 1.0 / self.scale, self.up_a, self.up_b)

    def apply(self, points: ArrayLike) -> Array:
        """Points (..., 3) in b -> the same points in a. Raises ValueError for another shape."""
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
        """Attitudes (n, 4) in b -> the same attitudes in a; body axes stay as they are."""
        turn = yaw_quaternion(self.yaw)
        if self.up_b == "y":
            turn = multiply_quaternions(turn, QUATERNION_Z_UP_FROM_Y_UP)
        if self.up_a == "y":
            turn = multiply_quaternions(inverse_quaternions(QUATERNION_Z_UP_FROM_Y_UP), turn)
        return multiply_quaternions(turn, quat_xyzw)


def _to_z_up(points: Array, up: Up) -> Array:
    return points @ Z_UP_FROM_Y_UP.T if up == "y" else points


def _from_z_up(points: Array, up: Up) -> Array:
    return points @ Z_UP_FROM_Y_UP if up == "y" else points


@overload
def wrap_angle(angle: float) -> float: ...
@overload
def wrap_angle(angle: Array) -> Array: ...
def wrap_angle(angle: float | Array) -> float | Array:
    """The same angle (rad), or angles, within [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def apply_frames(frames: Array, points: Array) -> Array:
    """Points (..., 3), each in a frame (..., 4) x, y, z, yaw -> the same points in what those frames are given in."""
    c, s = np.cos(frames[..., 3]), np.sin(frames[..., 3])
    x, y, z = np.moveaxis(points, -1, 0)
    turned = np.stack(np.broadcast_arrays(c * x - s * y, s * x + c * y, z), axis=-1)
    return np.asarray(frames[..., :3] + turned)


def difference(frames: Array, others: Array) -> Array:
    """(..., 4) x, y, z, yaw of frames minus those of others, yaw within [-pi, pi)."""
    out = frames - others
    out[..., 3] = wrap_angle(out[..., 3])
    return np.asarray(out)


def rotation_2d(yaw: float) -> Array:
    """(2, 2) rotation by yaw (rad)."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s], [s, c]])


def relative_to(frames: Array, reference: int) -> Array:
    """The same placements (k, 4) in the frame of the user `reference`."""
    x, y, z, yaw = frames[reference]
    c, s = np.cos(yaw), np.sin(yaw)
    dx, dy = frames[:, 0] - x, frames[:, 1] - y
    out = np.stack([c * dx + s * dy, -s * dx + c * dy, frames[:, 2] - z, frames[:, 3] - yaw], axis=1)
    out[:, 3] = wrap_angle(out[:, 3])
    return out


def moved_frames(common: Array, frames: Array) -> Array:
    """Frames (k, 4) x, y, z, yaw that are told in a frame which lies at `common` (4,)."""
    out = frames.copy()
    out[:, :3] = apply_frames(np.broadcast_to(common, out.shape), frames[:, :3])
    out[:, 3] = wrap_angle(frames[:, 3] + common[3])
    return out
