"""How far long work has come: a function that is called with the share that is done, 0 to 1, never falling."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float], None]


def unheard(share: float) -> None:
    """For whoever does not want to know."""


def stage(progress: Progress, begin: float, end: float) -> Progress:
    """The progress of one stage of the work, which begins and ends at these shares of the whole."""
    return lambda share: progress(begin + share * (end - begin))
