"""What is told to a user whose input cannot be used."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class InputError(ValueError):
    """An input that cannot be used: one line that names the place and the fault.

    `place` is a file or an option, `line` the line in it, counted from 1.
    """

    def __init__(self, place: str | Path, fault: str, line: int | None = None) -> None:
        where = str(place) if line is None else f"{place}:{line}"
        super().__init__(" ".join(f"{where}: {fault}".split()))


@contextmanager
def os_faults(path: Path) -> Iterator[None]:
    """Whatever the operating system refuses to do with `path` becomes an InputError that names it."""
    try:
        yield
    except OSError as error:
        raise InputError(path, error.strerror or str(error)) from error
