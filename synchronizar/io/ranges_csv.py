"""Reads and writes ranges.csv: a header, a line for each range, optional columns where they are known."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import islice, repeat
from operator import itemgetter
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from synchronizar.arrays import Array, Indices, Mask
from synchronizar.data.ranges import SOURCES, Ranges
from synchronizar.data.user import User
from synchronizar.errors import InputError, os_faults
from synchronizar.io.text import MAX_LENGTH, MAX_STAMP, MIN_SIGMA, is_number, is_plain, open_text, quoted

REQUIRED = ("t", "a", "b", "range")
OPTIONAL = ("sigma", "antenna_a", "antenna_b", "rx_power", "fp_power", "nlos", "source")
# Tables without blank integers write 0.0 and 1.0.
NLOS = {"": np.nan, "0": 0.0, "0.0": 0.0, "false": 0.0, "1": 1.0, "1.0": 1.0, "true": 1.0}
_NAMED = 12  # users, in a message
CHUNK_LINES = 2048
"""Lines read at a time; their text stays in the processor's cache, which makes reading twice as fast."""


def read_ranges_csv(path: Path, users: Sequence[User]) -> Ranges:
    """All ranges in the order of the file; users and antennas become indices in `users` and `User.antennas`.

    Columns may stand in any order, among others; blank lines are skipped; a blank value is unknown, and so is a source
    that is not one of SOURCES, since other tools use that column too. Distances of any size are kept, nan and inf too:
    whether a range is usable is decided later.

    Raises InputError where the file cannot be read or a line is not a range between two different users.
    """
    with os_faults(path), open_text(path) as file:
        chunks = [_ranges(chunk, users) for chunk in _chunks(path, file)]
    return Ranges(**{f.name: np.concatenate([getattr(chunk, f.name) for chunk in chunks]) for f in fields(Ranges)})


def read_usable_ranges(path: Path, users: Sequence[User]) -> Ranges:
    """All ranges without the rows that `read_ranges_csv` refuses; stamps may have any size.

    Raises InputError where the file cannot be read or a line has not as many values as the header.
    """
    with os_faults(path), open_text(path) as file:
        parts = [part for chunk in _chunks(path, file) for part in _usable(chunk, users)]
    return Ranges(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Ranges)})


def names_in_ranges_csv(path: Path) -> Counter[str]:
    """Number of ranges of each name, users or not. Raises InputError as `read_usable_ranges` does."""
    with os_faults(path), open_text(path) as file:
        return Counter(name for chunk in _chunks(path, file) for end in ("a", "b") for name in chunk.columns[end])


def unknown_columns(path: Path) -> list[str]:
    """Names of columns that are neither required nor optional. Raises InputError without a readable header."""
    with os_faults(path), open_text(path) as file:
        header, _ = _header(path, file)
    return [name for name in header if name and name not in REQUIRED + OPTIONAL]


def write_ranges_csv(path: Path, ranges: Ranges, users: Sequence[User]) -> None:
    """Write ranges so that they read back the same; an optional column only where some value in it is known.

    Raises InputError where the file cannot be written, ValueError for a range of a user with antennas that names none.
    """
    columns = {
        "t": ranges.t,
        "a": _user_names(users)[ranges.a],
        "b": _user_names(users)[ranges.b],
        "range": ranges.distance,
        "sigma": _blank_where_unknown(ranges.sigma),
        "antenna_a": _antenna_names(users, ranges.a, ranges.antenna_a),
        "antenna_b": _antenna_names(users, ranges.b, ranges.antenna_b),
        "rx_power": _blank_where_unknown(ranges.rx_power),
        "fp_power": _blank_where_unknown(ranges.fp_power),
        "nlos": np.select([ranges.nlos == 0.0, ranges.nlos == 1.0], ["0", "1"], default=""),
        "source": np.array([*SOURCES, ""], dtype=object)[ranges.source],  # -1 is the last, the blank
    }
    known = {name: column for name, column in columns.items() if name in REQUIRED or (column != "").any()}
    with os_faults(path), path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(known)
        writer.writerows(zip(*(column.tolist() for column in known.values()), strict=True))


@dataclass(frozen=True)
class _Chunk:
    """Consecutive ranges as text."""

    path: Path
    lines: NDArray[np.intp]
    """(n,) line of each range in the file, counted from 1."""
    columns: Mapping[str, list[str]]
    """n stripped values of each required and each optional column; blank where the file lacks the column."""

    def fault(self, column: str, row: int, expected: str) -> InputError:
        """The error for one value, with its line and what was expected."""
        value = quoted(self.columns[column][row])
        return InputError(self.path, f"{column} is {value}: {expected}", int(self.lines[row]))

    def refuse(self, column: str, bad: Mask, expected: str) -> None:
        """Raise the error for the first bad value (n,), if there is any."""
        if bad.any():
            raise self.fault(column, int(bad.argmax()), expected)

    def numbers(self, column: str, blank: str = "") -> Array:
        """(n,) numbers, nan and inf included; a blank is read as `blank`."""
        texts = [text or blank for text in self.columns[column]]
        try:
            if is_plain("".join(texts)):
                return np.fromiter(map(float, texts), dtype=float, count=len(texts))
        except ValueError:
            pass
        bad = ~np.fromiter(map(is_number, texts), dtype=bool, count=len(texts))
        remedy = ", nan for a measurement that failed" if column == "range" else ""
        raise self.fault(column, int(bad.argmax()), f"it must be a number{remedy}")

    def rows(self, which: slice) -> _Chunk:
        """The ranges that a slice picks."""
        return _Chunk(self.path, self.lines[which], {name: values[which] for name, values in self.columns.items()})

    def known(self, column: str) -> Mask:
        """(n,) whether the value is not blank."""
        return np.fromiter(map(bool, self.columns[column]), dtype=bool, count=len(self.lines))


def _chunks(path: Path, file: TextIO) -> Iterator[_Chunk]:
    """The file from its header on, in one chunk or more."""
    header, line = _header(path, file)
    while True:
        texts = list(islice(file, CHUNK_LINES))
        yield _chunk(path, header, texts, line + 1)
        line += len(texts)
        if len(texts) < CHUNK_LINES:
            return


def _header(path: Path, file: TextIO) -> tuple[list[str], int]:
    """Names of all columns, and the line that they stand in."""
    for number, line in enumerate(file, start=1):
        if not line.strip():
            continue
        header = [name.strip() for name in _split_line(path, line, number)]
        if missing := [name for name in REQUIRED if name not in header]:
            raise InputError(path, _lacks(missing, line), number)
        if twice := [name for name in REQUIRED + OPTIONAL if header.count(name) > 1]:
            raise InputError(path, f"the header has {twice[0]} more than once", number)
        return header, number
    raise InputError(path, f"is empty: it needs a header with {','.join(REQUIRED)}")


def _lacks(missing: Sequence[str], line: str) -> str:
    """What is wrong with a header, which is shown where it has nothing of what it needs."""
    fault = f"the header needs {','.join(REQUIRED)}, separated by commas; it lacks {','.join(missing)}"
    return fault if len(missing) < len(REQUIRED) else f"{fault}: it is {quoted(line.strip())}"


def _chunk(path: Path, header: list[str], texts: list[str], first_line: int) -> _Chunk:
    rows = _split(path, texts, first_line)
    complete = np.fromiter(map(len, rows), dtype=np.intp, count=len(rows)) == len(header)
    for i in np.flatnonzero(~complete).tolist():
        if texts[i].strip():
            raise InputError(path, f"the header has {len(header)} columns, here are {len(rows[i])}", first_line + i)
    rows = [row for row in rows if len(row) == len(header)]
    columns = {
        name: list(map(str.strip, map(itemgetter(header.index(name)), rows))) if name in header else [""] * len(rows)
        for name in REQUIRED + OPTIONAL
    }
    return _Chunk(path, first_line + np.flatnonzero(complete), columns)


def _split(path: Path, texts: list[str], first_line: int) -> list[list[str]]:
    """Values of each line. A quoted value must end in its line, so that each line is a row."""
    try:
        rows = list(csv.reader(texts, strict=True))
    except csv.Error:
        rows = []
    if len(rows) == len(texts):
        return rows
    return [_split_line(path, text, line) for line, text in enumerate(texts, start=first_line)]


def _split_line(path: Path, text: str, line: int) -> list[str]:
    try:
        return next(csv.reader([text], strict=True), [])
    except csv.Error as error:
        raise InputError(path, f"cannot be split into columns: {error}", line) from error


def _usable(chunk: _Chunk, users: Sequence[User]) -> Iterator[Ranges]:
    """Ranges of a chunk without its refused rows, which are found by bisection, in one part or more."""
    try:
        yield _ranges(chunk, users, np.inf)
    except InputError:
        half = len(chunk.lines) // 2
        yield from _usable(chunk.rows(slice(0, half)), users)
        if half:
            yield from _usable(chunk.rows(slice(half, None)), users)


def _ranges(chunk: _Chunk, users: Sequence[User], longest_stamp: float = MAX_STAMP) -> Ranges:
    t, distance = chunk.numbers("t"), chunk.numbers("range")
    chunk.refuse(
        "t",
        ~(np.isfinite(t) & (np.abs(t) <= longest_stamp)),
        f"a stamp is in seconds, finite and within {longest_stamp:g}",
    )
    a, b = _user_indices(chunk, "a", users), _user_indices(chunk, "b", users)
    chunk.refuse("b", a == b, "a device cannot measure the distance to itself")
    sigma = chunk.numbers("sigma", blank="nan")
    chunk.refuse(
        "sigma",
        chunk.known("sigma") & ~((sigma >= MIN_SIGMA) & (sigma <= MAX_LENGTH)),
        f"it must be between {MIN_SIGMA:g} and {MAX_LENGTH:g} m, or blank",
    )
    nlos = np.fromiter(
        map(NLOS.get, map(str.lower, chunk.columns["nlos"]), repeat(-1.0)), dtype=float, count=len(chunk.lines)
    )
    chunk.refuse("nlos", nlos < 0.0, "it must be 0, 1, true, false or blank")
    return Ranges(
        t=t,
        a=a,
        b=b,
        distance=distance,
        sigma=sigma,
        antenna_a=_antenna_indices(chunk, "antenna_a", a, users),
        antenna_b=_antenna_indices(chunk, "antenna_b", b, users),
        rx_power=_power(chunk, "rx_power"),
        fp_power=_power(chunk, "fp_power"),
        nlos=nlos,
        source=_sources(chunk),
    )


def _sources(chunk: _Chunk) -> Indices:
    """(n,) index in SOURCES; -1 for other words."""
    index_of = {word: i for i, word in enumerate(SOURCES)}
    found = map(index_of.get, map(str.lower, chunk.columns["source"]), repeat(-1))
    return np.fromiter(found, dtype=np.int32, count=len(chunk.lines))


def _power(chunk: _Chunk, column: str) -> Array:
    """(n,) dBm; NaN where it is blank or not finite (a radio without a power reports -inf)."""
    power = chunk.numbers(column, blank="nan")
    return np.where(np.isfinite(power), power, np.nan)


def _user_indices(chunk: _Chunk, column: str, users: Sequence[User]) -> Indices:
    index_of = {user.name: i for i, user in enumerate(users)}
    found = map(index_of.get, chunk.columns[column], repeat(-1))
    indices = np.fromiter(found, dtype=np.int32, count=len(chunk.lines))
    names = ", ".join([user.name for user in users[:_NAMED]])
    chunk.refuse(column, indices < 0, f"no user has that name; there are {names}")
    return indices


def _antenna_indices(chunk: _Chunk, column: str, who: Indices, users: Sequence[User]) -> Indices:
    antenna, unknown = antenna_indices(users, who, chunk.columns[column])
    if unknown is not None:
        user = users[who[unknown]]
        raise chunk.fault(column, unknown, f"{user.name} has the antennas {', '.join(user.antennas)}")
    return antenna


def antenna_indices(users: Sequence[User], who: Indices, named: Iterable[str]) -> tuple[Indices, int | None]:
    """(n,) antenna of each user `who`, -1 for users that declare none; and the first range whose antenna is unknown.

    A user's only antenna need not be named.
    """
    index_of = {(u, name): i for u, user in enumerate(users) for i, name in enumerate(user.antennas)}
    index_of |= {(u, ""): 0 for u, user in enumerate(users) if len(user.antennas) == 1}
    found = map(index_of.get, zip(who.tolist(), named, strict=True), repeat(-1))
    antenna = np.fromiter(found, dtype=np.int32, count=len(who))
    declared = np.array([bool(user.antennas) for user in users], dtype=bool)
    unknown = np.flatnonzero(declared[who] & (antenna < 0))
    return antenna, int(unknown[0]) if len(unknown) else None


def _user_names(users: Sequence[User]) -> NDArray[np.object_]:
    return np.array([user.name for user in users], dtype=object)


def _antenna_names(users: Sequence[User], who: Indices, antenna: Indices) -> NDArray[np.object_]:
    """(n,) names; blank for users that declare no antenna."""
    names = np.full((len(users), 1 + max((len(user.antennas) for user in users), default=0)), "", dtype=object)
    for u, user in enumerate(users):
        names[u, : len(user.antennas)] = list(user.antennas)
    declared = np.array([bool(user.antennas) for user in users], dtype=bool)
    if (declared[who] & (antenna < 0)).any():
        raise ValueError("a range of a user with antennas must say which one it is of")
    return names[who, antenna]  # -1 is the last column, which is blank


def _blank_where_unknown(column: Array) -> NDArray[np.object_]:
    return np.where(np.isnan(column), "", column.astype(object))
