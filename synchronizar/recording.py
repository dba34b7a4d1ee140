"""What is put in: each device's own track, the ranges between them, and what is known of the devices.

Everything is checked once, at construction, and frozen; the rest of the program trusts it. Frames are the devices' own,
z up; lengths m, times s.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from synchronizar.arrays import Array, Indices, Mask
from synchronizar.errors import InputError
from synchronizar.formats.ranges_csv import read_ranges_csv, write_ranges_csv
from synchronizar.formats.recording_toml import Settings, read_recording_toml, write_recording_toml
from synchronizar.formats.text import is_name, os_faults, quoted
from synchronizar.formats.tum import read_tum, write_tum
from synchronizar.geometry import rotate_by_quaternions
from synchronizar.ranges import Ranges
from synchronizar.track import Track
from synchronizar.user import User


@dataclass(frozen=True)
class Recording:
    """A walk: its users, sorted by name, the track of each that is not static, and all ranges.

    Raises ValueError where these contradict each other.
    """

    users: tuple[User, ...]
    tracks: Mapping[str, Track]
    ranges: Ranges

    def __post_init__(self) -> None:
        names = [u.name for u in self.users]
        if names != sorted(set(names)):
            raise ValueError("users must be sorted by name, each once")
        if {u.name for u in self.users if not u.static} != set(self.tracks):
            raise ValueError("every user that is not static needs a track, and nobody else has one")
        ends = np.concatenate([self.ranges.a, self.ranges.b])
        if len(ends) and (ends.min() < 0 or ends.max() >= len(names)):
            raise ValueError("a range names a user that is not there")
        antennas = np.array([len(u.antennas) for u in self.users], dtype=np.int32)
        for who, antenna in ((self.ranges.a, self.ranges.antenna_a), (self.ranges.b, self.ranges.antenna_b)):
            if len(who) and ((antenna < -1) | (antenna >= antennas[who])).any():
                raise ValueError("a range names an antenna that its user does not have")

    @classmethod
    def load(cls, path: str | Path) -> Recording:
        """Read a recording's folder: tracks/<user>.tum, ranges.csv and, if it is there, recording.toml.

        Raises InputError where the folder is not a recording, naming the file, the line and the fault.
        """
        folder = Path(path)
        toml = folder / "recording.toml"
        entries = _entries(folder)
        settings = read_recording_toml(toml) if toml in entries else Settings()
        files = _track_files(folder / "tracks") if folder / "tracks" in entries else {}
        users = {name: User(name) for name in files} | dict(settings.users)
        if not users:
            raise InputError(folder, "is not a recording: it has no tracks/<user>.tum")
        for user in users.values():
            if user.static and user.name in files:
                raise InputError(files[user.name], f"{user.name} is static in {toml.name} and cannot have a track")
            if not user.static and user.name not in files:
                raise InputError(toml, f"{user.name} has no track tracks/{user.name}.tum and is not static")
        by_name = tuple(users[name] for name in sorted(users))
        tracks = {name: read_tum(file, settings.up_of_user.get(name, settings.up)) for name, file in files.items()}
        return cls(by_name, tracks, read_ranges_csv(folder / "ranges.csv", by_name))

    def save(self, path: str | Path) -> None:
        """Write the folder that `load` reads; whatever else it holds is left alone.

        Raises InputError where it cannot be written, holds the track of a user who is not in this recording, or a
        user's name cannot be that of a file.
        """
        folder = Path(path)
        tracks = folder / "tracks"
        for user in self.users:
            if not is_name(user.name):
                raise InputError(folder, f"{quoted(user.name)} cannot be the name of a file")
        with os_faults(tracks):
            tracks.mkdir(parents=True, exist_ok=True)
        for name, file in _track_files(tracks).items():
            if name not in self.tracks:
                raise InputError(file, f"stands in the way: {name} has no track in the recording to be saved")
        for name, track in self.tracks.items():
            write_tum(tracks / f"{name}.tum", track)
        write_ranges_csv(folder / "ranges.csv", self.ranges, self.users)
        write_recording_toml(folder / "recording.toml", self.users)

    def index(self, name: str) -> int:
        """Where the user of that name stands in `users`; KeyError if there is none."""
        for i, user in enumerate(self.users):
            if user.name == name:
                return i
        raise KeyError(name)

    def antenna_positions(self, user: int, t: Array, antenna: Indices, max_gap: float) -> tuple[Array, Mask]:
        """Where a user's antennas were at its own times t (n,): (n, 3) m in its own frame, and which are known."""
        who = self.users[user]
        if who.static:
            return np.zeros((len(t), 3)), np.ones(len(t), dtype=bool)
        poses = self.tracks[who.name].at(t, max_gap)
        if not who.antennas:
            return poses.position, poses.valid
        return poses.position + rotate_by_quaternions(poses.quat_xyzw, who.levers[antenna]), poses.valid


def _entries(folder: Path) -> list[Path]:
    """What a folder holds, by name."""
    with os_faults(folder):
        return sorted(folder.iterdir())


def _track_files(folder: Path) -> dict[str, Path]:
    """The track of each user, by name; hidden files are not tracks."""
    files = {}
    for file in _entries(folder):
        if file.suffix == ".tum" and not file.name.startswith("."):
            if not is_name(file.stem):
                raise InputError(folder, f"{quoted(file.stem)} cannot be the name of a user")
            files[file.stem] = file
    return files
