"""From a file or a folder in another format to a recording."""

from __future__ import annotations

from array import array
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.convert.asked import Asked
from synchronizar.convert.assembling import Assembled, assemble, listed
from synchronizar.convert.formats import FORMATS, READ, Format, format_named
from synchronizar.convert.imported import Imported, merged
from synchronizar.convert.source import Source
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.errors import InputError
from synchronizar.geometry import YawFrame
from synchronizar.io.recording_folder import entries_of, track_files
from synchronizar.io.tum import read_tum
from synchronizar.progress import Progress, stage, unheard

_DEEPEST = 4
"""Folders within a folder that are looked into."""


class Part(NamedTuple):
    """A file or a folder of one format."""

    path: Path
    format: Format


def parts_of(path: Path, named: str | None) -> tuple[list[Part], list[Path]]:
    """What is to be read at a place, and files there that nobody knows; `named`: the format, where it is said.

    A folder that is no format's own is taken file by file. Raises InputError where there is nothing that can be read.
    """
    source = Source.of(path)
    candidates = [format_named(named)] if named is not None else [f for f in FORMATS if f.reader is not None]
    own = _format_of(source, candidates)
    if own is None and named is not None and not source.is_folder:
        own = candidates[0]
    if own is not None:
        return [Part(path, own)], []
    if not source.is_folder:
        raise InputError(path, f"is of no format that is known: say --from, one of {', '.join(READ)}")
    parts: list[Part] = []
    unknown: list[Path] = []
    _look(source, candidates, _DEEPEST, parts, unknown)
    if not parts:
        asked = f"in the format {named}" if named is not None else f"of a format that is known ({', '.join(READ)})"
        raise InputError(path, f"holds no file {asked}")
    return parts, unknown


def read_parts(path: Path, parts: list[Part], unknown: list[Path], asked: Asked, progress: Progress) -> Imported:
    """What all parts hold together. Raises InputError for the first that cannot be read."""
    if asked.user is not None and len(parts) > 1:
        raise InputError("--user", f"{path} holds {len(parts)} files: their names are the users'")
    read = {}
    for k, part in enumerate(parts):
        reading = part.format.reading()
        name = str(part.path.relative_to(path)) if part.path != path else path.name
        read[name] = reading.read(part.path, asked, stage(progress, k / len(parts), (k + 1) / len(parts)))
    whole = merged(read)
    _shift(whole, asked.time_offset)
    if unknown:
        whole.note(
            f"of no format that is known, and left out: {listed([str(file.relative_to(path)) for file in unknown])}"
        )
    return whole


def _shift(imported: Imported, offset: float) -> None:
    """Add an offset (s) to all stamps."""
    if offset:
        for rows in imported.tracks.values():
            rows[:, 0] += offset
        imported.ranges.t = array("d", (t + offset for t in imported.ranges.t))


def listing(part: Part, asked: Asked) -> str:
    """What is in a part and what is guessed of it, as lines."""
    reading = part.format.reading()
    lines = [f"{part.path}: {part.format.what}"]
    if part.format.lists:
        return "\n".join([*lines, *reading.listing(part.path, asked)])
    read: Imported = reading.read(part.path, asked, unheard)
    lines += [f"track of {name}: {len(rows)} poses" for name, rows in sorted(read.tracks.items())]
    pairs = Counter(tuple(sorted(pair)) for pair in zip(read.ranges.a, read.ranges.b, strict=True))
    lines += [f"ranges of {a} and {b}: {count}" for (a, b), count in sorted(pairs.items())]
    return "\n".join([*lines, *read.notes])


def recording_of(path: Path, imported: Imported, asked: Asked, added_to: Path | None) -> Assembled:
    """The recording, with what `added_to` holds where that is a recording that is added to."""
    if added_to is not None:
        imported = merged({added_to.name: _imported_of(added_to), path.name: imported})
    return assemble(str(path), imported, asked)


def _format_of(source: Source, candidates: list[Format]) -> Format | None:
    return next((f for f in candidates if f.reading().recognises(source)), None)


def _look(folder: Source, candidates: list[Format], depth: int, parts: list[Part], unknown: list[Path]) -> None:
    """Find the parts in a folder and in those below it."""
    for name in folder.names:
        if name.startswith("."):
            continue
        source = Source.of(folder.path / name)
        found = _format_of(source, candidates)
        if found is not None:
            parts.append(Part(source.path, found))
        elif not source.is_folder:
            unknown.append(source.path)
        elif depth:
            _look(source, candidates, depth - 1, parts, unknown)


def _imported_of(folder: Path) -> Imported:
    """A recording as if it had been imported."""
    recording = Recording.load(folder)
    names = [user.name for user in recording.users]
    imported = Imported(users={user.name: user for user in recording.users})
    for user in recording.users:
        if not user.static:
            imported.tracks[user.name] = _rows(recording.tracks[user.name], user.up)
    if folder / "truth" in entries_of(folder):
        for name, file in track_files(folder / "truth").items():
            up = imported.users[name].up if name in imported.users else "z"
            imported.truth[name] = _rows(read_tum(file, up), up)
    ranges = recording.ranges
    rows = imported.ranges
    for column in ("t", "distance", "sigma", "rx_power", "fp_power", "nlos"):
        getattr(rows, column).extend(getattr(ranges, column).tolist())
    for end in ("a", "b"):
        who, antenna = getattr(ranges, end).tolist(), getattr(ranges, f"antenna_{end}").tolist()
        getattr(rows, end).extend(names[u] for u in who)
        getattr(rows, f"antenna_{end}").extend(
            list(recording.users[u].antennas)[k] if k >= 0 else "" for u, k in zip(who, antenna, strict=True)
        )
    return imported


def _rows(track: Track, up: str) -> Array:
    """(n, 8) poses in the axes of its file."""
    own = YawFrame(up_a="y" if up == "y" else "z")
    if up == "z":
        return np.column_stack([track.t, track.position, track.quat_xyzw])
    return np.column_stack([track.t, own @ track.position, own.rotate_quaternions(track.quat_xyzw)])
