"""Factors of the graph that follows people: SLAM's steps from slot to slot, priors of those who join, ranges of a slot.

Variables, per user and slot: X (Pose2) is the device's place in the common frame and how its SLAM's axes lie there, H
(double, m) the device's height, D (Vector 3) log scale, radio bias and clock offset, in CALIBRATION_UNITS. X is the
relative frame composed with SLAM's own pose of that moment, so a drift of the heading turns about the device.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from math import cos, exp, pi, sin
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import gtsam
import numpy as np

from synchronizar._core import RangeSlot
from synchronizar.arrays import Array
from synchronizar.graph import keys
from synchronizar.graph.states import CLOCK, SCALE
from synchronizar.parameters import Parameters

if TYPE_CHECKING:
    from synchronizar._core import Loss

CALIBRATION_UNITS = np.array([0.02, 0.05, 0.01])
"""Log scale, m, s: D is in these. gtsam refuses a system in which one pivot is 4096 times the next, which clocks that
drift by 0.1 ms beside heights that are known to a metre would be."""

SlotFactor: TypeAlias = gtsam.NonlinearFactor
"""Any factor of the graph that follows people."""

_STEP_DIMENSION = 4
_SCALE_UNIT = float(CALIBRATION_UNITS[SCALE])
_Error = Callable[[gtsam.CustomFactor, gtsam.Values, "list[Array] | None"], Array]


class SlamStep(NamedTuple):
    """How a device moved from one slot's begin to another's, as its SLAM has it."""

    displacement: tuple[float, float, float]
    """SLAM units, in SLAM's axes."""
    sigma: tuple[float, float, float]
    """1 sigma in x and y (m), in height (m), in yaw (rad)."""
    duration: float
    """s."""


def step_factor(user: int, begin: int, end: int, step: SlamStep, parameters: Parameters) -> gtsam.CustomFactor:
    """SLAM's step of a user between two slots, under Student's t as a robust noise model.

    With s = exp(log scale) and SLAM's displacement d the error is R(yaw)' (t_end - t_begin) - s d_xy,
    H_end - H_begin - s d_z and yaw_end - yaw_begin, over sigma. Student's t with f degrees of freedom is, as a scale
    mixture of normals, Cauchy's weight k^2 / (k^2 + e^2) with k^2 = f + 4.
    """
    dx, dy, dz = step.displacement
    plane, up, turn = (1.0 / sigma for sigma in step.sigma)
    here, there = keys.slot_pose(user, begin), keys.slot_pose(user, end)
    low, high, device = keys.slot_height(user, begin), keys.slot_height(user, end), keys.slot_calibration(user, begin)
    # What does not depend on the estimates is made once: this is called a thousand times a second.
    by_here, by_there = np.diag([-plane, -plane, 0.0])[[0, 1, 2, 2]], np.diag([plane, plane, turn])[[0, 1, 1, 2]]
    by_here[3, 2], by_there[2] = -turn, 0.0
    by_low, by_high = np.array([[0.0], [0.0], [-up], [0.0]]), np.array([[0.0], [0.0], [up], [0.0]])
    by_device = np.zeros((_STEP_DIMENSION, 3))
    by_device[:3, SCALE] = -_SCALE_UNIT * dx * plane, -_SCALE_UNIT * dy * plane, -_SCALE_UNIT * dz * up

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        a, b = values.atPose2(here), values.atPose2(there)
        scale = exp(values.atVector(device)[SCALE] * _SCALE_UNIT)
        yaw, turned = a.theta(), b.theta() - a.theta()
        turned -= 2.0 * pi * round(turned / (2.0 * pi))
        c, s = cos(yaw), sin(yaw)
        east, north = b.x() - a.x(), b.y() - a.y()
        x, y = c * east + s * north, c * north - s * east
        rise = values.atDouble(high) - values.atDouble(low)
        if jacobians is not None:
            by_pose = by_here.copy()
            by_pose[0, 2], by_pose[1, 2] = y * plane, -x * plane
            jacobians[0], jacobians[1], jacobians[2], jacobians[4] = by_pose, by_low, scale * by_device, by_high
            by_pose = by_there.copy()
            ct, st = cos(turned) * plane, sin(turned) * plane
            by_pose[0, 0], by_pose[0, 1], by_pose[1, 0], by_pose[1, 1] = ct, -st, st, ct
            jacobians[3] = by_pose
        return np.array([(x - scale * dx) * plane, (y - scale * dy) * plane, (rise - scale * dz) * up, turned * turn])

    return gtsam.CustomFactor(_student(parameters.slam.drift_dof), [here, low, device, there, high], error)


def _student(dof: float) -> gtsam.noiseModel.Base:
    width = gtsam.noiseModel.mEstimator.Cauchy.Create(float(np.sqrt(dof + _STEP_DIMENSION)))
    return gtsam.noiseModel.Robust.Create(width, gtsam.noiseModel.Unit.Create(_STEP_DIMENSION))


def calibration_walk_factor(
    user: int, begin: int, end: int, duration: float, parameters: Parameters
) -> gtsam.BetweenFactorVector:
    """How scale, bias and clock of a device may change between two slots that are `duration` s apart."""
    devices = parameters.devices
    walk = np.array([devices.scale_walk, devices.bias_walk, devices.clock_walk]) * np.sqrt(duration)
    noise = gtsam.noiseModel.Diagonal.Sigmas(walk / CALIBRATION_UNITS)
    here, there = keys.slot_calibration(user, begin), keys.slot_calibration(user, end)
    return gtsam.BetweenFactorVector(here, there, np.zeros(3), noise)


class Joining(NamedTuple):
    """A user as the prior of those who join knows it."""

    user: int
    slot: int
    """Where its variables begin."""
    height: float
    """SLAM units: of the device in its own SLAM frame then."""
    assumed_clock: float
    """s: what its clock variable counts from."""
    height_sigma: float
    """m, 1 sigma of its origin about the mean level of all."""
    calibration_sigma: Array
    """(3,) 1 sigma of its log scale, bias (m) and clock (s) about what all devices share."""


def joining_prior(new: Sequence[Joining], known: Sequence[Joining], shared_sigma: Array) -> gtsam.CustomFactor:
    """Prior of the heights of origins and of the calibrations of users who join, given those who are there already.

    An origin lies at h = H - exp(log scale) z about the level L of all; a device's calibration deviates from what all
    share, K, which has 1 sigma `shared_sigma` (3,) about 0. L and K are marginalised out: with precisions p of those
    who join, and L or K known from the others with precision P as m, the rows are sqrt(p) (h - M) and sqrt(P) (m - M),
    where M is the mean of all.
    """
    everybody = [*new, *known]
    weight = np.array([[u.height_sigma**-2, *(u.calibration_sigma**-2)] for u in everybody])
    joins = np.arange(len(everybody)) < len(new)
    before = (weight[~joins]).sum(axis=0) + np.array([0.0, *(shared_sigma**-2)])
    total = weight[joins].sum(axis=0) + before
    # Rows: of each who joins, and of what is known before; columns: of everybody.
    to_known = np.where(joins[:, None], 0.0, np.divide(weight, before, out=np.zeros_like(weight), where=before > 0.0))
    to_mean = weight / total
    root = np.empty((4, len(new) + 1, len(everybody)))
    for c in range(4):
        root[c, :-1] = np.sqrt(weight[joins, c])[:, None] * (np.eye(len(everybody))[joins] - to_mean[:, c])
        root[c, -1] = np.sqrt(before[c]) * (to_known[:, c] - to_mean[:, c])
    z, clock = np.array([u.height for u in everybody]), np.array([u.assumed_clock for u in everybody])
    heights = [keys.slot_height(u.user, u.slot) for u in everybody]
    calibrations = [keys.slot_calibration(u.user, u.slot) for u in everybody]
    rows = 4 * (len(new) + 1)

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        devices = np.array([values.atVector(key) for key in calibrations]) * CALIBRATION_UNITS
        scale = np.exp(devices[:, SCALE])
        level = np.array([values.atDouble(key) for key in heights]) - scale * z
        devices[:, CLOCK] += clock
        if jacobians is not None:
            for n in range(len(everybody)):
                by_height, by_device = np.zeros((rows, 1)), np.zeros((rows, 3))
                size = len(new) + 1
                by_height[:size, 0] = root[0, :, n]
                by_device[:size, SCALE] = -root[0, :, n] * scale[n] * z[n]
                for c in range(3):
                    by_device[(c + 1) * size : (c + 2) * size, c] = root[c + 1, :, n]
                jacobians[2 * n], jacobians[2 * n + 1] = by_height, by_device * CALIBRATION_UNITS
        return np.concatenate([root[0] @ level, *(root[c + 1] @ devices[:, c] for c in range(3))])

    names = [key for pair in zip(heights, calibrations, strict=True) for key in pair]
    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(rows), names, error)


def place_prior(
    user: int, slot: int, pose: tuple[float, float, float], sigma: tuple[float, float, float]
) -> gtsam.PriorFactorPose2:
    """A user's place (m) and heading (rad) at a slot, each with 1 sigma."""
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array(sigma))
    return gtsam.PriorFactorPose2(keys.slot_pose(user, slot), gtsam.Pose2(*pose), noise)


def height_prior(user: int, slot: int, height: float, sigma: float) -> gtsam.PriorFactorDouble:
    """A user's height (m) at a slot, with 1 sigma."""
    return gtsam.PriorFactorDouble(keys.slot_height(user, slot), height, gtsam.noiseModel.Isotropic.Sigma(1, sigma))


@lru_cache
def _columns_of(users: int) -> tuple[list[slice], Array]:
    """Where X, H and D of each user stand among the columns of ranges, and the units of these and of the residual."""
    widths = [slice(7 * n + a, 7 * n + b) for n in range(users) for a, b in ((0, 3), (3, 4), (4, 7))]
    return widths, np.append(np.tile(np.concatenate([np.ones(4), CALIBRATION_UNITS]), users), 1.0)


def ranges_factor(
    slot: int, users: Sequence[int], ranges: RangeSlot, loss: Loss, curvature: Array | None = None
) -> gtsam.CustomFactor:
    """All ranges of a slot, between any of `users`, which are those of `ranges`, in its order.

    As `RangeSlotFactor`, for users who all have the same three variables. `curvature` (1/m^2), one a pair, is that of
    `RangeSlot.square_root`.
    """
    of_each = [(keys.slot_pose(u, slot), keys.slot_height(u, slot), keys.slot_calibration(u, slot)) for u in users]
    widths, units = _columns_of(len(users))
    shape = len(users), 7

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        numbers: list[float] = []
        for pose, height, device in of_each:
            at = values.atPose2(pose)
            numbers += (at.x(), at.y(), at.theta(), values.atDouble(height), *values.atVector(device).tolist())
        states = np.array(numbers).reshape(shape)
        devices = states[:, 4:] * CALIBRATION_UNITS
        if jacobians is None:
            poses = np.zeros((len(users), 8))
            poses[:, :4] = states[:, :4]
            return np.array([np.sqrt(2.0 * ranges.cost(poses, devices, loss))])
        root = ranges.square_root_frames(states[:, :4], devices, loss, 1.0, curvature)
        root *= units
        for n, width in enumerate(widths):
            jacobians[n] = root[:, width]
        return root[:, -1]

    of_all = [key for of_one in of_each for key in of_one]
    factor: gtsam.CustomFactor = gtsam.CustomFactor(None, of_all, error)  # type: ignore[call-overload]  # may be missing
    return factor
