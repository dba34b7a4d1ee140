"""What all files of one track have in common: whose it is, units and axes as asked."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from synchronizar.arrays import Array
from synchronizar.convert.asked import LENGTH_UNITS, Asked
from synchronizar.convert.axes import Turned, axes_named, quaternions_of_matrices, turned
from synchronizar.convert.imported import Imported
from synchronizar.data.user import User
from synchronizar.errors import InputError

_ORTHONORMAL = 0.02


def add_track(
    imported: Imported, name: str, rows: Array, asked: Asked, world: str = "flu", body: str | None = None
) -> None:
    """Take poses (n, 8) t x y z qx qy qz qw for a user's track; `world` and `body` are the format's own axes.

    Raises InputError where axes were asked for that do not go together.
    """
    user = asked.user or name
    imported.tracks[user], up = poses_as_asked(rows, asked, world, body)
    imported.users[user] = User(user, up=up)


def add_truth(imported: Imported, name: str, rows: Array, asked: Asked) -> None:
    """The same for where a device truly was, in a frame that is z up."""
    imported.truth[asked.user or name] = poses_as_asked(rows, asked, "flu", None).rows


def poses_of_matrices(path: Path, numbers: Array, line_of: Callable[[int], int]) -> Array:
    """(n, 7) x y z qx qy qz qw of matrices from body to frame: twelve numbers each, 3 x 4, row by row.

    `line_of` is a row's line in the file. Raises InputError for the first that is no rotation.
    """
    matrices = numbers.reshape(-1, 3, 4)
    rotations = matrices[:, :, :3]
    off = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    bad = ~(off < _ORTHONORMAL) | (np.linalg.det(rotations) < 0.0)
    if bad.any():
        raise InputError(path, "the matrix is no rotation", line_of(int(bad.argmax())))
    return np.column_stack([matrices[:, :, 3], quaternions_of_matrices(rotations)])


def poses_as_asked(rows: Array, asked: Asked, world: str, body: str | None) -> Turned:
    """Poses in m and in axes that a recording may have."""
    if asked.length_unit not in (None, "m"):
        rows = rows.copy()
        rows[:, 1:4] *= LENGTH_UNITS[asked.length_unit or "m"]
    world = axes_named("--world", asked.world) if asked.world is not None else world
    body = axes_named("--body", asked.body) if asked.body is not None else body
    try:
        return turned(rows, world, body)
    except ValueError as error:
        raise InputError("--body", str(error)) from error
