"""Reads tracks in TUM format: a pose a line, `t x y z qx qy qz qw`, by blanks or commas.

| | |
|---|---|
| time | s, the device's own clock (`--time-unit` for others) |
| units | m (`--length-unit`), quaternions x y z w (`--quaternion wxyz`) |
| frames | z up; `--world arkit` keeps y up, other axes are turned; bodies stay what they are |
| user | the file's name |
| refused | lines of fewer or more than eight numbers |
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from synchronizar.convert.asked import TIME_UNITS, Asked
from synchronizar.convert.imported import Imported
from synchronizar.convert.source import Source
from synchronizar.convert.tables import read_numbers
from synchronizar.convert.track_file import add_track
from synchronizar.io.text import is_number
from synchronizar.progress import Progress

COLUMNS = "t x y z qx qy qz qw"


def recognises(source: Source) -> bool:
    """Lines of eight numbers, of which the last four are a quaternion in most: SLAM that is lost may write nan."""
    lines = [line for line in source.lines if not line.startswith("#")]
    rows = [[word.strip() for word in (line.split(",") if "," in line else line.split())] for line in lines]
    if not all(len(row) == 8 and all(map(is_number, row)) for row in rows):
        return False
    return sum(0.9 < sum(float(q) ** 2 for q in row[4:]) < 1.1 for row in rows) > len(rows) / 2


def read(path: Path, asked: Asked, progress: Progress) -> Imported:
    """The one track of a file. Raises InputError for a line that is no pose."""
    first = next((line for line in Source.of(path).lines if not line.startswith("#")), "")
    rows, _ = read_numbers(path, COLUMNS, 8, "," if "," in first else None)
    if asked.quaternion == "wxyz":
        rows = rows[:, [0, 1, 2, 3, 5, 6, 7, 4]]
    imported = Imported()
    rows = rows * np.array([TIME_UNITS[asked.time_unit or "s"], *[1.0] * 7])
    add_track(imported, path.stem, rows, asked)
    progress(1.0)
    return imported
