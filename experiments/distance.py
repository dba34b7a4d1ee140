"""How far apart two users may be while they sample: the paper's figure 8.

`python -m experiments.distance [--full] [--seed N] [--scheduler ADDRESS]`: users 3 to 6 m apart, boxes 1.6 m wide,
heights 1.2 to 1.8 m, 100 samples of 3000 (see experiments/boxes.py); at the paper's size 10 choices of them with 100
random transforms each. A one-way analysis of variance, and t-tests between distances, corrected by Bonferroni.
"""

from __future__ import annotations

from time import perf_counter

import numpy as np

from experiments.boxes import MEASURES, METHODS, Boxes, Errors, Task, beside_baseline, by_cell, errors, rows_of
from experiments.statistics import claim, one_way, pairs_told
from experiments.study import figure, interval, options_of, points, results_of, rms, save

APART_M = (3.0, 4.0, 5.0, 6.0)
SIDE_M, LOW_M, HIGH_M, SAMPLES = 1.6, 1.2, 1.8, 100
REPEATS, TRANSFORMS = 10, 100
QUICK = 2
"""Times fewer repeats and transforms."""
PAPER_TRANSLATION_M, PAPER_ROTATION_RAD = 0.25, 0.23
"""At all distances;"""
PAPER_FAR_M, PAPER_FAR_RAD = 0.15, 0.13
"""and about this at 4 m and more."""
ASIDE_M = 0.03
"""By which the methods are drawn beside each other."""


def main() -> None:
    """Table, figure, tests."""
    options, began = options_of(__doc__), perf_counter()
    few = 1 if options.full else QUICK
    repeats, transforms = REPEATS // few, TRANSFORMS // few
    cells = [Boxes(SIDE_M, LOW_M, HIGH_M, apart) for apart in APART_M]
    tasks = [Task(cell, SAMPLES, n, transforms, options.seed) for cell in cells for n in range(repeats)]
    found = results_of(errors, tasks, options)
    made, axes = figure(columns=2)
    for ax, measure, label, bound in (
        (axes[0, 0], "place", "translation, RMSE (m)", PAPER_TRANSLATION_M),
        (axes[0, 1], "yaw", "rotation, RMSE (rad)", PAPER_ROTATION_RAD),
    ):
        for method, aside in (("pairwise", -ASIDE_M), ("rigid", ASIDE_M)):
            of = by_cell(found, repeats, method, measure)
            points(ax, np.array(APART_M) + aside, [interval(of_cell, rms) for of_cell in of], method)
        ax.axhline(bound, color="grey", linestyle=":", linewidth=1.0, label="the paper's bound")
        ax.set(xlabel="distance between the users (m)", ylabel=label, ylim=(0.0, 1.1 * bound))
    axes[0, 1].legend(loc="center right")
    save("distance", rows_of(cells, found, repeats), made, options, began)
    print("\n".join(said(found, repeats)))


def said(found: list[dict[str, Errors]], repeats: int) -> list[str]:
    """What the tests say, and the paper's claims."""
    lines = []
    far = np.array(APART_M) >= 4.0
    for method in METHODS:
        of = {measure: by_cell(found, repeats, method, measure) for measure in MEASURES}
        for measure in ("place", "origin", "yaw"):
            lines.append(f"{method}, {measure}: {one_way(of[measure])}")
            lines.append(f"    {pairs_told(of[measure], APART_M)}")
        worst = {measure: max(rms(cell) for cell in of[measure]) for measure in MEASURES}
        beyond = {measure: max(rms(cell) for cell in of[measure][far]) for measure in MEASURES}
        lines += [
            claim(f"{method}, translation at the partner", worst["place"], PAPER_TRANSLATION_M, "m"),
            claim(f"{method}, translation at the origin", worst["origin"], PAPER_TRANSLATION_M, "m"),
            claim(f"{method}, rotation", worst["yaw"], PAPER_ROTATION_RAD, "rad"),
            claim(f"{method}, translation at the partner from 4 m on", beyond["place"], PAPER_FAR_M, "m"),
            claim(f"{method}, rotation from 4 m on", beyond["yaw"], PAPER_FAR_RAD, "rad"),
        ]
    return lines + beside_baseline(found, repeats)


if __name__ == "__main__":
    main()
