"""Marginal prior of a window: the Gaussian that replaces all earlier ranges and keyframes.

The next window's graph is anchored at each user's last keyframe, relative to the reference's, so the prior holds
frames and calibrations, and no keyframe pose. A window that is solved again starts from an older prior and the same
ranges: its frames, scales and biases are linearised again, and none stays at its value of the time when a keyframe was
marginalised.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import gtsam
import numpy as np

from synchronizar.arrays import Array
from synchronizar.geometry import relative_to, rotation_2d, wrap_angle
from synchronizar.graph import keys
from synchronizar.graph.states import CLOCK

Error = Callable[[gtsam.CustomFactor, gtsam.Values, "list[Array] | None"], Array]

_LEAST = 1e-12  # of the largest eigenvalue: smaller ones are raised to it, which keeps the square root finite


class MarginalPrior(NamedTuple):
    """A Gaussian over the frames and calibrations of some of k users."""

    users: list[int]
    """Users that it holds, the reference among them."""
    reference: int
    frames: Array
    """(k, 4) x, y, z (m), yaw (rad): mean of each anchor relative to the reference's; NaN for other users."""
    calibration: Array
    """(k, 3) mean log scale, bias (m), clock offset (s)."""
    covariance: Array
    """(n, n) of additive errors in x, y, yaw, height of each user but the reference, then in every calibration."""

    @property
    def free(self) -> list[int]:
        """Users whose frames it holds: all but the reference."""
        return [u for u in self.users if u != self.reference]

    def keys(self) -> list[int]:
        """The gtsam keys of its variables, in the order of the covariance."""
        frames = [key for u in self.free for key in (keys.frame(u), keys.height(u))]
        return [*frames, *(keys.calibration(u) for u in self.users)]

    def without(self, users: set[int]) -> MarginalPrior:
        """The same without some users: their variables are marginalised out."""
        spans = dict(zip(self.keys(), keys.rows(self.keys()), strict=True))
        left = self._replace(users=[u for u in self.users if u not in users])
        at = np.concatenate([np.arange(s.start, s.stop) for key in left.keys() for s in [spans[key]]])  # noqa: SIM118
        frames = self.frames.copy()
        frames[list(users)] = np.nan
        return left._replace(frames=frames, covariance=self.covariance[np.ix_(at, at)])

    def aged(self, clock_variance: float) -> MarginalPrior:
        """The same after clock drift: adds `clock_variance` (s^2) to the variance of every clock offset."""
        covariance = self.covariance.copy()
        clocks = 4 * len(self.free) + 3 * np.arange(len(self.users)) + CLOCK
        covariance[clocks, clocks] += clock_variance
        return self._replace(covariance=covariance)

    def beside(self, reference: int) -> MarginalPrior:
        """The same relative to another of its users: frames and errors are transformed to the new reference."""
        others = [u for u in self.users if u != reference]
        first = {u: 4 * n for n, u in enumerate(self.free)}
        ours = self.frames[reference]
        to_ours = rotation_2d(-float(ours[3]))
        transform = np.zeros((4 * len(others) + 3 * len(self.users), len(self.covariance)))
        for n, u in enumerate(others):
            at, offset = 4 * n, self.frames[u] - ours
            if u in first:
                transform[at : at + 2, first[u] : first[u] + 2] = to_ours
                transform[at + 2 : at + 4, first[u] + 2 : first[u] + 4] = np.eye(2)
            at_reference = first[reference]
            transform[at : at + 2, at_reference : at_reference + 2] = -to_ours
            transform[at : at + 2, at_reference + 2] = -to_ours @ np.array([-offset[1], offset[0]])
            transform[at + 2 : at + 4, at_reference + 2 : at_reference + 4] = -np.eye(2)
        transform[4 * len(others) :, 4 * len(self.free) :] = np.eye(3 * len(self.users))
        return MarginalPrior(
            self.users,
            reference,
            relative_to(self.frames, reference),
            self.calibration,
            transform @ self.covariance @ transform.T,
        )

    def factor(self, assumed_clock: Array) -> gtsam.CustomFactor:
        """The Gaussian as a gtsam factor; the graph's clock variables count from `assumed_clock` (k,) s."""
        size = np.sqrt(np.diag(self.covariance))
        correlation = self.covariance / np.outer(size, size)
        values, axes = np.linalg.eigh(correlation)
        root = (axes / np.sqrt(np.maximum(values, _LEAST * values[-1]))).T / size
        of_keys = self.keys()
        return gtsam.CustomFactor(
            gtsam.noiseModel.Unit.Create(len(root)), of_keys, _error(self, root, keys.rows(of_keys), assumed_clock)
        )


def _error(marginal_prior: MarginalPrior, root: Array, spans: list[slice], assumed_clock: Array) -> Error:
    """`root` times (variables - means), with Jacobians in gtsam's tangent spaces."""

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        deviations, yaws = [], []
        for u in marginal_prior.free:
            at, (x, y, z, yaw) = values.atPose2(keys.frame(u)), marginal_prior.frames[u]
            deviations += [at.x() - x, at.y() - y, wrap_angle(at.theta() - yaw), values.atDouble(keys.height(u)) - z]
            yaws.append(at.theta())
        for u in marginal_prior.users:
            calibration = values.atVector(keys.calibration(u)) - marginal_prior.calibration[u]
            deviations += [calibration[0], calibration[1], calibration[2] + assumed_clock[u]]
        if jacobians is not None:
            for n, span in enumerate(spans):
                jacobians[n] = root[:, span].copy()
            for n, theta in enumerate(yaws):
                jacobians[2 * n][:, :2] = root[:, spans[2 * n]][:, :2] @ rotation_2d(theta)
        return np.asarray(root @ np.array(deviations))

    return error
