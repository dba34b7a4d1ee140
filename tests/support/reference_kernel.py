"""The C++ core's arithmetic once more, plain and slow, from definitions alone: what the tests compare the core with.

A placement is the array (8,) that `UserPose` takes: F (x, y, yaw), H, X (x, y, yaw), Z. Derivatives that are not
written out come from complex steps (Squire and Trapp, SIAM Review 1998): f'(x) = Im f(x + i h) / h is exact to the last
digit, because nothing is subtracted; so what is differentiated takes complex numbers too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from synchronizar._core import Cauchy, GemanMcClure, Huber, RangeBlock, Squared
from synchronizar.arrays import Array

if TYPE_CHECKING:
    from synchronizar._core import Loss

Numbers = NDArray[Any]  # real or complex

STEP = 1e-30
QUARTER_TURN = np.array([[0.0, -1.0], [1.0, 0.0]])


class Measured(NamedTuple):
    """What a RangeBlock is made of."""

    o_i: Array
    o_j: Array
    distance: Array
    sigma: Array
    nlos_odds: Array

    def block(self) -> RangeBlock:
        return RangeBlock(*self)


# ---- geometry ----


def rotation(yaw: Any) -> Numbers:
    return np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])


def compose(a: Numbers, b: Numbers) -> Numbers:
    """The product of two poses (x, y, yaw)."""
    return np.array([*(a[:2] + rotation(a[2]) @ b[:2]), a[2] + b[2]])


def exponential(v: Numbers) -> Numbers:
    """The pose (x, y, yaw) of the twist (vx, vy, w): Exp of SE(2)."""
    w = v[2]
    if w == 0.0:
        return v
    a, b = np.sin(w) / w, 2.0 * np.sin(0.5 * w) ** 2 / w
    return np.array([a * v[0] - b * v[1], b * v[0] + a * v[1], w])


def perturbed(placement: Array, delta: Numbers) -> Numbers:
    """The placement after gtsam's retraction: F Exp(delta_F), H + delta_H, X Exp(delta_X), Z + delta_Z."""
    frame = compose(placement[:3], exponential(delta[:3]))
    keyframe_poses = compose(placement[4:7], exponential(delta[4:7]))
    return np.array([*frame, placement[3] + delta[3], *keyframe_poses, placement[7] + delta[7]])


def antenna(placement: Numbers, o: Array) -> Numbers:
    """Where the antenna lies in the common frame."""
    in_user = placement[4:6] + rotation(placement[6]) @ o[:2]
    in_common = placement[:2] + rotation(placement[2]) @ in_user
    return np.array([*in_common, placement[3] + placement[7] + o[2]])


def distance(i: Numbers, o_i: Array, j: Numbers, o_j: Array) -> Any:
    return np.sqrt(((antenna(i, o_i) - antenna(j, o_j)) ** 2).sum())


def antenna_jacobian(placement: Array, o: Array) -> Array:
    """(3, 8): how the antenna moves with the user's eight variables."""
    in_user = placement[4:6] + rotation(placement[6]) @ o[:2]
    to_common = rotation(placement[2])
    out = np.zeros((3, 8))
    out[:2, 0:2] = to_common
    out[:2, 2] = to_common @ QUARTER_TURN @ in_user
    out[2, 3] = 1.0
    out[:2, 4:6] = to_common @ rotation(placement[6])
    out[:2, 6] = to_common @ rotation(placement[6]) @ QUARTER_TURN @ o[:2]
    out[2, 7] = 1.0
    return out


def row(i: Array, o_i: Array, j: Array, o_j: Array) -> Array:
    """(16,): the derivative of the distance, by the chain rule; zero where the antennas coincide."""
    between = antenna(i, o_i) - antenna(j, o_j)
    length = np.linalg.norm(between)
    direction = between / length if length > 0.0 else np.zeros(3)
    return np.concatenate([direction @ antenna_jacobian(i, o_i), -direction @ antenna_jacobian(j, o_j)])


# ---- losses ----


def rho_around(loss: Loss, e: float, sigma: float, nlos_odds: float) -> Callable[[Any], Any]:
    """The smooth function that the loss is on e's side of whatever seam it has."""
    if isinstance(loss, Squared):
        return lambda x: x * x / 2.0
    if isinstance(loss, Huber):
        k, side = loss.k, np.sign(e)
        return (lambda x: x * x / 2.0) if abs(e) <= k else (lambda x: k * (side * x - k / 2.0))
    if isinstance(loss, Cauchy):
        return lambda x: loss.k**2 / 2.0 * np.log(1.0 + (x / loss.k) ** 2)
    if isinstance(loss, GemanMcClure):
        return lambda x: x * x / 2.0 / (1.0 + (x / loss.k) ** 2)
    odds = nlos_odds if e < 0.0 else loss.early_odds
    at_zero = mixture(0.0, sigma, odds, loss.scale)
    return lambda x: -np.log(mixture(x, sigma, odds, loss.scale) / at_zero)


def mixture(e: Any, sigma: float, odds: float, scale: float) -> Any:
    """The density (1/m, times 1 + odds) of an honest range, or of a stray one with the given odds."""
    return honest_density(e, sigma) + odds * stray_density(e, sigma, scale)


def honest_density(e: Any, sigma: Any) -> Any:
    """A normal distribution's density (1/m)."""
    return np.exp(-e * e / 2.0) / (np.sqrt(2.0 * np.pi) * sigma)


def stray_density(e: Any, sigma: Any, scale: float) -> Any:
    """A half Cauchy's density (1/m) of the length that a stray range is off by."""
    return 2.0 / (np.pi * scale * (1.0 + (e * sigma / scale) ** 2))


def loss_value(loss: Loss, e: float, sigma: float, nlos_odds: float, annealing: float = 1.0) -> Array:
    """(rho, weight, curvature) of mu^2 rho(e / mu), the last two by numerical derivatives."""
    around = rho_around(loss, e / annealing, sigma, nlos_odds)

    def rho(x: Any) -> Any:
        return annealing**2 * around(x / annealing)

    def slope(x: float) -> float:
        return float(np.imag(rho(x + 1j * STEP)) / STEP)

    h = 1e-3
    curvature = (slope(e - 2 * h) - 8 * slope(e - h) + 8 * slope(e + h) - slope(e + 2 * h)) / (12 * h)
    return np.array([np.real(rho(e + 0j)), slope(e) / e if e != 0.0 else curvature, curvature])


# ---- blocks ----


def residuals(i: Array, j: Array, ranges: Measured) -> Array:
    return np.array(
        [
            np.real(distance(i, o_i, j, o_j)) - d
            for o_i, o_j, d in zip(ranges.o_i, ranges.o_j, ranges.distance, strict=True)
        ]
    )


def losses(i: Array, j: Array, ranges: Measured, loss: Loss, annealing: float = 1.0) -> Array:
    """(n, 3): rho, weight and curvature of every range."""
    e = residuals(i, j, ranges) / ranges.sigma
    return np.array(
        [loss_value(loss, *of_range, annealing) for of_range in zip(e, ranges.sigma, ranges.nlos_odds, strict=True)]
    )


def cost(i: Array, j: Array, ranges: Measured, loss: Loss, annealing: float = 1.0) -> float:
    return float(losses(i, j, ranges, loss, annealing)[:, 0].sum())


def rows(i: Array, j: Array, ranges: Measured) -> Array:
    """(n, 16)."""
    return np.array([row(i, o_i, j, o_j) for o_i, o_j in zip(ranges.o_i, ranges.o_j, strict=True)])


def gradient(i: Array, j: Array, ranges: Measured, loss: Loss, annealing: float = 1.0) -> Array:
    """(16,): of the cost."""
    e = residuals(i, j, ranges) / ranges.sigma
    weight = losses(i, j, ranges, loss, annealing)[:, 1]
    return np.asarray(rows(i, j, ranges).T @ (weight * e / ranges.sigma))


def height_curvature(i: Array, j: Array, ranges: Measured, loss: Loss, annealing: float = 1.0) -> float:
    """The sum over ranges of rho' (1 - e_z^2) / (sigma d): what their own bending adds to a height's information."""
    e = residuals(i, j, ranges) / ranges.sigma
    slope = losses(i, j, ranges, loss, annealing)[:, 1] * e
    total = 0.0
    for n in range(len(e)):
        between = antenna(i, ranges.o_i[n]) - antenna(j, ranges.o_j[n])
        length = np.linalg.norm(between)
        if length > 0.0:
            total += slope[n] / ranges.sigma[n] * (1.0 - (between[2] / length) ** 2) / length
    return float(total)


def information(i: Array, j: Array, ranges: Measured, loss: Loss, annealing: float = 1.0) -> Array:
    """(16, 16): the Hessian of the cost but for what could make it indefinite, as range_block.h documents it."""
    _, weight, curvature = losses(i, j, ranges, loss, annealing).T
    kept = np.maximum(curvature, 0.1 * weight) / ranges.sigma**2
    J = rows(i, j, ranges)
    up = np.zeros(16)
    up[[3, 7]], up[[11, 15]] = 1.0, -1.0
    curvature_up = max(height_curvature(i, j, ranges, loss, annealing), 0.0)
    return np.asarray(J.T @ (kept[:, None] * J) + curvature_up * np.outer(up, up))
