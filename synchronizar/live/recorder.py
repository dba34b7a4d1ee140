"""Writes a room down as it goes: a recording in the project's own format, appended, on disk once a second."""

from __future__ import annotations

import json
import os
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from synchronizar.data.user import User
from synchronizar.errors import InputError, os_faults
from synchronizar.io.ranges_csv import OPTIONAL, REQUIRED
from synchronizar.io.recording_toml import write_recording_toml
from synchronizar.live import messages as m
from synchronizar.live.words_file import MOST_BYTES, WORDS_FILE, Word, line_of

STATE_FILE = "solver.state"
RESUME_FILE = "resume.json"


def recorded_name(user: str, session: int) -> str:
    """A device whose SLAM began anew is another user of the recording: its poses are in another frame."""
    return user if session == 0 else f"{user}~{session + 1}"


@dataclass
class _File:
    size: int
    """Bytes that are written or wait to be."""
    lines: list[str] = field(default_factory=list)
    """Those that wait."""


class Gathered(NamedTuple):
    """What is to be written; nothing else changes it any more."""

    texts: dict[str, bytes]
    """By the file's name."""
    users: list[User] | None
    """All of recording.toml, where that is another one."""


class FolderRecorder:
    """One room's folder. Lines are gathered; `flush` writes them, or `gather` and `write` where nobody may wait.

    No file stays open, of however many frames devices have tracks.
    """

    def __init__(self, folder: Path) -> None:
        """Raises InputError where the folder cannot be written."""
        self.folder = folder
        self._files: dict[str, _File] = {}
        self._users: dict[str, User] = {}
        self._names: dict[tuple[str, int], str] = {}
        self._settings_changed = False
        with os_faults(folder):
            (folder / "tracks").mkdir(parents=True, exist_ok=True)
            (folder / "ranges.csv").touch()
            for path in (folder / "ranges.csv", *folder.glob(WORDS_FILE), *(folder / "tracks").glob("*.tum")):
                self._files[path.relative_to(folder).as_posix()] = _File(_end_line(path))
        if self._files["ranges.csv"].size == 0:
            self._write("ranges.csv", ",".join(REQUIRED + OPTIONAL) + "\n")

    def user(self, settings: m.UserSettings, session: int) -> None:
        """Somebody comes, or has a new frame: its settings are in recording.toml."""
        name = recorded_name(settings.name, session)
        self._users[name] = User(
            name,
            settings.static,
            settings.height_sigma,
            dict(settings.antennas),
            settings.up,
            settings.position,
            settings.position_sigma,
            settings.range_bias,
            settings.range_bias_sigma,
        )
        self._settings_changed = True

    def pose(self, user: str, session: int, t: float, position: m.Vector, quat_xyzw: m.Quaternion) -> None:
        """A pose, by the room's clock, in the device's own axes."""
        x, y, z = position
        qx, qy, qz, qw = quat_xyzw
        line = f"{t:.9f} {x:.9f} {y:.9f} {z:.9f} {qx:.9f} {qy:.9f} {qz:.9f} {qw:.9f}\n"
        self._write(f"tracks/{recorded_name(user, session)}.tum", line)

    def range(
        self, t: float, a: str, b: str, sessions: tuple[int, int], distance: float, optional: dict[str, Any]
    ) -> None:
        """A range, by the room's clock; none of a device that has not said any pose, which no recording can have."""
        written_as = [self._written_as(user, session) for user, session in zip((a, b), sessions, strict=True)]
        if None in written_as:
            return
        values = [_text(optional[name]) if name in optional else "" for name in OPTIONAL]
        self._write("ranges.csv", f"{t:.9f},{written_as[0]},{written_as[1]},{distance!r},{','.join(values)}\n")

    def word(self, word: Word) -> bool:
        """What was said or moved; False where the file of it is full."""
        file = self._files.get(WORDS_FILE)
        if file is not None and file.size >= MOST_BYTES:
            return False
        self._write(WORDS_FILE, line_of(word))
        return True

    def offsets(self) -> dict[str, int]:
        """Bytes of each file that hold all that was recorded until now."""
        return {name: file.size for name, file in self._files.items()}

    def flush(self) -> None:
        """All on disk. Raises InputError where that is full or gone."""
        self.write(self.gather())

    def gather(self) -> Gathered:
        """What came since the last time: to be given to `write`, which another thread may do while more comes."""
        users = None
        if self._settings_changed:
            self._settings_changed = False
            users = [user for name, user in self._users.items() if self._is_there(name)]
        texts = {name: "".join(file.lines).encode() for name, file in self._files.items() if file.lines}
        for file in self._files.values():
            file.lines.clear()
        return Gathered(texts, users)

    def write(self, gathered: Gathered) -> None:
        """Write it, all of it before any is waited for to be on disk. Raises InputError where that is full or gone."""
        with os_faults(self.folder), ExitStack() as stack:
            written = []
            for name, text in gathered.texts.items():
                written.append(stack.enter_context((self.folder / name).open("ab")))
                written[-1].write(text)
                written[-1].flush()
            if gathered.users is not None:
                write_recording_toml(self.folder / "recording.toml", gathered.users)
            for file in written:
                os.fsync(file.fileno())

    def note(self, name: str, value: Any) -> None:
        """A small file beside the recording, replaced as a whole."""
        half = self.folder / f"{name}.half"
        with os_faults(half):
            with half.open("w", encoding="utf-8") as out:
                json.dump(msgspec.to_builtins(value), out)
                out.flush()
                os.fsync(out.fileno())
            half.replace(self.folder / name)

    def close(self) -> None:
        """All on disk."""
        with suppress(InputError):
            self.flush()

    def _written_as(self, user: str, session: int) -> str | None:
        """Its name in ranges.csv; None while a recording cannot have it."""
        if (user, session) not in self._names and self._is_there(name := recorded_name(user, session)):
            self._names[user, session] = _quoted(name)
        return self._names.get((user, session))

    def _is_there(self, name: str) -> bool:
        """Whether a recording can have this user: a radio that stands still, or a device with a pose."""
        user = self._users.get(name)
        return (user is not None and user.static) or f"tracks/{name}.tum" in self._files

    def _write(self, name: str, line: str) -> None:
        if name not in self._files:
            self._files[name] = _File(0)
            self._settings_changed = True  # a device may have its first pose
        file = self._files[name]
        file.lines.append(line)
        file.size += len(line.encode())


def _end_line(path: Path) -> int:
    """Whoever was killed while it wrote left half a line: it is cut off. Returns the bytes that stay."""
    data = path.read_bytes()
    whole = data.rfind(b"\n") + 1
    if whole < len(data):
        os.truncate(path, whole)
    return whole


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if set(name) & set('",') else name


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return str(value)
