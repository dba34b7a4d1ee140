"""What ranges have told so far, carried to where everybody is now: a Gaussian that goes on without them.

The frame of a later window's graph is anchored at each user's last keyframe, in the axes of the reference's. So what is
carried is linear in nothing old: when the window is solved again, from an older carried Gaussian and the same ranges,
frames, scales and biases are linearised anew, and nothing stays where it happened to be when a keyframe was given up.
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

_LEAST = 1e-12  # of the largest variance: what is known any better makes the square root singular in its numbers


class MarginalPrior(NamedTuple):
    """A Gaussian over frames and devices."""

    users: list[int]
    """Those that are carried, the reference among them."""
    reference: int
    frames: Array
    """(k, 4) x, y, z, yaw: where each anchor lies beside the reference's; NaN for users that are not carried."""
    calibration: Array
    """(k, 3) log scale, bias (m), clock offset (s)."""
    covariance: Array
    """(n, n) of additive errors: x, y, yaw and height of each user but the reference, then of every user's device."""

    @property
    def free(self) -> list[int]:
        """Users whose frames it holds."""
        return [u for u in self.users if u != self.reference]

    def keys(self) -> list[int]:
        """Of the variables, in the order of the covariance."""
        frames = [key for u in self.free for key in (keys.frame(u), keys.height(u))]
        return [*frames, *(keys.calibration(u) for u in self.users)]

    def without(self, users: set[int]) -> MarginalPrior:
        """What is known of all others."""
        spans = dict(zip(self.keys(), keys.rows(self.keys()), strict=True))
        left = self._replace(users=[u for u in self.users if u not in users])
        at = np.concatenate([np.arange(s.start, s.stop) for key in left.keys() for s in [spans[key]]])  # noqa: SIM118
        frames = self.frames.copy()
        frames[list(users)] = np.nan
        return left._replace(frames=frames, covariance=self.covariance[np.ix_(at, at)])

    def aged(self, clock_variance: float) -> MarginalPrior:
        """The same after a while in which every clock may have drifted: by so much, s^2."""
        covariance = self.covariance.copy()
        clocks = 4 * len(self.free) + 3 * np.arange(len(self.users)) + CLOCK
        covariance[clocks, clocks] += clock_variance
        return self._replace(covariance=covariance)

    def beside(self, reference: int) -> MarginalPrior:
        """The same beside another user that is carried: errors are turned and moved with it."""
        others = [u for u in self.users if u != reference]
        first = {u: 4 * n for n, u in enumerate(self.free)}
        ours = self.frames[reference]
        to_ours = rotation_2d(-float(ours[3]))
        turn = np.zeros((4 * len(others) + 3 * len(self.users), len(self.covariance)))
        for n, u in enumerate(others):
            at, away = 4 * n, self.frames[u] - ours
            if u in first:
                turn[at : at + 2, first[u] : first[u] + 2] = to_ours
                turn[at + 2 : at + 4, first[u] + 2 : first[u] + 4] = np.eye(2)
            there = first[reference]
            turn[at : at + 2, there : there + 2] = -to_ours
            turn[at : at + 2, there + 2] = -to_ours @ np.array([-away[1], away[0]])
            turn[at + 2 : at + 4, there + 2 : there + 4] = -np.eye(2)
        turn[4 * len(others) :, 4 * len(self.free) :] = np.eye(3 * len(self.users))
        return MarginalPrior(
            self.users,
            reference,
            relative_to(self.frames, reference),
            self.calibration,
            turn @ self.covariance @ turn.T,
        )

    def factor(self, assumed_clock: Array) -> gtsam.CustomFactor:
        """The Gaussian as a factor; `assumed_clock` (k,) s are the offsets that the graph's clocks count from."""
        size = np.sqrt(np.diag(self.covariance))
        correlation = self.covariance / np.outer(size, size)
        values, axes = np.linalg.eigh(correlation)
        root = (axes / np.sqrt(np.maximum(values, _LEAST * values[-1]))).T / size
        of_keys = self.keys()
        return gtsam.CustomFactor(
            gtsam.noiseModel.Unit.Create(len(root)), of_keys, _error(self, root, keys.rows(of_keys), assumed_clock)
        )


def _error(marginal_prior: MarginalPrior, root: Array, spans: list[slice], assumed_clock: Array) -> Error:
    """`root` times how far the variables are from their means; its Jacobians by gtsam's tangents."""

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        away, turns = [], []
        for u in marginal_prior.free:
            at, (x, y, z, yaw) = values.atPose2(keys.frame(u)), marginal_prior.frames[u]
            away += [at.x() - x, at.y() - y, wrap_angle(at.theta() - yaw), values.atDouble(keys.height(u)) - z]
            turns.append(at.theta())
        for u in marginal_prior.users:
            calibration = values.atVector(keys.calibration(u)) - marginal_prior.calibration[u]
            away += [calibration[0], calibration[1], calibration[2] + assumed_clock[u]]
        if jacobians is not None:
            for n, span in enumerate(spans):
                jacobians[n] = root[:, span].copy()
            for n, turn in enumerate(turns):
                jacobians[2 * n][:, :2] = root[:, spans[2 * n]][:, :2] @ rotation_2d(turn)
        return np.asarray(root @ np.array(away))

    return error
