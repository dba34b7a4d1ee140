"""Writes a recording that was converted: all of it, or nothing."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from tempfile import mkdtemp

from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.errors import InputError, os_faults
from synchronizar.io.recording_folder import is_recording
from synchronizar.io.tum import write_tum

_PARTS = ("tracks", "truth", "ranges.csv", "recording.toml")


def check_place(out: Path, replace: bool) -> None:
    """Raise InputError where a recording cannot be written: at a file, or at a folder that holds something.

    With `replace` a recording that stands there may be replaced; any other folder may not.
    """
    with os_faults(out):
        if out.is_dir():
            if not any(out.iterdir()):
                return
            if not is_recording(out):
                raise InputError(out, "holds something that is no recording: name a folder that is not there yet")
            if not replace:
                raise InputError(out, "is a recording already: --force replaces it, --add adds to it")
        elif out.exists() or out.is_symlink():
            raise InputError(out, "is a file: a recording is a folder")


def save(recording: Recording, truth: Mapping[str, Track], out: Path) -> None:
    """Write the recording beside its place, and move it there once it is whole.

    Of one that stood there nothing is left, but what else is in its folder stays. Raises InputError where it cannot be
    written; what stood there stands there still then.
    """
    with os_faults(out.parent):
        out.parent.mkdir(parents=True, exist_ok=True)
        folder = Path(mkdtemp(prefix=f".{out.name}-", dir=out.parent))
    try:
        made = folder / "new"
        recording.save(made)
        if truth:
            with os_faults(out):
                (made / "truth").mkdir()
            for name, track in truth.items():
                write_tum(made / "truth" / f"{name}.tum", track, recording.users[recording.index(name)].up)
        with os_faults(out):
            out.mkdir(exist_ok=True)
            _exchange(made, out, folder / "old")
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _exchange(made: Path, out: Path, old: Path) -> None:
    """Move the parts of the recording in `out` to `old`, and those in `made` to `out`; or nothing."""
    old.mkdir()
    moved: list[tuple[Path, Path]] = []
    try:
        for folder, to in ((out, old), (made, out)):
            for name in _PARTS:
                if (folder / name).exists():
                    (folder / name).rename(to / name)
                    moved.append((folder / name, to / name))
    except OSError:
        for here, there in reversed(moved):
            there.rename(here)
        raise
