"""Which column of a table is what: by names that were said, or usual ones, and the units in them."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from synchronizar.convert.source import Source
from synchronizar.errors import InputError
from synchronizar.io.text import is_number, quoted

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
COLUMNS = (*_NAMES, "y", "z", "qx", "qy", "qz")
LITERAL = ("a", "b", "user", "antenna_a", "antenna_b")
"""Columns in whose place one name may be said for all rows."""
_UNIT = re.compile(r"(?i)[\s_.(\[]+(ns|us|µs|ms|sec|s|m|mm|cm|ft|deg|degrees|rad)[\])\s]*$")
_SHOWN = 20


class Table(NamedTuple):
    """A text file of rows below a header."""

    path: Path
    header: list[str]
    separator: str | None
    """None: blanks."""
    first_line: int
    """Of the rows, counted from 1."""

    @classmethod
    def of(cls, source: Source) -> Table | None:
        """None where its first lines are no names of columns."""
        if not source.is_text:
            return None
        comment = ""
        for number, line in enumerate(source.head.decode("utf-8-sig", errors="replace").splitlines(), start=1):
            text = line.strip()
            if not text:
                continue
            if text.startswith("#"):
                comment = text.lstrip("# ")
                continue
            separator = next((s for s in ",;\t" if s in text), None)
            header, first = text, number + 1
            if is_number(split(text, separator)[0]):
                header, first = comment, number
            names = [name.strip().strip('"') for name in split(header, separator)]
            if len(names) < 2 or any(is_number(name) for name in names):
                return None
            return cls(source.path, names, separator, first)
        return None

    @property
    def shown(self) -> str:
        """Its columns, for a message."""
        return ", ".join(self.header[:_SHOWN])

    def columns(self, said: Mapping[str, str]) -> dict[str, int]:
        """Where each of COLUMNS is, as said or by usual names. Raises InputError for what was said and is not there."""
        found: dict[str, int] = {}
        for name, column in said.items():
            if column in self.header:
                found[name] = self.header.index(column)
            elif name not in LITERAL:
                raise InputError(self.path, f"has no column {quoted(column)}: there are {self.shown}")
        plain = [_UNIT.sub("", name.lower()).strip() for name in self.header]
        whole = [name.lower() for name in self.header]
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
                alike = dict(_alike(plain, found[first], others, letter))
                found |= {name: k for name, k in alike.items() if name not in found and name not in said}
        return found

    def unit(self, column: int, known: Iterable[str]) -> str | None:
        """The unit that a column's name ends with, where it is one of these."""
        found = _UNIT.search(self.header[column])
        unit = found[1].lower() if found else ""
        unit = {"sec": "s", "µs": "us", "degrees": "deg"}.get(unit, unit)
        return unit if unit in known else None


def split(line: str, separator: str | None) -> list[str]:
    """The values of a line. Raises csv.Error for one that cannot be split."""
    return line.split() if separator is None else next(csv.reader([line], delimiter=separator), [])


def _alike(plain: list[str], first: int, others: Sequence[str], letter: str) -> Iterator[tuple[str, int]]:
    """The columns whose names differ from a first one by a letter alone."""
    place = plain[first].rfind(letter)
    for other in others:
        like = plain[first][:place] + other[-1] + plain[first][place + 1 :]
        if like in plain:
            yield other, plain.index(like)
