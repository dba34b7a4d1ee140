"""How large the space must be in which two users sample: the paper's figure 7.

`python -m experiments.sampling_space [--full] [--seed N] [--scheduler ADDRESS]`: users 6 m apart, boxes 1.4 to 2.0 m
wide, of three ranges of height, 100 samples of 3000 (see experiments/boxes.py); at the paper's size 10 choices of them
with 100 random transforms each. A two-way analysis of variance asks whether width and height matter, t-tests between
widths, corrected by Bonferroni, which differ.
"""

from __future__ import annotations

from time import perf_counter

import numpy as np

from experiments.boxes import MEASURES, METHODS, Boxes, Errors, Task, beside_baseline, by_cell, errors, rows_of
from experiments.statistics import claim, pairs_told, two_way
from experiments.study import figure, interval, options_of, points, results_of, rms, save

SIDES_M = (1.4, 1.6, 1.8, 2.0)
HEIGHTS_M = ((0.9, 1.5), (1.2, 1.8), (1.5, 2.1))
APART_M, SAMPLES = 6.0, 100
REPEATS, TRANSFORMS = 10, 100
QUICK = 4
"""Times fewer repeats and transforms."""
PAPER_TRANSLATION_M, PAPER_ROTATION_RAD = 0.2, 0.21
"""For boxes of 1.6 m and more."""
ENOUGH_M = 1.6
ASIDE_M = 0.015
"""By which the methods are drawn beside each other."""


def main() -> None:
    """Table, figure, tests."""
    options, began = options_of(__doc__), perf_counter()
    few = 1 if options.full else QUICK
    repeats, transforms = max(REPEATS // few, 3), TRANSFORMS // few
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
            of_cell = by_cell(found, repeats, method, measure).reshape(len(HEIGHTS_M), len(SIDES_M), repeats)
            for ax, of_height in zip(row, of_cell, strict=True):
                points(ax, np.array(SIDES_M) + aside, [interval(of, rms) for of in of_height], method)
        for ax in row:
            ax.axhline(bound, color="grey", linestyle=":", linewidth=1.0, label="the paper's, from 1.6 m on")
            ax.set(ylim=(0.0, 1.1 * bound))
        row[0].set_ylabel(label)
    for ax, (low, high) in zip(axes[0], HEIGHTS_M, strict=True):
        ax.set_title(f"heights {low} to {high} m")
    for ax in axes[1]:
        ax.set_xlabel("width of the box (m)")
    axes[1, 2].legend(loc="center right")
    save("sampling_space", rows, made, options, began)
    print("\n".join(said(found, repeats)))


def said(found: list[dict[str, Errors]], repeats: int) -> list[str]:
    """What the tests say, and the paper's claims."""
    lines = []
    wide = np.tile(np.array(SIDES_M) >= ENOUGH_M, len(HEIGHTS_M))
    for method in METHODS:
        for measure in ("place", "origin", "yaw"):
            of_cell = by_cell(found, repeats, method, measure).reshape(len(HEIGHTS_M), len(SIDES_M), repeats)
            lines.append(f"{method}, {measure}: {two_way(of_cell, 'height', 'width')}")
            lines.append(f"    {pairs_told(of_cell.transpose(1, 0, 2).reshape(len(SIDES_M), -1), SIDES_M)}")
        of_wide = {m: max(rms(cell) for cell in by_cell(found, repeats, method, m)[wide]) for m in MEASURES}
        where = f"for {ENOUGH_M} m and more"
        lines += [
            claim(f"{method}, translation at the partner {where}", of_wide["place"], PAPER_TRANSLATION_M, "m"),
            claim(f"{method}, translation at the origin {where}", of_wide["origin"], PAPER_TRANSLATION_M, "m"),
            claim(f"{method}, rotation {where}", of_wide["yaw"], PAPER_ROTATION_RAD, "rad"),
        ]
    return lines + beside_baseline(found, repeats)


if __name__ == "__main__":
    main()
