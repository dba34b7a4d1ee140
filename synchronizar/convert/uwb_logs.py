"""Reads text logs of ranging modules: DWM1001, Nooploop LinkTrack, Pozyx. One module for the three, line by line.

| module | what is read |
|---|---|
| dwm1001 | `les`: `022E[7.94,8.03,0.00]=3.38 ...`, and `lec`: `DIST,4,AN0,022E,7.94,8.03,0.00,3.44,...` |
| nooploop | `rostopic echo` of nlink_parser's node and tag frames, as YAML or (`-p`) as csv |
| pozyx | `1234 ms, 2045 mm, -81 dBm`, as pypozyx prints a DeviceRange, with or without `0x6951:` before it; |
| | `ANCHOR,0x6951,X: 0, Y: 4000, Z: 2500`, as its examples print where anchors are |

| | |
|---|---|
| time | a stamp before each line (s, ms, us or ns since 1970, or 2024-05-01T12:00:00.5, or 12:00:00.5); csv: `%time`; |
| | else the module's own clock (ms since it was switched on); none at all: `--rate HZ`; `--time-offset` shifts it |
| units | m (DWM1001, Nooploop), mm (Pozyx); `--range-unit` for others; dBm |
| names | who ranges is `--user`, or the file's name; the others by the ids in the log. Anchors stand still |
| surveyed | places of anchors, as they were entered: `position`, but where several are told to be at one |
| refused | lines that begin as such a line and are broken; logs without any time |

Positions that a module has estimated are not read. What else stands in a log (prompts, answers) is skipped and counted.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from synchronizar.convert.asked import LENGTH_UNITS, TIME_UNITS, Asked, time_unit_by_size
from synchronizar.convert.imported import Imported
from synchronizar.convert.source import Source
from synchronizar.convert.surveyed import add_surveyed
from synchronizar.data.user import User
from synchronizar.errors import InputError, os_faults
from synchronizar.io.text import is_number, open_text, quoted
from synchronizar.progress import Progress

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_LES = re.compile(rf"\b([0-9A-Fa-f]{{4,16}})\[({_NUMBER}),({_NUMBER}),({_NUMBER})\]=({_NUMBER})")
_LES_BROKEN = re.compile(r"\b[0-9A-Fa-f]{4}\[")
_LEC = re.compile(r"\bDIST,(\d+)")
_POZYX = re.compile(
    rf"(?:(0x[0-9A-Fa-f]+|\d+)\s*[:,]\s*)?(\d+)\s*ms,\s*({_NUMBER})\s*mm(?:,\s*({_NUMBER})\s*dBm)?", re.I
)
_POZYX_ANCHOR = re.compile(
    rf"ANCHOR,\s*(0x[0-9A-Fa-f]+|\d+),\s*(?:X:)?\s*({_NUMBER}),\s*(?:Y:)?\s*({_NUMBER}),\s*(?:Z:)?\s*({_NUMBER})", re.I
)
_DATE = re.compile(r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d(?:[.,]\d+)?)(Z|[+-]\d\d:?\d\d)?")
_CLOCK = re.compile(r"(\d\d):(\d\d):(\d\d(?:[.,]\d+)?)")


class _Line(NamedTuple):
    number: int
    text: str


def recognises_dwm1001(source: Source) -> bool:
    """A line of `les` or `lec`."""
    return any(_LES.search(line) or _LEC.search(line) for line in source.lines)


def recognises_nooploop(source: Source) -> bool:
    """nlink_parser's fields, as YAML or as csv."""
    text = "\n".join(source.lines)
    if "%time" in text[:200] and re.search(r"field\.(nodes0\.dis|dis_arr0)\b", text.split("\n", 1)[0]):
        return True
    return "system_time:" in text and ("dis:" in text or "dis_arr:" in text)


def recognises_pozyx(source: Source) -> bool:
    """Times in ms and distances in mm."""
    lines = [line for line in source.lines if not _POZYX_ANCHOR.search(line)]
    return bool(lines) and sum(bool(_POZYX.search(line)) for line in lines) > len(lines) / 2


def read_dwm1001(path: Path, asked: Asked, progress: Progress) -> Imported:
    """Ranges of one tag to its anchors. Raises InputError for a broken line, or a log without times."""
    imported, me, skipped = Imported(), asked.user or path.stem, 0
    clock, places = _Clock(path, asked, imported), dict[str, list[float]]()
    for line in _lines(path, progress):
        found = _of_lec(path, line) if _LEC.search(line.text) else _of_les(path, line)
        if not found:
            skipped += 1
            continue
        begin = min(k for k in (line.text.find("DIST,"), _first(_LES, line.text)) if k >= 0)
        t = clock.at(line, line.text[:begin])
        for anchor, place, distance in found:
            add_range(imported, t, me, anchor, distance, asked, "m")
            imported.users[anchor] = User(anchor, static=True)
            places[anchor] = place
    add_surveyed(imported, places)
    return _told(path, imported, skipped)


def read_pozyx(path: Path, asked: Asked, progress: Progress) -> Imported:
    """Ranges of one module to others. Raises InputError for a log without times."""
    imported, me, skipped = Imported(), asked.user or path.stem, 0
    clock, places = _Clock(path, asked, imported), dict[str, list[float]]()
    other = dict(asked.columns).get("b", "pozyx")
    for line in _lines(path, progress):
        if anchor := _POZYX_ANCHOR.search(line.text):
            metres = LENGTH_UNITS[asked.range_unit or "mm"]
            places[anchor[1]] = [metres * float(anchor[k]) for k in (2, 3, 4)]
            continue
        found = _POZYX.search(line.text)
        if not found:
            skipped += 1
            continue
        t = clock.at(line, line.text[: found.start()], 1e-3 * float(found[2]))
        power = float(found[4]) if found[4] else np.nan
        add_range(imported, t, me, found[1] or other, float(found[3]), asked, "mm", rx_power=power)
    add_surveyed(imported, {name: place for name, place in places.items() if name in imported.ranges.b})
    if other in imported.ranges.b:
        imported.note(f"the log does not say whom it ranges with: {other} (--column b=NAME)")
    return _told(path, imported, skipped)


def read_nooploop(path: Path, asked: Asked, progress: Progress) -> Imported:
    """Ranges of a node or a tag to others. Raises InputError for a value that is no number."""
    with os_faults(path), open_text(path) as file:
        first = file.readline()
    imported = Imported()
    if "%time" in first:
        _nooploop_csv(path, asked, imported, progress)
    else:
        _nooploop_yaml(path, asked, imported, progress)
    return _told(path, imported, 0)


def _lines(path: Path, progress: Progress) -> Iterator[_Line]:
    with os_faults(path):
        size = max(path.stat().st_size, 1)
    done = 0
    with os_faults(path), open_text(path) as file:
        for number, line in enumerate(file, start=1):
            done += len(line)
            if number % 20_000 == 0:
                progress(min(done / size, 1.0))
            if line.strip():
                yield _Line(number, line.strip())


def _first(pattern: re.Pattern[str], text: str) -> int:
    found = pattern.search(text)
    return found.start() if found else -1


def _of_les(path: Path, line: _Line) -> list[tuple[str, list[float], float]]:
    found = _LES.findall(line.text)
    if not found and _LES_BROKEN.search(line.text):
        raise InputError(path, "a line of `les` is broken: it has ID[x,y,z]=range for each anchor", line.number)
    return [(a.upper(), [float(x), float(y), float(z)], float(r)) for a, x, y, z, r in found]


def _of_lec(path: Path, line: _Line) -> list[tuple[str, list[float], float]]:
    words = line.text[line.text.index("DIST,") :].split(",")
    if not words[1].strip().isdecimal():
        raise InputError(path, f"a line of `lec` has {words[1]!r} where the number of anchors is due", line.number)
    count = int(words[1])
    out = []
    for k in range(count):
        values = words[2 + 6 * k : 8 + 6 * k]
        if len(values) < 6 or not values[0].startswith("AN") or not all(is_number(v.strip()) for v in values[2:]):
            fault = f"DIST,{count} needs {count} anchors, each AN,id,x,y,z,range; number {k + 1} is broken"
            raise InputError(path, fault, line.number)
        x, y, z, r = (float(v) for v in values[2:])
        out.append((values[1].strip().upper(), [x, y, z], r))
    return out


def add_range(
    imported: Imported,
    t: float,
    a: str,
    b: str,
    distance: float,
    asked: Asked,
    unit: str,
    rx_power: float = np.nan,
    fp_power: float = np.nan,
) -> None:
    """Add a range in `unit`, or in the one that was asked for; powers in dBm."""
    metres = LENGTH_UNITS[asked.range_unit or unit]
    imported.ranges.add(t, a, b, metres * distance, rx_power=rx_power, fp_power=fp_power)


def _told(path: Path, imported: Imported, skipped: int) -> Imported:
    if not len(imported.ranges):
        raise InputError(path, "has no range")
    if skipped:
        imported.note(f"{skipped} lines of {path.name} are no ranges and skipped")
    return imported


class _Clock:
    """When a line was logged: its own stamp, the module's, or so many lines a second."""

    def __init__(self, path: Path, asked: Asked, imported: Imported) -> None:
        self._path, self._asked, self._imported = path, asked, imported
        self._count = 0

    def at(self, line: _Line, before: str, own: float | None = None) -> float:
        """The time (s) of a line, with what stands before its ranges, and the module's own time."""
        self._count += 1
        stamp = self._stamp(before)
        if stamp is not None:
            return stamp
        if own is not None:
            self._imported.note("stamps are the module's own clock (--time-offset shifts them to the tracks')")
            return own
        if self._asked.rate is not None:
            return (self._count - 1) / self._asked.rate
        raise InputError(
            self._path, "has no time: log a stamp before each line, or say --rate HZ (and --time-offset)", line.number
        )

    def _stamp(self, text: str) -> float | None:
        if found := _DATE.search(text):
            zone = (found[3] or "Z").replace("Z", "+00:00")
            try:
                moment = datetime.fromisoformat(f"{found[1]}T{found[2].replace(',', '.')}{zone}")
            except ValueError:
                return None
            if found[3] is None:
                self._imported.note("dates without a zone are taken for UTC")
            return moment.astimezone(UTC).timestamp()
        if found := _CLOCK.search(text):
            self._imported.note("stamps are times of the day, without a date")
            return 3600.0 * float(found[1]) + 60.0 * float(found[2]) + float(found[3].replace(",", "."))
        found = re.search(_NUMBER, text)
        if found is None:
            return None
        value = float(found[0])
        unit = self._asked.time_unit or time_unit_by_size(value)
        return value * TIME_UNITS[unit]


def _nooploop_csv(path: Path, asked: Asked, imported: Imported, progress: Progress) -> None:
    lines = _lines(path, progress)
    header = next(lines).text.split(",")
    place = {name.strip(): k for k, name in enumerate(header)}
    nodes = [n for n in range(256) if f"field.nodes{n}.dis" in place]
    arrays = [n for n in range(256) if f"field.dis_arr{n}" in place]
    for line in lines:
        values = line.text.split(",")

        def number(name: str, values: list[str] = values, line: _Line = line) -> float:
            k = place.get(name)
            if k is None or k >= len(values) or not values[k].strip():
                return np.nan
            if not is_number(values[k].strip()):
                raise InputError(path, f"{name} is {quoted(values[k])}: it must be a number", line.number)
            return float(values[k])

        me = _whose(asked, path, number("field.id"))
        t = 1e-9 * number("%time")
        for n in nodes:
            fp, rx = number(f"field.nodes{n}.fp_rssi"), number(f"field.nodes{n}.rx_rssi")
            _add_node(imported, t, me, number(f"field.nodes{n}.id"), number(f"field.nodes{n}.dis"), asked, fp, rx)
        for n in arrays:
            _add_node(imported, t, me, float(n), number(f"field.dis_arr{n}"), asked, prefix="anchor")


def _nooploop_yaml(path: Path, asked: Asked, imported: Imported, progress: Progress) -> None:
    top: dict[str, float] = {}
    nodes: list[dict[str, float]] = []
    in_nodes = False

    def finish() -> None:
        t = 1e-3 * top.get("system_time", np.nan)
        if "secs" in top:
            t = top["secs"] + 1e-9 * top.get("nsecs", 0.0)
        me = _whose(asked, path, top.get("id", np.nan))
        for node in nodes:
            fp, rx = node.get("fp_rssi", np.nan), node.get("rx_rssi", np.nan)
            number, distance = node.get("id", np.nan), node.get("dis", np.nan)
            _add_node(imported, t, me, number, distance, asked, fp, rx, "anchor" if "index" in node else "")
        top.clear()
        nodes.clear()

    for line in _lines(path, progress):
        text = line.text
        if text.startswith("---"):
            finish()
            in_nodes = False
            continue
        if text.startswith("dis_arr:"):
            in_nodes = False
            values = [v.strip() for v in text.partition(":")[2].strip(" []()").split(",") if v.strip()]
            for n, value in enumerate(values):
                nodes.append({"id": float(n), "index": float(n), "dis": _value(path, line, value)})
            continue
        key, colon, value = text.lstrip("- ").partition(":")
        if not colon:
            continue
        key = key.strip()
        if key == "nodes":
            in_nodes = True
            continue
        if in_nodes and (text.startswith("-") or (key == "role" and (not nodes or "dis" in nodes[-1]))):
            nodes.append({})
        of = nodes[-1] if in_nodes and nodes else top
        if value.strip() and key in ("id", "dis", "fp_rssi", "rx_rssi", "system_time", "local_time", "secs", "nsecs"):
            of[key] = _value(path, line, value.strip())
    finish()
    if not any(t > 1e9 for t in imported.ranges.t[:1]):
        imported.note("stamps are the module's own clock (--time-offset shifts them to the tracks')")


def _value(path: Path, line: _Line, text: str) -> float:
    if not is_number(text):
        raise InputError(path, f"{quoted(text)} must be a number", line.number)
    return float(text)


def _whose(asked: Asked, path: Path, number: float) -> str:
    return asked.user or (str(int(number)) if np.isfinite(number) else path.stem)


def _add_node(
    imported: Imported,
    t: float,
    me: str,
    node: float,
    distance: float,
    asked: Asked,
    fp: float = np.nan,
    rx: float = np.nan,
    prefix: str = "",
) -> None:
    """A range of a frame: none where it is 0."""
    if np.isfinite(node) and np.isfinite(t) and distance > 0.0:
        add_range(imported, t, me, f"{prefix}{int(node)}", distance, asked, "m", rx_power=rx, fp_power=fp)
