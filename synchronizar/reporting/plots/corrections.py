"""Drift of SLAM over time: distance and heading from its own track to the corrected one."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from synchronizar.arrays import Array
from synchronizar.reporting.answer import Answer
from synchronizar.reporting.drift import drift_of
from synchronizar.reporting.plots.style import JUMP, Style, few

LEAST_M, LEAST_DEG = 0.1, 1.0
"""Least span of the axes, so that a correction below the noise of a range does not look large."""


def draw_corrections(distance: Axes, turn: Axes, answer: Answer, styles: dict[str, Style]) -> None:
    """Draw the distance (m) and heading (degrees) from SLAM's own track, a line for each user that is not static."""
    for name in answer.moving:
        drift, t = drift_of(answer, name), answer.elapsed(name, answer.tracks[name].t)
        at = np.array([jump.pose for jump in answer.registration.users[name].jumps], dtype=int)
        _draw(distance, t, drift.distance, at, styles[name])
        _draw(turn, t, np.degrees(drift.turn), at, styles[name])
    distance.set(ylabel="apart (m)", title="How far SLAM's own track leads away from the corrected one")
    turn.set(ylabel="corrected to the left by (°)", xlabel="time since the first range (s)")
    turn.axhline(0.0, color="black", linewidth=0.8, zorder=1)
    for ax in (distance, turn):
        ax.grid(color="0.92")
        ax.margins(x=0.01)
    distance.set_ylim(top=max(distance.get_ylim()[1], LEAST_M))
    low, high = turn.get_ylim()
    turn.set_ylim(min(low, -LEAST_DEG), max(high, LEAST_DEG))


def _draw(ax: Axes, t: Array, y: Array, jumps: Array, style: Style) -> None:
    rows = few(len(t))
    ax.plot(t[rows], y[rows], linestyle=style.dashes, color=style.colour, linewidth=1.3)
    ax.plot(t[jumps], y[jumps], JUMP, color=style.colour, markersize=9, markeredgecolor="white", zorder=4)
