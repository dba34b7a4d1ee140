"""Writes a room down as it goes: a recording in the project's own format, appended, on disk once a second."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, NamedTuple

import msgspec

from synchronizar.data.user import User
from synchronizar.errors import InputError, os_faults
from synchronizar.io.ranges_csv import OPTIONAL, REQUIRED
from synchronizar.io.recording_toml import write_recording_toml
from synchronizar.live import messages as m

STATE_FILE = "solver.state"
RESUME_FILE = "resume.json"
ROOM_FILE = "room.json"


def recorded_name(user: str, session: int) -> str:
    """A device whose SLAM began anew is another user of the recording: its poses are in another frame."""
    return user if session == 0 else f"{user}~{session + 1}"


@dataclass
class _File:
    handle: IO[str]
    size: int
    """Bytes that are written or wait to be."""
    lines: list[str] = field(default_factory=list)
    """Those that wait."""


class Gathered(NamedTuple):
    """What is to be written; nothing else changes it any more."""

    lines: list[tuple[IO[str], str]]
    users: list[User] | None
    """All of recording.toml, where that is another one."""


class FolderRecorder:
    """One room's folder. Lines are gathered; `flush` writes them, or `gather` and `write` where nobody may wait."""

    def __init__(self, folder: Path) -> None:
        """Raises InputError where the folder cannot be written."""
        self.folder = folder
        self._files: dict[str, _File] = {}
        self._users: dict[str, User] = {}
        self._names: dict[tuple[str, int], str] = {}
        self._settings_changed = False
        with os_faults(folder):
            (folder / "tracks").mkdir(parents=True, exist_ok=True)
            for track in (folder / "tracks").glob("*.tum"):
                self._open(f"tracks/{track.name}")
            ranges = self._open("ranges.csv")
        if ranges.size == 0:
            self._write("ranges.csv", ",".join(REQUIRED + OPTIONAL) + "\n")

    def user(self, settings: m.UserSettings, session: int) -> None:
        """Somebody comes, or has a new frame: its settings are in recording.toml."""
        name = recorded_name(settings.name, session)
        self._users[name] = User(name, settings.static, settings.height_sigma, dict(settings.antennas), settings.up)
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
        waiting = [(file.handle, "".join(file.lines)) for file in self._files.values() if file.lines]
        for file in self._files.values():
            file.lines.clear()
        return Gathered(waiting, users)

    def write(self, gathered: Gathered) -> None:
        """Write it, all of it before any is waited for to be on disk. Raises InputError where that is full or gone."""
        with os_faults(self.folder):
            for handle, text in gathered.lines:
                handle.write(text)
                handle.flush()
            if gathered.users is not None:
                write_recording_toml(self.folder / "recording.toml", gathered.users)
            for handle, _ in gathered.lines:
                os.fsync(handle.fileno())

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
        """All on disk, and no file open."""
        with suppress(InputError):
            self.flush()
        for file in self._files.values():
            file.handle.close()
        self._files.clear()

    def _written_as(self, user: str, session: int) -> str | None:
        """Its name in ranges.csv; None while a recording cannot have it."""
        if (user, session) not in self._names and self._is_there(name := recorded_name(user, session)):
            self._names[user, session] = _quoted(name)
        return self._names.get((user, session))

    def _is_there(self, name: str) -> bool:
        """Whether a recording can have this user: a radio that stands still, or a device with a pose."""
        user = self._users.get(name)
        return (user is not None and user.static) or f"tracks/{name}.tum" in self._files

    def _open(self, name: str) -> _File:
        if name not in self._files:
            self._settings_changed = True
            handle = (self.folder / name).open("a", encoding="utf-8", newline="")
            _end_line(self.folder / name, handle)
            self._files[name] = _File(handle, handle.tell())
        return self._files[name]

    def _write(self, name: str, line: str) -> None:
        file = self._open(name)
        file.lines.append(line)
        file.size += len(line.encode())


def _end_line(path: Path, handle: IO[str]) -> None:
    """Whoever was killed while it wrote left half a line: it is cut off."""
    data = path.read_bytes()
    if data and not data.endswith(b"\n"):
        handle.truncate(data.rfind(b"\n") + 1)
        handle.seek(0, os.SEEK_END)


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if set(name) & set('",') else name


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return str(value)
