"""Reads tables with a header: poses of one device or of several, or ranges, by columns that are named or guessed.

| | |
|---|---|
| columns | poses: t, x, y, z and qx qy qz qw, or yaw (pitch, roll), and user; ranges: t, a, b, range, sigma, ... |
| named | `--column t=stamp --column x="pos x"`, or `[columns]` of `--map`; `a`, `b`, `user` may be a name instead |
| guessed | columns of usual names (timestamp, tx, px, distance, from_id, ...), which is said; units in names count |
| time | s unless a column says ms, us or ns, or its numbers can be nothing else; `--time-unit`, `--time-offset` |
| units | m, rad unless columns or `--length-unit`, `--range-unit`, `--angle-unit` say otherwise |
| numbers | with a decimal point, or a comma where semicolons separate columns |
| frames | z up unless `--world` says otherwise (`--world arkit`: y up) |
| refused | tables without a header, without t, or with neither x y z nor range; values that are no numbers |

Yaw, pitch and roll are about z, y and x, in this order (ZYX). A table without attitudes has the identity.
"""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from synchronizar.arrays import Array
from synchronizar.convert.asked import ANGLE_UNITS, LENGTH_UNITS, TIME_UNITS, Asked, time_unit_by_size
from synchronizar.convert.columns import COLUMNS, LITERAL, Table, split
from synchronizar.convert.imported import Imported
from synchronizar.convert.mapping import mapped
from synchronizar.convert.source import Source
from synchronizar.convert.tables import lines_of
from synchronizar.convert.track_file import add_track
from synchronizar.errors import InputError
from synchronizar.io.text import is_number, quoted
from synchronizar.progress import Progress
from synchronizar.quaternions import IDENTITY, multiply_quaternions

_ANGLES = (("yaw", 2), ("pitch", 1), ("roll", 0))
"""And the axes that they are about, in the order in which the body is turned."""
_QUATERNION = ("qx", "qy", "qz", "qw")
_OF_RANGES = ("range", "sigma", "rx_power", "fp_power", "nlos")
_OF_POSES = ("x", "y", "z", *_QUATERNION, *(name for name, _ in _ANGLES))


def recognises(source: Source) -> bool:
    """A header of names, in which the columns of poses or of ranges are."""
    table = Table.of(source)
    if table is None:
        return False
    found = table.columns({})
    return "t" in found and ({"x", "y", "z"} <= found.keys() or {"a", "b", "range"} <= found.keys())


def read(path: Path, asked: Asked, progress: Progress) -> Imported:
    """Tracks or ranges. Raises InputError for a table without what is needed, or a value that is no number."""
    said = mapped(asked).columns
    table = Table.of(Source.of(path))
    if table is None:
        raise InputError(
            path, "has no header: its first line has to name the columns, t x y z qx qy qz qw or t a b range"
        )
    for name in said:
        if name not in COLUMNS:
            raise InputError("--column", f"{quoted(name)} is no column that is read: there are {', '.join(COLUMNS)}")
    found = table.columns(said)
    if "t" not in found:
        raise InputError(path, f"has no column of times: say --column t=NAME, one of {table.shown}")
    has_ranges = "range" in found
    if not has_ranges and not {"x", "y", "z"} <= found.keys():
        raise InputError(path, f"has neither x y z nor range: say --column x=NAME ..., of {table.shown}")
    for end in ("a", "b") if has_ranges else ():
        if end not in {*found, *said}:
            raise InputError(path, f"does not say whose its ranges are: say --column {end}=COLUMN, or a name")
    imported = Imported()
    guessed = {name: table.header[k] for name, k in found.items() if name not in said and name != table.header[k]}
    if guessed:
        imported.note(f"columns are taken to be {', '.join(map(' = '.join, guessed.items()))}")
    wanted = {
        name: k for name, k in found.items() if name in ("t", *LITERAL, *(_OF_RANGES if has_ranges else _OF_POSES))
    }
    rows = _Rows(table, wanted, said, asked, imported)
    rows.read(progress)
    if has_ranges:
        rows.add_ranges()
    else:
        rows.add_poses()
    return imported


class _Rows:
    """The columns of a table that are used."""

    def __init__(
        self, table: Table, columns: Mapping[str, int], said: Mapping[str, str], asked: Asked, imported: Imported
    ) -> None:
        self._table, self._columns, self._said = table, columns, said
        self._asked, self._imported = asked, imported
        self._numbers = {name: array("d") for name in columns if name not in LITERAL}
        self._names: dict[str, list[str]] = {name: [] for name in columns if name in LITERAL}
        self._count = 0

    def read(self, progress: Progress) -> None:
        """All rows. Raises InputError that names the line at fault."""
        path, header = self._table.path, self._table.header
        decimal_comma = self._table.separator == ";"  # as spreadsheets write where a number has one
        known: dict[str, str] = {}
        for number, line in lines_of(path, progress):
            if number < self._table.first_line or line.startswith("#"):
                continue
            try:
                values = split(line, self._table.separator)
            except csv.Error as error:
                raise InputError(path, f"cannot be split into columns: {error}", number) from error
            if len(values) < len(header):
                fault = f"the header has {len(header)} columns, here are {len(values)}"
                raise InputError(path, fault, number)
            for name, column in self._numbers.items():
                text = values[self._columns[name]].strip()
                if decimal_comma:
                    text = text.replace(",", ".", 1)
                if not is_number(text) and (text or name not in _OF_RANGES):
                    fault = f"{header[self._columns[name]]} is {quoted(text)}: it must be a number"
                    raise InputError(path, fault, number)
                column.append(float(text or "nan"))
            for name, names in self._names.items():
                text = values[self._columns[name]].strip()
                names.append(known.setdefault(text, re.sub(r"^(-?\d+)\.0+$", r"\1", text)))
            self._count += 1
        if not self._count:
            raise InputError(path, "has a header and no line below it")

    def add_ranges(self) -> None:
        """Add them, in m and s."""
        for end in ("a", "b"):
            if not all(self._named(end)):
                raise InputError(self._table.path, f"has a range without a name in the column of {end}")
        unit = self._asked.range_unit or self._unit("range", LENGTH_UNITS) or "m"
        optional: dict[str, Iterable[float]] = {
            name: self._numbers[name] for name in ("rx_power", "fp_power", "nlos") if name in self._numbers
        }
        if "sigma" in self._numbers and (self._asked.sigma or "sigma" in self._said):
            metres = LENGTH_UNITS[self._unit("sigma", LENGTH_UNITS) or unit]
            optional["sigma"] = (metres * np.array(self._numbers["sigma"])).tolist()
        antennas = {name: self._named(name) for name in ("antenna_a", "antenna_b")}
        distance = LENGTH_UNITS[unit] * np.array(self._numbers["range"])
        self._imported.ranges.extend(
            self._times().tolist(), self._named("a"), self._named("b"), distance.tolist(), **optional, **antennas
        )

    def add_poses(self) -> None:
        """Add the tracks, of each user one."""
        metres = LENGTH_UNITS[self._unit("x", LENGTH_UNITS) or "m"]
        if self._asked.length_unit is not None:
            metres = 1.0  # `add_track` turns what was asked into metres
        position = metres * np.column_stack([self._numbers[axis] for axis in "xyz"])
        poses = np.column_stack([self._times(), position, self._attitudes()])
        users, who = np.unique(np.array(self._named("user")), return_inverse=True)
        for k, user in enumerate(users.tolist()):
            add_track(self._imported, user or self._table.path.stem, poses[who == k], self._asked)

    def _named(self, name: str) -> list[str]:
        """(n,) names of a column, or the one that was said."""
        return self._names.get(name) or [self._said.get(name, "")] * self._count

    def _unit(self, name: str, known: Mapping[str, float]) -> str | None:
        return self._table.unit(self._columns[name], known)

    def _times(self) -> Array:
        """(n,) s."""
        t, name = np.array(self._numbers["t"]), self._table.header[self._columns["t"]]
        unit = self._asked.time_unit or self._unit("t", TIME_UNITS) or ("ns" if name == "%time" else None)
        if unit is None:
            size = float(np.median(np.abs(t[np.isfinite(t)]))) if np.isfinite(t).any() else 0.0
            unit = time_unit_by_size(size)
            if unit != "s":
                told = f"{name} is taken to be in {unit}, since it is {size:.6g} (--time-unit says otherwise)"
                self._imported.note(told)
        return t * TIME_UNITS[unit]

    def _attitudes(self) -> Array:
        """(n, 4) x y z w."""
        if self._numbers.keys() >= {*_QUATERNION}:
            return np.column_stack([self._numbers[name] for name in _QUATERNION])
        quat = np.tile(IDENTITY, (self._count, 1))
        if "yaw" not in self._numbers:
            self._imported.note(f"{self._table.path.name} has no attitudes: they are the identity")
            return quat
        for name, axis in _ANGLES:
            if name in self._numbers:
                half = 0.5 * self._radians(name)
                turn = np.zeros((self._count, 4))
                turn[:, axis], turn[:, 3] = np.sin(half), np.cos(half)
                quat = multiply_quaternions(quat, turn)
        return quat

    def _radians(self, name: str) -> Array:
        """(n,) an angle, in the unit that was asked for, that its name says, or that it can only be."""
        angle, header = np.array(self._numbers[name]), self._table.header[self._columns[name]]
        unit = self._asked.angle_unit or self._table.unit(self._columns[name], ANGLE_UNITS)
        if unit is None:
            unit = "deg" if np.abs(angle[np.isfinite(angle)]).max(initial=0.0) > 2.0 * np.pi + 0.1 else "rad"
            self._imported.note(f"{header} is taken to be in {unit} (--angle-unit says otherwise)")
        return np.radians(angle) if unit == "deg" else angle
