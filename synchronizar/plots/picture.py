"""The page: the map, beside it who is who and what became of the ranges."""

from __future__ import annotations

import warnings
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from synchronizar.formats.text import os_faults
from synchronizar.plots.answer import Answer, read_answer
from synchronizar.plots.residuals import draw_histogram, draw_over_time, range_sigma, residual_limits
from synchronizar.plots.style import Style, caption, short, styles
from synchronizar.plots.walks import SYMBOLS, draw_walks
from synchronizar.recording import Recording
from synchronizar.report import range_counts

SIZE_IN = (16.0, 10.0)
DPI = 110
ROWS_PER_COLUMN = 22
MOST_LISTED = 2 * ROWS_PER_COLUMN


def plot(recording: Recording, folder: str | Path, name: str) -> Path:
    """Draw what `register --out` wrote into a folder about the recording of that name: `picture.png` in that folder.

    Raises InputError where there is no answer in the folder, it is about another recording, or nothing can be written.
    """
    answer = read_answer(Path(folder), recording)
    file = Path(folder) / "picture.png"
    figure = draw(answer, f"{name}: where its {len(answer.names)} devices were, from the distances between them")
    with warnings.catch_warnings(), os_faults(file):
        warnings.filterwarnings("ignore", message="Glyph .* missing")  # names may be of scripts that the font lacks
        figure.savefig(file, dpi=DPI)
    return file


def draw(answer: Answer, title: str) -> Figure:
    """The whole page."""
    figure = Figure(figsize=SIZE_IN, layout="constrained")
    columns = figure.add_gridspec(1, 2, width_ratios=(2.4, 1.0))
    left = columns[0].subgridspec(2, 1, height_ratios=(3.6, 1.0))
    right = columns[1].subgridspec(3, 1, height_ratios=(2.6, 1.0, 1.6))
    of_user = styles(answer)
    sigma = range_sigma(answer)
    limits = residual_limits(answer, sigma)
    with matplotlib.rc_context({"text.parse_math": False}):  # names may look like formulas
        draw_walks(figure.add_subplot(left[0]), answer, of_user)
        draw_over_time(figure.add_subplot(left[1]), answer, limits)
        _draw_users(figure.add_subplot(right[0]), answer, of_user)
        _draw_symbols(figure.add_subplot(right[1]))
        draw_histogram(figure.add_subplot(right[2]), answer, sigma, limits)
        figure.suptitle(title, fontsize=14, fontweight="bold")
    return figure


def _draw_users(ax: Axes, answer: Answer, of_user: dict[str, Style]) -> None:
    """What came out for everybody, under the figures of the whole."""
    ax.axis("off")
    listed = answer.names[:MOST_LISTED]
    handles = [_sample(of_user[name], answer.registration.users[name].static) for name in listed]
    # A space before each: what begins with _ would be left out.
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
        fontsize=9 if len(captions) <= ROWS_PER_COLUMN else 6.5,
        borderpad=0.8,
        borderaxespad=0.0,
        columnspacing=0.8,
    )
    legend.set_in_layout(False)  # else a long name would narrow the map


def _sample(style: Style, static: bool) -> Line2D:
    if static:
        return Line2D([], [], color=style.colour, marker="^", markersize=8, linestyle="")
    return Line2D([], [], color=style.colour, linestyle=style.dashes, linewidth=2.5)


def _summary(answer: Answer) -> str:
    registration, t = answer.registration, answer.ranges.t
    counts = ", ".join(f"{count} {what}" for what, count in range_counts(registration.ranges).items())
    return "\n".join(
        [
            f"{len(answer.names)} devices, {len(t)} ranges in {t.max() - t.min() if len(t) else 0.0:.1f} s",
            f"ranges: {counts}",
            f"reference {short(registration.reference)}; model {registration.model}, {registration.method}",
            "±: 1σ at the walk's end in the plane; of the heading",
        ]
    )


def _draw_symbols(ax: Axes) -> None:
    ax.axis("off")
    ax.legend(handles=SYMBOLS, loc="upper left", fontsize=9, frameon=False, borderaxespad=0.0)
