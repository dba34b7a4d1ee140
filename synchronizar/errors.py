"""The error for input that cannot be used."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class InputError(ValueError):
    """Input that cannot be used. The message is one line that names the place and the fault.

    `place` is a file or an option, `line` the line in it, counted from 1.
    """

    def __init__(self, place: str | Path, fault: str, line: int | None = None) -> None:
        where = str(place) if line is None else f"{place}:{line}"
        super().__init__(" ".join(f"{where}: {fault}".split()))


@contextmanager
def os_faults(path: Path, remedy: str = "") -> Iterator[None]:
    """Context in which an OSError is raised as an InputError that names `path`, and what to do, where that is known."""
    try:
        yield
    except OSError as error:
        fault = error.strerror or str(error)
        raise InputError(path, f"{fault}; {remedy}" if remedy else fault) from error
