"""A ball's flight in closed form: everybody who knows how it began knows where it is."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, dist, hypot, sin, sqrt

import numpy as np

Vector = tuple[float, float, float]

GRAVITY = 4.0
"""m/s^2: less than the Earth's, so that a throw across a room leaves time to see where it goes."""


@dataclass(frozen=True)
class Flight:
    """From `t` (s, the room's clock) on, in the common frame, z up: p(t) = p0 + v0 t - g t^2 / 2."""

    t: float
    position: Vector
    """m."""
    velocity: Vector
    """m/s."""

    def at(self, t: float) -> Vector:
        """Where it is (m)."""
        s = t - self.t
        x, y, z = (p + v * s for p, v in zip(self.position, self.velocity, strict=True))
        return x, y, z - 0.5 * GRAVITY * s * s

    def velocity_at(self, t: float) -> Vector:
        """How it moves (m/s)."""
        vx, vy, vz = self.velocity
        return vx, vy, vz - GRAVITY * (t - self.t)

    def lands(self, floor: float) -> float:
        """When (s) it comes down to a height (m); at once where it begins below."""
        up, height = self.velocity[2], max(0.0, self.position[2] - floor)
        return self.t + (up + sqrt(up * up + 2.0 * GRAVITY * height)) / GRAVITY

    def nearest(self, place: Vector, begin: float, end: float) -> tuple[float, float]:
        """When (s) between two moments it is nearest to a place, and how near (m).

        d/dt |p(t) - place|^2 = 0 is a cubic; the nearest is at one of its roots, or at an end.
        """
        (bx, by, bz), (vx, vy, vz) = self.at(begin), self.velocity_at(begin)
        dx, dy, dz = bx - place[0], by - place[1], bz - place[2]
        cubic = (
            0.5 * GRAVITY * GRAVITY,
            -1.5 * GRAVITY * vz,
            vx * vx + vy * vy + vz * vz - GRAVITY * dz,
            dx * vx + dy * vy + dz * vz,
        )
        last = end - begin
        inside = [float(s.real) for s in np.roots(cubic) if abs(s.imag) < 1e-9 and 0.0 < s.real < last]
        tried = [(dist(self.at(begin + s), place), begin + s) for s in (0.0, last, *inside)]
        near, when = min(tried)
        return when, near


def throw_to(begin: Vector, goal: Vector, speed: float) -> Vector:
    """The velocity with which what is thrown at `speed` (m/s) reaches a goal, by the lower of its two arcs.

    With d the way in the plane and h the one upwards, tan(angle) = (v^2 - sqrt(v^4 - g (g d^2 + 2 h v^2))) / (g d);
    where no arc does, the one that goes farthest before it is at that height, tan(angle) = v / sqrt(v^2 - 2 g h).
    """
    dx, dy, h = goal[0] - begin[0], goal[1] - begin[1], goal[2] - begin[2]
    d = hypot(dx, dy)
    if d < 1e-6:
        return 0.0, 0.0, speed if h >= 0.0 else -speed
    square = speed * speed
    under = square * square - GRAVITY * (GRAVITY * d * d + 2.0 * h * square)
    if under >= 0.0:
        angle = atan2(square - sqrt(under), GRAVITY * d)
    else:
        angle = atan2(speed, sqrt(max(0.0, square - 2.0 * GRAVITY * h)))
    along, up = speed * cos(angle), speed * sin(angle)
    return along * dx / d, along * dy / d, up
