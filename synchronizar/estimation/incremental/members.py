"""Those who are followed: where they are, how sure that is, and the verdict on each."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.user import User
from synchronizar.estimation.assessment import with_calibration
from synchronizar.estimation.hypotheses import GaussianComponent, Hypothesis
from synchronizar.estimation.incremental.standing import Placed
from synchronizar.estimation.incremental.tracking import Tracking
from synchronizar.estimation.integrity import Evidence, Verdict, nearness, verdicts
from synchronizar.graph.priors import height_sigma_of
from synchronizar.graph.states import BIAS, SCALE
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.extent import EXTENT_POINTS, extent_points_of

_POSE = 5  # x, y, z, yaw, log scale
_TANGENT = 7  # of X, H and D
_ROWS = (0, 1, 3, 2, 4, 5, 6)  # x, y, height, yaw, log scale, bias, clock among them


@lru_cache
def _order(size: int) -> Array:
    """(7 size, 7 size) one row a number of each member: from the order of its variables to x, y, height, yaw, ..."""
    return np.eye(_TANGENT * size)[[_TANGENT * n + row for n in range(size) for row in _ROWS]]


@dataclass(frozen=True)
class _One:
    """A member and the gauge, as a verdict looks at them."""

    users: tuple[User, ...]
    reference: int
    free: list[int]
    parameters: Parameters

    def prior_variances(self, user: int) -> Array:
        """(4,) of x, y, z (m^2) and yaw (rad^2) relative to the gauge."""
        priors = self.parameters.priors
        heights = [height_sigma_of(self.users[u], self.parameters) for u in (user, self.reference)]
        height = 0.5 * (heights[0] ** 2 + heights[1] ** 2)
        return np.array([priors.place_sigma**2, priors.place_sigma**2, height, priors.yaw_sigma**2])


class Joint(NamedTuple):
    """A joint covariance, and of whom."""

    at: list[tuple[int, int]]
    """m users, by their index, and the slot of each."""
    covariance: Array
    """(m, 7, m, 7) x, y, height, yaw, log scale, bias, clock of each; all in the graph's frame."""


class Members:
    """What the graph tells of all members at one moment."""

    def __init__(self, tracking: Tracking, reference: int, shift: Array, before: Joint | None = None) -> None:
        """`shift` (3,) m: where the graph's origin lies in the common frame.

        `before`: what it told last. Of users at the same slots as then it tells the same covariance, which ranges have
        made a little smaller since: it is asked once a slot, for it costs the cube of how many there are.
        """
        self.tracking, self.reference, self._shift = tracking, reference, shift
        self.order = sorted(tracking.members)
        self._row = {u: n for n, u in enumerate(self.order)}
        at = [(u, tracking.members[u].slot) for u in self.order]
        self.joint = before if before is not None and before.at == at else self._asked(at)
        self._joint = self.joint.covariance

    def _asked(self, at: list[tuple[int, int]]) -> Joint:
        """The joint covariance as the graph has it now. Raises RuntimeError where it is singular."""
        tracking = self.tracking
        size = len(self.order)
        yaw = np.array([tracking.members[u].state[2] for u in self.order])
        turn = _order(size).copy()
        x = _TANGENT * np.arange(size)
        turn[x, x] = turn[x + 1, x + 1] = np.cos(yaw)
        turn[x + 1, x] = np.sin(yaw)
        turn[x, x + 1] = -turn[x + 1, x]
        joint: Array = turn @ tracking.follower.covariance(at) @ turn.T
        return Joint(at, joint.reshape(size, _TANGENT, size, _TANGENT))

    def frame(self, user: int) -> Array:
        """(4,) x, y, z, yaw of a member at the begin of its newest slot, in the graph's frame."""
        x, y, yaw, height = self.tracking.members[user].state[:4].tolist()
        return np.array([x, y, height, yaw])

    def placed(self, user: int) -> Placed:
        """A member, in the common frame."""
        tracked = self.tracking.members[user]
        state = tracked.state.copy()
        state[[0, 1, 3]] += self._shift
        state[6] += self.tracking.assumed_clock[user]
        n = self._row[user]
        own = self._joint[n, :, n]
        covariance = np.zeros((6, 6))
        covariance[:_POSE, :_POSE] = own[:_POSE, :_POSE]
        covariance[2, 2] += self.tracking.height_spread[user]
        if self.reference in self._row:
            r = self._row[self.reference]
            covariance[5, 5] = self._joint[r, 4, r, 4]
            covariance[5, :_POSE] = covariance[:_POSE, 5] = self._joint[n, :_POSE, r, 4]
        sigma = np.sqrt(np.maximum(own[[4, 5, 6], [4, 5, 6]], 0.0))
        if self.tracking.users[user].static:
            sigma[[n for n in range(3) if n != BIAS]] = np.nan
        return Placed(tracked.place, state, covariance, sigma)

    def relative(self, user: int, gauge: int) -> Array:
        """(4, 4) covariance of x, y, z, yaw of a member relative to another one; a common shift and turn cancel."""
        n, g = self._row[user], self._row[gauge]
        offset = self.frame(user) - self.frame(gauge)
        against = np.eye(4)
        against[0, 3], against[1, 3] = -offset[1], offset[0]
        own, other = self._joint[n, :4, n, :4], self._joint[g, :4, g, :4]
        cross = self._joint[n, :4, g, :4] @ against.T
        out = own + against @ other @ against.T - cross - cross.T
        # The graph has one height of each; the others that searches see are told beside it.
        out[2, 2] += self.tracking.height_spread[user] + self.tracking.height_spread[gauge]
        return np.asarray(out)

    def extent(self, user: int, since: float) -> Array:
        """(c, 3) m: extent points of a member's walk since its own stamp, about where its newest slot begins."""
        stream, tracked = self.tracking.streams[user], self.tracking.members[user]
        if stream is None:
            return np.zeros((EXTENT_POINTS, 3))
        walk = stream.tail(since).position
        scale = float(np.exp(tracked.state[4 + SCALE]))
        return scale * (extent_points_of(walk if len(walk) else tracked.place[None]) - tracked.place)

    def hypothesis(self, user: int, gauge: int) -> Hypothesis:
        """Where a member is beside another, as a verdict looks at it."""
        k = len(self.tracking.users)
        frames, covariances = np.zeros((k, 4)), np.zeros((k, 4, 4))
        frames[user], covariances[user] = self.frame(user), self.relative(user, gauge)
        return Hypothesis(0.0, frames, covariances, [GaussianComponent(1.0, frames, covariances)])

    def verdict(
        self, user: int, gauge: int, extent: Array, rejected: float, registered: bool
    ) -> tuple[Verdict, float, Hypothesis]:
        """On a member beside another, how near it is to being registered, and what both follow from."""
        users, parameters = self.tracking.users, self.tracking.parameters
        found = self.hypothesis(user, gauge)
        of_all = np.zeros((len(users), len(extent), 3))
        of_all[user] = extent
        shares = np.full(len(users), rejected)
        one = _One(users, gauge, [user], parameters)
        evidence = Evidence(shares, of_all, registered=[user] if registered else [])
        known = verdicts([found], evidence, one, parameters)[user]
        assert known is not None
        variances = self.placed(user).calibration_sigma ** 2
        near = nearness(found, user, users[user].static, extent, parameters)
        return with_calibration(known, variances, parameters), float(min(near, 1.0)), found
