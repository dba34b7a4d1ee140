"""Error over the size of the space in which two users sample: the paper's figure 7.

`python -m experiments.paper.sampling_space [--full] [--seed N] [--scheduler ADDRESS]`: users 6 m apart, boxes 1.4 to
2.0 m wide, of three ranges of height, 100 samples of 3000 (see experiments/paper/boxes.py); at the paper's size 10
repeats of 100 random transforms. A two-way analysis of variance of the repeats' log RMSE asks whether width and height
matter, Welch's t-tests between widths, corrected by Bonferroni, which differ. Both users share a range of height and
only differences of height enter a distance, so height has no effect by construction; nor should it in the paper.
"""

from __future__ import annotations

from time import perf_counter

import numpy as np

from experiments.common.statistics import SIGNIFICANT, claim, corrected, pairs_told, two_way
from experiments.common.study import figure, options_of, points, results_of, save
from experiments.paper.boxes import METHODS, Boxes, Errors, Task, beside_baseline, by_cell, errors, intervals, rows_of

SIDES_M = (1.4, 1.6, 1.8, 2.0)
HEIGHTS_M = ((0.9, 1.5), (1.2, 1.8), (1.5, 2.1))
APART_M, SAMPLES = 6.0, 100
REPEATS, TRANSFORMS = 10, 100
QUICK_REPEATS, QUICK_TRANSFORMS = 4, 20
PAPER_TRANSLATION_M, PAPER_ROTATION_RAD = 0.2, 0.21
"""For boxes of 1.6 m and more."""
ENOUGH_M = 1.6
ASIDE_M = 0.015
"""By which the methods are drawn beside each other."""


def main() -> None:
    """Table, figure, tests."""
    options, began = options_of(__doc__), perf_counter()
    repeats, transforms = (REPEATS, TRANSFORMS) if options.full else (QUICK_REPEATS, QUICK_TRANSFORMS)
    cells = [Boxes(side, low, high, APART_M) for low, high in HEIGHTS_M for side in SIDES_M]
    tasks = [Task(cell, SAMPLES, n, transforms, options.seed) for cell in cells for n in range(repeats)]
    found = results_of(errors, tasks, options)
    rows = rows_of(cells, found, repeats)
    made, axes = figure(columns=len(HEIGHTS_M), rows=2)
    for row, measure, label, bound in (
        (axes[0], "place", "translation, RMSE (m)", PAPER_TRANSLATION_M),
        (axes[1], "yaw", "rotation, RMSE (rad)", PAPER_ROTATION_RAD),
    ):
        for method, aside in (("pairwise", -ASIDE_M), ("rigid", ASIDE_M)):
            of_cells = intervals(found, repeats, method, measure)
            for n, ax in enumerate(row):
                points(ax, np.array(SIDES_M) + aside, of_cells[n * len(SIDES_M) : (n + 1) * len(SIDES_M)], method)
        for ax in row:
            ax.axhline(bound, color="grey", linestyle=":", linewidth=1.0, label="the paper's, from 1.6 m on")
            ax.set_ylim(bottom=0.0)
        row[0].set_ylabel(label)
    for ax, (low, high) in zip(axes[0], HEIGHTS_M, strict=True):
        ax.set_title(f"heights {low} to {high} m")
    for ax in axes[1]:
        ax.set_xlabel("width of the box (m)")
    axes[1, 2].legend(loc="center right")
    save("sampling_space", rows, made, options, began, said(found, repeats))


def said(found: list[dict[str, Errors]], repeats: int) -> list[str]:
    """What the tests say, and the paper's claims."""
    lines = []
    where = f"for {ENOUGH_M} m and more"
    for method in METHODS:
        for measure in ("place", "origin", "yaw"):
            shape = len(HEIGHTS_M), len(SIDES_M), repeats
            logs = np.log(by_cell(found, repeats, method, measure)).reshape(shape)
            by_width = logs.transpose(1, 0, 2).reshape(len(SIDES_M), -1)
            lines.append(f"{method}, {measure}: {two_way(logs, 'height', 'width')}")
            lines.append(f"    {pairs_told(by_width, SIDES_M)}")
            least = max(p for (a, _), p in corrected(by_width).items() if a == 0)
            apart = "reproduced" if least < SIGNIFICANT else "NOT reproduced"
            lines.append(f"{method}, {measure}: {SIDES_M[0]} m differs from the rest: {apart} (p at most {least:.2g})")
        worst = {
            measure: max(
                (of for n, of in enumerate(intervals(found, repeats, method, measure)) if n % len(SIDES_M)),
                key=lambda of: of.value,
            )
            for measure in ("place", "origin", "yaw")
        }
        lines += [
            claim(f"{method}, translation at the partner {where}", worst["place"], PAPER_TRANSLATION_M, "m"),
            claim(f"{method}, translation at the origin {where}", worst["origin"], PAPER_TRANSLATION_M, "m"),
            claim(f"{method}, rotation {where}", worst["yaw"], PAPER_ROTATION_RAD, "rad"),
        ]
    return lines + beside_baseline(found, repeats)


if __name__ == "__main__":
    main()
