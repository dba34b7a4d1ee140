"""Axes by name: where x, y and z of a frame point, and poses turned from such axes into those of a recording.

A frame is three letters, where its x, y and z point: f(orward) or n(orth), b(ack) or s(outh), r(ight) or e(ast),
l(eft) or w(est), u(p), d(own). The names below are those in use.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.errors import InputError
from synchronizar.geometry import Up
from synchronizar.io.text import quoted
from synchronizar.quaternions import inverse_quaternions, multiply_quaternions

NAMED = {
    "ros": "flu",
    "flu": "flu",
    "enu": "rfu",
    "nwu": "flu",
    "z-up": "flu",
    "ned": "frd",
    "frd": "frd",
    "aerospace": "frd",
    "optical": "rdf",
    "camera": "rdf",
    "opencv": "rdf",
    "colmap": "rdf",
    "kitti": "rdf",
    "y-up": "rub",
    "opengl": "rub",
    "openxr": "rub",
    "webxr": "rub",
    "arkit": "rub",
    "arcore": "rub",
    "unity": "ruf",
    "unreal": "fru",
}
_DIRECTIONS = {
    "f": (1.0, 0.0, 0.0),
    "b": (-1.0, 0.0, 0.0),
    "l": (0.0, 1.0, 0.0),
    "r": (0.0, -1.0, 0.0),
    "u": (0.0, 0.0, 1.0),
    "d": (0.0, 0.0, -1.0),
}
_FACING_NORTH = str.maketrans({"n": "f", "s": "b", "e": "r", "w": "l"})


def axes_named(place: str, name: str) -> str:
    """The letters of axes that are named, or given by letters. Raises InputError for a word that is neither."""
    letters = NAMED.get(name.strip().lower()) or name.strip().lower().translate(_FACING_NORTH)
    if len(letters) != 3 or any(c not in _DIRECTIONS for c in letters) or not _is_frame(letters):
        raise InputError(
            place, f"{quoted(name)} names no axes: say {', '.join(sorted(NAMED))}, or where x y z point, as in rdf"
        )
    return letters


def axes_matrix(letters: str) -> Array:
    """(3, 3): vectors in these axes, in axes forward, left, up."""
    return np.array([_DIRECTIONS[c] for c in letters]).T


class Turned(NamedTuple):
    """Poses in axes that a recording can have."""

    rows: Array
    """(n, 8) t x y z qx qy qz qw."""
    up: Up


def turned(rows: Array, world: str, body: str | None = None) -> Turned:
    """Poses (n, 8) whose frame has the axes `world` and whose body has the axes `body` (letters), in a recording's.

    Right-handed frames with z or y up stay what they are; others become forward, left, up. Body axes become those where
    they are named. A left-handed frame's body is left-handed alike, where it is not named.
    """
    right_handed = np.linalg.det(axes_matrix(world)) > 0.0
    kept = right_handed and "u" in world[1:]
    if body is None:
        body = None if right_handed else world
    if kept and body is None:
        return Turned(rows, "y" if world[1] == "u" else "z")
    if body is not None and (np.linalg.det(axes_matrix(body)) > 0.0) != right_handed:
        raise ValueError("a frame and the body in it must both be right-handed, or both left-handed")
    out = rows.copy()
    # Where both are mirrored the mirrors cancel: - R - is R.
    sign = 1.0 if right_handed else -1.0
    if not kept:
        out[:, 1:4] = rows[:, 1:4] @ axes_matrix(world).T
        out[:, 4:] = multiply_quaternions(_quaternion(sign * axes_matrix(world)), out[:, 4:])
    if body is not None:
        out[:, 4:] = multiply_quaternions(out[:, 4:], inverse_quaternions(_quaternion(sign * axes_matrix(body))))
    return Turned(out, "y" if kept and world[1] == "u" else "z")


def _is_frame(letters: str) -> bool:
    return bool(abs(np.linalg.det(axes_matrix(letters))) > 0.5)


def _quaternion(rotation: Array) -> Array:
    """(4,) x y z w of a rotation matrix."""
    return np.asarray(quaternions_of_matrices(rotation[None])[0])


def quaternions_of_matrices(rotations: Array) -> Array:
    """(n, 4) x y z w of rotation matrices (n, 3, 3), by the largest of the four squares (Shepperd)."""
    m = rotations
    trace = m[:, 0, 0] + m[:, 1, 1] + m[:, 2, 2]
    squares = np.stack([m[:, 0, 0], m[:, 1, 1], m[:, 2, 2], trace], axis=1)
    best = squares.argmax(axis=1)
    quat = np.empty((len(m), 4))
    for k in range(3):
        rows = best == k
        i, j = (k + 1) % 3, (k + 2) % 3
        quat[rows, k] = 1.0 + m[rows, k, k] - m[rows, i, i] - m[rows, j, j]
        quat[rows, i] = m[rows, i, k] + m[rows, k, i]
        quat[rows, j] = m[rows, j, k] + m[rows, k, j]
        quat[rows, 3] = m[rows, j, i] - m[rows, i, j]
    rows = best == 3
    quat[rows, 0] = m[rows, 2, 1] - m[rows, 1, 2]
    quat[rows, 1] = m[rows, 0, 2] - m[rows, 2, 0]
    quat[rows, 2] = m[rows, 1, 0] - m[rows, 0, 1]
    quat[rows, 3] = 1.0 + trace[rows]
    return np.asarray(quat / np.linalg.norm(quat, axis=1, keepdims=True))
