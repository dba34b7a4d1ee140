"""devices.png: each device's drift, calibration and jumps, and the residuals of each pair."""

from __future__ import annotations

import matplotlib
from matplotlib.figure import Figure, SubFigure

from synchronizar.parameters import Parameters
from synchronizar.reporting.answer import Answer
from synchronizar.reporting.pairs import Pair, pairs
from synchronizar.reporting.plots.corrections import draw_corrections
from synchronizar.reporting.plots.estimates import draw_estimates, draw_names, draw_slam_noise, kinds
from synchronizar.reporting.plots.jump_list import draw_jumps
from synchronizar.reporting.plots.pairs import MOST_PAIRS, draw_pair, pair_limits
from synchronizar.reporting.plots.style import styles

WIDTH_IN = 18.0
TOP_IN = 6.4
BOTTOM_IN = 0.8
PAIR_ROW_IN = 1.7
MOST_IN_A_ROW = 5


def draw_devices(answer: Answer, title: str) -> Figure:
    """The figure: SLAM's drift, each device's calibration, the jumps; below them the pairs."""
    found = pairs(answer)
    pair_rows = -(-min(len(found), MOST_PAIRS) // MOST_IN_A_ROW)
    bottom_in = BOTTOM_IN + pair_rows * PAIR_ROW_IN
    figure = Figure(figsize=(WIDTH_IN, TOP_IN + bottom_in), layout="constrained")
    with matplotlib.rc_context({"text.parse_math": False}):  # names may look like formulas
        halves = figure.add_gridspec(2, 1, height_ratios=(TOP_IN, bottom_in))
        _draw_each(figure.add_subfigure(halves[0]), answer)
        _draw_pairs(figure.add_subfigure(halves[1]), answer, found)
        figure.suptitle(title, fontsize=14, fontweight="bold")
    return figure


def _draw_each(figure: SubFigure, answer: Answer) -> None:
    of_user = styles(answer)
    columns = figure.add_gridspec(2, 7, width_ratios=(4.4, 1.1, 1.3, 1.3, 1.3, 1.1, 2.6))
    distance = figure.add_subplot(columns[0, 0])
    draw_corrections(distance, figure.add_subplot(columns[1, 0], sharex=distance), answer, of_user)
    draw_names(figure.add_subplot(columns[:, 1]), answer, of_user)
    panels = [figure.add_subplot(columns[:, column]) for column in (2, 3, 4)]
    for ax, kind in zip(panels, kinds(Parameters()), strict=True):
        draw_estimates(ax, answer, kind)
    panels[1].set_xlabel("bars: ±2σ; band: the prior's ±2σ\ngrey and hollow: the prior determines it", fontsize=9)
    draw_slam_noise(figure.add_subplot(columns[:, 5]), answer)
    draw_jumps(figure.add_subplot(columns[:, 6]), answer, of_user)


def _draw_pairs(figure: SubFigure, answer: Answer, found: list[Pair]) -> None:
    """Draw a panel for each pair, MOST_PAIRS at most, all with the same axes."""
    shown, limits = found[:MOST_PAIRS], pair_limits(answer, answer.range_sigma)
    title = "Measured minus predicted of each pair over time: used grey, rejected red, at the edge where further out"
    if len(shown) < len(found):
        title += f" - the {len(shown)} pairs of the largest rms, {len(found) - len(shown)} more not shown"
    figure.suptitle(title if found else "No pair has a usable range", fontsize=12)
    if not found:
        return
    rows = -(-len(shown) // MOST_IN_A_ROW)
    in_a_row = -(-len(shown) // rows)
    panels = figure.subplots(rows, in_a_row, sharex=True, sharey=True, squeeze=False)
    for index, ax in enumerate(panels.flat):
        if index >= len(shown):
            ax.axis("off")
            continue
        draw_pair(ax, answer, shown[index], limits)
        # The lowest panel of each column has the time labels, even where the last row is not full.
        ax.tick_params(labelbottom=index + in_a_row >= len(shown))
    figure.supxlabel("time since the first range (s)", fontsize=10)
    figure.supylabel("residual (m)", fontsize=10)
