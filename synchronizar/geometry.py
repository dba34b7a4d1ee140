"""Gravity-aligned frames and the little quaternion arithmetic that tracks need, on arrays.

Every frame is right-handed, metric, z up. Quaternions are unit, x y z w, and turn body axes into the frame's axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import ArrayLike

from synchronizar.arrays import Array

# Rows are the axes of z-up in those of y-up (ARKit, ARCore, WebXR, OpenXR): x = -z, y = -x, z = y.
Z_UP_FROM_Y_UP: Array = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
QUATERNION_Z_UP_FROM_Y_UP: Array = np.array([0.5, -0.5, -0.5, 0.5])


@dataclass(frozen=True)
class YawFrame:
    """`a_from_b` of two gravity-aligned frames: p_a = Rz(yaw) (scale p_b) + (x, y, z); m and rad."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0
    scale: float = 1.0

    @property
    def translation(self) -> Array:
        """(3,) m: the origin of b in a."""
        return np.array([self.x, self.y, self.z])

    @property
    def matrix(self) -> Array:
        """(4, 4) homogeneous matrix of the same map."""
        m = np.eye(4)
        m[:2, :2] = rotation_2d(self.yaw)
        m[:3, :3] *= self.scale
        m[:3, 3] = self.translation
        return m

    def inverse(self) -> YawFrame:
        """`b_from_a`."""
        x, y, z = (-YawFrame(yaw=-self.yaw, scale=1.0 / self.scale).apply(self.translation)).tolist()
        return YawFrame(x, y, z, -self.yaw, 1.0 / self.scale)

    def apply(self, points: ArrayLike) -> Array:
        """Points (..., 3) in b -> the same points in a."""
        p = np.asarray(points, dtype=float)
        if p.shape[-1:] != (3,):
            raise ValueError(f"points must have shape (..., 3), not {p.shape}")
        out = np.empty(p.shape)
        out[..., :2] = self.scale * (p[..., :2] @ rotation_2d(self.yaw).T)
        out[..., 2] = self.scale * p[..., 2]
        return out + self.translation

    @overload
    def __matmul__(self, other: YawFrame) -> YawFrame: ...
    @overload
    def __matmul__(self, other: ArrayLike) -> Array: ...
    def __matmul__(self, other: YawFrame | ArrayLike) -> YawFrame | Array:
        """`a_from_b @ b_from_c` is `a_from_c`; `a_from_b @ points` (..., 3) are the points in a."""
        if not isinstance(other, YawFrame):
            return self.apply(other)
        x, y, z = self.apply(other.translation).tolist()
        return YawFrame(x, y, z, wrap_angle(self.yaw + other.yaw), self.scale * other.scale)

    def rotate_quaternions(self, quat_xyzw: Array) -> Array:
        """Attitudes (n, 4) in b -> the same attitudes in a."""
        return multiply_quaternions(yaw_quaternion(self.yaw), quat_xyzw)


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


def yaw_quaternion(yaw: float) -> Array:
    """(4,) x y z w: a turn by yaw (rad) about z."""
    return np.array([0.0, 0.0, np.sin(yaw / 2.0), np.cos(yaw / 2.0)])


def multiply_quaternions(left: Array, right: Array) -> Array:
    """Hamilton products of quaternions (..., 4) x y z w: first `right` turns, then `left`."""
    lv, lw = left[..., :3], left[..., 3:]
    rv, rw = right[..., :3], right[..., 3:]
    vector = lw * rv + rw * lv + np.cross(lv, rv)
    scalar = lw * rw - np.sum(lv * rv, axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


def rotate_by_quaternions(quat_xyzw: Array, vectors: Array) -> Array:
    """Vectors (..., 3) turned by unit quaternions (..., 4): v + 2 w (q x v) + 2 q x (q x v)."""
    q, w = quat_xyzw[..., :3], quat_xyzw[..., 3:]
    t = 2.0 * np.cross(q, vectors)
    return vectors + w * t + np.cross(q, t)


def yaw_of_quaternions(quat_xyzw: Array) -> Array:
    """(n,) rad: the turn about z of unit quaternions (n, 4), what is left of them tilting (swing and twist)."""
    return np.asarray(wrap_angle(2.0 * np.arctan2(quat_xyzw[..., 2], quat_xyzw[..., 3])))


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
