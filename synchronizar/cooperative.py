"""Work that is done a portion at a time, each of some milliseconds: whoever drives it decides when the next is done."""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

T = TypeVar("T")

Cooperative = Generator[None, None, T]
"""Yields after each portion, and returns what it was for."""


def finish(work: Cooperative[T]) -> T:
    """All portions that are left, one after the other."""
    while True:
        try:
            next(work)
        except StopIteration as done:
            result: T = done.value
            return result
