"""How far SLAM drifts, by how much the places of those who are followed are corrected.

A search measures drift on the few seconds in which somebody is found (`graph.step_noise`), and goes by what is usual
where they say little. What comes afterwards tells more. When a slot ends a user is not where SLAM's step led to when it
began: these corrections are the innovations of a Kalman filter, white and as large as the covariance shrinks within the
slot. Where SLAM drifts farther than it is taken to, their sums over some slots are larger (Mehra, IEEE Trans. Automatic
Control 15, 1970).
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from synchronizar.arrays import Array, Indices
from synchronizar.geometry import wrap_angle
from synchronizar.parameters import SlamParameters

_SLOTS = 5  # summed: corrections follow drift that is larger than it is taken for over some of them
_MEMORY = 60.0  # slots
_KNOWN = 4  # x, y (m), yaw (rad), log scale
_NOWHERE = -1


class SeenDrift:
    """Of k users who are followed."""

    KEPT: ClassVar[tuple[str, ...]] = (
        "factors",
        "_slot",
        "_looked",
        "_ahead",
        "_step",
        "_covariance",
        "_last",
        "_sums",
    )

    def __init__(self, users: int, parameters: SlamParameters) -> None:
        self._parameters = parameters
        self._slot = np.full(users, _NOWHERE)  # the newest one that was opened, ...
        self._looked = np.full(users, _NOWHERE)  # ... and looked at
        self._ahead = np.zeros((users, 3))  # x, y, yaw where SLAM's step led to, there
        self._step = np.full((users, 7), np.nan)
        """x, y, yaw that were corrected within the slot before; x, y of the step to the newest one; variances of that
        step, of place and heading, as they were used."""
        self._covariance = np.full((users, _KNOWN, _KNOWN), np.nan)  # when the newest slot began
        self._last = np.full((users, _SLOTS, 9), np.nan)
        """Of each of the last slots x, y, yaw corrected; what is expected of the squares of place and heading; the
        variances of steps as they were used; as they are usual."""
        self.factors = np.ones((users, 2))
        """(k, 2) on the usual drift of each user's place and heading, 1 at least."""
        self._sums = np.zeros((users, 4))  # squares over usual variances, of place and heading; what is expected so

    def add_user(self) -> None:
        """One more, who is not followed yet."""
        new = SeenDrift(1, self._parameters)
        for name in self.KEPT:
            setattr(self, name, np.concatenate([getattr(self, name), getattr(new, name)]))

    def begin(self) -> None:
        """Somebody has come or gone: places change by what is known anew, and count from now on."""
        self._slot[:], self._last[:] = _NOWHERE, np.nan

    def forget(self, user: int) -> None:
        """Its SLAM began anew."""
        self._slot[user], self._last[user], self._sums[user], self.factors[user] = _NOWHERE, np.nan, 0.0, 1.0

    def open(self, user: int, before: tuple[int, Array], newest: tuple[int, Array], used: tuple[float, float]) -> None:
        """A slot was opened: the one before and where the user is at its begin now (7,); it and where the step leads.

        `used`: 1 sigma of the step's place and heading.
        """
        self._step[user] = np.nan
        if self._slot[user] == before[0]:
            self._step[user, :3] = before[1][:3] - self._ahead[user]
            self._step[user, 2] = wrap_angle(float(self._step[user, 2]))
            self._step[user, 3:5] = newest[1][:2] - before[1][:2]
            self._step[user, 5:] = used[0] ** 2, used[1] ** 2
        self._slot[user], self._ahead[user] = newest[0], newest[1][:3]

    def look(self, users: Indices, slots: Indices, covariances: Array, noise: Array) -> None:
        """What is known of m users where slots begin: (m, 4, 4) of x, y, yaw, log scale; `noise` (m, 2) of the steps.

        Of each slot what was known first counts: the others may turn to theirs a little later.
        """
        new = (slots == self._slot[users]) & (slots != self._looked[users])
        users, slots, covariances, noise = users[new], slots[new], covariances[new], noise[new]
        self._looked[users] = slots
        before, step = self._covariance[users], self._step[users]
        self._covariance[users], self._step[users] = covariances, np.nan
        x, y, used = step[:, 3], step[:, 4], step[:, 5:]
        back = np.tile(np.eye(_KNOWN), (len(users), 1, 1))  # errors at the step's begin, by those at its end
        back[:, 0, 2], back[:, 0, 3], back[:, 1, 2], back[:, 1, 3] = y, -x, -x, -y
        end = covariances.copy()
        end[:, [0, 1, 2], [0, 1, 2]] -= used[:, [0, 0, 1]]
        expected = (before - back @ end @ back.swapaxes(1, 2))[:, [0, 1, 2], [0, 1, 2]]
        of_both = np.column_stack([0.5 * (expected[:, 0] + expected[:, 1]), expected[:, 2]])
        newest = np.hstack([step[:, :3], of_both, used, used / noise**2])
        self._last[users] = np.concatenate([self._last[users, 1:], newest[:, None]], axis=1)
        self._add(users)

    def _add(self, users: Indices) -> None:
        sums = self._last[users].sum(axis=1)
        whole = ~np.isnan(sums[:, 0])
        users, sums = users[whole], sums[whole]
        if not len(users):
            return
        squares = np.column_stack([0.5 * (sums[:, 0] ** 2 + sums[:, 1] ** 2), sums[:, 2] ** 2]) / sums[:, 7:]
        told = np.clip(sums[:, 3:5] / sums[:, 5:7], 0.0, 1.0)
        ordinary = squares < self._parameters.slip_sigmas**2
        self._sums[users] *= 1.0 - 1.0 / _MEMORY
        self._sums[users] += np.hstack([squares * ordinary, told * ordinary])
        weight, largest = self._parameters.drift_seen_weight, self._parameters.drift_largest
        known = self._sums[users]
        self.factors[users] = np.sqrt(np.clip((weight + known[:, :2]) / (weight + known[:, 2:]), 1.0, largest**2))
