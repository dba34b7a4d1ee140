"""The pictures as files beside the answer."""

from __future__ import annotations

import warnings
from pathlib import Path

from matplotlib.figure import Figure

from synchronizar.formats.text import os_faults
from synchronizar.plots.answer import read_answer
from synchronizar.plots.devices import draw_devices
from synchronizar.plots.picture import draw
from synchronizar.recording import Recording

DPI = 110


def plot(recording: Recording, folder: str | Path, name: str) -> Path:
    """Draw what `register --out` wrote into a folder about the recording of that name: `picture.png` in that folder.

    Where the answer corrects SLAM, `devices.png` beside it tells what is wrong with which device; else an earlier one
    is removed. Returns the path of the first. Raises InputError where there is no answer in the folder, it is about
    another recording, or nothing can be written.
    """
    answer = read_answer(Path(folder), recording)
    picture, devices = Path(folder) / "picture.png", Path(folder) / "devices.png"
    _save(draw(answer, f"{name}: where its {len(answer.names)} devices were, from the distances between them"), picture)
    if answer.corrects_slam:
        _save(draw_devices(answer, f"{name}: what is wrong with which of its {len(answer.names)} devices"), devices)
    else:
        with os_faults(devices):
            devices.unlink(missing_ok=True)
    return picture


def _save(figure: Figure, file: Path) -> None:
    with warnings.catch_warnings(), os_faults(file):
        warnings.filterwarnings("ignore", message="Glyph .* missing")  # names may be of scripts that the font lacks
        figure.savefig(file, dpi=DPI)
