"""Reads KITTI poses: a line of twelve numbers a pose, the 3 x 4 matrix from camera to world, row by row.

| | |
|---|---|
| time | s, a line a pose, in `times.txt` beside it (or in the folder above, or `<name>_times.txt`); refused without |
| units | m |
| frames | a camera's: x right, y down, z forward, for world and body (`--world`, `--body` for others) |
| user | the file's name |
| assumed | the first camera was level, since nothing else says where down is |
| refused | matrices that are no rotations, other numbers of poses than of times |
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from synchronizar.convert.asked import TIME_UNITS, Asked
from synchronizar.convert.imported import Imported
from synchronizar.convert.source import Source
from synchronizar.convert.tables import read_numbers
from synchronizar.convert.track_file import add_track, poses_of_matrices
from synchronizar.errors import InputError
from synchronizar.io.text import is_number
from synchronizar.progress import Progress

TIMES = "times.txt"


def recognises(source: Source) -> bool:
    """Lines of twelve numbers by blanks."""
    lines = source.lines
    return bool(lines) and all(len(words := line.split()) == 12 and all(map(is_number, words)) for line in lines)


def read(path: Path, asked: Asked, progress: Progress) -> Imported:
    """The one track of a file. Raises InputError for a line that is no pose."""
    numbers, line_of = read_numbers(path, "r11 r12 r13 x r21 r22 r23 y r31 r32 r33 z", 12)
    times = next((file for file in _time_files(path) if file.is_file()), None)
    if times is None:
        raise InputError(path, f"has no times: put {TIMES}, a number (s) for each of its lines, beside it")
    t, _ = read_numbers(times, "t", 1)
    if len(t) != len(numbers):
        raise InputError(times, f"has {len(t)} times, {path.name} has {len(numbers)} poses")
    rows = np.column_stack([t * TIME_UNITS[asked.time_unit or "s"], poses_of_matrices(path, numbers, line_of)])
    imported = Imported()
    if asked.world is None:
        imported.note("axes are a camera's (x right, y down, z forward), and the first camera is taken to be level")
    add_track(imported, path.stem, rows, asked, world="rdf", body="rdf")
    progress(1.0)
    return imported


def _time_files(path: Path) -> list[Path]:
    return [
        path.with_name(f"{path.stem}_{TIMES}"),
        path.with_name(f"{path.stem}.{TIMES}"),
        path.with_name(TIMES),
        path.parent.parent / TIMES,
        path.parent.parent / "sequences" / path.stem / TIMES,
    ]
