"""Writes the plots as files beside the answer."""

from __future__ import annotations

import warnings
from pathlib import Path

from matplotlib.figure import Figure

from synchronizar.data.recording import Recording
from synchronizar.errors import os_faults
from synchronizar.io.updates_jsonl import UPDATES_FILE, read_updates
from synchronizar.reporting.answer import read_answer
from synchronizar.reporting.history import history_of
from synchronizar.reporting.plots.devices import draw_devices
from synchronizar.reporting.plots.picture import draw
from synchronizar.reporting.plots.timeline import draw_timeline

DPI = 110
PICTURE, DEVICES, REPLAY = "picture.png", "devices.png", "replay.png"


def plot(recording: Recording, folder: str | Path, name: str) -> list[Path]:
    """Draw what `register --out` or `replay --out` wrote into a folder; return the files that are drawn.

    Of a registration: `picture.png` in that folder and, where the model corrects SLAM, `devices.png` with each device's
    calibration. Of a replay: `replay.png`. Files of an earlier answer that are not drawn again are removed. `name` is
    the recording's, for the titles. Raises InputError where the folder holds no answer, or one about another recording,
    or where a file cannot be written.
    """
    pages = _pages(recording, Path(folder), name)
    for page in (PICTURE, DEVICES, REPLAY):
        if page in pages:
            _save(pages[page], Path(folder) / page)
        else:
            with os_faults(Path(folder) / page):
                (Path(folder) / page).unlink(missing_ok=True)
    return [Path(folder) / page for page in pages]


def _pages(recording: Recording, folder: Path, name: str) -> dict[str, Figure]:
    devices = f"{len(recording.users)} devices"
    if (folder / UPDATES_FILE).exists():  # only a replay writes it
        history = history_of(read_updates(folder / UPDATES_FILE, recording), recording)
        return {REPLAY: draw_timeline(history, f"{name}: what was known of its {devices} while they moved")}
    answer = read_answer(folder, recording)
    pages = {PICTURE: draw(answer, f"{name}: where its {devices} were, from the distances between them")}
    if answer.corrects_slam:
        pages[DEVICES] = draw_devices(answer, f"{name}: what is wrong with which of its {devices}")
    return pages


def _save(figure: Figure, file: Path) -> None:
    with warnings.catch_warnings(), os_faults(file):
        warnings.filterwarnings("ignore", message="Glyph .* missing")  # names may be in scripts that the font lacks
        figure.savefig(file, dpi=DPI)
