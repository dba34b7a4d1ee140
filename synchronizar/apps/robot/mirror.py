"""Somebody's mirror image: the mirror stands between the two where they are when it begins."""

from __future__ import annotations

from math import atan2, cos, hypot, pi, sin
from typing import NamedTuple

from synchronizar.apps.bodies.drive import Ground
from synchronizar.geometry import wrap_angle


class Mirror(NamedTuple):
    """A line on the floor of the common frame, through (x, y)."""

    x: float
    y: float
    direction: float
    """rad, along the line."""

    def image(self, person: Ground) -> Ground:
        """Of a place and a heading: p' = c + R (p - c) with R = [[cos 2a, sin 2a], [sin 2a, -cos 2a]], h' = 2 a - h."""
        c, s = cos(2.0 * self.direction), sin(2.0 * self.direction)
        dx, dy = person.x - self.x, person.y - self.y
        heading = wrap_angle(2.0 * self.direction - person.heading)
        return Ground(self.x + c * dx + s * dy, self.y + s * dx - c * dy, heading)

    def turned(self, velocity: tuple[float, float]) -> tuple[float, float]:
        """The image of a velocity: R v."""
        c, s = cos(2.0 * self.direction), sin(2.0 * self.direction)
        return c * velocity[0] + s * velocity[1], s * velocity[0] - c * velocity[1]


def mirror_between(person: Ground, robot: Ground) -> Mirror:
    """The mirror in which the robot is the person's image now: across the middle between both."""
    dx, dy = robot.x - person.x, robot.y - person.y
    across = atan2(dy, dx) if hypot(dx, dy) > 1e-6 else person.heading
    return Mirror(0.5 * (person.x + robot.x), 0.5 * (person.y + robot.y), wrap_angle(across + 0.5 * pi))


def beside(person: Ground, robot: Ground, distance: float) -> Ground:
    """Where a robot comes to when it is called: `distance` (m) from the person, on its own side, looking there."""
    dx, dy = robot.x - person.x, robot.y - person.y
    way = hypot(dx, dy)
    ux, uy = (dx / way, dy / way) if way > 1e-6 else (cos(person.heading), sin(person.heading))
    return Ground(person.x + distance * ux, person.y + distance * uy, atan2(-uy, -ux))
