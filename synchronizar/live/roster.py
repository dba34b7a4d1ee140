"""What a room has to remember that stands in no recording: its code and key, and by what its devices are known.

Kept in the user's own state folder, readable by nobody else, under the name of the room's folder.
"""

from __future__ import annotations

from pathlib import Path

import msgspec

from synchronizar.errors import InputError, os_faults
from synchronizar.live.certificates import state_folder
from synchronizar.live.messages import UserSettings


class KnownDevice(msgspec.Struct):
    """A device that was in the room."""

    settings: UserSettings
    owner: str
    """Hash of the secret by which its connection is known."""
    frame: int
    session: int
    """How often its SLAM began anew."""


class Roster(msgspec.Struct):
    """A room to be opened again."""

    code: str
    key: str
    """In hex."""
    devices: list[KnownDevice]
    modules: dict[int, str]
    """Whose module has which address."""
    given: dict[int, str] = {}
    """Whose module ever had which."""
    sequences: dict[int, int] = {}
    """The newest sequence of each module's datagrams: older ones are not taken again."""
    app: str | None = None
    """What is done there."""


_decoder = msgspec.json.Decoder(Roster)


def roster_path(folder: Path) -> Path:
    """Of the room that was recorded in a folder."""
    return state_folder() / "rooms" / f"{folder.name}.json"


def write_roster(folder: Path, roster: Roster) -> None:
    """Replaces the one before. Raises InputError where it cannot be written."""
    path = roster_path(folder)
    half = path.with_suffix(".half")
    with os_faults(path):
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        half.touch(mode=0o600)
        half.write_bytes(msgspec.json.encode(roster))
        half.replace(path)


def read_roster(folder: Path) -> Roster | None:
    """None where the room of a folder is not known here. Raises InputError where it cannot be read."""
    path = roster_path(folder)
    try:
        return _decoder.decode(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, msgspec.DecodeError) as error:
        raise InputError(path, f"is no room's roster: {error}") from error
