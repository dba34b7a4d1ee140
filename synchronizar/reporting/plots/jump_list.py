"""Table of SLAM's jumps: time, device, distance, turn and tilt."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from synchronizar.reporting.answer import Answer
from synchronizar.reporting.plots.style import Style, short

MOST_JUMPS = 20
HEAD = ("at (s)", "device", "by (m)", "turn (°)", "tilt (°)")
COLUMNS = (0.16, 0.21, 0.68, 0.85, 1.0)
"""Left edge of the device's name and right edges of the numbers, as shares of the width."""
ROW = 1.0 / (MOST_JUMPS + 3)
"""Height of a row, as a share of the table's."""


def draw_jumps(ax: Axes, answer: Answer, styles: dict[str, Style]) -> None:
    """Draw the table in the order of time, MOST_JUMPS at most; disconnected users' jumps too."""
    ax.axis("off")
    jumps = [(name, jump) for name, user in answer.registration.users.items() for jump in user.jumps]
    times = [float(answer.elapsed(name, np.array([jump.t]))[0]) for name, jump in jumps]
    ax.set_title(f"Where SLAM jumped: {len(jumps)} times" if jumps else "SLAM never jumped")
    if not jumps:
        return
    _write(ax, 1, HEAD, "black")
    for row, k in enumerate(np.argsort(times, kind="stable")[:MOST_JUMPS].tolist(), start=2):
        name, jump = jumps[k]
        turn, tilt = np.degrees(jump.turn), np.degrees(jump.tilt)
        cells = (f"{times[k]:.1f}", short(name), f"{jump.distance:.2f}", f"{turn:+.1f}", f"{tilt:.1f}")
        _write(ax, row, cells, styles[name].ink)
    if len(jumps) > MOST_JUMPS:
        _write(ax, MOST_JUMPS + 2, ("", f"and {len(jumps) - MOST_JUMPS} more", "", "", ""), "black")


def _write(ax: Axes, row: int, cells: tuple[str, ...], colour: str) -> None:
    for column, (x, cell) in enumerate(zip(COLUMNS, cells, strict=True)):
        side = "left" if column == 1 else "right"
        ax.text(x, 1.0 - row * ROW, cell, transform=ax.transAxes, color=colour, fontsize=8.5, ha=side, va="center")
