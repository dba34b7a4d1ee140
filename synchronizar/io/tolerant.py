"""A recording that `Recording.load` refuses, as far as it can be read, and what is wrong with it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from synchronizar.data.findings import Finding
from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.errors import InputError
from synchronizar.io.ranges_csv import names_in_ranges_csv, read_usable_ranges
from synchronizar.io.recording_folder import entries_of, load_recording, track_files
from synchronizar.io.recording_toml import Settings, read_recording_toml
from synchronizar.io.text import is_name
from synchronizar.io.tum import read_usable_poses
from synchronizar.io.unread import unknown_column_findings, unknown_setting_findings, unknown_user_finding


def read_tolerantly(folder: Path) -> tuple[Recording, InputError | None]:
    """A recording and why `Recording.load` refuses it; None where it does not.

    What cannot be read is left out, names without a track are taken for radios that stand still; what was found on the
    way is in the recording's findings. Raises InputError where nothing of it can be read.
    """
    try:
        return load_recording(folder), None
    except InputError as error:
        refused = error
    found: list[Finding] = []
    settings = _settings(folder / "recording.toml", found)
    tracks = _tracks(folder, settings)
    counts: Mapping[str, int] = {}
    ranges = folder / "ranges.csv"
    try:
        counts = names_in_ranges_csv(ranges)
        found += unknown_column_findings(ranges)
    except InputError:
        pass
    if not tracks and not counts:
        raise refused
    users = {name: settings.users.get(name, User(name, up=settings.up)) for name in tracks}
    files = _files(folder)
    for name, user in settings.users.items():
        if name not in tracks:
            users[name] = User(name, True, user.height_sigma)
            if not user.static and name not in files:
                found.append(unknown_user_finding(name, counts.get(name, 0), sorted(tracks)))
    for name, count in sorted(counts.items()):
        if name not in users and name not in files and is_name(name):
            users[name] = User(name, static=True)
            found.append(unknown_user_finding(name, count, sorted(tracks)))
    by_name = tuple(users[name] for name in sorted(users))
    try:
        measured = read_usable_ranges(ranges, by_name)
    except InputError:
        empty = np.zeros(0)
        none = np.zeros(0, dtype=np.int32)
        measured = Ranges.of(empty, none, none, empty)
    return Recording(by_name, tracks, measured, tuple(found)), refused


def _settings(toml: Path, found: list[Finding]) -> Settings:
    """What can be read of recording.toml: nothing where a value is wrong."""
    unknown: list[str] = []
    try:
        settings = read_recording_toml(toml, unknown)
    except InputError:
        return Settings()
    found += unknown_setting_findings(toml, unknown)
    return settings


def _tracks(folder: Path, settings: Settings) -> dict[str, Track]:
    """The tracks that can be read, of users that are not static."""
    tracks = {}
    for name, file in _files(folder).items():
        if name in settings.users and settings.users[name].static:
            continue
        try:
            tracks[name] = read_usable_poses(file, settings.users[name].up if name in settings.users else settings.up)
        except InputError:
            continue
    return tracks


def _files(folder: Path) -> dict[str, Path]:
    if folder / "tracks" not in entries_of(folder):
        return {}
    try:
        return track_files(folder / "tracks")
    except InputError:
        return {}
