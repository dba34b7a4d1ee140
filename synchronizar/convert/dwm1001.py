"""Reads logs of the DWM1001's shell: a line of `les` or `lec` for each time that it ranges.

| | |
|---|---|
| `les` | `022E[7.94,8.03,0.00]=3.38 9280[7.95,0.00,2.50]=5.49 ...`: id, place and range of each anchor |
| `lec` | `DIST,4,AN0,022E,7.94,8.03,0.00,3.44,...` |
| time | a stamp before each line (`logs`), or `--rate HZ`; `--time-offset` shifts it |
| units | m; `--range-unit` for others |
| names | who ranges is `--user`, or the file's name; anchors by their ids, and they stand still |
| surveyed | places of anchors, as they were entered: `position`, but where several are told to be at one |
| refused | lines that begin as such a line and are broken; logs without any time |

Positions that the module has estimated are not read. What else stands in a log (prompts, answers) is skipped and
counted.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from synchronizar.convert.asked import Asked
from synchronizar.convert.imported import Imported
from synchronizar.convert.logs import NUMBER, Log
from synchronizar.convert.source import Source
from synchronizar.convert.surveyed import add_surveyed
from synchronizar.convert.tables import lines_of
from synchronizar.data.user import User
from synchronizar.errors import InputError
from synchronizar.io.text import is_number, quoted
from synchronizar.progress import Progress

_LES = re.compile(rf"\b([0-9A-Fa-f]{{4,16}})\[({NUMBER}),({NUMBER}),({NUMBER})\]=({NUMBER})")
_LES_BROKEN = re.compile(r"\b[0-9A-Fa-f]{4}\[")
_LEC = re.compile(r"\bDIST,(\d+)")


class _ToAnchor(NamedTuple):
    anchor: str
    place: list[float]
    distance: float


def recognises(source: Source) -> bool:
    """A line of `les` or `lec`."""
    return any(_LES.search(line) or _LEC.search(line) for line in source.lines)


def read(path: Path, asked: Asked, progress: Progress) -> Imported:
    """Ranges of one tag to its anchors. Raises InputError for a broken line, or a log without times."""
    log, skipped = Log(path, asked, "m"), 0
    places = dict[str, list[float]]()
    for number, line in lines_of(path, progress):
        if lec := _LEC.search(line):
            begin, found = lec.start(), _of_lec(path, number, line[lec.start() :])
        else:
            les = _LES.search(line)
            begin, found = les.start() if les else 0, _of_les(path, number, line)
        if not found:
            skipped += 1
            continue
        t = log.time(number, line[:begin])
        for anchor, place, distance in found:
            log.add(t, log.me, anchor, distance)
            log.imported.users[anchor] = User(anchor, static=True)
            places[anchor] = place
    add_surveyed(log.imported, places)
    return log.read("022E[7.94,8.03,0.00]=3.38 or DIST,1,AN0,022E,7.94,8.03,0.00,3.38", skipped)


def _of_les(path: Path, number: int, line: str) -> list[_ToAnchor]:
    found = _LES.findall(line)
    if not found and _LES_BROKEN.search(line):
        raise InputError(path, "a line of `les` is broken: it has ID[x,y,z]=range for each anchor", number)
    return [_ToAnchor(a.upper(), [float(x), float(y), float(z)], float(r)) for a, x, y, z, r in found]


def _of_lec(path: Path, number: int, line: str) -> list[_ToAnchor]:
    words = line.split(",")
    if not (words[1].isascii() and words[1].strip().isdecimal()):
        raise InputError(path, f"a line of `lec` has {quoted(words[1])} where the number of anchors is due", number)
    count, found = int(words[1]), []
    for k in range(count):
        values = words[2 + 6 * k : 8 + 6 * k]
        if len(values) < 6 or not values[0].startswith("AN") or not all(is_number(v.strip()) for v in values[2:]):
            fault = f"DIST,{count} needs {count} anchors, each AN,id,x,y,z,range; number {k + 1} is broken"
            raise InputError(path, fault, number)
        x, y, z, r = (float(v) for v in values[2:])
        found.append(_ToAnchor(values[1].strip().upper(), [x, y, z], r))
    return found
