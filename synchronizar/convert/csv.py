"""Reads tables with a header: poses of one device or of several, or ranges, by columns that are named or guessed.

| | |
|---|---|
| columns | poses: t, x, y, z and qx qy qz qw, or yaw (pitch, roll), and user; ranges: t, a, b, range, sigma, ... |
| named | `--column t=stamp --column x="pos x"`, or `[columns]` of `--map`; `a`, `b`, `user` may be a name instead |
| guessed | columns of usual names (timestamp, tx, px, distance, from_id, ...), which is said; units in names count |
| time | s unless a column says ms, us or ns, or its numbers can be nothing else; `--time-unit`, `--time-offset` |
| units | m, rad unless columns or `--length-unit`, `--range-unit`, `--angle-unit` say otherwise |
| frames | z up unless `--world` says otherwise (`--world arkit`: y up) |
| refused | tables without a header, without t, or with neither x y z nor range; values that are no numbers |

Yaw, pitch and roll are about z, y and x, in this order (ZYX). A table without attitudes has the identity.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.convert.asked import LENGTH_UNITS, TIME_UNITS, Asked, time_unit_by_size
from synchronizar.convert.imported import Imported
from synchronizar.convert.mapping import mapped
from synchronizar.convert.source import Source
from synchronizar.convert.track_file import add_track
from synchronizar.errors import InputError, os_faults
from synchronizar.io.text import is_number, open_text, quoted
from synchronizar.progress import Progress
from synchronizar.quaternions import multiply_quaternions

_NAMES = {
    "t": "t time timestamp stamp ts timestamps time_s timestamp_s timestamp_ns timestamp_ms timestamp_us t_ns t_ms "
    "time_ns time_ms unix_time epoch utc sec secs seconds header.stamp %time rosbagtimestamp",
    "user": "user device name robot agent phone vehicle track tag_name",
    "x": "x tx px pos_x position_x p_x p_rs_r_x x_m x_mm position.x translation_x field.pose.position.x "
    "field.pose.pose.position.x pose.position.x pose.pose.position.x posx",
    "qw": "qw q_w quat_w rot_w orientation_w q_rs_w rotation_w orientation.w field.pose.orientation.w "
    "field.pose.pose.orientation.w pose.orientation.w pose.pose.orientation.w ow quaternion_w",
    "yaw": "yaw heading theta psi rz yaw_deg yaw_rad heading_deg azimuth",
    "pitch": "pitch ry pitch_deg pitch_rad",
    "roll": "roll rx roll_deg roll_rad",
    "a": "a from from_id src source source_id initiator initiator_id requester requester_id tag tag_id tagid id1 id_1 "
    "node_a id_a device_a user_a origin_id sender robot_a robot1",
    "b": "b to to_id dst dest destination destination_id target target_id responder responder_id anchor anchor_id "
    "anchorid id2 id_2 node_b id_b device_b user_b peer receiver beacon beacon_id robot_b robot2",
    "range": "range distance dist dis r range_m distance_m dist_m range_mm distance_mm dist_mm range_cm distance_cm d "
    "measured_range measured_distance uwb_range uwb_distance field.range",
    "sigma": "sigma",
    "rx_power": "rx_power rssi rx_rssi rss rx_power_dbm",
    "fp_power": "fp_power fp_rssi fpp fp_power_dbm",
    "nlos": "nlos is_nlos",
    "antenna_a": "antenna_a",
    "antenna_b": "antenna_b",
}
"""Usual names of each column; those of y, z and of qx, qy, qz follow from x and qw."""
_UNIT = re.compile(r"(?i)[\s_.(\[]+(ns|us|µs|ms|sec|s|m|mm|cm|ft|deg|degrees|rad)[\])\s]*$")
_LITERAL = ("a", "b", "user", "antenna_a", "antenna_b")
"""Stamps since 1970 that are larger are of that unit."""


class _Table(NamedTuple):
    path: Path
    header: list[str]
    separator: str | None
    first_line: int
    """Of the rows, counted from 1."""


def recognises(source: Source) -> bool:
    """A header of names, in which the columns of poses or of ranges are."""
    table = _table_of(source)
    if table is None:
        return False
    found = _columns(table, {})
    return "t" in found and ({"x", "y", "z"} <= found.keys() or {"a", "b", "range"} <= found.keys())


def read(path: Path, asked: Asked, progress: Progress) -> Imported:
    """Tracks or ranges. Raises InputError for a table without what is needed, or a value that is no number."""
    said = mapped(asked).columns
    table = _table_of(Source.of(path))
    if table is None:
        raise InputError(
            path, "has no header: its first line has to name the columns, t x y z qx qy qz qw or t a b range"
        )
    for name in said:
        if name not in _all_names():
            raise InputError(
                "--column", f"{quoted(name)} is no column that is read: there are {', '.join(_all_names())}"
            )
    found = _columns(table, said)
    if "t" not in found:
        raise InputError(path, f"has no column of times: say --column t=NAME, one of {_shown(table.header)}")
    rows = _rows(table)
    progress(0.5)
    imported = Imported()
    guessed = [
        f"{name} = {table.header[k]}" for name, k in found.items() if name not in said and name != table.header[k]
    ]
    if guessed:
        imported.note(f"columns are taken to be {', '.join(guessed)}")
    t = _times(table, found, rows, asked, imported)
    if "range" in found:
        _add_ranges(imported, table, found, said, rows, t, asked)
    elif {"x", "y", "z"} <= found.keys():
        _add_poses(imported, table, found, said, rows, t, asked)
    else:
        raise InputError(path, f"has neither x y z nor range: say --column x=NAME ..., of {_shown(table.header)}")
    progress(1.0)
    return imported


def _all_names() -> list[str]:
    return [*_NAMES, "y", "z", "qx", "qy", "qz"]


def _shown(header: Sequence[str]) -> str:
    return ", ".join(header[:20])


def _table_of(source: Source) -> _Table | None:
    if not source.is_text:
        return None
    lines = source.head.decode("utf-8-sig", errors="replace").splitlines()
    comment = ""
    for number, line in enumerate(lines, start=1):
        text = line.strip()
        if not text:
            continue
        if text.startswith("#"):
            comment = text.lstrip("# ")
            continue
        separator = next((s for s in ",;\t" if s in text), None)
        header, first = text, number + 1
        if is_number(_split(text, separator)[0]):
            header, first = comment, number
        names = [name.strip().strip('"') for name in _split(header, separator)]
        if len(names) < 2 or any(is_number(name) for name in names):
            return None
        return _Table(source.path, names, separator, first)
    return None


def _split(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return line.split()
    return next(csv.reader([line], delimiter=separator), [])


def _columns(table: _Table, said: Mapping[str, str]) -> dict[str, int]:
    """Where each column is; raises InputError for one that was said and is not there."""
    found: dict[str, int] = {}
    for name, column in said.items():
        if column in table.header:
            found[name] = table.header.index(column)
        elif name not in _LITERAL:
            raise InputError(table.path, f"has no column {quoted(column)}: there are {_shown(table.header)}")
    plain = [_UNIT.sub("", name.lower()).strip() for name in table.header]
    whole = [name.lower() for name in table.header]
    for name, names in _NAMES.items():
        if name in found or name in said:
            continue
        for candidate in names.split():
            k = next((k for k in range(len(plain)) if candidate in (plain[k], whole[k])), None)
            if k is not None and k not in found.values():
                found[name] = k
                break
    for first, others, letter in (("x", "yz", "x"), ("qw", ("qx", "qy", "qz"), "w")):
        if first in found:
            _follow(plain, found, said, first, others, letter)
    return found


def _follow(
    plain: list[str], found: dict[str, int], said: Mapping[str, str], first: str, others: Sequence[str], letter: str
) -> None:
    """Find the columns whose names differ from a found one by a letter alone."""
    pattern = plain[found[first]]
    place = pattern.rfind(letter)
    for other in others:
        like = pattern[:place] + other[-1] + pattern[place + 1 :]
        if other not in found and other not in said and like in plain:
            found[other] = plain.index(like)


def _rows(table: _Table) -> list[tuple[int, list[str]]]:
    """Line and values of each row."""
    rows = []
    with os_faults(table.path), open_text(table.path) as file:
        for number, line in enumerate(file, start=1):
            if number < table.first_line or not line.strip() or line.lstrip().startswith("#"):
                continue
            try:
                values = [value.strip() for value in _split(line, table.separator)]
            except csv.Error as error:
                raise InputError(table.path, f"cannot be split into columns: {error}", number) from error
            if len(values) < len(table.header):
                fault = f"the header has {len(table.header)} columns, here are {len(values)}"
                raise InputError(table.path, fault, number)
            rows.append((number, values))
    if not rows:
        raise InputError(table.path, "has a header and no line below it")
    return rows


def _numbers(table: _Table, rows: list[tuple[int, list[str]]], column: int, blank: bool = False) -> Array:
    """(n,) numbers of a column."""
    out = np.full(len(rows), np.nan)
    for k, (line, values) in enumerate(rows):
        if blank and not values[column]:
            continue
        if not is_number(values[column]):
            fault = f"{table.header[column]} is {quoted(values[column])}: it must be a number"
            raise InputError(table.path, fault, line)
        out[k] = float(values[column])
    return out


def _unit_in(name: str, known: Mapping[str, float]) -> str | None:
    found = _UNIT.search(name)
    unit = {"sec": "s", "µs": "us"}.get(found[1].lower(), found[1].lower()) if found else None
    return unit if unit in known else None


def _times(
    table: _Table, found: Mapping[str, int], rows: list[tuple[int, list[str]]], asked: Asked, imported: Imported
) -> Array:
    t = _numbers(table, rows, found["t"])
    name = table.header[found["t"]]
    unit = asked.time_unit or _unit_in(name, TIME_UNITS) or ("ns" if name == "%time" else None)
    if unit is None:
        size = float(np.median(np.abs(t[np.isfinite(t)]))) if np.isfinite(t).any() else 0.0
        unit = time_unit_by_size(size)
        if unit != "s":
            imported.note(f"{name} is taken to be in {unit}, since it is {size:.6g} (--time-unit says otherwise)")
    return t * TIME_UNITS[unit]


def _names(
    rows: list[tuple[int, list[str]]], found: Mapping[str, int], said: Mapping[str, str], name: str
) -> list[str]:
    """(n,) names of a column, or the one that was said."""
    if name in found:
        return [re.sub(r"^(-?\d+)\.0+$", r"\1", values[found[name]]) for _, values in rows]
    return [said.get(name, "")] * len(rows)


def _add_ranges(
    imported: Imported,
    table: _Table,
    found: Mapping[str, int],
    said: Mapping[str, str],
    rows: list[tuple[int, list[str]]],
    t: Array,
    asked: Asked,
) -> None:
    ends = {}
    for end in ("a", "b"):
        ends[end] = _names(rows, found, said, end)
        if not all(ends[end]):
            raise InputError(table.path, f"does not say whose its ranges are: say --column {end}=COLUMN, or a name")
    name = table.header[found["range"]]
    unit = asked.range_unit or _unit_in(name, LENGTH_UNITS) or "m"
    ranges = imported.ranges
    ranges.t.extend(t.tolist())
    ranges.a.extend(ends["a"])
    ranges.b.extend(ends["b"])
    ranges.distance.extend((_numbers(table, rows, found["range"], blank=True) * LENGTH_UNITS[unit]).tolist())
    for column in ("sigma", "rx_power", "fp_power", "nlos"):
        known = column in found and (column != "sigma" or asked.sigma or column in said)
        values = _numbers(table, rows, found[column], blank=True) if known else np.full(len(rows), np.nan)
        getattr(ranges, column).extend(values.tolist())
    for column in ("antenna_a", "antenna_b"):
        getattr(ranges, column).extend(_names(rows, found, said, column))


def _add_poses(
    imported: Imported,
    table: _Table,
    found: Mapping[str, int],
    said: Mapping[str, str],
    rows: list[tuple[int, list[str]]],
    t: Array,
    asked: Asked,
) -> None:
    metres = LENGTH_UNITS[_unit_in(table.header[found["x"]], LENGTH_UNITS) or "m"]
    if asked.length_unit is not None:
        metres = 1.0  # `add_track` turns what was asked into metres
    position = np.column_stack([_numbers(table, rows, found[axis]) for axis in "xyz"]) * metres
    poses = np.column_stack([t, position, _attitudes(imported, table, found, rows, asked)])
    users = _names(rows, found, said, "user")
    stem = table.path.stem
    for user in sorted(set(users)):
        mine = np.array([name == user for name in users])
        add_track(imported, user or stem, poses[mine], asked)


def _attitudes(
    imported: Imported, table: _Table, found: Mapping[str, int], rows: list[tuple[int, list[str]]], asked: Asked
) -> Array:
    """(n, 4) x y z w."""
    quaternion = ("qx", "qy", "qz", "qw")
    if all(name in found for name in quaternion):
        return np.column_stack([_numbers(table, rows, found[name]) for name in quaternion])
    if "yaw" not in found:
        imported.note(f"{table.path.name} has no attitudes: they are the identity")
        return np.tile([0.0, 0.0, 0.0, 1.0], (len(rows), 1))
    quat = np.tile([0.0, 0.0, 0.0, 1.0], (len(rows), 1))
    for name, axis in (("yaw", 2), ("pitch", 1), ("roll", 0)):
        if name not in found:
            continue
        angle = _numbers(table, rows, found[name])
        header = table.header[found[name]].lower()
        unit = asked.angle_unit or ("deg" if re.search(r"deg", header) else None)
        if unit is None:
            unit = "deg" if np.nanmax(np.abs(angle)) > 2.0 * np.pi + 0.1 else "rad"
            imported.note(f"{table.header[found[name]]} is taken to be in {unit} (--angle-unit says otherwise)")
        half = 0.5 * (np.radians(angle) if unit == "deg" else angle)
        turn = np.zeros((len(rows), 4))
        turn[:, axis], turn[:, 3] = np.sin(half), np.cos(half)
        quat = multiply_quaternions(quat, turn)
    return quat
