"""The frame that a page shows follows the one that is solved, so slowly that no object is seen to swim.

`pages/smoothing.js` is the same rule for browsers; both are held to `tests/live/vectors/smoothing.json`.

All axes are z up. A frame is `common_from_user`: p_common = Rz(yaw) (scale p_user) + (x, y, z). What a person sees of a
correction is how things move near the device, so places are compared where the device is, not at the origin of its
SLAM, and turns and scales as they move what is `arm` away.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from synchronizar.arrays import Array
from synchronizar.geometry import wrap_angle
from synchronizar.parameters import SmoothingParameters

InView: TypeAlias = Literal["things", "people", "nothing"]
"""What of the common frame is on the screen: something that stands, or else somebody who moves anyway, or nothing."""


class Placing(NamedTuple):
    """`common_from_user`, z up: m, rad, and length in the common frame over length in the user's."""

    x: float
    y: float
    z: float
    yaw: float
    scale: float = 1.0

    def apply(self, point: ArrayLike) -> Array:
        """(3,) m: a point of the user's frame, in the common one."""
        px, py, pz = (self.scale * np.asarray(point, dtype=float)).tolist()
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([self.x + c * px - s * py, self.y + s * px + c * py, self.z + pz])


class Shown(NamedTuple):
    """What a page draws with."""

    placing: Placing
    opacity: float
    """0 to 1, of everything that stands in the common frame."""


class Alarm(NamedTuple):
    """A correction that is larger than what had been told of the frame allows."""

    distance: float
    """m by which things near the device move."""
    sigmas: float
    """By the covariance that was told."""


class _Told(NamedTuple):
    t: float
    placing: Placing
    covariance: Array


class DriftAlarm:
    """Watches one device's frame for corrections that are larger than what had been told of it allows."""

    def __init__(self, parameters: SmoothingParameters | None = None) -> None:
        self._parameters = parameters or SmoothingParameters()
        self._told: _Told | None = None

    def solved(self, t: float, placing: Placing, covariance: Array, at: ArrayLike) -> Alarm | None:
        """A registered frame was told at `t` (s); the device is `at` (3,) m in its own frame."""
        alarm = None if self._told is None else _alarm(self._told, placing, at, self._parameters)
        if self._told is None or alarm is not None or t - self._told.t >= self._parameters.alarm_memory:
            self._told = _Told(t, placing, covariance)
        return alarm

    def forget(self) -> None:
        """Whatever comes next contradicts nothing."""
        self._told = None


class Smoother:
    """Follows one device's frame. `solved` for each frame that is told, `step` for each frame that is drawn."""

    def __init__(self, parameters: SmoothingParameters | None = None) -> None:
        self.parameters = parameters or SmoothingParameters()
        self.opacity = 0.0
        self.shown: Placing | None = None
        self._solved: Placing | None = None
        self._covariance: Array = np.zeros((4, 4))
        self._alarm = DriftAlarm(self.parameters)
        self._following = [False, False, False]

    def solved(self, t: float, placing: Placing, covariance: ArrayLike, at: ArrayLike) -> Alarm | None:
        """A registered frame was told at `t` (s), with its covariance (4, 4) over x, y, z, yaw.

        The device is `at` (3,) m in its own frame. An alarm where it contradicts what was told before: a page says that
        things have moved.
        """
        self._solved, self._covariance = placing, np.asarray(covariance, dtype=float)
        alarm = self._alarm.solved(t, placing, self._covariance, at)
        if self.shown is None:
            self.shown = placing
        return alarm

    def lost(self) -> None:
        """The device is not registered any more: what is shown stays, and whatever comes next contradicts nothing."""
        self._alarm.forget()

    def forget(self) -> None:
        """The device's SLAM began another frame: nothing can be shown until that one is solved."""
        self._alarm.forget()
        self.shown, self._solved, self.opacity = None, None, 0.0
        self._following = [False, False, False]

    def step(self, dt: float, at: ArrayLike, in_view: InView = "things") -> Shown | None:
        """The frame to draw with, `dt` (s) after the last, the device being `at` (3,) m in its own frame.

        None: nothing was solved yet.
        """
        if self.shown is None or self._solved is None:
            return None
        p, shown, goal = self.parameters, self.shown, self._solved
        here, there = shown.apply(at), goal.apply(at)
        away = there - here
        distance = float(np.linalg.norm(away))
        turn = wrap_angle(goal.yaw - shown.yaw)
        stretch = math.log(goal.scale / shown.scale)
        fading = max(distance, p.arm * abs(turn), p.arm * abs(stretch)) > p.fade_beyond
        seen = in_view != "nothing"
        if fading and seen:
            self.opacity -= dt / p.fade_time
        if fading and (not seen or self.opacity <= 0.0):
            self.opacity, self.shown, self._following = max(0.0, self.opacity), goal, [False, False, False]
            return Shown(goal, self.opacity)
        if not fading:
            self.opacity = min(1.0, self.opacity + dt / p.fade_time)
            sigma, sigma_yaw = _sigmas(self._covariance, goal, at)
            factor = dt * {"things": 1.0, "people": p.people, "nothing": p.out_of_view}[in_view]
            moved = self._share(0, distance, sigma, 1.0, factor)
            turned = self._share(1, abs(turn), sigma_yaw, p.arm, factor)
            stretched = self._share(2, abs(stretch), 0.0, p.arm, factor)
            place = here + moved * away
            yaw, scale = wrap_angle(shown.yaw + turned * turn), shown.scale * math.exp(stretched * stretch)
            x, y, z = (place - Placing(0.0, 0.0, 0.0, yaw, scale).apply(at)).tolist()
            self.shown = Placing(x, y, z, yaw, scale)
        return Shown(self.shown, self.opacity)

    def _share(self, which: int, error: float, sigma: float, arm: float, factor: float) -> float:
        """Which share of an error (m, or over `arm` m: rad, log) is taken back now."""
        p = self.parameters
        band = p.settled * p.dead_band / arm if self._following[which] else max(p.dead_band / arm, sigma)
        self._following[which] = error > band
        if not self._following[which]:
            return 0.0
        return min(1.0, factor * (p.least_speed / arm + p.rate * error) / error)


def _at_place(covariance: Array, placing: Placing, at: ArrayLike) -> Array:
    """(4, 4): covariance over x, y, z, yaw at the place of the device, from that at the origin of its frame."""
    arm = placing.apply(at) - np.array([placing.x, placing.y, placing.z])
    jacobian = np.eye(4)
    jacobian[0, 3], jacobian[1, 3] = -arm[1], arm[0]
    return np.asarray(jacobian @ covariance @ jacobian.T)


def _sigmas(covariance: Array, placing: Placing, at: ArrayLike) -> tuple[float, float]:
    """m: the longer half-axis in the plane at the device's place, 1 sigma; rad: of yaw."""
    c = _at_place(covariance, placing, at)
    mean, half = 0.5 * (c[0, 0] + c[1, 1]), 0.5 * (c[0, 0] - c[1, 1])
    return math.sqrt(max(0.0, mean + math.hypot(half, c[0, 1]))), math.sqrt(max(0.0, c[3, 3]))


def _alarm(told: _Told, now: Placing, at: ArrayLike, p: SmoothingParameters) -> Alarm | None:
    moved = now.apply(at) - told.placing.apply(at)
    turn = wrap_angle(now.yaw - told.placing.yaw)
    distance = float(np.linalg.norm(moved)) + p.arm * abs(turn)
    if distance <= p.alarm_least:
        return None
    # Nothing is known better than what a display can show.
    covariance = _at_place(told.covariance, told.placing, at)
    covariance += np.diag([p.dead_band, p.dead_band, p.dead_band, p.dead_band / p.arm]) ** 2
    change = np.append(moved, turn)
    sigmas = math.sqrt(float(change @ np.linalg.solve(covariance, change)))
    return Alarm(distance, sigmas) if sigmas > p.alarm_sigmas else None
