"""picture.png: the map, residuals over time and as a histogram, and a list of the users."""

from __future__ import annotations

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from synchronizar.io.registration_folder import range_counts
from synchronizar.reporting.answer import Answer
from synchronizar.reporting.plots.residuals import draw_histogram, draw_over_time, residual_limits
from synchronizar.reporting.plots.style import Style, caption, short, styles
from synchronizar.reporting.plots.walks import draw_walks, symbols

SIZE_IN = (16.0, 10.0)
ROWS_PER_COLUMN = 22
ROWS_IN_LARGE_PRINT = 14
MOST_LISTED = 2 * ROWS_PER_COLUMN


def draw(answer: Answer, title: str) -> Figure:
    """The figure."""
    figure = Figure(figsize=SIZE_IN, layout="constrained")
    columns = figure.add_gridspec(1, 2, width_ratios=(2.4, 1.0))
    left = columns[0].subgridspec(2, 1, height_ratios=(3.6, 1.0))
    right = columns[1].subgridspec(3, 1, height_ratios=(2.6, 1.0, 1.6))
    of_user = styles(answer)
    sigma = answer.range_sigma
    limits = residual_limits(answer, sigma)
    with matplotlib.rc_context({"text.parse_math": False}):  # names may look like formulas
        draw_walks(figure.add_subplot(left[0]), answer, of_user)
        draw_over_time(figure.add_subplot(left[1]), answer, limits)
        _draw_users(figure.add_subplot(right[0]), answer, of_user)
        _draw_symbols(figure.add_subplot(right[1]), answer)
        draw_histogram(figure.add_subplot(right[2]), answer, sigma, limits)
        figure.suptitle(title, fontsize=14, fontweight="bold")
    return figure


def _draw_users(ax: Axes, answer: Answer, of_user: dict[str, Style]) -> None:
    """List every user with its state and 1 sigma, below a summary of the registration."""
    ax.axis("off")
    listed = answer.names[:MOST_LISTED]
    handles = [_sample(of_user[name], answer.registration.users[name].static) for name in listed]
    # Each begins with a space: matplotlib leaves out what begins with _.
    captions = [" " + caption(answer, name) for name in listed]
    if len(listed) < len(answer.names):
        handles.append(Line2D([], [], linestyle=""))
        captions.append(f" and {len(answer.names) - len(listed)} more")
    legend = ax.legend(
        handles,
        captions,
        title=_summary(answer),
        title_fontsize=10,
        alignment="left",
        loc="upper left",
        ncols=-(-len(captions) // ROWS_PER_COLUMN),
        fontsize=_font_size(len(captions)),
        labelspacing=0.3,
        borderpad=0.8,
        borderaxespad=0.0,
        columnspacing=0.8,
    )
    legend.set_in_layout(False)  # else a long name would narrow the map


def _font_size(rows: int) -> float:
    """So that the list ends above the symbols."""
    return 9.0 if rows <= ROWS_IN_LARGE_PRINT else 7.5 if rows <= ROWS_PER_COLUMN else 6.5


def _sample(style: Style, static: bool) -> Line2D:
    if static:
        return Line2D([], [], color=style.colour, marker="^", markersize=8, linestyle="")
    return Line2D([], [], color=style.colour, linestyle=style.dashes, linewidth=2.5)


def _summary(answer: Answer) -> str:
    registration, t = answer.registration, answer.ranges.t
    counts = ", ".join(f"{count} {what}" for what, count in range_counts(registration.ranges).items())
    lines = [
        f"{len(answer.names)} devices, {len(t)} ranges in {t.max() - t.min() if len(t) else 0.0:.1f} s",
        f"ranges: {counts}",
        f"reference {short(answer.reference)}; model {registration.model}, {registration.method}",
        "±: 1σ at the walk's end in the plane; of the heading",
    ]
    if answer.corrects_slam:
        lines.append("what is wrong with which device: devices.png")
    return "\n".join(lines)


def _draw_symbols(ax: Axes, answer: Answer) -> None:
    ax.axis("off")
    ax.legend(handles=symbols(answer), loc="upper left", fontsize=9, frameon=False, borderaxespad=0.0)
