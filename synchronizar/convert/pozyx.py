"""Reads logs of Pozyx ranges, as pypozyx prints a DeviceRange: `1234 ms, 2045 mm, -81 dBm`.

| | |
|---|---|
| time | a stamp before each line (`logs`), or the module's own clock: ms since it was switched on |
| units | mm and dBm; `--range-unit` for others |
| names | who ranges is `--user`, or the file's name; the other by the id before: `0x6951: 1234 ms, ...` |
| | where there is none, `--column b=NAME` |
| surveyed | `ANCHOR,0x6951,X: 0, Y: 4000, Z: 2500`, as its examples print where anchors are |
| refused | logs without such a line |

What else stands in a log is skipped and counted.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from synchronizar.convert.asked import Asked
from synchronizar.convert.imported import Imported
from synchronizar.convert.logs import NUMBER, Log
from synchronizar.convert.source import Source
from synchronizar.convert.surveyed import add_surveyed
from synchronizar.convert.tables import lines_of
from synchronizar.progress import Progress

_RANGE = re.compile(rf"(?:(0x[0-9A-Fa-f]+|\d+)\s*[:,]\s*)?(\d+)\s*ms,\s*({NUMBER})\s*mm(?:,\s*({NUMBER})\s*dBm)?", re.I)
_ANCHOR = re.compile(
    rf"ANCHOR,\s*(0x[0-9A-Fa-f]+|\d+),\s*(?:X:)?\s*({NUMBER}),\s*(?:Y:)?\s*({NUMBER}),\s*(?:Z:)?\s*({NUMBER})", re.I
)


def recognises(source: Source) -> bool:
    """Times in ms and distances in mm, in most lines."""
    lines = [line for line in source.lines if not _ANCHOR.search(line)]
    return bool(lines) and sum(bool(_RANGE.search(line)) for line in lines) > len(lines) / 2


def read(path: Path, asked: Asked, progress: Progress) -> Imported:
    """Ranges of one module to others. Raises InputError for a log without ranges."""
    log, skipped = Log(path, asked, "mm"), 0
    places = dict[str, list[float]]()
    other = dict(asked.columns).get("b", "pozyx")
    for number, line in lines_of(path, progress):
        if anchor := _ANCHOR.search(line):
            places[anchor[1]] = [log.metres * float(anchor[k]) for k in (2, 3, 4)]
        elif found := _RANGE.search(line):
            t = log.time(number, line[: found.start()], 1e-3 * float(found[2]))
            power = float(found[4]) if found[4] else np.nan
            log.add(t, log.me, found[1] or other, float(found[3]), rx_power=power)
        else:
            skipped += 1
    add_surveyed(log.imported, {name: place for name, place in places.items() if name in log.imported.ranges.b})
    if other in log.imported.ranges.b:
        log.imported.note(f"the log does not say whom it ranges with: {other} (--column b=NAME)")
    return log.read("0x6951: 1234 ms, 2045 mm, -81 dBm", skipped)
