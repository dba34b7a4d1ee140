"""Reads and writes a recording's folder: tracks/<user>.tum, ranges.csv and optionally recording.toml."""

from __future__ import annotations

from pathlib import Path

from synchronizar.data.recording import Recording
from synchronizar.data.user import User
from synchronizar.errors import InputError, os_faults
from synchronizar.io.ranges_csv import read_ranges_csv, write_ranges_csv
from synchronizar.io.recording_toml import Settings, read_recording_toml, write_recording_toml
from synchronizar.io.text import is_name, quoted
from synchronizar.io.tum import read_tum, write_tum
from synchronizar.io.unread import unknown_column_findings

REMEDY = (
    "a recording is a folder with tracks/<user>.tum and ranges.csv: `synchronizar convert` makes one of other formats"
)


def load_recording(folder: Path) -> Recording:
    """The recording in a folder. Raises InputError as `Recording.load` does."""
    toml = folder / "recording.toml"
    entries = entries_of(folder, REMEDY)
    settings = read_recording_toml(toml) if toml in entries else Settings()
    files = track_files(folder / "tracks") if folder / "tracks" in entries else {}
    users = {name: User(name, up=settings.up) for name in files} | dict(settings.users)
    if not users:
        raise InputError(folder, f"is not a recording: it has no tracks/<user>.tum; {REMEDY}")
    for user in users.values():
        if user.static and user.name in files:
            raise InputError(files[user.name], f"{user.name} is static in {toml.name} and cannot have a track")
        if not user.static and user.name not in files:
            raise InputError(toml, f"{user.name} has no track tracks/{user.name}.tum and is not static")
    by_name = tuple(users[name] for name in sorted(users))
    tracks = {name: read_tum(file, users[name].up) for name, file in files.items()}
    ranges = folder / "ranges.csv"
    return Recording(by_name, tracks, read_ranges_csv(ranges, by_name), tuple(unknown_column_findings(ranges)))


def save_recording(recording: Recording, folder: Path) -> None:
    """Write the folder that `load_recording` reads. Raises InputError as `Recording.save` does."""
    tracks = folder / "tracks"
    for user in recording.users:
        if not is_name(user.name):
            raise InputError(folder, f"{quoted(user.name)} cannot be the name of a file")
    with os_faults(tracks):
        tracks.mkdir(parents=True, exist_ok=True)
    for name, file in track_files(tracks).items():
        if name not in recording.tracks:
            raise InputError(file, f"stands in the way: {name} has no track in the recording to be saved")
    for user in recording.users:
        if not user.static:
            write_tum(tracks / f"{user.name}.tum", recording.tracks[user.name], user.up)
    write_ranges_csv(folder / "ranges.csv", recording.ranges, recording.users)
    write_recording_toml(folder / "recording.toml", recording.users)


def is_recording(folder: Path) -> bool:
    """Whether a folder looks like one that `save_recording` wrote. Raises InputError where it cannot be looked into."""
    with os_faults(folder):
        return (folder / "ranges.csv").is_file() and (folder / "tracks").is_dir()


def entries_of(folder: Path, remedy: str = "") -> list[Path]:
    """Entries of a folder, sorted by name. Raises InputError, with the remedy, where it cannot be read."""
    with os_faults(folder, remedy):
        return sorted(folder.iterdir())


def track_files(folder: Path) -> dict[str, Path]:
    """Track file of each user; hidden files are not tracks."""
    files = {}
    for file in entries_of(folder):
        if file.suffix == ".tum" and not file.name.startswith("."):
            if not is_name(file.stem):
                raise InputError(folder, f"{quoted(file.stem)} cannot be the name of a user")
            files[file.stem] = file
    return files
