"""Writes a room down as it goes: a recording in the project's own format, appended, on disk once a second."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from typing import Any

import msgspec

from synchronizar.data.user import User
from synchronizar.errors import InputError, os_faults
from synchronizar.io.ranges_csv import OPTIONAL, REQUIRED
from synchronizar.io.recording_toml import write_recording_toml
from synchronizar.live import messages as m

STATE_FILE = "solver.state"
RESUME_FILE = "resume.json"
_MOST_WAITING = 64 * 1024 * 1024
"""Bytes of one file that wait for a disk that is full."""


def recorded_name(user: str, session: int) -> str:
    """A device whose SLAM began anew is another user of the recording: its poses are in another frame."""
    return user if session == 0 else f"{user}~{session + 1}"


@dataclass
class _File:
    written: int
    """Bytes on disk."""
    size: int
    """With those that wait."""
    lines: list[str] = field(default_factory=list)


class FolderRecorder:
    """One room's folder. Lines wait in memory and are written by `flush`, which the caller calls once a second.

    No file stays open, of however many frames devices have tracks.
    """

    def __init__(self, folder: Path) -> None:
        """Raises InputError where the folder cannot be written."""
        self.folder = folder
        self._files: dict[str, _File] = {}
        self._users: dict[str, User] = {}
        self._settings_changed = False
        self._lock = Lock()
        """Lines come while others are being written."""
        with os_faults(folder):
            (folder / "tracks").mkdir(parents=True, exist_ok=True)
            (folder / "ranges.csv").touch()
            for path in (folder / "ranges.csv", *(folder / "tracks").glob("*.tum")):
                size = _end_line(path)
                self._files[path.relative_to(folder).as_posix()] = _File(size, size)
        if self._files["ranges.csv"].size == 0:
            self._write("ranges.csv", ",".join(REQUIRED + OPTIONAL) + "\n")

    def user(self, settings: m.UserSettings, session: int) -> None:
        """Somebody comes, or has a new frame: its settings are in recording.toml."""
        name = recorded_name(settings.name, session)
        self._users[name] = User(name, settings.static, settings.height_sigma, dict(settings.antennas), settings.up)
        self._settings_changed = True

    def pose(self, user: str, session: int, t: float, position: m.Vector, quat_xyzw: m.Quaternion) -> None:
        """A pose, by the room's clock, in the device's own axes."""
        numbers = " ".join(f"{x:.9f}" for x in (t, *position, *quat_xyzw))
        self._write(f"tracks/{recorded_name(user, session)}.tum", numbers + "\n")

    def range(
        self, t: float, a: str, b: str, sessions: tuple[int, int], distance: float, optional: dict[str, Any]
    ) -> None:
        """A range, by the room's clock; none of a device that has not said any pose, which no recording can have."""
        names = [recorded_name(user, session) for user, session in zip((a, b), sessions, strict=True)]
        if not all(self._is_there(name) for name in names):
            return
        values = [f"{t:.9f}", *map(_quoted, names), repr(distance), *(_text(optional.get(name)) for name in OPTIONAL)]
        self._write("ranges.csv", ",".join(values) + "\n")

    def offsets(self) -> dict[str, int]:
        """Bytes of each file that hold all that was recorded until now."""
        return {name: file.size for name, file in self._files.items()}

    def flush(self) -> None:
        """On disk, from any one thread at a time. Raises InputError where the disk is full or gone."""
        with os_faults(self.folder):
            if self._settings_changed:
                self._settings_changed = False
                there = [user for name, user in list(self._users.items()) if self._is_there(name)]
                write_recording_toml(self.folder / "recording.toml", there)
            for name, file in list(self._files.items()):
                if file.lines:
                    self._append(self.folder / name, file)

    def _append(self, path: Path, file: _File) -> None:
        """Lines that cannot be written wait for the next time, up to a point; half a line is never left."""
        with self._lock:
            lines, file.lines = file.lines, []
        data = "".join(lines).encode()
        try:
            with path.open("ab") as out:
                out.truncate(file.written)
                out.write(data)
                out.flush()
                os.fsync(out.fileno())
        except OSError:
            with self._lock:
                if len(data) <= _MOST_WAITING:
                    file.lines = lines + file.lines
                else:
                    file.size -= len(data)
            self._settings_changed = True
            raise
        file.written += len(data)

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

    def _is_there(self, name: str) -> bool:
        """Whether a recording can have this user: a radio that stands still, or a device with a pose."""
        user = self._users.get(name)
        return (user is not None and user.static) or f"tracks/{name}.tum" in self._files

    def _write(self, name: str, line: str) -> None:
        if name not in self._files:
            self._files[name] = _File(0, 0)
            self._settings_changed = True
        file = self._files[name]
        with self._lock:
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
