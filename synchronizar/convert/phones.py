"""Reads poses as recorders for ARKit and ARCore write them: frames y up (x right, z back), the camera's attitude.

| recorder | a line |
|---|---|
| ARKit Data Logger | `t[ns] r11 r12 r13 x r21 r22 r23 y r31 r32 r33 z`: the 3 x 4 matrix from camera to world |
| ARCore Data Logger | `t[ns] qx qy qz qw x y z` |
| ios_logger (ARposes) | `t[s], x, y, z, qw, qx, qy, qz` |

| | |
|---|---|
| time | the phone's clock, s or ns by its size; not since 1970 as a rule: `--time-offset` shifts it to the ranges' |
| units | m |
| frames | `up = "y"` in recording.toml, positions and attitudes as they are; `--world` and `--body` for others |
| user | the file's name, or its folder's where the recorder gives every file the same |
| refused | lines of another shape |
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from synchronizar.arrays import Array
from synchronizar.convert.asked import TIME_UNITS, Asked
from synchronizar.convert.imported import Imported
from synchronizar.convert.source import Source
from synchronizar.convert.tables import read_numbers
from synchronizar.convert.track_file import add_track, poses_of_matrices
from synchronizar.errors import InputError
from synchronizar.io.text import is_number
from synchronizar.progress import Progress

_STANDARD = re.compile(r"(?i)(arkit|arcore|ar)[-_ ]?(camera|sensor)?[-_ ]?poses?")
_NANOSECONDS = 1e7
"""s: a phone is on for less."""


def recognises(source: Source) -> bool:
    """Thirteen numbers with a rotation in them, or a stamp in ns, a quaternion and a place, or w first by commas."""
    return _shape(source) is not None


def read(path: Path, asked: Asked, progress: Progress) -> Imported:
    """The one track of a file. Raises InputError for a line of another shape."""
    shape = _shape(Source.of(path))
    if shape is None:
        raise InputError(path, "is no log of a phone's poses: lines of 13 numbers (t, 3 x 4 matrix), or of 8 (t, pose)")
    columns, separator, order = shape
    rows, line_of = read_numbers(path, order, columns, separator)
    if columns == 13:
        rows = np.column_stack([rows[:, 0], poses_of_matrices(path, rows[:, 1:], line_of)])
    else:
        names = order.split()
        rows = rows[:, [names.index(name) for name in ("t", "x", "y", "z", "qx", "qy", "qz", "qw")]]
    imported = Imported()
    unit = asked.time_unit or ("ns" if float(np.median(np.abs(rows[:, 0]))) > 1e3 * _NANOSECONDS else "s")
    rows[:, 0] *= TIME_UNITS[unit]
    imported.note(f"stamps are the phone's own, in {unit}; axes are y up")
    name = path.parent.resolve().name if _STANDARD.fullmatch(path.stem) else path.stem
    add_track(imported, name, rows, asked, world="rub")
    progress(1.0)
    return imported


def _shape(source: Source) -> tuple[int, str | None, str] | None:
    """Columns, separator and their order."""
    lines = [line for line in source.lines if not line.startswith("#")]
    if not lines:
        return None
    separator = "," if "," in lines[0] else None
    words = [word.strip() for word in lines[0].split(separator)]
    if not all(map(is_number, words)):
        return None
    values = np.array([float(word) for word in words])
    if len(words) == 13:
        return 13, separator, "t r11 r12 r13 x r21 r22 r23 y r31 r32 r33 z"
    if len(words) != 8:
        return None
    named = _STANDARD.search(source.path.name) is not None
    if separator is None and _is_unit(values[1:5]) and (values[0] > 1e3 * _NANOSECONDS or named):
        return 8, None, "t qx qy qz qw x y z"
    if separator == "," and named and _is_unit(values[4:]):
        return 8, ",", "t x y z qw qx qy qz"
    return None


def _is_unit(quat: Array) -> bool:
    return bool(abs(np.linalg.norm(quat) - 1.0) < 0.02)
