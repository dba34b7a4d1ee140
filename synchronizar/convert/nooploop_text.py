"""Reads `rostopic echo` of nlink_parser's node and tag frames, as YAML or (`-p`) as csv."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice
from pathlib import Path

import numpy as np

from synchronizar.convert.asked import Asked
from synchronizar.convert.imported import Imported
from synchronizar.convert.logs import OWN_CLOCK, Log
from synchronizar.convert.source import Source
from synchronizar.convert.tables import lines_of
from synchronizar.errors import InputError
from synchronizar.io.text import is_number, quoted
from synchronizar.progress import Progress, unheard

_KEYS = ("id", "dis", "fp_rssi", "rx_rssi", "system_time", "local_time", "secs", "nsecs")
_MOST = 256
"""Nodes and anchors of a frame."""


def recognises(source: Source) -> bool:
    """nlink_parser's fields, as YAML or as csv."""
    lines = source.lines
    if lines and _is_csv(lines[0]):
        return "field.nodes0.dis" in lines[0] or "field.dis_arr0" in lines[0]
    text = "\n".join(lines)
    return "system_time:" in text and ("dis:" in text or "dis_arr:" in text)


def read(path: Path, asked: Asked, progress: Progress) -> Imported:
    """Ranges of a node or a tag to others, m and dBm. Raises InputError for a value that is no number."""
    log = Log(path, asked, "m")
    _, first = next(iter(lines_of(path, unheard)), (0, ""))
    if _is_csv(first):
        _read_csv(log, path, asked, progress)
    else:
        _read_yaml(log, path, asked, progress)
    return log.read("dis: 2.25 below nodes:, or a column field.nodes0.dis")


def _is_csv(header: str) -> bool:
    return header.startswith("%time")


def _read_csv(log: Log, path: Path, asked: Asked, progress: Progress) -> None:
    lines = lines_of(path, progress)
    place = {name.strip(): k for _, header in islice(lines, 1) for k, name in enumerate(header.split(","))}
    nodes = [n for n in range(_MOST) if f"field.nodes{n}.dis" in place]
    anchors = [n for n in range(_MOST) if f"field.dis_arr{n}" in place]
    for line, text in lines:
        number = _numbers(path, line, place, text.split(","))
        me, t = _whose(asked, log, number("field.id")), 1e-9 * number("%time")
        for n in nodes:
            at = f"field.nodes{n}"
            fp, rx = number(f"{at}.fp_rssi"), number(f"{at}.rx_rssi")
            _add(log, t, me, _name(number(f"{at}.id")), number(f"{at}.dis"), fp_power=fp, rx_power=rx)
        for n in anchors:
            _add(log, t, me, f"anchor{n}", number(f"field.dis_arr{n}"))


def _numbers(path: Path, line: int, place: dict[str, int], values: list[str]) -> Callable[[str], float]:
    """A function of a field's name: its number in a row, NaN where it has none."""

    def number(name: str) -> float:
        k = place.get(name)
        text = values[k].strip() if k is not None and k < len(values) else ""
        return _number(path, line, name, text) if text else np.nan

    return number


def _read_yaml(log: Log, path: Path, asked: Asked, progress: Progress) -> None:
    top: dict[str, float] = {}
    nodes: list[dict[str, float]] = []
    anchors: list[float] = []
    in_nodes = False

    def finish() -> None:
        t = 1e-3 * top.get("system_time", np.nan)
        if "secs" in top:
            t = top["secs"] + 1e-9 * top.get("nsecs", 0.0)
        elif nodes or anchors:
            log.imported.note(OWN_CLOCK)
        me = _whose(asked, log, top.get("id", np.nan))
        for node in nodes:
            powers = {f"{of}_power": node.get(f"{of}_rssi", np.nan) for of in ("fp", "rx")}
            _add(log, t, me, _name(node.get("id", np.nan)), node.get("dis", np.nan), **powers)
        for n, distance in enumerate(anchors):
            _add(log, t, me, f"anchor{n}", distance)
        for of in (top, nodes, anchors):
            of.clear()

    for line, text in lines_of(path, progress):
        if text.startswith("---"):
            finish()
            in_nodes = False
            continue
        key, colon, value = (part.strip() for part in text.lstrip("- ").partition(":"))
        if key == "dis_arr":
            in_nodes = False
            several = value.strip("[]()").split(",")
            anchors.extend(_number(path, line, key, one.strip()) for one in several if one.strip())
        elif key == "nodes":
            in_nodes = True
        elif colon:
            if in_nodes and (text.startswith("-") or (key == "role" and (not nodes or "dis" in nodes[-1]))):
                nodes.append({})
            if value and key in _KEYS:
                of = nodes[-1] if in_nodes and nodes else top
                of[key] = _number(path, line, key, value)
    finish()


def _number(path: Path, line: int, name: str, text: str) -> float:
    if not is_number(text):
        raise InputError(path, f"{name} is {quoted(text)}: it must be a number", line)
    return float(text)


def _whose(asked: Asked, log: Log, number: float) -> str:
    return log.me if asked.user is not None else _name(number) or log.me


def _name(number: float) -> str:
    return str(int(number)) if np.isfinite(number) else ""


def _add(log: Log, t: float, me: str, other: str, distance: float, **powers: float) -> None:
    """A range of a frame: none where it is 0."""
    if other and np.isfinite(t) and distance > 0.0:
        log.add(t, me, other, distance, **powers)
