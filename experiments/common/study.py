"""Shared by the studies of the paper's evaluation: options, parallel tasks, confidence intervals, results.

Tasks are independent and seeded one by one, so results do not hang on how many cores there are, or on which machine of
a Dask cluster a task was done.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any, NamedTuple, TypeVar

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.common.results import FOLDER, write_table
from synchronizar.arrays import Array

Task = TypeVar("Task")
Result = TypeVar("Result")

CONFIDENCE = 0.95
RESAMPLED = 2000
"""Bootstrap resamples of an interval."""
COLOURS = {"pairwise": "#AA4499", "joint": "#332288", "rigid": "#44AA99", "bound": "#333333"}
"""The paper's method, ours, ours with SLAM trusted: Paul Tol's muted scheme, which the colour-blind can tell apart."""
MARKERS = {"pairwise": "s", "joint": "o", "rigid": "^", "bound": "_"}
STYLE = {
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "legend.fontsize": 7.0,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
}
COLUMN_INCHES, WIDE_INCHES = 3.4, 7.0
"""One and two columns of a journal."""


def options_of(
    doc: str | None,
    argv: Sequence[str] | None = None,
    add: Callable[[argparse.ArgumentParser], None] | None = None,
) -> argparse.Namespace:
    """The options of every study, and those that one of them adds."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true", help="the paper's size")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster that does the tasks")
    if add is not None:
        add(parser)
    return parser.parse_args(argv)


def results_of(work: Callable[[Task], Result], tasks: Sequence[Task], options: argparse.Namespace) -> list[Result]:
    """The results of tasks, in their order, on all cores or on a cluster."""
    from tqdm import tqdm

    bar = tqdm(total=len(tasks), disable=not sys.stderr.isatty(), leave=False)
    out: list[Result] = []
    with bar:
        if options.scheduler is not None:
            from distributed import Client

            with Client(options.scheduler) as client:
                for future in client.map(work, tasks, pure=False):
                    out.append(future.result())
                    bar.update()
        else:
            chunk = max(1, min(8, len(tasks) // (4 * multiprocessing.cpu_count())))
            with multiprocessing.Pool() as pool:
                for result in pool.imap(work, tasks, chunksize=chunk):
                    out.append(result)
                    bar.update()
    return out


class Interval(NamedTuple):
    """A statistic with its confidence interval."""

    value: float
    low: float
    high: float


def interval(values: Array, statistic: Callable[[Array], float], seed: int = 0) -> Interval:
    """Of a statistic of n independent values (n, ...), by the percentile bootstrap (Efron 1979)."""
    random = np.random.default_rng(seed)
    drawn = [statistic(values[random.integers(len(values), size=len(values))]) for _ in range(RESAMPLED)]
    half = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.quantile(drawn, [half, 1.0 - half])
    return Interval(statistic(values), float(low), float(high))


def rms(values: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def points(ax: Axes, x: Array, of: Sequence[Interval], method: str, label: str | None = None) -> None:
    """A line of intervals in the method's colour."""
    value, low, high = np.array(of).T
    ax.errorbar(
        x,
        value,
        [value - low, high - value],
        color=COLOURS[method],
        marker=MARKERS[method],
        markersize=4,
        linewidth=1.2,
        capsize=2,
        label=label or method,
    )


def figure(columns: int = 1, rows: int = 1, wide: bool = True, height: float = 2.6) -> tuple[Figure, Any]:
    """A figure with axes (rows, columns), as wide as one or two columns of a journal."""
    matplotlib.rcParams.update(STYLE)
    made = Figure(figsize=(WIDE_INCHES if wide else COLUMN_INCHES, height * rows), layout="constrained")
    axes = made.subplots(rows, columns, squeeze=False)
    return made, axes


def save(
    name: str,
    rows: list[dict[str, Any]],
    made: Figure,
    options: argparse.Namespace,
    began: float,
    said: Sequence[str] = (),
) -> None:
    """Write NAME.csv, NAME.json with the settings, NAME.txt with what is said of them and NAME.png; print all.

    A full run's have _full in their names. `began` by perf_counter.
    """
    if options.full:
        name += "_full"
    print(write_table(name, rows, vars(options) | {"seconds": round(perf_counter() - began, 1)}))
    print("\n".join(said))
    (FOLDER / f"{name}.txt").write_text("".join(f"{line}\n" for line in said), encoding="utf-8")
    made.savefig(FOLDER / f"{name}.png", dpi=200)
    print(f"{FOLDER / name}.png")
