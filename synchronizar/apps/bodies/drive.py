"""A simulated robot with two driven wheels: what it is told, where it goes, and where its odometry says that it is."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from typing import NamedTuple

import numpy as np

from synchronizar.geometry import wrap_angle


class Twist(NamedTuple):
    """A command: as ROS has it, for a robot that goes forwards and turns."""

    linear: float
    """m/s, forwards."""
    angular: float
    """rad/s, to the left."""


STOP = Twist(0.0, 0.0)


class Ground(NamedTuple):
    """A place on the floor."""

    x: float
    y: float
    heading: float
    """rad."""


@dataclass(frozen=True)
class DriveLimits:
    """What its motors do."""

    linear: float = 1.0
    """m/s."""
    angular: float = 2.5
    """rad/s."""
    linear_acceleration: float = 3.0
    """m/s^2."""
    braking: float = 6.0
    """m/s^2: slower or back."""
    angular_acceleration: float = 12.0
    """rad/s^2."""
    silence: float = 0.2
    """s without a command after which it brakes by itself."""


class Drive:
    """The robot, and its odometry: each step's way with an error, as wheels that slip have it."""

    def __init__(
        self, start: Ground, seed: int, limits: DriveLimits | None = None, drift: float = 0.01, drift_rad: float = 0.01
    ) -> None:
        """`start`: where it stands in truth. `drift`: m a square root of a metre; `drift_rad`: rad the same."""
        self.truth, self.odometry = start, Ground(0.0, 0.0, 0.0)
        self.limits = limits or DriveLimits()
        self.twist = STOP
        """How it moves now."""
        self._asked, self._silent = STOP, 0.0
        self._random = np.random.default_rng(seed)
        self._drift, self._drift_rad = drift, drift_rad

    def command(self, twist: Twist) -> None:
        """From now on, until the next command or for as long as it bears silence."""
        self._asked, self._silent = twist, 0.0

    def step(self, dt: float) -> None:
        """Go on for `dt` (s)."""
        limits = self.limits
        self._silent += dt
        asked = STOP if self._silent > limits.silence else self._asked
        wanted, goes = _held(asked.linear, limits.linear), self.twist.linear
        faster = wanted * goes >= goes * goes
        linear = _toward(goes, wanted, (limits.linear_acceleration if faster else limits.braking) * dt)
        angular = _toward(self.twist.angular, _held(asked.angular, limits.angular), limits.angular_acceleration * dt)
        self.twist = Twist(linear, angular)
        self.truth = _moved(self.truth, linear * dt, angular * dt)
        way = abs(linear * dt) ** 0.5
        along, turned = self._random.normal(0.0, way, 2) * (self._drift, self._drift_rad)
        self.odometry = _moved(self.odometry, linear * dt + along, angular * dt + turned)


def _moved(at: Ground, way: float, turn: float) -> Ground:
    """Along an arc: its chord points half the turn to the side."""
    middle = at.heading + 0.5 * turn
    return Ground(at.x + way * cos(middle), at.y + way * sin(middle), wrap_angle(at.heading + turn))


def _held(value: float, most: float) -> float:
    return max(-most, min(most, value))


def _toward(value: float, goal: float, step: float) -> float:
    return value + _held(goal - value, step)
