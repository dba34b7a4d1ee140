"""Reads and writes tracks in TUM format: a pose a line, `t x y z qx qy qz qw`, in s and m, body axes into the frame."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.data.track import Track
from synchronizar.errors import InputError, os_faults
from synchronizar.geometry import Up, YawFrame
from synchronizar.io.text import MAX_PLACE, MAX_STAMP, is_number, open_text, quoted
from synchronizar.quaternions import normalized_quaternions

COLUMNS = 8
LARGEST_UNIT = 1e3
"""Units in a metre at most: positions may be in millimetres by mistake."""


def read_tum(path: Path, up: Up = "z") -> Track:
    """The track in a file, in a frame with z up; `up` is the vertical axis of the file's own frame.

    Blank lines and `#` comments are skipped, poses sorted by stamp; of several poses with one stamp the last in the
    file is taken. Quaternions are normalised. Raises InputError where the file cannot be read or a line is not a pose.
    """
    rows = _read_rows(path)
    for bad, fault in _faults(rows):
        if bad.any():
            line, _ = next(islice(_data_lines(path), int(bad.argmax()), None))
            raise InputError(path, fault, line)
    return track_of_rows(rows, up)


def read_usable_poses(path: Path, up: Up = "z") -> Track:
    """The track in a file without the poses that `read_tum` refuses, z up; stamps may have any size.

    Raises InputError where the file cannot be read, a line is not a pose, or no pose can be used.
    """
    rows = _read_rows(path)
    usable = np.isfinite(rows).all(axis=1) & rows[:, 4:].any(axis=1)
    usable &= (np.abs(rows[:, 1:4]) <= LARGEST_UNIT * MAX_PLACE).all(axis=1)
    if not usable.any():
        raise InputError(path, "has no pose that can be used")
    return track_of_rows(rows[usable], up)


def track_of_rows(rows: Array, up: Up) -> Track:
    """The z-up track of poses (n, 8) t x y z qx qy qz qw in any order, in a frame with `up` as its vertical axis.

    Of several poses with one stamp the last is taken. Quaternions may have any length but zero.
    """
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    rows = rows[np.append(rows[1:, 0] != rows[:-1, 0], True)]
    t, position, quat_xyzw = rows[:, 0], rows[:, 1:4], rows[:, 4:]
    # The squares of huge and tiny ones overflow and vanish.
    quat_xyzw = normalized_quaternions(quat_xyzw / np.abs(quat_xyzw).max(axis=1, keepdims=True))
    if up == "z":
        return Track(t, position, quat_xyzw)
    z_up_from_own = YawFrame(up_b=up)
    return Track(t, z_up_from_own @ position, z_up_from_own.rotate_quaternions(quat_xyzw))


def write_tum(path: Path, track: Track, up: Up = "z") -> None:
    """Write a z-up track, to 1 ns and 1 nm, into a file whose frame has `up` as its vertical axis.

    Raises InputError where the file cannot be written.
    """
    with os_faults(path):
        np.savetxt(path, rows_of_track(track, up), fmt="%.9f")


def rows_of_track(track: Track, up: Up) -> Array:
    """(n, 8) t x y z qx qy qz qw of a z-up track, in a frame with `up` as its vertical axis."""
    if up == "z":
        return np.column_stack([track.t, track.position, track.quat_xyzw])
    own = YawFrame(up_a=up)  # from z up
    return np.column_stack([track.t, own @ track.position, own.rotate_quaternions(track.quat_xyzw)])


def _read_rows(path: Path) -> Array:
    """(n, 8) numbers of n > 0 poses, in the order of the file."""
    if next(_data_lines(path), None) is None:
        raise InputError(path, "has no pose")
    with os_faults(path), open_text(path) as file:
        try:
            rows = np.loadtxt(file, ndmin=2)
        except ValueError as error:
            raise _first_malformed(path) from error
    if rows.shape[1] != COLUMNS:
        raise _first_malformed(path)
    return np.asarray(rows)


def _faults(rows: Array) -> list[tuple[Mask, str]]:
    """Each possible fault of a pose: which of the n poses have it (n,), and its text."""
    return [
        (~np.asarray(np.isfinite(rows).all(axis=1)), "a number is not finite"),
        (np.abs(rows[:, 0]) > MAX_STAMP, f"the stamp is beyond {MAX_STAMP:g}; stamps are in seconds"),
        (
            np.asarray((np.abs(rows[:, 1:4]) > MAX_PLACE).any(axis=1)),
            f"the position is beyond {MAX_PLACE:g} m",
        ),
        (~np.asarray(rows[:, 4:].any(axis=1)), "the quaternion is zero"),
    ]


def _data_lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Number (from 1) and values of each line that has any."""
    with os_faults(path), open_text(path) as file:
        for number, line in enumerate(file, start=1):
            if values := line.partition("#")[0].split():
                yield number, values


def _first_malformed(path: Path) -> InputError:
    """The error for the first line that is not eight numbers."""
    for number, values in _data_lines(path):
        if len(values) != COLUMNS:
            return InputError(
                path,
                f"a pose has {COLUMNS} numbers, t x y z qx qy qz qw, separated by spaces; here are {len(values)}",
                number,
            )
        for value in values:
            if not is_number(value):
                return InputError(path, f"{quoted(value)} is not a number; a comment begins with #", number)
    return InputError(path, "is not a track")
