"""Lines of text files, and tables of numbers: read fast, and where that fails, the first line at fault is named."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from synchronizar.arrays import Array
from synchronizar.errors import InputError, os_faults
from synchronizar.io.text import is_number, open_text, quoted
from synchronizar.progress import Progress

_LINES_A_STEP = 20_000


def lines_of(path: Path, progress: Progress) -> Iterator[tuple[int, str]]:
    """Lines of a text that are not blank, counted from 1, without what surrounds them."""
    with os_faults(path):
        size, done = max(path.stat().st_size, 1), 0
        with open_text(path) as file:
            for number, line in enumerate(file, start=1):
                done += len(line)
                if number % _LINES_A_STEP == 0:
                    progress(min(done / size, 1.0))
                if text := line.strip():
                    yield number, text
    progress(1.0)


def read_numbers(
    path: Path, names: str, columns: int, separator: str | None = None, more: bool = False
) -> tuple[Array, Callable[[int], int]]:
    """(n, columns) numbers of n > 0 lines, and a function from a row to its line in the file, counted from 1.

    `names` says what the columns are, for a message. With `more`, further columns are not read. Blank lines and what
    follows a # are skipped. Raises InputError that names the line where it is not that many numbers.
    """
    with os_faults(path), open_text(path) as file, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of a file without numbers, which is refused below
        try:
            rows = np.loadtxt(file, delimiter=separator, ndmin=2, usecols=range(columns) if more else None)
        except (ValueError, IndexError):
            rows = np.zeros((0, 0))
    if not len(rows) or rows.shape[1] != columns:
        raise _fault(path, names, columns, separator, more)
    return np.asarray(rows), lambda row: _line_of(path, row)


def _fault(path: Path, names: str, columns: int, separator: str | None, more: bool) -> InputError:
    with os_faults(path), open_text(path) as file:
        for number, line in enumerate(file, start=1):
            text = line.partition("#")[0].strip()
            if not text:
                continue
            values = [value.strip() for value in text.split(separator)]
            if len(values) < columns or (len(values) > columns and not more):
                return InputError(path, f"a line has {columns} numbers, {names}; here are {len(values)}", number)
            for value in values[:columns]:
                if not is_number(value):
                    return InputError(path, f"{quoted(value)} is no number; a line has {names}", number)
    return InputError(path, f"has no line of numbers {names}")


def _line_of(path: Path, row: int) -> int:
    """The line of a row's numbers."""
    with os_faults(path), open_text(path) as file:
        for number, line in enumerate(file, start=1):
            if line.partition("#")[0].strip():
                if row == 0:
                    return number
                row -= 1
    return 0
