"""The map: every user's track from above in the common frame, with uncertainty and ranges."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, FancyArrowPatch
from matplotlib.text import Annotation

from synchronizar.arrays import Array
from synchronizar.data.registration import State, UserRegistration
from synchronizar.data.track import Track
from synchronizar.reporting.answer import Answer
from synchronizar.reporting.drift import common_from_user_at_start, drift_of
from synchronizar.reporting.plots.labels import Arrangement, label
from synchronizar.reporting.plots.style import FAINT, JUMP, REJECTED, STATIC, USED, Style, few, short
from synchronizar.reporting.uncertainty import CHI2_95_OF_TWO, axes_of, jacobian, plane_covariance

MOST_RANGES = 150
"""Ranges drawn at most: more lines would hide the walks."""
SMALLEST_M = 1.0
"""m: least side of the map."""
MARGIN = 0.08
ARROW = 0.06
"""Length of an arrow, as a share of the map's side."""
MANY = 8
"""Of more devices that move, the last part of each walk alone is drawn strongly, and named where it ends."""
TAIL_S = 4.0
"""s: of a walk that is one of many, drawn strongly; the rest is as faint as it takes not to be a tangle."""
WHOLE = 0.25
"""Opacity of that rest."""
MOST_TIMES = 12
"""Jumps labelled with their time at most: more would hide the walks."""
UNCORRECTED = (0, (3.0, 2.0))
"""Dashes of SLAM's own tracks."""

ENDS = (
    Line2D([], [], color=STATIC, marker="o", markersize=6, linestyle="", label="start; the arrow is its own x axis"),
    Line2D([], [], color=STATIC, marker="s", markersize=5, linestyle="", label="end"),
)
ENDS_OF_MANY = (
    Line2D([], [], color=STATIC, marker="s", markersize=5, linewidth=1.8, label=f"end, and the {TAIL_S:g} s before"),
    Line2D([], [], color=STATIC, marker="o", markersize=3, linewidth=0.7, alpha=2 * WHOLE, label="whole walk, start"),
)
SYMBOLS = (
    Line2D([], [], color=STATIC, marker="^", markersize=8, linestyle="", label="static radio"),
    Line2D(
        [],
        [],
        color=STATIC,
        marker="o",
        markersize=11,
        fillstyle="none",
        linestyle="",
        label="95 % region of where it is",
    ),
    Line2D([], [], color=STATIC, linestyle=(0, (4, 3)), alpha=2 * FAINT, label="another placement that fits"),
    Line2D(
        [], [], color=STATIC, marker="$\u2194$", markersize=12, linestyle="", label="direction the ranges do not see"
    ),
    Line2D([], [], color=USED, linewidth=0.8, label="range, used"),
    Line2D([], [], color=REJECTED, linewidth=0.8, label="range, rejected"),
)
SYMBOLS_OF_CORRECTIONS = (
    Line2D([], [], color=STATIC, linewidth=0.9, linestyle=UNCORRECTED, label="as SLAM had it, laid at its start"),
    Line2D([], [], color=STATIC, marker=JUMP, markersize=8, linestyle="", label="SLAM jumped, and when"),
)


def is_crowded(answer: Answer) -> bool:
    """Whether so many move that the map would be a tangle."""
    return len(answer.moving) > MANY


def symbols(answer: Answer) -> tuple[Line2D, ...]:
    """Legend entries of the map's symbols."""
    shown = (*(ENDS_OF_MANY if is_crowded(answer) else ENDS), *SYMBOLS)
    if not answer.corrects_slam:
        return shown
    return shown + SYMBOLS_OF_CORRECTIONS[1 if is_crowded(answer) else 0 :]


def draw_walks(ax: Axes, answer: Answer, styles: dict[str, Style]) -> None:
    """Draw walks, static radios, their 95 % ellipses, and some of the ranges between them."""
    span = _frame_the_map(ax, answer)
    _draw_ranges(ax, answer)
    for name in answer.tracks:
        _draw_user(ax, answer, name, styles[name], span)
    named, size = (-1, 8.5) if is_crowded(answer) else (0, 10.0)
    labels = [
        label(ax, short(name), track.position[named], styles[name].ink, size, bold=True)
        for name, track in answer.tracks.items()
    ]
    if answer.corrects_slam:
        labels += _draw_corrections(ax, answer, styles)
    ax.add_artist(Arrangement(labels))


def _frame_the_map(ax: Axes, answer: Answer) -> float:
    """Set up the axes; return the side (m) of the square around every walk, alternatives included.

    SLAM's own tracks are shown too, within a map of twice that side.
    """
    walks = [track.position[:, :2] for track in answer.tracks.values()]
    for name, user in answer.registration.users.items():
        if user.state is State.AMBIGUOUS:
            walks += [walk[:, :2] for walk in answer.other_walks(name)]
    corners = np.concatenate([[walk.min(axis=0), walk.max(axis=0)] for walk in walks])
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle, span = 0.5 * (low + high), max(float((high - low).max()), SMALLEST_M)
    ax.update_datalim([middle - 0.25 * span, middle + 0.25 * span])
    if answer.corrects_slam and not is_crowded(answer):
        for name in answer.moving:
            walk = drift_of(answer, name).uncorrected.position[:, :2]
            corners = np.array([walk.min(axis=0), walk.max(axis=0)])
            ax.update_datalim(np.clip(corners, low - 0.5 * span, high + 0.5 * span))
    ax.margins(MARGIN)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(
        xlabel="x (m)",
        ylabel="y (m)",
        title=f"From above, in the common frame: the axes of {short(answer.whose_axes)}",
    )
    ax.grid(color="0.92")
    ax.set_axisbelow(True)
    return span


def _draw_corrections(ax: Axes, answer: Answer, styles: dict[str, Style]) -> list[Annotation]:
    """Draw SLAM's own tracks, and its jumps; return the labels of these."""
    for name in () if is_crowded(answer) else answer.moving:
        walk = drift_of(answer, name).uncorrected.position
        ax.add_collection(
            LineCollection(
                [walk[few(len(walk)), :2]],
                colors=styles[name].colour,
                linestyles=[UNCORRECTED],
                linewidths=0.8,
                alpha=0.8,
                zorder=2,
            ),
            autolim=False,
        )
    jumps = [(name, jump) for name in answer.moving for jump in answer.registration.users[name].jumps]
    labels = []
    for name, jump in jumps:
        x, y, _ = answer.tracks[name].position[jump.pose]
        size = 6 if is_crowded(answer) else 9
        ax.plot(x, y, JUMP, color=styles[name].colour, markersize=size, markeredgecolor="white", zorder=5)
        if len(jumps) <= MOST_TIMES:
            when = f"{answer.elapsed(name, np.array([jump.t]))[0]:.1f} s"
            labels.append(label(ax, when, (x, y), styles[name].ink, 8.0))
    return labels


def _draw_ranges(ax: Axes, answer: Answer) -> None:
    """Draw MOST_RANGES of the usable ranges at most, evenly chosen."""
    verdicts = answer.registration.ranges
    usable = np.flatnonzero(verdicts.usable)
    rows = usable[np.unique(np.linspace(0, len(usable) - 1, min(MOST_RANGES, len(usable))).round().astype(int))]
    lines = answer.ends(rows)[:, :, :2]
    for used, colour in ((True, USED), (False, REJECTED)):
        chosen = lines[verdicts.used[rows] == used]
        ax.add_collection(
            LineCollection(
                list(chosen), colors=colour, linewidths=0.6, alpha=0.15 if is_crowded(answer) else 0.4, zorder=1
            ),
            autolim=False,
        )


def _draw_user(ax: Axes, answer: Answer, name: str, style: Style, span: float) -> None:
    user, position = answer.registration.users[name], answer.tracks[name].position
    if user.state is State.AMBIGUOUS:
        for walk in answer.other_walks(name):
            _draw_walk(ax, walk, user, style._replace(dashes="--"), alpha=FAINT, width=1.5)
    if is_crowded(answer) and not user.static:
        _draw_one_of_many(ax, answer.tracks[name], style)
    else:
        _draw_walk(ax, position, user, style, alpha=0.9, width=1.5)
    _draw_ellipse(ax, user, position[-1], style, largest=span)
    if not user.static and not is_crowded(answer):
        if not answer.corrects_slam:  # else the covariance is that of the frame at the end alone
            _draw_ellipse(ax, user, position[0], style, largest=span)
        _draw_heading(ax, common_from_user_at_start(answer, name).yaw, position[0], style, ARROW * span)
    if user.state is State.UNOBSERVABLE and user.unseen_direction is not None:
        _draw_unseen(ax, user, position[-1], style, ARROW * span)


def _draw_walk(ax: Axes, walk: Array, user: UserRegistration, style: Style, alpha: float, width: float) -> None:
    x, y = walk[:, 0], walk[:, 1]
    if user.static:
        ax.plot(x[:1], y[:1], "^", color=style.colour, markersize=9, alpha=alpha, zorder=4)
        return
    rows = few(len(walk))
    ax.plot(x[rows], y[rows], linestyle=style.dashes, color=style.colour, linewidth=width, alpha=alpha, zorder=3)
    ax.plot(x[:1], y[:1], "o", color=style.colour, markersize=7, markeredgecolor="white", alpha=alpha, zorder=5)
    ax.plot(x[-1:], y[-1:], "s", color=style.colour, markersize=6, markeredgecolor="white", alpha=alpha, zorder=5)


def _draw_one_of_many(ax: Axes, track: Track, style: Style) -> None:
    """Draw a walk faintly, and its last seconds strongly."""
    x, y = track.position[:, 0], track.position[:, 1]
    rows, tail = few(len(track)), track.t >= track.t[-1] - TAIL_S
    for part, width, alpha in ((rows, 0.7, WHOLE), (tail, 1.8, 0.9)):
        ax.plot(x[part], y[part], linestyle=style.dashes, color=style.colour, linewidth=width, alpha=alpha, zorder=3)
    ax.plot(x[:1], y[:1], "o", color=style.colour, markersize=3, alpha=2 * WHOLE, zorder=2)
    ax.plot(x[-1:], y[-1:], "s", color=style.colour, markersize=6, markeredgecolor="white", zorder=5)


def _draw_ellipse(ax: Axes, user: UserRegistration, place: Array, style: Style, largest: float) -> None:
    """Draw the 95 % ellipse of a position; none where that is larger than the map."""
    sigmas, angle = axes_of(plane_covariance(user, place))
    width, height = 2.0 * np.sqrt(CHI2_95_OF_TWO) * sigmas
    if width > largest:
        return
    ax.add_artist(
        Ellipse(
            (place[0], place[1]),
            width,
            height,
            angle=np.degrees(angle),
            facecolor=(style.colour, 0.15),
            edgecolor=style.colour,
            linewidth=1.2,
            zorder=4,
        )
    )


def _draw_heading(ax: Axes, yaw: float, start: Array, style: Style, length: float) -> None:
    _arrow(ax, start, start + length * np.array([np.cos(yaw), np.sin(yaw), 0.0]), style, "-|>")


def _draw_unseen(ax: Axes, user: UserRegistration, end: Array, style: Style, length: float) -> None:
    """Draw the unobservable direction at the end of the walk: along, about the vertical, or in height; not to scale."""
    assert user.unseen_direction is not None
    unseen = np.nan_to_num(user.unseen_direction)
    along = jacobian(user, end) @ unseen
    if abs(unseen[3]) > np.linalg.norm(along):
        side, ahead = np.array([length, 0.0, 0.0]), np.array([0.0, length, 0.0])
        _arrow(ax, end + side - ahead, end + side + ahead, style, "<|-|>", bend=0.5)
    elif abs(along[2]) > np.hypot(along[0], along[1]):
        ax.annotate(
            "height unseen",
            (end[0], end[1]),
            xytext=(0, -14),
            textcoords="offset points",
            ha="center",
            fontsize=8,
            color=style.ink,
        )
    else:
        way = 1.5 * length * along / np.hypot(along[0], along[1])
        _arrow(ax, end - way, end + way, style, "<|-|>")


def _arrow(ax: Axes, begin: Array, end: Array, style: Style, heads: str, bend: float = 0.0) -> None:
    ax.add_artist(
        FancyArrowPatch(
            (begin[0], begin[1]),
            (end[0], end[1]),
            arrowstyle=heads,
            connectionstyle=f"arc3,rad={bend}",
            mutation_scale=12,
            shrinkA=0,
            shrinkB=0,
            color=style.colour,
            linewidth=1.5,
            zorder=5,
        )
    )
