"""Beyond the paper: errors of its method and of ours as one condition after another gets harder.

`python -m experiments.sweeps.sweeps [--full] [--seed N] [--scheduler ADDRESS]`: walks in a room of 6 m, three users and
12 s unless told otherwise, ranges with the hardware's 0.1 m; more users, late signals, SLAM that drifts, clocks that
are off, devices held at other heights, somebody who comes late, people who walk side by side, ranging at higher rates.
Each walk is registered by all methods. Errors of a walk are RMS over its users but the reference; what is told is the
median over walks. Shares are of walks, since the users of one walk are not independent: of those in which all users but
the reference are called registered, any of them is off, any is off and called registered all the same. A table and a
figure beyond_NAME of each; an arrow at the top of a panel is an interval without an upper end.

The paper's method takes its samples at the paper's rate, whatever the ranging's. Its states mean nothing: everybody
with four ranges is registered.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from experiments.accuracy.full_walks import OFF
from experiments.common.methods import (
    CLOCKS_TRUSTED,
    METHODS,
    WALKS,
    WALKS_FULL,
    Placed,
    beginning,
    bootstrap,
    median,
    placed,
    points_or_arrows,
    share,
)
from experiments.common.side_by_side import side_by_side
from experiments.common.study import Interval, figure, options_of, results_of, save
from synchronizar.arrays import Array
from synchronizar.data.ranging_rate import papers_rate_hz
from synchronizar.data.registration import State
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

KIM_M, KIM_RAD = 0.02, 0.01
"""In a second's root: how ARKit drifts (Kim et al., Sensors 22(24), 2022)."""
BEFORE_S = 12.0
"""How long the others have walked when somebody comes late."""


@dataclass(frozen=True)
class Sweep:
    """One thing that gets worse."""

    name: str
    axis: str
    at: tuple[float, ...]
    walk: Callable[[float, int], Simulation]
    """Of a value on the axis and a seed."""
    methods: tuple[str, ...] = tuple(METHODS)
    who: Mapping[str, slice] = field(default_factory=lambda: {"": slice(None)})
    """Whose errors are told apart, among the users but the reference."""
    last: str = "any registered, off"
    """What the last panel shows."""
    log: bool = False
    """Whether the axis is logarithmic."""


def _scene(seed: int, users: int = 3, seconds: float = 12.0, **worse: Any) -> Simulation:
    return simulate(Scene(users=users, seconds=seconds, seed=seed, **worse))


def _joined(since: float, seed: int) -> Simulation:
    """Four users, the last of whom came so long ago and BEFORE_S after the others.

    The same walk whatever `since`, which is BEFORE_S at most: who joins a scene late comes after half of it.
    """
    whole = _scene(seed, users=4, seconds=2.0 * BEFORE_S, late_joiners=1)
    kept = whole.recording.ranges.t < BEFORE_S + since
    cut = beginning(whole.recording, BEFORE_S + since)
    return replace(whole, recording=cut, late=whole.late[kept], extra=whole.extra[kept])


SWEEPS = (
    Sweep("users", "users", (2, 3, 4, 6, 8, 10), lambda k, seed: _scene(seed, users=int(k)), last="seconds"),
    Sweep(
        "late",
        "share of ranges without line of sight",
        (0.0, 0.1, 0.2, 0.3, 0.4, 0.5),
        lambda late, seed: _scene(seed, late_share=late),
    ),
    Sweep(
        "drift",
        "SLAM's drift in 60 s, times Kim et al.'s",
        (0.0, 0.5, 1.0, 2.0, 4.0),
        lambda times, seed: _scene(
            seed, seconds=60.0, drift_m_per_sqrt_s=times * KIM_M, drift_rad_per_sqrt_s=times * KIM_RAD
        ),
    ),
    Sweep(
        "clock",
        "clock offset, 1 sigma (s)",
        (0.0, 0.05, 0.1, 0.2, 0.3),
        lambda offset, seed: _scene(seed, clock_offset_sigma=offset),
        methods=(*METHODS, CLOCKS_TRUSTED),
    ),
    Sweep(
        "height",
        "spread of the devices' heights, 1 sigma (m)",
        (0.0, 0.1, 0.2, 0.4, 0.8),
        lambda spread, seed: _scene(seed, height_spread=spread),
    ),
    Sweep(
        "joiner",
        f"since the last of four users came, {BEFORE_S:g} s after the others (s)",
        (3.0, 4.0, 6.0, 8.0, 12.0),
        _joined,
        who={"there before": slice(0, -1), "who came": slice(-1, None)},
    ),
    Sweep(
        "side_by_side",
        "straying from the other's side (m)",
        (0.0, 0.05, 0.1, 0.2, 0.5, 1.0),
        lambda stray, seed: side_by_side(Scene(seed=seed), stray),
    ),
    Sweep(
        "rate",
        "rounds of ranging (Hz)",
        (papers_rate_hz(partners=2), 25.0, 60.0, 125.0, 250.0),
        lambda hz, seed: _scene(seed, rate_hz=hz),
        last="seconds",
        log=True,
    ),
)
BY_NAME = {sweep.name: sweep for sweep in SWEEPS}


class Task(NamedTuple):
    """One walk of a sweep."""

    sweep: str
    value: float
    seed: int


Line = tuple[str, str]
"""A method, and whose errors."""


def walk(task: Task) -> dict[str, Placed]:
    """By all methods of the sweep."""
    sweep = BY_NAME[task.sweep]
    simulation = sweep.walk(task.value, task.seed)
    return {method: placed(simulation.recording, simulation.world_from_user, method) for method in sweep.methods}


def tasks_of(sweep: Sweep, options: Any) -> list[Task]:
    """Every value with every seed; long and short ones in turn, so that the cores end together."""
    walks = WALKS_FULL if options.full else WALKS
    return [Task(sweep.name, value, options.seed + n) for n in range(walks) for value in sweep.at]


def told(walks: Sequence[Placed], who: slice) -> dict[str, Interval]:
    """Medians of errors (m, degrees) and time of walks alike, and shares of walks."""
    plane = np.array([w.plane[who] for w in walks])
    z = np.array([w.z[who] for w in walks])
    yaw = np.array([w.yaw[who] for w in walks])
    off = ~(np.hypot(plane, z) <= OFF)
    states = np.array([w.states[who] for w in walks])
    out = {
        "plane": bootstrap(_rms(plane), median),
        "z": bootstrap(_rms(z), median),
        "yaw deg": bootstrap(np.rad2deg(_rms(yaw)), median),
        "any off": share(off.any(axis=1)),
        "any registered, off": share((off & (states == State.REGISTERED)).any(axis=1)),
        "seconds": bootstrap(np.array([w.seconds for w in walks]), median),
        "all registered": share((states == State.REGISTERED).all(axis=1)),
    }
    unsure = (state for state in State if state is not State.REGISTERED)
    return out | {f"any {state}": share((states == state).any(axis=1)) for state in unsure}


def rows_of(sweep: Sweep, cells: Mapping[Line, Sequence[Mapping[str, Interval]]], walks: int) -> list[dict[str, Any]]:
    """A row of each value and line; of what is drawn but time and height, the intervals too."""
    rows = []
    for n, value in enumerate(sweep.at):
        for (method, who), line in cells.items():
            row: dict[str, Any] = {sweep.axis: value, "method": method} | ({"who": who} if who else {})
            row["walks"] = walks
            for name, of in line[n].items():
                row[name] = of.value
                if name in ("plane", "yaw deg", "any off", "any registered, off", "all registered"):
                    row |= {f"{name} low": of.low, f"{name} high": of.high}
            rows.append(row)
    return rows


_PANELS = {
    "plane": "error in the plane (m)",
    "z": "error in height (m)",
    "yaw deg": "error in heading (°)",
    "all registered": "share of walks, all registered",
    "any off": f"share of walks, any off by {OFF} m",
    "any registered, off": "share of walks, any off, registered",
    "seconds": "CPU time (s)",
}


def drawn(sweep: Sweep, cells: Mapping[Line, Sequence[Mapping[str, Interval]]]) -> Figure:
    """Errors above, verdicts below; a second line of one method is dashed."""
    made, axes = figure(columns=3, rows=2, height=2.3)
    shown = ["plane", "z", "yaw deg", "all registered", "any off", sweep.last]
    for name, ax in zip(shown, axes.ravel(), strict=True):
        seen = set()
        for x, ((method, who), line) in zip(_beside_each_other(sweep, len(cells)), cells.items(), strict=True):
            family = method.partition(",")[0]
            points_or_arrows(ax, x, [cell[name] for cell in line], family, f"{method}, {who}" if who else method)
            if family in seen:
                ax.containers[-1].lines[0].set(linestyle="--", markerfacecolor="white")
            seen.add(family)
        ax.set_title(_PANELS[name])
        if name in ("plane", "yaw deg", "seconds"):
            ax.set_yscale("log")
            ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            ax.yaxis.set_major_formatter("{x:g}")
            ax.yaxis.set_minor_formatter(NullFormatter())
        elif name == "z":
            ax.set_ylim(bottom=0.0)
        else:
            ax.set_ylim(-0.04, 1.04)
        if sweep.log:
            ax.set_xscale("log")
    made.supxlabel(sweep.axis, fontsize=8)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    columns = len(labels) // len(sweep.who)
    made.legend(handles, labels, loc="outside upper center", ncols=columns, frameon=False)
    return made


def cells_of(sweep: Sweep, tasks: Sequence[Task], results: Sequence[Mapping[str, Placed]]) -> dict[Line, list[Any]]:
    """Of each line what is told at each value."""
    done = list(zip(tasks, results, strict=True))
    return {
        (method, who): [told([r[method] for task, r in done if task.value == value], where) for value in sweep.at]
        for method in sweep.methods
        for who, where in sweep.who.items()
    }


def main(argv: Sequence[str] | None = None) -> None:
    """All sweeps, one after another."""
    options = options_of(__doc__, argv)
    for sweep in SWEEPS:
        began = perf_counter()
        tasks = tasks_of(sweep, options)
        cells = cells_of(sweep, tasks, results_of(walk, tasks, options))
        rows = rows_of(sweep, cells, len(tasks) // len(sweep.at))
        save(f"beyond_{sweep.name}", rows, drawn(sweep, cells), options, began)


def _beside_each_other(sweep: Sweep, lines: int) -> list[Array]:
    """Where on the axis each line has its points, so that intervals do not hide one another."""
    apart = 0.012 * (np.arange(lines) - 0.5 * (lines - 1))
    at = np.array(sweep.at)
    if sweep.log:
        return [at * (at[-1] / at[0]) ** step for step in apart]
    return [at + step * np.ptp(at) for step in apart]


def _rms(errors: Array) -> Array:
    """(n,) over the users of each walk (n, k - 1)."""
    return np.asarray(np.sqrt(np.mean(errors**2, axis=1)))


if __name__ == "__main__":
    main()
