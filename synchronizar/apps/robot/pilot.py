"""What a robot knows of its room, and from that the command for its motors. No network and no clock of its own."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from math import inf

from synchronizar.apps.bodies.drive import STOP, Ground, Twist
from synchronizar.apps.bodies.steering import Goal, Person, Plane, SteeringParameters, may_move, steer
from synchronizar.apps.robot.mirror import Mirror, beside

_SPEED_OVER_S = 0.2
"""s over which somebody's speed is measured."""
_FASTEST = 2.0
"""m/s: a place that moves faster was corrected, nobody walks so fast."""
_FRESH_S = 1.0
_FORGOTTEN_S = 10.0
"""s without news after which somebody has left."""


@dataclass
class _Seen:
    """Somebody's last places."""

    places: deque[tuple[float, Plane]] = field(default_factory=lambda: deque(maxlen=32))
    heading: float = 0.0
    sigma: float = 0.0


class Pilot:
    """One robot's."""

    def __init__(self, parameters: SteeringParameters | None = None) -> None:
        self.parameters = parameters or SteeringParameters()
        self.whom: str | None = None
        """Whose image it is, or to whom it comes."""
        self.mirror: Mirror | None = None
        """Where it mirrors; None: it comes to `whom`."""
        self.goal: Ground | None = None
        """Where it last wanted to be."""
        self._seen: dict[str, _Seen] = {}
        self._state, self._sigma, self._heard = "disconnected", inf, -inf

    def own(self, t: float, state: str, sigma: float) -> None:
        """At `t` (s) the room says of this robot that its frame is in a state, and known to `sigma` (m)."""
        self._state, self._sigma, self._heard = state, sigma, t

    def person(self, t: float, name: str, place: Ground, sigma: float) -> None:
        """Somebody was there at `t`, in the common frame."""
        seen = self._seen.setdefault(name, _Seen())
        if not seen.places or t > seen.places[-1][0]:
            seen.places.append((t, (place.x, place.y)))
            seen.heading, seen.sigma = place.heading, sigma

    @property
    def places(self) -> dict[str, Plane]:
        """Where everybody was seen just now, by name."""
        last = {name: seen.places[-1] for name, seen in self._seen.items()}
        return {name: place for name, (t, place) in last.items() if self._heard - t < _FRESH_S}

    def twist(self, t: float, at: Ground) -> Twist:
        """The command at `t` for a robot whose own odometry, in the common frame, has it `at` a place."""
        p = self.parameters
        if not may_move(self._state, self._sigma, t - self._heard, p):
            return STOP
        self._seen = {name: seen for name, seen in self._seen.items() if t - seen.places[-1][0] < _FORGOTTEN_S}
        people = {name: _now(seen, t) for name, seen in self._seen.items()}
        goal = self._goal(at, people)
        self.goal = None if goal is None else goal.ground
        return steer(at, goal, list(people.values()), self._sigma, p)

    def _goal(self, at: Ground, people: dict[str, Person]) -> Goal | None:
        if self.whom is None or self.whom not in people:
            return None
        person = people[self.whom]
        whom = Ground(*person.place, self._seen[self.whom].heading)
        if self.mirror is not None:
            return Goal(self.mirror.image(whom), self.mirror.turned(person.velocity))
        return Goal(beside(whom, at, self.parameters.keep + 0.3))


def _now(seen: _Seen, t: float) -> Person:
    """Where somebody is by now who went on as before; the longer ago the less sure."""
    last, place = seen.places[-1]
    vx, vy = _velocity(seen)
    age = max(0.0, t - last)
    ahead = min(age, 0.5)
    return Person((place[0] + vx * ahead, place[1] + vy * ahead), (vx, vy), seen.sigma + 0.3 * age)


def _velocity(seen: _Seen) -> Plane:
    last, place = seen.places[-1]
    recent = [(t, p) for t, p in seen.places if last - t <= _SPEED_OVER_S]
    first, begin = recent[0]
    if last - first < 0.03:
        return 0.0, 0.0
    vx, vy = (place[0] - begin[0]) / (last - first), (place[1] - begin[1]) / (last - first)
    speed = (vx * vx + vy * vy) ** 0.5
    return (0.0, 0.0) if speed > _FASTEST else (vx, vy)
