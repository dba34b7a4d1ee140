"""How a robot goes where it should and keeps away from people: all by where the room says that everybody is.

It steers a point somewhat ahead of its axle: that point can go in any direction at once, which the axle cannot
(d/dt point = linear h + angular l h', h the heading, h' to its left, l how far ahead).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, hypot, sin
from typing import NamedTuple

from synchronizar.apps.bodies.drive import Ground, Twist
from synchronizar.geometry import wrap_angle

Plane = tuple[float, float]


@dataclass(frozen=True)
class SteeringParameters:
    """How it moves among people."""

    ahead: float = 0.15
    """m from the axle to the point that is steered."""
    speed: float = 1.0
    """m/s, towards a goal."""
    retreat: float = 1.0
    """m/s, away from who comes."""
    gain: float = 3.0
    """1/s: speed for a metre to the goal."""
    turning: float = 2.0
    """rad/s."""
    arrived: float = 0.08
    """m: so near to the goal it turns to the goal's heading."""
    slow: float = 0.1
    """m/s: a goal that moves less stands still."""
    keep: float = 0.8
    """m to everybody's middle."""
    yielding: float = 1.5
    """1/s: of the room that is left beyond `keep`, how much may go in a second."""
    sigmas: float = 2.45
    """Sigmas of uncertainty that are kept besides (95 % in a plane lie within)."""
    largest_sigma: float = 0.4
    """m: who knows no better where it is stands still."""
    stale: float = 0.18
    """s without news of the room after which it stands still."""


class Goal(NamedTuple):
    """Where to be, and how that place moves."""

    ground: Ground
    velocity: Plane = (0.0, 0.0)
    """m/s."""


class Person(NamedTuple):
    """Somebody to keep away from."""

    place: Plane
    """m, common frame."""
    velocity: Plane
    """m/s."""
    sigma: float
    """m: how well the place is known."""


def may_move(state: str, sigma: float, age: float, parameters: SteeringParameters) -> bool:
    """Whether a robot knows enough to move: its state, how well its place is known (m), how old that news is (s)."""
    return state == "registered" and sigma <= parameters.largest_sigma and age <= parameters.stale


def steer(at: Ground, goal: Goal | None, people: Sequence[Person], sigma: float, p: SteeringParameters) -> Twist:
    """What to do now, for a robot that is `at` a place in the common frame, known to `sigma` (m). No goal: stay.

    A velocity u of the steered point is kept such that for each person d/dt distance >= -yielding (distance - keep): a
    control barrier function (Ames et al. 2019), which never lets the distance go below `keep` where motors can follow.
    """
    c, s = cos(at.heading), sin(at.heading)
    point = at.x + p.ahead * c, at.y + p.ahead * s
    wanted = (0.0, 0.0)
    if goal is not None and _is_there(at, goal, p):
        turn = max(-p.turning, min(p.turning, 2.0 * p.gain * wrap_angle(goal.ground.heading - at.heading)))
        wanted = -p.ahead * turn * s, p.ahead * turn * c
    elif goal is not None:
        to_goal = _goal_point(at, goal.ground, point, p)
        wanted = _limited((p.gain * to_goal[0] + goal.velocity[0], p.gain * to_goal[1] + goal.velocity[1]), p.speed)
    bounds = [bound for person in people if (bound := _bound(point, person, sigma, p)) is not None]
    x, y = _kept(wanted, bounds, p.retreat)
    return Twist(x * c + y * s, (y * c - x * s) / p.ahead)


def _is_there(at: Ground, goal: Goal, p: SteeringParameters) -> bool:
    """Whether it is at a goal that stands still: then it turns on the spot."""
    return hypot(goal.ground.x - at.x, goal.ground.y - at.y) < p.arrived and hypot(*goal.velocity) < p.slow


def _goal_point(at: Ground, goal: Ground, point: Plane, p: SteeringParameters) -> Plane:
    """From the steered point to where it is when the axle is at the goal, coming from here."""
    dx, dy = goal.x - at.x, goal.y - at.y
    way = hypot(dx, dy)
    # Far off the point is led along the way; near the goal along its heading, so that it arrives looking right.
    hx, hy = (dx / way, dy / way) if way > 2.0 * p.ahead else (cos(goal.heading), sin(goal.heading))
    return goal.x + p.ahead * hx - point[0], goal.y + p.ahead * hy - point[1]


def _bound(point: Plane, person: Person, sigma: float, p: SteeringParameters) -> tuple[Plane, float] | None:
    """The bound u . n >= least, with n from the person to the robot; None where the two are at one place."""
    dx, dy = point[0] - person.place[0], point[1] - person.place[1]
    distance = hypot(dx, dy)
    if distance < 1e-9:
        return None
    n = dx / distance, dy / distance
    room = distance - p.keep - p.ahead - p.sigmas * hypot(sigma, person.sigma)
    closing = person.velocity[0] * n[0] + person.velocity[1] * n[1]
    return n, closing - p.yielding * room


def _kept(wanted: Plane, bounds: Sequence[tuple[Plane, float]], most: float) -> Plane:
    """The velocity nearest to the wanted one that keeps to all bounds, about as fast as `most`: projected in turn."""
    u = wanted
    for _ in range(50):
        u, worst = _limited(u, most), 0.0
        for n, least in bounds:
            short = least - (u[0] * n[0] + u[1] * n[1])
            if short > 0.0:
                u = u[0] + short * n[0], u[1] + short * n[1]
                worst = max(worst, short)
        if worst < 1e-6:
            break
    return u


def _limited(u: Plane, most: float) -> Plane:
    speed = hypot(*u)
    return u if speed <= most else (u[0] * most / speed, u[1] * most / speed)
