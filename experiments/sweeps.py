"""Beyond the paper: what becomes of the paper's method and of ours as one thing after another gets worse.

`python -m experiments.sweeps [--full] [--seed N] [--scheduler ADDRESS]`: walks in a room of 6 m, three users and 12 s
unless told otherwise, ranges with the hardware's 0.1 m; more users, late signals, SLAM that drifts, clocks that are
off, devices held at other heights, somebody who comes late, people who walk side by side, ranging at higher rates. Each
walk is registered by all methods. Errors of a walk are RMS over its users but the reference; what is told is the median
over walks. A table and a figure beyond_NAME of each.

The paper's method takes its samples at the paper's rate, whatever the ranging's. Its states mean nothing: everybody
with four ranges is registered.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from experiments.beyond import WALKS, WALKS_FULL, Placed, bootstrap, median, placed, share
from experiments.full_walks import OFF
from experiments.side_by_side import side_by_side
from experiments.study import Interval, figure, options_of, points, results_of, save
from synchronizar.arrays import Array
from synchronizar.registration import State
from synchronizar.scene import Scene
from synchronizar.simulate import Simulation, simulate

KIM_M, KIM_RAD = 0.02, 0.01
"""In a second's root: how ARKit drifts (Kim et al., Sensors 22(24), 2022)."""
PAPERS_HZ = 1000.0 / (80.0 + 21.0 * 2.0)
"""Of ranging with two partners."""


@dataclass(frozen=True)
class Sweep:
    """One thing that gets worse."""

    name: str
    axis: str
    at: tuple[float, ...]
    walk: Callable[[float, int], Simulation]
    """Of a value on the axis and a seed."""
    methods: tuple[str, ...] = ("pairwise", "rigid", "joint")
    who: Mapping[str, slice] = field(default_factory=lambda: {"": slice(None)})
    """Whose errors are told apart, among the users but the reference."""
    last: str = "registered, off"
    """What the last panel shows."""
    log: bool = False
    """Whether the axis is logarithmic."""


def _scene(seed: int, users: int = 3, seconds: float = 12.0, **worse: Any) -> Simulation:
    return simulate(Scene(users=users, seconds=seconds, seed=seed, **worse))


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
        methods=("pairwise", "rigid", "joint", "joint, clocks trusted"),
    ),
    Sweep(
        "height",
        "spread of the devices' heights, 1 sigma (m)",
        (0.0, 0.1, 0.2, 0.4, 0.8),
        lambda spread, seed: _scene(seed, height_spread=spread),
    ),
    Sweep(
        "joiner",
        "since the last of four users came (s)",
        (3.0, 4.0, 6.0, 8.0, 12.0),
        lambda since, seed: _scene(seed, users=4, seconds=2.0 * since, late_joiners=1),
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
        (PAPERS_HZ, 25.0, 60.0, 125.0, 250.0),
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
    """Errors (m, degrees), states and time of walks alike."""
    plane = np.array([w.plane[who] for w in walks])
    z = np.array([w.z[who] for w in walks])
    yaw = np.array([w.yaw[who] for w in walks])
    off = ~(np.hypot(plane, z) <= OFF)
    states = np.array([w.states[who] for w in walks])
    out = {
        "plane": bootstrap(_rms(plane), median),
        "z": bootstrap(_rms(z), median),
        "yaw deg": bootstrap(np.rad2deg(_rms(yaw)), median),
        "off": bootstrap(off, share),
        "registered, off": bootstrap(off & (states == State.REGISTERED), share),
        "seconds": bootstrap(np.array([w.seconds for w in walks]), median),
    }
    return out | {str(state): bootstrap(states == state, share) for state in State}


def rows_of(sweep: Sweep, cells: Mapping[Line, Sequence[Mapping[str, Interval]]], walks: int) -> list[dict[str, Any]]:
    """A row of each value and line; of errors their intervals too."""
    rows = []
    for n, value in enumerate(sweep.at):
        for (method, who), line in cells.items():
            row: dict[str, Any] = {sweep.axis: value, "method": method} | ({"who": who} if who else {})
            row["walks"] = walks
            for name, of in line[n].items():
                row[name] = of.value
                if name in ("plane", "yaw deg"):
                    row |= {f"{name} low": of.low, f"{name} high": of.high}
            rows.append(row)
    return rows


_PANELS = {
    "plane": "error in the plane (m)",
    "z": "error in height (m)",
    "yaw deg": "error in heading (°)",
    "registered": "share called registered",
    "off": f"share off by more than {OFF} m",
    "registered, off": "share off, called registered",
    "seconds": "time to compute (s)",
}


def drawn(sweep: Sweep, cells: Mapping[Line, Sequence[Mapping[str, Interval]]]) -> Figure:
    """Errors above, verdicts below; a second line of one method is dashed."""
    made, axes = figure(columns=3, rows=2, height=2.3)
    shown = ["plane", "z", "yaw deg", "registered", "off", sweep.last]
    for name, ax in zip(shown, axes.ravel(), strict=True):
        seen = set()
        for x, ((method, who), line) in zip(_beside_each_other(sweep, len(cells)), cells.items(), strict=True):
            family = method.partition(",")[0]
            of = [Interval(*np.where(np.isfinite(cell[name]), cell[name], np.nan)) for cell in line]
            points(ax, x, of, family, label=f"{method}, {who}" if who else method)
            if family in seen:
                ax.containers[-1].lines[0].set(linestyle="--", markerfacecolor="white")
            seen.add(family)
        ax.set_title(_PANELS[name])
        if name in ("plane", "yaw deg", "seconds"):
            ax.set_yscale("log")
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
