"""Cooperative scheduling: work that yields every few milliseconds, so that its caller decides when it goes on."""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

T = TypeVar("T")

Cooperative = Generator[None, None, T]
"""Yields after each portion of the work and returns its result."""


def finish(work: Cooperative[T]) -> T:
    """Run the work to its end and return its result."""
    while True:
        try:
            next(work)
        except StopIteration as done:
            result: T = done.value
            return result
