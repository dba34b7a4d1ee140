"""Panels of the residuals of pairs of devices over time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from synchronizar.arrays import Array
from synchronizar.reporting.answer import Answer
from synchronizar.reporting.pairs import Pair
from synchronizar.reporting.plots.residuals import LEAST_SIGMAS, SHOWN
from synchronizar.reporting.plots.style import REJECTED, USED, short

MOST_PAIRS = 15


def pair_limits(answer: Answer, sigma: float) -> tuple[float, float]:
    """m: symmetric limits of all panels: LEAST_SIGMAS sigma at least, and SHOWN of the used residuals."""
    residual = np.abs(answer.registration.ranges.residual[answer.registration.ranges.used])
    reach = float(np.quantile(residual, SHOWN)) if len(residual) else 0.0
    reach = max(1.2 * reach, LEAST_SIGMAS * sigma)
    return -reach, reach


def draw_pair(ax: Axes, answer: Answer, pair: Pair, limits: tuple[float, float]) -> None:
    """Draw the residuals of a pair over time; those outside the limits stand at the edge."""
    verdicts, t = answer.registration.ranges, answer.ranges.t[pair.rows] - answer.began
    residual, used = verdicts.residual[pair.rows], verdicts.used[pair.rows]
    ax.axhline(0.0, color="black", linewidth=0.8, zorder=1)
    for mask, colour in ((used, USED), (~used, REJECTED)):
        _draw_points(ax, t[mask], residual[mask], colour, limits)
    agreement = "none used" if np.isnan(pair.rms) else f"rms {pair.rms:.2f} m"
    ax.set_title(f"{short(pair.a)} - {short(pair.b)}: {agreement}", fontsize=9)
    ax.set(ylim=limits)
    ax.grid(color="0.92")
    ax.tick_params(labelsize=8)


def _draw_points(ax: Axes, t: Array, residual: Array, colour: str, limits: tuple[float, float]) -> None:
    low, high = limits
    inside = (residual >= low) & (residual <= high)
    ax.plot(t[inside], residual[inside], ".", color=colour, markersize=3)
    for outside, edge, marker in ((residual > high, high, 6), (residual < low, low, 7)):  # carets up and down
        ax.plot(t[outside], np.full(int(outside.sum()), edge), linestyle="", marker=marker, color=colour, markersize=3)
