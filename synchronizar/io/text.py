"""Shared by the text formats: opening and quoting text, what counts as a number or a name, largest plausible values."""

from __future__ import annotations

from pathlib import Path
from typing import TextIO

MAX_LENGTH = 1e6
"""m: a distance, an arm or a sigma beyond it is a fault of the file."""
MAX_PLACE = 1e7
"""m: the same of a coordinate, which may be a map's: northings (UTM) count from the equator or the pole."""
MAX_STAMP = 1e11
"""s: seconds since 1970 are well below it, milliseconds since 1970 beyond."""
MIN_SIGMA = 1e-6
"""m: a smaller standard deviation is not plausible, and its square would leave no digits for anything else."""

QUOTED_CHARACTERS = 40
_NOT_UTF_8 = "\ufffd"


def open_text(path: Path) -> TextIO:
    """The file opened as text; bytes that are not UTF-8 become U+FFFD, which is in no number and in no name."""
    return path.open(encoding="utf-8-sig", errors="replace")


def quoted(text: str) -> str:
    """The text for a message: in quotes, shortened, without control characters."""
    return repr(text if len(text) <= QUOTED_CHARACTERS else text[:QUOTED_CHARACTERS] + "…")


def is_plain(text: str) -> bool:
    """Whether the text has only ASCII and no underscore: float() alone takes 1_0 and Arabic digits."""
    return text.isascii() and "_" not in text


def is_number(text: str) -> bool:
    """Whether the text is a number; nan and inf count as numbers."""
    try:
        float(text)
    except ValueError:
        return False
    return is_plain(text)


def is_name(text: str) -> bool:
    """Whether the text can name a user or an antenna: as a value in a column, as a key, and as a file name."""
    is_plain_text = text.isprintable() and text == text.strip() and not set(text) & {"/", "\\", _NOT_UTF_8}
    return is_plain_text and text[:1] not in ("", ".")
