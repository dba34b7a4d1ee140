"""What was said and moved in a recorded room: `words.jsonl` beside its tracks, a line each, in the room's order."""

from __future__ import annotations

from pathlib import Path

import msgspec

from synchronizar.errors import InputError
from synchronizar.live import messages as m

WORDS_FILE = "words.jsonl"
MOST_BYTES = 64 * 1024 * 1024
"""Of the file: what comes after that is not written."""


class Word(msgspec.Struct, omit_defaults=True):
    """One line. Times are the room's (s), as in the tracks; places are in its common frame."""

    t: float
    app: str | None = None
    """What is done in the room, from now on."""
    reference: str | None = None
    """Whose first pose fixes the common frame, from now on."""
    object: m.Object | None = None
    """As it now stands."""
    removed: str | None = None
    """Id of an object that is gone."""
    said: m.Said | None = None
    to: str | None = None
    """To whom that was said; none: to all others."""


_decoder = msgspec.json.Decoder(Word)


def line_of(word: Word) -> str:
    """With its end."""
    return msgspec.json.encode(word).decode() + "\n"


def read_words(folder: Path) -> list[Word]:
    """Those of a recording, none where it has none. Raises InputError with the line that cannot be read."""
    path = folder / WORDS_FILE
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return []
    except OSError as error:
        raise InputError(path, error.strerror or str(error)) from error
    words = []
    # Whoever was killed while it wrote left half a line.
    for number, line in enumerate(data[: data.rfind(b"\n") + 1].splitlines(), 1):
        try:
            words.append(_decoder.decode(line))
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise InputError(path, f"line {number}: {error}") from error
    return words
