"""Error and solving time over the number of samples.

`python -m experiments.paper.sample_count [--full] [--seed N] [--scheduler ADDRESS]`: users 6 m apart, boxes 1.6 m wide,
heights 1.2 to 1.8 m (see experiments/paper/boxes.py), 10 to 1000 samples. The paper took 100 of them, which
its solver had done within 0.15 s. Times are medians, of tasks that are done on all cores at once: compare them within
one run.
"""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter

from experiments.common.study import figure, interval, options_of, points, results_of, save
from experiments.paper.boxes import METHODS, Boxes, Task, errors, intervals, rows_of

COUNTS = (10, 20, 50, 100, 200, 500, 1000)
BOXES = Boxes(1.6, 1.2, 1.8, 6.0)
REPEATS, TRANSFORMS = 10, 100
QUICK_REPEATS, QUICK_TRANSFORMS = 3, 33
PAPER_COUNT, PAPER_SECONDS = 100, 0.15


def main() -> None:
    """Table and figure."""
    options, began = options_of(__doc__), perf_counter()
    repeats, transforms = (REPEATS, TRANSFORMS) if options.full else (QUICK_REPEATS, QUICK_TRANSFORMS)
    tasks = [Task(BOXES, count, n, transforms, options.seed) for count in COUNTS for n in range(repeats)]
    found = results_of(errors, tasks, options)
    rows: list[dict[str, Any]] = []
    made, axes = figure(columns=3)
    labels = {"place": "translation, RMSE (m)", "yaw": "rotation, RMSE (rad)", "seconds": "solver, median (ms)"}
    for ax, (measure, label) in zip(axes[0], labels.items(), strict=True):
        for method in METHODS:
            if measure == "seconds":
                taken = [
                    np.concatenate([of[method].seconds for of in _of(found, n, repeats)]) for n in range(len(COUNTS))
                ]
                told = [interval(1e3 * of, lambda values: float(np.median(values))) for of in taken]
            else:
                told = intervals(found, repeats, method, measure)
            points(ax, np.array(COUNTS), told, method)
        ax.set(xlabel="samples", ylabel=label, xscale="log", yscale="log")
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_formatter(NullFormatter())
    axes[0, 0].legend(loc="upper right")
    axes[0, 2].plot(PAPER_COUNT, 1e3 * PAPER_SECONDS, "x", color="grey")
    axes[0, 2].annotate("the paper's bound", (PAPER_COUNT, 1e3 * PAPER_SECONDS), (6, -3), textcoords="offset points")
    for n, count in enumerate(COUNTS):
        of_count = _of(found, n, repeats)
        for row in rows_of([BOXES], of_count, repeats):
            seconds = np.concatenate([of[row["method"]].seconds for of in of_count])
            wrong = np.concatenate([np.abs(of[row["method"]].yaw) > 0.5 for of in of_count])
            rows.append(
                {
                    "samples": count,
                    **row,
                    "median ms": 1e3 * float(np.median(seconds)),
                    "turned > 0.5 rad": int(wrong.sum()),
                }
            )
    said = []
    for row in rows:
        if row["samples"] == PAPER_COUNT:
            verdict = "reproduced" if row["median ms"] < 1e3 * PAPER_SECONDS else "NOT reproduced"
            taken = f"{row['median ms']:.1f} ms, the paper below {1e3 * PAPER_SECONDS:.0f}"
            said.append(f"{row['method']}, {PAPER_COUNT} samples: {taken}: {verdict}")
    save("sample_count", rows, made, options, began, said)


def _of(found: list[Any], n: int, repeats: int) -> list[Any]:
    return found[n * repeats : (n + 1) * repeats]


if __name__ == "__main__":
    main()
