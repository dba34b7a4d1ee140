"""Rotations for tests, written without the package's own quaternions."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from synchronizar.arrays import Array

unit_quaternions = (
    arrays(float, (4,), elements=st.floats(-1.0, 1.0))
    .filter(lambda q: bool(np.linalg.norm(q) > 0.1))
    .map(lambda q: q / np.linalg.norm(q))
)


def rotation_matrix(quat_xyzw: Array) -> Array:
    """(3, 3) the textbook's matrix of a unit quaternion (4,)."""
    x, y, z, w = quat_xyzw
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
