"""What is put in: each device's own track, the ranges between them, and what is known of the devices.

Everything is checked once, at construction, and frozen; the rest of the program trusts it. Frames are the devices' own,
z up; lengths m, times s.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from synchronizar.arrays import Array, Indices, Mask
from synchronizar.data.findings import Finding
from synchronizar.data.ranges import Ranges
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.geometry import Up
from synchronizar.quaternions import rotate_by_quaternions


@dataclass(frozen=True)
class Recording:
    """A walk: its users, sorted by name, the track of each that is not static, and all ranges.

    Raises ValueError where these contradict each other.
    """

    users: tuple[User, ...]
    tracks: Mapping[str, Track]
    ranges: Ranges
    findings: tuple[Finding, ...] = ()
    """What looked wrong when it was read from files, where nothing else shows it."""

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
        from synchronizar.io.recording_folder import load_recording

        return load_recording(Path(path))

    @classmethod
    def from_arrays(
        cls,
        tracks: Mapping[str, tuple[ArrayLike, ArrayLike, ArrayLike]],
        ranges: Iterable[Sequence[Any]] | Mapping[str, Sequence[Any]],
        up: Up = "z",
        users: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> Recording:
        """A recording from arrays, lists or tuples instead of files.

        `tracks`: of each user that moves (t, positions, quats_xyzw): stamps (n,) s of its own clock, in any order;
        positions (n, 3) m and attitudes (n, 4) in its own SLAM frame; quaternions are normalised.
        `ranges`: rows (t, a, b, distance): stamp (s) of the range clock, two users' names, metres; or columns by the
        names that ranges.csv has. None, as a phone reports a failed measurement, is kept and not used.
        `up`: which axis of the tracks points up, "z" or "y". `users`: settings by name, as in recording.toml.
        Raises ValueError that names the argument at fault.
        """
        from synchronizar.io.recording_arrays import recording_from_arrays

        return recording_from_arrays(tracks, ranges, up, users or {})

    def save(self, path: str | Path) -> None:
        """Write the folder that `load` reads; whatever else it holds is left alone.

        Raises InputError where it cannot be written, holds the track of a user who is not in this recording, or a
        user's name cannot be that of a file.
        """
        from synchronizar.io.recording_folder import save_recording

        save_recording(self, Path(path))

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
        if not who.antennas:
            return self.tracks[who.name].positions_at(t, max_gap)
        poses = self.tracks[who.name].at(t, max_gap)
        return poses.position + rotate_by_quaternions(poses.quat_xyzw, who.levers[antenna]), poses.valid
