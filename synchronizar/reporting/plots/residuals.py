"""Residuals of the ranges (measured minus predicted, m): their histogram, and each over time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from synchronizar.arrays import Array
from synchronizar.reporting.answer import Answer
from synchronizar.reporting.plots.style import REJECTED, USED

SHOWN = 0.98
"""Share of the residuals that the axes must hold."""
LEAST_SIGMAS = 6.0
BINS = 80


def residual_limits(answer: Answer, sigma: float) -> tuple[float, float]:
    """m: limits of the axes: LEAST_SIGMAS sigma to either side at least, and SHOWN of the residuals."""
    residual = answer.registration.ranges.residual[answer.registration.ranges.usable]
    low, high = np.quantile(residual, [0.5 - 0.5 * SHOWN, 0.5 + 0.5 * SHOWN]) if len(residual) else (0.0, 0.0)
    return min(1.1 * float(low), -LEAST_SIGMAS * sigma), max(1.1 * float(high), LEAST_SIGMAS * sigma)


def draw_histogram(ax: Axes, answer: Answer, sigma: float, limits: tuple[float, float]) -> None:
    """Draw histograms of the used and of the rejected ranges' residuals, and the normal density of noise alone."""
    used, rejected = _split(answer)
    edges = np.linspace(*limits, BINS + 1).tolist()
    ax.hist(used, edges, color=USED, label="used")
    ax.hist(rejected, edges, histtype="step", color=REJECTED, linewidth=1.3, label="rejected")
    x = np.linspace(-4.0 * sigma, 4.0 * sigma, 200)
    density = np.exp(-0.5 * (x / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi))
    ax.plot(
        x, len(used) * (edges[1] - edges[0]) * density, color="black", linewidth=1, label=f"noise, σ = {sigma:.2g} m"
    )
    ax.set(
        xlim=limits,
        xlabel="measured minus predicted (m)",
        ylabel="ranges",
        title=f"Residuals{_outside(np.concatenate([used, rejected]), limits)}",
    )
    ax.legend(fontsize=8, frameon=False)


def draw_over_time(ax: Axes, answer: Answer, limits: tuple[float, float]) -> None:
    """Draw the residual of each range over time."""
    verdicts, t = answer.registration.ranges, answer.ranges.t - answer.began
    rejected = verdicts.usable & ~verdicts.used
    for mask, colour, size in ((verdicts.used, USED, 2.0), (rejected, REJECTED, 3.0)):
        ax.plot(t[mask], verdicts.residual[mask], ".", color=colour, markersize=size, rasterized=True)
    ax.axhline(0.0, color="black", linewidth=0.8)
    ax.set(
        ylim=limits,
        xlabel="time since the first range (s)",
        ylabel="residual (m)",
        title="Residuals over time: used grey, rejected red" + _outside(verdicts.residual[verdicts.usable], limits),
    )
    ax.grid(color="0.92")
    ax.margins(x=0.01)


def _split(answer: Answer) -> tuple[Array, Array]:
    """Residuals (m) of the used and of the rejected ranges."""
    verdicts = answer.registration.ranges
    return verdicts.residual[verdicts.used], verdicts.residual[verdicts.usable & ~verdicts.used]


def _outside(residual: Array, limits: tuple[float, float]) -> str:
    """How many residuals lie outside the limits, in parentheses; nothing where none does."""
    count = int(((residual < limits[0]) | (residual > limits[1])).sum())
    return f" ({count} further out)" if count else ""
