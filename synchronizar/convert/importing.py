"""From a file or a folder in another format to a recording."""

from __future__ import annotations

import codecs
from array import array
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from synchronizar.convert.asked import Asked
from synchronizar.convert.assembling import Assembled, assemble, listed
from synchronizar.convert.formats import FORMATS, READ, Format, format_named
from synchronizar.convert.imported import Imported, merged
from synchronizar.convert.source import Source
from synchronizar.data.recording import Recording
from synchronizar.data.user import User
from synchronizar.errors import InputError
from synchronizar.io.recording_folder import entries_of, track_files
from synchronizar.io.tum import read_tum, rows_of_track
from synchronizar.progress import Progress, stage, unheard

_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
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
        if not source.head:
            raise InputError(path, "is empty")
        if source.head.startswith(_UTF_16):
            raise InputError(path, "is text in UTF-16: save it as UTF-8")
        known = ", ".join(READ)
        raise InputError(path, f"is of no format that is known: say --from, and what is wrong is told; one of {known}")
    parts: list[Part] = []
    unknown: list[Path] = []
    _look(source, candidates, _DEEPEST, parts, unknown)
    if not parts:
        asked = f"in the format {named}" if named is not None else f"of a format that is known ({', '.join(READ)})"
        raise InputError(path, f"holds no file {asked}")
    beside = tuple(part.format.beside for part in parts if part.format.beside)
    return parts, [file for file in unknown if not file.name.endswith(beside)]


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
    """Add an offset (s) to all stamps; those of radios that stand still tell nothing."""
    if not offset:
        return
    shift = np.array([offset, *[0.0] * 7])
    still = {name for name, user in imported.users.items() if user.static}
    imported.tracks = {name: rows + shift for name, rows in imported.tracks.items()}
    imported.truth = {name: rows if name in still else rows + shift for name, rows in imported.truth.items()}
    imported.ranges.t = array("d", (np.array(imported.ranges.t) + offset).tobytes())


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
    """The recording, with what the one at `added_to` holds where it is added to one."""
    if added_to is not None:
        imported = merged({added_to.name: _imported_of(added_to, imported), path.name: imported})
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


def _imported_of(folder: Path, added: Imported) -> Imported:
    """A recording as if it had been imported; its truth has the axes that tracks have after another was added."""
    recording = Recording.load(folder)
    names = [user.name for user in recording.users]
    imported = Imported(users={user.name: user for user in recording.users})
    for user in recording.users:
        if not user.static:
            imported.tracks[user.name] = rows_of_track(recording.tracks[user.name], user.up)
    if folder / "truth" in entries_of(folder):
        for name, file in track_files(folder / "truth").items():
            own = imported.users.get(name, User(name))
            later = added.users.get(name, own) if name in added.tracks else own
            imported.truth[name] = rows_of_track(read_tum(file, own.up), later.up)
    ranges = recording.ranges
    numbers = {name: getattr(ranges, name).tolist() for name in ("sigma", "rx_power", "fp_power", "nlos", "source")}
    a, b = ([names[u] for u in end.tolist()] for end in (ranges.a, ranges.b))
    antennas = [[*user.antennas, ""] for user in recording.users]  # -1 is the last, the blank
    antenna_a, antenna_b = (
        [antennas[u][k] for u, k in zip(who.tolist(), antenna.tolist(), strict=True)]
        for who, antenna in ((ranges.a, ranges.antenna_a), (ranges.b, ranges.antenna_b))
    )
    imported.ranges.extend(
        ranges.t.tolist(), a, b, ranges.distance.tolist(), antenna_a=antenna_a, antenna_b=antenna_b, **numbers
    )
    for finding in recording.findings:
        imported.note(f"{finding.message}, and is left out: {finding.remedy}")
    return imported
