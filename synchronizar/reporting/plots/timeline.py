"""replay.png: each user's state, progress and 1 sigma over time, and the events."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogLocator, NullFormatter

from synchronizar.arrays import Array
from synchronizar.data.registration import State
from synchronizar.reporting.history import History, UserHistory
from synchronizar.reporting.plots.style import Style, short, styles_of

WIDTH_IN = 12.0
ROW_IN = 0.42
PANEL_IN = 2.1
LINE_IN = 0.17
MARGIN_IN = 1.0
FEWEST_ROWS, MOST_USERS = 2, 40
MANY = 8
"""Of more devices lines are thinner."""
MOST_EVENTS = 24
LONGEST_EVENT = 84
STATE_COLOURS = {
    # Paul Tol's light scheme: legible behind black, and distinct for the colour-blind.
    State.REGISTERED: "#44BB99",
    State.AMBIGUOUS: "#EEDD88",
    State.UNOBSERVABLE: "#EE8866",
    State.DISCONNECTED: "#DDDDDD",
}
SHORTEST_S = 0.1
"""s: least length of the time axis."""
BAR = 0.8
"""Height of a user's bar, as a share of its row."""
SAMPLE = (-0.024, -0.004)
"""Ends of the sample of a user's line, between its name and its bar, as shares of the width."""
HALO = (withStroke(linewidth=3.0, foreground="white"),)


def draw_timeline(history: History, title: str) -> Figure:
    """The figure: every user's state and progress, 1 sigma in the plane and of the heading, and the events."""
    events_in = LINE_IN * (2 + _event_rows(history))
    heights = (ROW_IN * _rows(history), PANEL_IN, PANEL_IN, events_in)
    figure = Figure(figsize=(WIDTH_IN, sum(heights) + MARGIN_IN), layout="constrained")
    of_user = styles_of({name: user.static for name, user in history.users.items()})
    with matplotlib.rc_context({"text.parse_math": False}):  # names may look like formulas
        rows = figure.add_gridspec(4, 1, height_ratios=heights)
        states = figure.add_subplot(rows[0])
        xy, yaw = (figure.add_subplot(rows[n], sharex=states) for n in (1, 2))
        _draw_states(states, history, of_user)
        thickness = 1.0 if len(history.users) <= MANY else 0.5
        for name, user in history.users.items():
            _draw_sigma(xy, history.t, user.sigma_xy, user, of_user[name], thickness)
            _draw_sigma(yaw, history.t, np.degrees(user.sigma_yaw), user, of_user[name], thickness)
        xy.set(ylabel="in the plane (m)", title="1σ of where everybody was; thick while registered")
        yaw.set(ylabel="heading (°)", xlabel="time since the first range (s)")
        _draw_events(figure.add_subplot(rows[3]), history)
        figure.suptitle(title, fontsize=14, fontweight="bold")
    return figure


def _rows(history: History) -> int:
    """Number of rows; one more where some users are not shown."""
    n = len(history.users)
    return max(min(n, MOST_USERS) + (n > MOST_USERS), FEWEST_ROWS)


def _draw_states(ax: Axes, history: History, of_user: dict[str, Style]) -> None:
    """Draw a bar for each user, from the first range on; over it progress, events and cues."""
    shown = list(history.users)[:MOST_USERS]
    for row, name in enumerate(shown):
        user, style = history.users[name], of_user[name]
        _draw_bar(ax, row, history.t, user.states)
        lower, upper = row + BAR / 2.0, row - BAR / 2.0  # the first user is on top
        progress = lower - BAR * user.progress
        ax.plot(history.t, progress, drawstyle="steps-post", color="black", linewidth=1.2, path_effects=HALO)
        events = [t for t, event in history.events if event.startswith(f"{name}: ")]
        ax.plot(events, np.full(len(events), upper), "v", color="black", markersize=5, zorder=4)
        cues = _new_cues(history.t, user.cues)
        ax.plot(cues, np.full(len(cues), lower), "|", color="black", markersize=6, zorder=4)
        ax.plot(
            SAMPLE,
            [row, row],
            linestyle=style.dashes,
            color=style.colour,
            linewidth=2.2,
            transform=ax.get_yaxis_transform(),
            clip_on=False,
        )
    if len(shown) < len(history.users):
        more = f"and {len(history.users) - len(shown)} more"
        ax.text(0.0, MOST_USERS, more, transform=ax.get_yaxis_transform(), fontsize=9, va="center")
    ax.set_yticks(range(len(shown)), [short(name) for name in shown])
    for label, name in zip(ax.get_yticklabels(), shown, strict=True):
        label.set(color=of_user[name].ink, fontweight="bold")
    ax.tick_params("y", length=0, pad=28)
    ax.set(ylim=(_rows(history) - 0.5, -0.6), xlim=(0.0, max(float(history.t.max(initial=0.0)), SHORTEST_S)))
    ax.spines[["top", "left", "right"]].set_visible(False)
    legend = [
        *(Patch(color=colour, label=str(state)) for state, colour in STATE_COLOURS.items()),
        Line2D([], [], color="black", linewidth=1.2, label="progress, from 0 below to 1 above"),
        Line2D([], [], color="black", marker="v", markersize=5, linestyle="", label="event"),
        Line2D([], [], color="black", marker="|", markersize=6, linestyle="", label="new cue"),
    ]
    ax.legend(
        handles=legend, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(legend), fontsize=9, frameon=False
    )


def _draw_bar(ax: Axes, row: int, t: Array, states: list[State]) -> None:
    """Draw the states as one bar; a state holds until the next update with another one."""
    first = np.array([n for n, state in enumerate(states) if n == 0 or state is not states[n - 1]], dtype=int)
    begin = np.where(first == 0, 0.0, t[first])
    end = np.append(begin, t[-1:])[1:]
    ax.barh(row, end - begin, left=begin, height=BAR, color=[STATE_COLOURS[states[n]] for n in first])


def _new_cues(t: Array, cues: list[str | None]) -> Array:
    """(m,) s: times at which the cue changed to another one."""
    return t[[n for n, cue in enumerate(cues) if cue is not None and (n == 0 or cue != cues[n - 1])]]


def _draw_sigma(ax: Axes, t: Array, sigma: Array, user: UserHistory, style: Style, thickness: float) -> None:
    """Draw 1 sigma (n,) over time, thick while the user is registered."""
    registered = np.array([state is State.REGISTERED for state in user.states], dtype=bool)
    for y, width in ((sigma, 0.9 * thickness), (np.where(registered, sigma, np.nan), 2.2 * thickness)):
        ax.plot(t, y, linestyle=style.dashes, color=style.colour, linewidth=width)
    ax.set_yscale("log", nonpositive="mask")
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.grid(color="0.92")


def _event_rows(history: History) -> int:
    """Number of rows of the events, which stand in two columns."""
    return -(-min(len(history.events), MOST_EVENTS) // 2)


def _draw_events(ax: Axes, history: History) -> None:
    """List the first events, down the left half and then down the right one."""
    ax.axis("off")
    events, rows = history.events[:MOST_EVENTS], _event_rows(history)
    title = "What was told" if events else "Nothing was told" if len(history.t) else "No range came"
    if len(events) < len(history.events):
        title += f": the first {len(events)} of {len(history.events)} events"
    ax.set_title(title)
    for n, (t, event) in enumerate(events):
        x, y = 0.5 * (n // rows), 1.0 - (n % rows + 1.0) / (rows + 1.0)
        shortened = event if len(event) <= LONGEST_EVENT else event[: LONGEST_EVENT - 1] + "…"
        ax.text(x + 0.045, y, f"{t:.1f} s", fontsize=8, ha="right", transform=ax.transAxes, in_layout=False)
        ax.text(x + 0.055, y, shortened, fontsize=8, transform=ax.transAxes, in_layout=False)
