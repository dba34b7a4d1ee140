"""What a search found, brought into the common frame and into the graph's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.user import User
from synchronizar.estimation.incremental.snapshot import Found
from synchronizar.estimation.incremental.standing import Placed
from synchronizar.estimation.incremental.tracking import JoiningUser
from synchronizar.geometry import apply_frames, wrap_angle


@dataclass(frozen=True)
class FoundPlaces:
    """A search's findings, and where its frame lies."""

    found: Found
    common: Array
    """(4,) x, y, z, yaw: the common frame from that of the search."""
    shift: Array
    """(3,) m: where the graph's origin lies in the common frame."""

    def placed(self, user: int) -> Placed:
        """A user at its last pose."""
        own = self.found.users[user]
        turn = np.eye(6)
        c, s = np.cos(self.common[3]), np.sin(self.common[3])
        turn[:2, :2] = [[c, -s], [s, c]]
        x, y, z, yaw = self._at_last(own.place).tolist()
        state = np.array([x, y, yaw, z, *own.calibration])
        covariance = turn @ own.covariance @ turn.T
        return Placed(self.found.poses[user].places[-1], state, covariance, own.calibration_sigma)

    def _at_last(self, place: Array) -> Array:
        """(4,) x, y, z, yaw in the common frame, of one in the search's."""
        return np.append(apply_frames(self.common, place[:3]), wrap_angle(float(place[3] + self.common[3])))

    def alternatives(self) -> list[tuple[float, dict[int, Array]]]:
        """Cost beside the best, and (4,) x, y, z, yaw of each user's last pose; none where there is but one."""
        if len(self.found.alternatives) < 2:
            return []
        best = self.found.alternatives[0][0]
        return [
            (max(cost - best, 0.0), {u: self._at_last(last[u]) for u in self.found.users})
            for cost, last in self.found.alternatives
        ]

    def joining(self, user: int, of: User) -> JoiningUser | None:
        """A user's slots, in the graph's frame; None where it has none."""
        own, poses = self.found.users[user], self.found.poses[user]
        if not poses.slots:
            return None
        common = np.broadcast_to(self.common, own.states.shape)
        at = apply_frames(common, own.states[:, :3]) - self.shift
        yaw = wrap_angle(own.states[:, 3] + self.common[3])
        clock = 0.0 if of.static else float(own.calibration[2])
        rest = np.tile([own.calibration[0], own.calibration[1], 0.0], (len(at), 1))
        states = np.column_stack([at[:, :2], yaw, at[:, 2], rest])
        return JoiningUser(
            poses.slots, poses.stamps[:-1], poses.places[:-1], states, clock, own.height_weight, own.calibration_prior
        )
