"""Arithmetic of unit quaternions x y z w, on arrays (..., 4).

An attitude turns body axes into a frame's axes. Products are Hamilton's: the right factor turns first. q and -q are the
same rotation; every angle below is that of the shorter way.
"""

from __future__ import annotations

from itertools import accumulate

import numpy as np

from synchronizar.arrays import Array

IDENTITY: Array = np.array([0.0, 0.0, 0.0, 1.0])
"""(4,): no rotation."""


def multiply_quaternions(left: Array, right: Array) -> Array:
    """(..., 4) Hamilton products: the rotation `right` followed by `left`."""
    lv, lw = left[..., :3], left[..., 3:]
    rv, rw = right[..., :3], right[..., 3:]
    vector = lw * rv + rw * lv + _cross(lv, rv)
    scalar = lw * rw - np.sum(lv * rv, axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


def cumulative_products(quat_xyzw: Array) -> Array:
    """(n, 4) products of the first 1, 2, ..., n quaternions (n, 4): q0, q0 q1, q0 q1 q2, ..."""
    return np.array(list(accumulate(quat_xyzw, multiply_quaternions)))


def inverse_quaternions(quat_xyzw: Array) -> Array:
    """(..., 4) inverses of unit quaternions: their conjugates."""
    return np.asarray(quat_xyzw * np.array([-1.0, -1.0, -1.0, 1.0]))


def normalized_quaternions(quat_xyzw: Array) -> Array:
    """(..., 4) the same quaternions at unit length; none may be zero."""
    return np.asarray(quat_xyzw / np.linalg.norm(quat_xyzw, axis=-1, keepdims=True))


def rotate_by_quaternions(quat_xyzw: Array, vectors: Array) -> Array:
    """(..., 3) vectors rotated by unit quaternions (..., 4): v + 2 w (q x v) + 2 q x (q x v)."""
    q, w = quat_xyzw[..., :3], quat_xyzw[..., 3:]
    t = 2.0 * _cross(q, vectors)
    return vectors + w * t + _cross(q, t)


def rotation_vectors(quat_xyzw: Array) -> Array:
    """(n, 3) rad: rotation vectors of unit quaternions (n, 4), of length 0 to pi."""
    q = np.where(quat_xyzw[:, 3:] < 0.0, -quat_xyzw, quat_xyzw)
    half_sine = np.linalg.norm(q[:, :3], axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(half_sine, q[:, 3:])
    stretch = np.divide(angle, half_sine, out=np.full_like(angle, 2.0), where=half_sine > 0.0)
    return np.asarray(stretch * q[:, :3])


def quaternions_of_rotation_vectors(vectors: Array) -> Array:
    """(n, 4) unit quaternions of rotation vectors (n, 3) rad of any length."""
    angle = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.concatenate([0.5 * np.sinc(0.5 * angle / np.pi) * vectors, np.cos(0.5 * angle)], axis=1)


def rotation_angles(quat_xyzw: Array) -> Array:
    """(...,) rad, 0 to pi: angles of the rotations (..., 4)."""
    return np.asarray(2.0 * np.arctan2(np.linalg.norm(quat_xyzw[..., :3], axis=-1), np.abs(quat_xyzw[..., 3])))


def angles_between(quat_xyzw: Array, others: Array) -> Array:
    """(...,) rad, 0 to pi: angles of the rotations from attitudes (..., 4) to others (..., 4)."""
    return rotation_angles(multiply_quaternions(inverse_quaternions(quat_xyzw), others))


def yaw_quaternion(yaw: float) -> Array:
    """(4,): the rotation by yaw (rad) about z."""
    return np.array([0.0, 0.0, np.sin(yaw / 2.0), np.cos(yaw / 2.0)])


def yaw_quaternions(yaw: Array) -> Array:
    """(n, 4): the rotations by yaw (n,) rad about z."""
    zero = np.zeros_like(yaw)
    return np.stack([zero, zero, np.sin(yaw / 2.0), np.cos(yaw / 2.0)], axis=-1)


def yaw_of_quaternions(quat_xyzw: Array) -> Array:
    """(...,) rad, within [-pi, pi): the twist about z of unit quaternions (..., 4).

    A rotation is its twist about z followed by a swing, which tilts z about a horizontal axis and does not turn about z
    (swing-twist decomposition). It has no singularity but a tilt by pi, where the twist is arbitrary: 0 comes back.
    """
    twist = 2.0 * np.arctan2(quat_xyzw[..., 2], quat_xyzw[..., 3])
    return np.asarray((twist + np.pi) % (2.0 * np.pi) - np.pi)


def tilt_of_quaternions(quat_xyzw: Array) -> Array:
    """(...,) rad, 0 to pi: the angle between z and z rotated by unit quaternions (..., 4)."""
    horizontal, vertical = np.linalg.norm(quat_xyzw[..., :2], axis=-1), np.linalg.norm(quat_xyzw[..., 2:], axis=-1)
    return np.asarray(2.0 * np.arctan2(horizontal, vertical))


def _cross(a: Array, b: Array) -> Array:
    """(..., 3) cross products, to the last bit those of `np.cross`, which takes five times as long on a few rows."""
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    product[..., 0] = ay * bz - az * by
    product[..., 1] = az * bx - ax * bz
    product[..., 2] = ax * by - ay * bx
    return product


def quaternions_of_matrices(matrices: Array) -> Array:
    """(n, 4) x y z w: the attitudes of rotation matrices (n, 3, 3).

    The eigenvector of the largest eigenvalue of Bar-Itzhack's K (New method for extracting the quaternion from a
    rotation matrix, J. Guidance 23(6), 2000): no case for each sign of the trace.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(matrices, 0, -1)
    k = np.array(
        [
            [xx - yy - zz, xy + yx, xz + zx, zy - yz],
            [xy + yx, yy - xx - zz, yz + zy, xz - zx],
            [xz + zx, yz + zy, zz - xx - yy, yx - xy],
            [zy - yz, xz - zx, yx - xy, xx + yy + zz],
        ]
    )
    return np.asarray(np.linalg.eigh(np.moveaxis(k, -1, 0))[1][:, :, 3])
