"""Beyond the paper: errors against the Cramer-Rao bound.

`python -m experiments.sweeps.beside_bound [--full] [--seed N] [--scheduler ADDRESS]`: clean walks of two and of four, 3
to 24 s; the paper's method, ours with SLAM trusted (the model that the bound is of), and maximum likelihood that starts
at the truth. Errors are those of the frames, whose origins are where users began; the bound knows the priors (van
Trees), on heights above all.

All is conditional on being registered by ours: RMS over the users that ours calls registered and that the paper's
method could place, for all methods and the bound alike, since a wrong basin is no matter of a bound. Which users these
are hangs on their ranges, noise included, so where they are few, errors may be below the bound. The table tells what
share of all users ours registers and what share is told of; the figure has the former below the times.
A table and a figure beyond_bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from experiments.common.methods import bootstrap
from experiments.common.study import Interval, figure, options_of, points, results_of, save
from experiments.common.walks import beside_oracle, true_frames
from synchronizar.arrays import Array, Mask
from synchronizar.estimation.pairwise.register import register_pairwise
from synchronizar.geometry import difference
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

USERS = (2, 4)
SECONDS, SECONDS_FULL = (3.0, 6.0, 12.0, 24.0), (3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0)
WALKS, WALKS_FULL = 20, 100
METHODS = ("bound", "likelihood", "rigid", "pairwise")


class Task(NamedTuple):
    """One walk."""

    users: int
    seconds: float
    seed: int


class Errors(NamedTuple):
    """Of a walk."""

    of: Array
    """(methods, k - 1, 4) x, y, z (m), yaw (rad); of the bound 1 sigma."""
    registered: Mask
    """(k - 1,) whether ours says so."""

    @property
    def kept(self) -> Mask:
        """(k - 1,) who is told of: registered by ours, placed by all."""
        return np.asarray(self.registered & np.isfinite(self.of).all(axis=(0, 2)))


def walk(task: Task) -> Errors:
    """By all methods."""
    simulation = simulate(Scene(users=task.users, seconds=task.seconds, seed=task.seed))
    beside = beside_oracle(simulation)
    found = register_pairwise(simulation.recording)
    others = [name for name in found.users if name != found.reference]
    frames = [found.users[name].common_from_user for name in others]
    pairwise = np.array([[f.x, f.y, f.z, f.yaw] if f is not None else [np.nan] * 4 for f in frames])
    truth = true_frames(simulation, found.reference)[[simulation.recording.index(name) for name in others]]
    errors = np.array([beside.bound, beside.best, beside.ours, difference(pairwise, truth)])
    return Errors(errors, np.array(beside.registered))


def told(walks: Sequence[Errors]) -> dict[str, dict[str, Interval]]:
    """RMS in the plane (m), in height (m) and heading (degrees) of each method over the users that are kept."""
    of, kept = np.array([w.of for w in walks]), np.array([w.kept for w in walks])
    out = {}
    for n, method in enumerate(METHODS):
        x, y, z, yaw = np.moveaxis(of[:, n] ** 2, -1, 0)
        squares = {"plane": x + y, "z": z, "yaw deg": np.rad2deg(np.rad2deg(yaw))}
        out[method] = {name: bootstrap(np.where(kept, square, np.nan), _root) for name, square in squares.items()}
    return out


def main(argv: Sequence[str] | None = None) -> None:
    """The table and the figure."""
    options, began = options_of(__doc__, argv), perf_counter()
    seconds, walks = (SECONDS_FULL, WALKS_FULL) if options.full else (SECONDS, WALKS)
    tasks = [Task(k, s, options.seed + n) for n in range(walks) for k in USERS for s in seconds]
    done = list(zip(tasks, results_of(walk, tasks, options), strict=True))
    rows, cells, registered = [], {}, {}
    for k in USERS:
        for s in seconds:
            mine = [errors for task, errors in done if (task.users, task.seconds) == (k, s)]
            cells[k, s] = told(mine)
            row: dict[str, Any] = {"users": k, "seconds": s, "walks": walks}
            registered[k, s] = row["users registered"] = float(np.mean([e.registered for e in mine]))
            row["users told of"] = float(np.mean([e.kept for e in mine]))
            for what in ("plane", "z", "yaw deg"):
                row |= {f"{what} {method}": cells[k, s][method][what].value for method in METHODS}
            rows.append(row | {"plane rigid / bound": row["plane rigid"] / row["plane bound"]})
    save("beyond_bound", rows, drawn(seconds, cells, registered), options, began)


def drawn(
    seconds: Sequence[float],
    cells: dict[tuple[int, float], dict[str, dict[str, Interval]]],
    registered: dict[tuple[int, float], float],
) -> Figure:
    """The plane and the heading, of two and of four users; below the times, the share of users that ours registers."""
    made, axes = figure(columns=2, rows=len(USERS))
    for k, row in zip(USERS, axes, strict=True):
        for ax, (what, label) in zip(
            row, {"plane": "RMS in the plane (m)", "yaw deg": "RMS of heading (°)"}.items(), strict=True
        ):
            for method, aside in zip(("bound", "rigid", "pairwise"), (0.98, 1.0, 1.02), strict=True):
                points(ax, aside * np.array(seconds), [cells[k, s][method][what] for s in seconds], method)
            ax.set(ylabel=label, title=f"{k} users, where registered by ours", xscale="log", yscale="log")
            ax.set_xlabel("time of walking (s), share of users registered by ours")
            ax.set_xticks(seconds, [f"{s:g}\n{registered[k, s]:.0%}" for s in seconds])
            ax.minorticks_off()
    axes[0, 0].legend(frameon=False)
    return made


def _root(squares: Array) -> Array:
    """(m,) root of the mean of squares (m, n, k - 1), of those there are; NaN where there is none."""
    count = np.isfinite(squares).sum(axis=(1, 2))
    total = np.nansum(squares, axis=(1, 2))
    return np.asarray(np.sqrt(np.divide(total, count, out=np.full(len(squares), np.nan), where=count > 0)))


if __name__ == "__main__":
    main()
