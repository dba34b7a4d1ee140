"""Beyond the paper: duration of ranging until users are registered to 0.15 m, by their number.

`python -m experiments.sweeps.ranges_needed [--full] [--seed N] [--scheduler ADDRESS]`: clean walks of 24 s, cut off
after 3 s and more, by the paper's method and by ours. What is needed is the least of these after which, and after all
longer ones, the median over walks of the users' RMS error in the plane is below 0.15 m; infinite where that is never
so: then an arrow at the top of the figure. A table and a figure beyond_needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from experiments.common.methods import METHODS, WALKS, WALKS_FULL, beginning, bootstrap, placed, points_or_arrows
from experiments.common.study import Interval, figure, options_of, results_of, save
from synchronizar.arrays import Array
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

GOOD = 0.15
"""m."""
USERS, USERS_FULL = (2, 4, 6), (2, 3, 4, 6, 8, 10)
AFTER, AFTER_FULL = (3.0, 6.0, 12.0, 24.0), (3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0)
"""s."""


class Task(NamedTuple):
    """One walk."""

    users: int
    seed: int
    after: tuple[float, ...]


def walk(task: Task) -> Array:
    """(methods, times) m: RMS error in the plane after each."""
    simulation = simulate(Scene(users=task.users, seconds=max(task.after), seed=task.seed))
    cut = [beginning(simulation.recording, seconds) for seconds in task.after]
    errors = [[placed(r, simulation.world_from_user, method).plane for r in cut] for method in METHODS]
    return np.asarray(np.sqrt(np.mean(np.square(errors), axis=2)))


def needed(errors: Array, after: Array) -> Array:
    """(m,) s of m samples of walks, errors (m, n, times): the first after which the median stays good, or infinity."""
    good = np.median(errors, axis=1) < GOOD
    stays = np.logical_and.accumulate(good[:, ::-1], axis=1)[:, ::-1]
    return np.where(stays[:, -1], after[np.argmax(stays, axis=1)], np.inf)


def main(argv: Sequence[str] | None = None) -> None:
    """The table and the figure."""
    options, began = options_of(__doc__, argv), perf_counter()
    users, after, walks = (USERS_FULL, AFTER_FULL, WALKS_FULL) if options.full else (USERS, AFTER, WALKS)
    tasks = [Task(k, options.seed + n, after) for n in range(walks) for k in reversed(users)]
    done = list(zip(tasks, results_of(walk, tasks, options), strict=True))
    rows: list[dict[str, Any]] = []
    seconds: dict[str, list[Interval]] = {method: [] for method in METHODS}
    for k in users:
        errors = np.array([error for task, error in done if task.users == k])
        for n, method in enumerate(METHODS):
            least = bootstrap(errors[:, n], lambda drawn: needed(drawn, np.array(after)))
            seconds[method].append(least)
            row = {"users": k, "method": method, "walks": walks, "needed s": least.value}
            row |= {"low s": least.low, "high s": least.high, "rounds": least.value * Scene(users=k).round_hz}
            rows.append(row | {f"plane after {t:g} s": float(np.median(errors[:, n, m])) for m, t in enumerate(after)})
    save("beyond_needed", rows, drawn(users, seconds), options, began)


def drawn(users: Sequence[int], seconds: dict[str, list[Interval]]) -> Figure:
    """Seconds and rounds."""
    made, axes = figure(columns=2)
    hz = np.array([Scene(users=k).round_hz for k in users])
    for ax, times, what in zip(axes[0], (np.ones(len(users)), hz), ("time (s)", "rounds of ranging"), strict=True):
        for method, of, aside in zip(METHODS, seconds.values(), (-0.12, 0.0, 0.12), strict=True):
            scaled = [Interval(*(x * np.array(i))) for i, x in zip(of, times, strict=True)]
            points_or_arrows(ax, np.array(users) + aside, scaled, method)
        ax.set(xlabel="users", ylabel=what, title=f"needed for {GOOD} m in the plane")
        ax.set_ylim(bottom=0.0)
    handles, methods = axes[0, 0].get_legend_handles_labels()
    made.legend(handles, methods, loc="outside upper center", ncols=len(methods), frameon=False)
    return made


if __name__ == "__main__":
    main()
