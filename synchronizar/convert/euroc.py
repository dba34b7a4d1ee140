"""Reads EuRoC / ASL csv files of poses: `# timestamp [ns], p_x, p_y, p_z, q_w, q_x, q_y, q_z`, and what may follow.

| | |
|---|---|
| time | ns since 1970 (or since any moment), the device's own clock; `--time-unit` for others |
| units | m, unit quaternions w first (`--quaternion xyzw` for those that have it last) |
| frames | a gravity-aligned world, z up (`p_RS_R`, `q_RS`); body axes are the sensor's and stay what they are |
| user | the file's name; of `data.csv` that of the nearest folder which is no sensor's (mav0, vicon0, ...) |
| refused | fewer than eight columns, what is no number, a stamp that is not finite |

Velocities and biases after the eighth column are not read. These files have no ranges.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from synchronizar.convert.asked import TIME_UNITS, Asked
from synchronizar.convert.imported import Imported
from synchronizar.convert.source import Source
from synchronizar.convert.tables import read_numbers
from synchronizar.convert.track_file import add_track
from synchronizar.progress import Progress

COLUMNS = "t x y z qw qx qy qz"
_SENSOR_FOLDERS = re.compile(r"mav\d*|state_groundtruth_estimate\d*|vicon\d*|leica\d*|mocap\d*|gt|estimate", re.I)


def recognises(source: Source) -> bool:
    """A header in a comment, then a stamp of many digits and seven numbers or more, by commas."""
    lines = source.lines
    if not lines or not any(line.startswith("#") for line in lines):
        return False
    data = next((line for line in lines if not line.startswith("#")), "").split(",")
    return len(data) >= 8 and re.fullmatch(r"\d{12,19}", data[0].strip()) is not None


def read(path: Path, asked: Asked, progress: Progress) -> Imported:
    """The one track of a file. Raises InputError for a line that is no pose."""
    rows, _ = read_numbers(path, COLUMNS, 8, ",", more=True)
    order = [0, 1, 2, 3, 4, 5, 6, 7] if asked.quaternion == "xyzw" else [0, 1, 2, 3, 5, 6, 7, 4]
    rows = rows[:, order] * np.array([TIME_UNITS[asked.time_unit or "ns"], *[1.0] * 7])
    imported = Imported()
    add_track(imported, name_of(path), rows, asked)
    progress(1.0)
    return imported


def name_of(path: Path) -> str:
    """Whose file it is."""
    if path.stem.lower() != "data":
        return path.stem
    folders = [p.name for p in path.resolve().parents if p.name and not _SENSOR_FOLDERS.fullmatch(p.name)]
    return folders[0] if folders else path.stem
