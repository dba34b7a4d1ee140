"""Error over the distance between two sampling users: the paper's figure 8.

`python -m experiments.paper.distance [--full] [--seed N] [--scheduler ADDRESS]`: users 3 to 6 m apart, boxes 1.6 m
wide, heights 1.2 to 1.8 m, 100 samples of 3000 (see experiments/paper/boxes.py); at the paper's size 10 repeats of 100
random transforms. A one-way analysis of variance of the repeats' log RMSE, and Welch's t-tests between distances,
corrected by Bonferroni.
"""

from __future__ import annotations

from time import perf_counter

import numpy as np

from experiments.common.statistics import claim, one_way, pairs_told
from experiments.common.study import Interval, figure, options_of, points, results_of, save
from experiments.paper.boxes import METHODS, Boxes, Errors, Task, beside_baseline, by_cell, errors, intervals, rows_of

APART_M = (3.0, 4.0, 5.0, 6.0)
SIDE_M, LOW_M, HIGH_M, SAMPLES = 1.6, 1.2, 1.8, 100
REPEATS, TRANSFORMS = 10, 100
QUICK_REPEATS, QUICK_TRANSFORMS = 5, 50
PAPER_TRANSLATION_M, PAPER_ROTATION_RAD = 0.25, 0.23
"""At all distances;"""
PAPER_FAR_M, PAPER_FAR_RAD = 0.15, 0.13
"""and about this at 4 m and more."""
ASIDE_M = 0.03
"""By which the methods are drawn beside each other."""


def main() -> None:
    """Table, figure, tests."""
    options, began = options_of(__doc__), perf_counter()
    repeats, transforms = (REPEATS, TRANSFORMS) if options.full else (QUICK_REPEATS, QUICK_TRANSFORMS)
    cells = [Boxes(SIDE_M, LOW_M, HIGH_M, apart) for apart in APART_M]
    tasks = [Task(cell, SAMPLES, n, transforms, options.seed) for cell in cells for n in range(repeats)]
    found = results_of(errors, tasks, options)
    made, axes = figure(columns=2)
    for ax, measure, label, bound in (
        (axes[0, 0], "place", "translation, RMSE (m)", PAPER_TRANSLATION_M),
        (axes[0, 1], "yaw", "rotation, RMSE (rad)", PAPER_ROTATION_RAD),
    ):
        for method, aside in (("pairwise", -ASIDE_M), ("rigid", ASIDE_M)):
            points(ax, np.array(APART_M) + aside, intervals(found, repeats, method, measure), method)
        ax.axhline(bound, color="grey", linestyle=":", linewidth=1.0, label="the paper's bound")
        ax.set(xlabel="distance between the users (m)", ylabel=label)
        ax.set_ylim(bottom=0.0)
    axes[0, 1].legend(loc="center right")
    save("distance", rows_of(cells, found, repeats), made, options, began, said(found, repeats))


def said(found: list[dict[str, Errors]], repeats: int) -> list[str]:
    """What the tests say, and the paper's claims."""
    lines = []
    for method in METHODS:
        for measure in ("place", "origin", "yaw"):
            logs = np.log(by_cell(found, repeats, method, measure))
            lines.append(f"{method}, {measure}: {one_way(logs)}")
            lines.append(f"    {pairs_told(logs, APART_M)}")
        place, origin, yaw = (intervals(found, repeats, method, measure) for measure in ("place", "origin", "yaw"))
        lines += [
            claim(f"{method}, translation at the partner", max(place), PAPER_TRANSLATION_M, "m"),
            claim(f"{method}, translation at the origin", max(origin), PAPER_TRANSLATION_M, "m"),
            claim(f"{method}, rotation", max(yaw), PAPER_ROTATION_RAD, "rad"),
            f"{method}, from 4 m on: translation at the partner {_span(place)} m, the paper about {PAPER_FAR_M} m",
            f"{method}, from 4 m on: rotation {_span(yaw)} rad, the paper about {PAPER_FAR_RAD} rad",
        ]
    return lines + beside_baseline(found, repeats)


def _span(of_distances: list[Interval]) -> str:
    """Of 4 m and more."""
    values = [of.value for of in of_distances[1:]]
    return f"{min(values):.3f} to {max(values):.3f}"


if __name__ == "__main__":
    main()
