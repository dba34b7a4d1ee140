"""Two devices' frames from the distances between them, as SynchronizAR finds them (Huo et al., UIST 2018): a baseline.

Of all rotations R and translations T those with the least sum of w_i (d_i - |x_i - R y_i - T|)^2 (equation 1), reduced
to what devices need that both know which way is up (equation 2): R turns about the vertical alone, heights of all
samples are replaced by their averages, and the frames' origins differ in height by 0.1 m at most. It is solved by
sequential quadratic programming: scipy's SLSQP stands in for MATLAB's. The paper does not say where that starts; here
it starts from the best few of a grid of headings, bearings and distances, and the best end counts.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.errors import InputError
from synchronizar.geometry import YawFrame, rotation_2d, wrap_angle

LARGEST_HEIGHT = 0.1
"""m: how far origins may differ in height."""
LEAST_REDUCED = 4
"""Samples: as many as there are unknowns."""
_GRID = 16  # headings, and bearings, of the reduced problem
_PARTS = (0.3, 0.6, 1.0)  # of the mean distance, at which both walks' middles may lie: people walk about each other
_STARTS = 8  # that are followed, at most
_PRECISION = 1e-10
_ITERATIONS = 200
_TOUCHING = 1e-9  # m: closer than that a distance has no direction


class Reduced(NamedTuple):
    """A solution of equation 2."""

    x_from_y: YawFrame
    cost: float
    """m^2: the weighted mean square of what is left of the distances, heights being their averages."""


def solve_reduced(x: Array, y: Array, distance: Array, weight: Array | None = None) -> Reduced:
    """Equation 2: a heading and a translation.

    `x`, `y` (n, 3) m in their own frames, z up; `distance` (n,) m, `weight` (n,). ValueError for fewer than 4 samples,
    InputError where scipy is not installed.
    """
    w = _weights(distance, weight, LEAST_REDUCED)
    _require_scipy()
    heights = float(x[:, 2].mean() - y[:, 2].mean())

    def cost(parameters: Array) -> tuple[float, Array]:
        yaw, t = parameters[0], parameters[1:]
        turned = y[:, :2] @ rotation_2d(float(yaw)).T
        away = np.column_stack([x[:, :2] - turned - t[:2], np.full(len(x), heights - t[2])])
        length = np.maximum(np.linalg.norm(away, axis=1), _TOUCHING)
        error = length - distance
        pull = (2.0 * w * error / length)[:, None] * away
        by_yaw = (pull[:, 0] * turned[:, 1] - pull[:, 1] * turned[:, 0]).sum()
        return float(w @ error**2), np.concatenate([[by_yaw], -pull.sum(axis=0)])

    starts = [np.append(yaw, [*along[:2], 0.0]) for yaw, along in _starts(x, y, distance, w)]
    bounds = [(None, None)] * 3 + [(-LARGEST_HEIGHT, LARGEST_HEIGHT)]
    found, least = _least(cost, starts, jac=True, bounds=bounds)
    yaw, tx, ty, tz = found.tolist()
    return Reduced(YawFrame(tx, ty, tz, wrap_angle(yaw)), least)


def _weights(distance: Array, weight: Array | None, least: int) -> Array:
    """(n,) that sum up to 1."""
    if len(distance) < least:
        raise ValueError(f"{len(distance)} samples, where {least} are needed")
    w = np.ones(len(distance)) if weight is None else weight
    return np.asarray(w / w.sum())


def _starts(x: Array, y: Array, distance: Array, weight: Array) -> list[tuple[float, Array]]:
    """Heading (rad) and translation (3,) of the lowest valleys of a grid of headings, bearings and distances."""
    from_x, from_y, far = weight @ x, weight @ y, float(weight @ distance)
    angle = np.arange(_GRID) * (2.0 * np.pi / _GRID)
    part, yaw, bearing = (a.ravel() for a in np.meshgrid(_PARTS, angle, angle, indexing="ij"))
    c, s = np.cos(yaw), np.sin(yaw)
    turned = np.stack([c * from_y[0] - s * from_y[1], s * from_y[0] + c * from_y[1]], axis=1)
    along = from_x[:2] + (part * far)[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1) - turned
    ax = x[None, :, 0] - (c[:, None] * y[:, 0] - s[:, None] * y[:, 1]) - along[:, :1]
    ay = x[None, :, 1] - (s[:, None] * y[:, 0] + c[:, None] * y[:, 1]) - along[:, 1:]
    length = np.sqrt(ax**2 + ay**2 + (from_x[2] - from_y[2]) ** 2)
    cost = ((length - distance) ** 2 @ weight).reshape(len(_PARTS), _GRID, _GRID)
    around = [np.roll(cost, (a, b), axis=(1, 2)) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]
    valleys = np.flatnonzero((cost <= np.min(around, axis=0)).ravel())
    best = valleys[np.argsort(cost.ravel()[valleys])][:_STARTS]
    return [(float(yaw[k]), np.append(along[k], 0.0)) for k in best]


def _least(cost: Callable[[Array], Any], starts: list[Array], **of_scipy: Any) -> tuple[Array, float]:
    """The best end of SLSQP from several starts."""
    from scipy.optimize import minimize

    options = {"ftol": _PRECISION, "maxiter": _ITERATIONS}
    ends = [minimize(cost, start, method="SLSQP", options=options, **of_scipy) for start in starts]
    best = min(ends, key=lambda end: float(end.fun))
    return np.asarray(best.x, dtype=float), float(best.fun)


def _require_scipy() -> None:
    if find_spec("scipy") is None:
        raise InputError("--method pairwise", "needs scipy: pip install 'synchronizar[pairwise]'")
