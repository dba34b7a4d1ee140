"""Simulates two users who each sample a box of the room, as for the paper's figures 7 and 8.

Each user is at 3000 places, drawn evenly in its box, with distances between them (0.1 m of noise, the paper's own
figure for its radios). For each of some transforms some of these are chosen at random, the partner's places are put
into a frame of its own by the transform, and the transform is asked for; each repeat has places and noise of its own.
(How the paper's 10 repeats, 100 transforms and 3000 samples go together is our reading.) A random choice has no path:
SLAM is trusted by both methods, and ours is the rigid model. What the paper calls the error of a translation is that of
the frame's origin, which may be more than ten metres from where the partner walks, so it carries the heading's error on
a long arm, or else that of the place where the partner is; it does not say which. Both are told.
"""

from __future__ import annotations

from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from experiments.common.study import Interval, interval, rms
from synchronizar.arrays import Array
from synchronizar.data.ranges import Ranges
from synchronizar.data.ranging_rate import papers_rate_hz
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.estimation.pairwise.solve import solve_reduced
from synchronizar.estimation.register import register
from synchronizar.geometry import YawFrame, wrap_angle

METHODS = ("pairwise", "rigid")
MEASURES = ("origin", "place", "z", "yaw")
DRAWN = 3000
SIGMA_M = 0.1
ORIGIN_M, ORIGIN_UP_M = 10.0, 0.2
STEP_S = 1.0 / papers_rate_hz(1)
"""Between samples."""


class Boxes(NamedTuple):
    """Two boxes of the same size."""

    side: float
    """m: length and width."""
    low: float
    """m above the floor."""
    high: float
    """m."""
    apart: float
    """m, between their middles."""


class Task(NamedTuple):
    """One repeat."""

    boxes: Boxes
    samples: int
    repeat: int
    transforms: int
    seed: int


class Errors(NamedTuple):
    """Of one method, over the transforms (n,)."""

    origin: Array
    """m: of the translation, the partner's origin."""
    place: Array
    """m, in the plane: of the middle of where the partner walks."""
    z: Array
    """m."""
    yaw: Array
    """rad."""
    seconds: Array


def errors(task: Task) -> dict[str, Errors]:
    """By method."""
    cell = [round(1000 * value) for value in task.boxes]
    drawing = np.random.default_rng([task.seed, *cell, task.repeat])
    x, y = (_places(drawing, task.boxes) for _ in range(2))
    y[:, 0] += task.boxes.apart
    distance = np.linalg.norm(x - y, axis=1) + SIGMA_M * drawing.standard_normal(DRAWN)
    chosen = np.random.default_rng([task.seed, *cell, task.repeat, task.samples])
    rows: dict[str, list[tuple[float, ...]]] = {method: [] for method in METHODS}
    for _ in range(task.transforms):
        k = chosen.choice(DRAWN, task.samples, replace=False)
        to = chosen.uniform(-1.0, 1.0, 3) * [ORIGIN_M, ORIGIN_M, ORIGIN_UP_M]
        x_from_y = YawFrame(*to.tolist(), yaw=float(chosen.uniform(-np.pi, np.pi)))
        p_y = x_from_y.inverse() @ y[k]
        for method, solve in (("pairwise", _pairwise), ("rigid", _rigid)):
            began = perf_counter()
            found = solve(x[k], p_y, distance[k])
            seconds = perf_counter() - began
            off = found @ p_y.mean(axis=0) - x_from_y @ p_y.mean(axis=0)
            origin = float(np.linalg.norm(found.translation - x_from_y.translation))
            turned = wrap_angle(found.yaw - x_from_y.yaw)
            rows[method].append((origin, float(np.hypot(*off[:2])), float(off[2]), turned, seconds))
    return {method: Errors(*np.array(of_method).T) for method, of_method in rows.items()}


def by_cell(found: list[dict[str, Errors]], repeats: int, method: str, measure: str) -> Array:
    """(cells, repeats) RMSE over transforms, of results by cell and repeat."""
    return np.array([rms(getattr(of[method], measure)) for of in found]).reshape(-1, repeats)


def intervals(found: list[dict[str, Errors]], repeats: int, method: str, measure: str) -> list[Interval]:
    """RMSE of each cell, over all repeats and transforms."""
    of_cells = np.array([getattr(of[method], measure) for of in found]).reshape(len(found) // repeats, -1)
    return [interval(of_cell, rms) for of_cell in of_cells]


def rows_of(cells: list[Boxes], found: list[dict[str, Errors]], repeats: int) -> list[dict[str, Any]]:
    """A line for each cell and method: RMSE with intervals."""
    rows = []
    for n, cell in enumerate(cells):
        for method in METHODS:
            row: dict[str, Any] = {"side m": cell.side, "from m": cell.low, "to m": cell.high, "apart m": cell.apart}
            row |= {"method": method, "n": repeats * len(found[0][method].yaw)}
            for measure in MEASURES:
                told = intervals(found, repeats, method, measure)[n]
                row |= {measure: told.value, f"{measure} low": told.low, f"{measure} high": told.high}
            rows.append(row)
    return rows


def beside_baseline(found: list[dict[str, Errors]], repeats: int) -> list[str]:
    """By measure: how many times the baseline's error ours is, over the cells."""
    lines = []
    for measure in MEASURES:
        ours, theirs = (by_cell(found, repeats, method, measure) for method in ("rigid", "pairwise"))
        ratio = np.sqrt((ours**2).mean(axis=1) / (theirs**2).mean(axis=1))
        above = f"above 1 in {(ratio > 1.0).sum()} of {len(ratio)} cells"
        lines.append(f"rigid / pairwise, {measure}: {ratio.min():.3f} to {ratio.max():.3f}, {above}")
    return lines


def _places(random: np.random.Generator, boxes: Boxes) -> Array:
    half = 0.5 * boxes.side
    return random.uniform([-half, -half, boxes.low], [half, half, boxes.high], (DRAWN, 3))


def _pairwise(x: Array, y: Array, distance: Array) -> YawFrame:
    return solve_reduced(x, y, distance).x_from_y


def _rigid(x: Array, y: Array, distance: Array) -> YawFrame:
    n = len(distance)
    t, level = np.arange(n) * STEP_S, np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
    ranges = Ranges.of(t, np.zeros(n, dtype=np.int32), np.ones(n, dtype=np.int32), distance)
    recording = Recording((User("x"), User("y")), {"x": Track(t, x, level), "y": Track(t, y, level)}, ranges)
    return register(recording, "x", model="rigid").between("x", "y")
