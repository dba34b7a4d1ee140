"""What the text formats share: how a fault is told, what counts as a number, and which sizes can be meant."""

from __future__ import annotations

from pathlib import Path
from typing import TextIO

MAX_LENGTH = 1e6
"""m: a coordinate beyond it is a fault of the file, not a place."""
MAX_STAMP = 1e11
"""s: seconds since 1970 are well below it, milliseconds since 1970 beyond."""
MIN_SIGMA = 1e-6
"""m: a standard deviation below it is no honest one, and its square would leave no digits for anything else."""

QUOTED_CHARACTERS = 40


def open_text(path: Path) -> TextIO:
    """The file for reading, any bytes allowed: those that are no UTF-8 become U+FFFD, which is in no number or name."""
    return path.open(encoding="utf-8-sig", errors="replace")


def quoted(text: str) -> str:
    """The text as a message can show it: in quotes, short, without control characters."""
    return repr(text if len(text) <= QUOTED_CHARACTERS else text[:QUOTED_CHARACTERS] + "…")


def is_plain(text: str) -> bool:
    """Whether every number in the text is written in the common way: float() alone would take 1_0 and Arabic digits."""
    return text.isascii() and "_" not in text


def is_number(text: str) -> bool:
    """Whether the text is a number; nan and inf are."""
    try:
        float(text)
    except ValueError:
        return False
    return is_plain(text)


def is_name(text: str) -> bool:
    """Whether the text can name a user or an antenna: in a column, in a key and as the name of a file."""
    return text.isprintable() and text == text.strip() and text[:1] not in ("", ".") and not set(text) & set("/\\")
