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

from synchronizar.arrays import Array
from synchronizar.geometry import wrap_angle
from synchronizar.parameters import SlamParameters

_SLOTS = 5  # summed: corrections follow drift that is larger than it is taken for over some of them
_MEMORY = 60.0  # slots
_LARGEST = 4.0  # of the factors, as of a search's
_KNOWN = 4  # x, y (m), yaw (rad), log scale
_NOWHERE = -1


class SeenDrift:
    """Of k users who are followed."""

    KEPT: ClassVar[tuple[str, ...]] = ("_slot", "_ahead", "_step", "_covariance", "_last", "_sums")

    def __init__(self, users: int, parameters: SlamParameters) -> None:
        self._parameters = parameters
        self._slot = np.full(users, _NOWHERE)  # the newest one that was opened
        self._ahead = np.zeros((users, 3))  # x, y, yaw where SLAM's step led to, there
        self._step = np.full((users, 7), np.nan)
        """x, y, yaw that were corrected within the slot before; x, y of the step to the newest one; variances of that
        step, of place and heading, as they were used."""
        self._covariance = np.full((users, _KNOWN, _KNOWN), np.nan)  # when the newest slot began
        self._last = np.full((users, _SLOTS, 9), np.nan)
        """Of each of the last slots x, y, yaw corrected; what is expected of the squares of place and heading; the
        variances of steps as they were used; as they are usual."""
        self._sums = np.zeros((users, 4))  # squares over usual variances, of place and heading; what is expected so

    @property
    def factors(self) -> Array:
        """(k, 2) on the usual drift of each user's place and heading, 1 at least."""
        weight = self._parameters.drift_seen_weight
        squares = (weight + self._sums[:, :2]) / (weight + self._sums[:, 2:])
        return np.sqrt(np.clip(squares, 1.0, _LARGEST**2))

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
        self._slot[user], self._last[user], self._sums[user] = _NOWHERE, np.nan, 0.0

    def open(self, user: int, before: tuple[int, Array], newest: tuple[int, Array], used: tuple[float, float]) -> None:
        """A slot was opened: the one before and where the user is at its begin now (7,); it and where the step leads.

        `used`: 1 sigma of the step's place and heading.
        """
        self._step[user] = np.nan
        if self._slot[user] == before[0]:
            corrected = before[1][:3] - self._ahead[user]
            corrected[2] = wrap_angle(float(corrected[2]))
            self._step[user] = *corrected, *(newest[1] - before[1])[:2], *np.square(used)
        self._slot[user], self._ahead[user] = newest[0], newest[1][:3]

    def look(self, user: int, slot: int, covariance: Array, noise: Array) -> None:
        """What was known of a user when a slot began: (4, 4) of x, y, yaw, log scale; `noise` (2,) of its step."""
        if slot != self._slot[user]:
            return
        before, step = self._covariance[user], self._step[user]
        self._covariance[user] = covariance
        if np.isnan(step[0]):
            self._last[user] = np.nan
            return
        x, y, *used = step[3:].tolist()
        back = np.eye(_KNOWN)  # errors at the step's begin, by those at its end
        back[:2, 2:] = [[y, -x], [-x, -y]]
        end = covariance - np.diag([used[0], used[0], used[1], 0.0])
        expected = np.diag(before - back @ end @ back.T)
        of_both = [0.5 * float(expected[0] + expected[1]), float(expected[2])]
        self._last[user] = np.roll(self._last[user], -1, axis=0)
        self._last[user, -1] = *step[:3], *of_both, *used, *(np.array(used) / noise**2)
        self._step[user] = np.nan
        self._add(user)

    def _add(self, user: int) -> None:
        sums = self._last[user].sum(axis=0)
        if np.isnan(sums[0]):
            return
        x, y, yaw = sums[:3].tolist()
        squares = np.array([0.5 * (x * x + y * y), yaw * yaw]) / sums[7:]
        told = np.clip(sums[3:5] / sums[5:7], 0.0, 1.0)
        slipped = squares > self._parameters.slip_sigmas**2
        self._sums[user] *= 1.0 - 1.0 / _MEMORY
        self._sums[user] += np.where(np.tile(slipped, 2), 0.0, np.concatenate([squares, told]))
