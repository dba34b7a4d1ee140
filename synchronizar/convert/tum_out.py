"""Writes tracks as a folder of TUM files, one a device that moves, which `evo_traj` and `evo_ape` read as they are.

Without an answer they are SLAM's own tracks, each in its own frame, z up; with one they are in the common frame. Either
way they have the device's own stamps, as the recording's `truth/` has. A folder may hold such files already, and then
those of the same names are replaced; a recording is refused.
"""

from __future__ import annotations

from pathlib import Path

from synchronizar.data.exported import Exported
from synchronizar.errors import InputError, os_faults
from synchronizar.io.recording_folder import is_recording
from synchronizar.io.tum import write_tum


def write_tum_folder(path: Path, exported: Exported) -> None:
    """Write the folder. Raises InputError where it cannot be written or is a recording."""
    if is_recording(path):
        raise InputError(path, "is a recording: tracks of another frame have no place in it")
    with os_faults(path):
        path.mkdir(parents=True, exist_ok=True)
    for name, track in exported.shown.items():
        if name in exported.recording.tracks:
            write_tum(path / f"{name}.tum", track)
