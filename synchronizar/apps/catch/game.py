"""The game: who holds the ball, where it flies, who catches it, how often without a drop."""

from __future__ import annotations

from collections.abc import Mapping
from math import acos, atan2, dist, hypot, isfinite, pi
from typing import Any

from synchronizar.apps.catch.flight import Flight, Vector, throw_to
from synchronizar.geometry import wrap_angle
from synchronizar.live.applications import Application
from synchronizar.live.stage import Player, Stage

BALL, SCORE = "catch ball", "catch score"
SLOWEST, FASTEST = 1.5, 8.0
"""m/s."""
REACH_M, BLIND_REACH_M = 0.7, 0.35
"""m from a hand: so near a ball is caught by who looks at it, and by who does not."""
AIM = pi / 4.0
"""rad between where a device looks and where the ball comes from, at most, for the longer reach."""
OWN_THROW_S = 0.4
"""s in which whoever has thrown it cannot catch it."""
HELP = pi / 9.0
"""rad: a throw that passes somebody by less goes to that hand."""
PICK_UP_M = 0.8
"""m in the plane: so near to somebody a ball that lies is picked up."""
LIES_S = 8.0
"""s after which a ball that nobody picks up comes to who is nearest."""
GONE_S = 3.0
"""s after which whoever holds it and is no longer registered loses it."""
SMOOTHED_S = 0.3
"""s over which everybody's velocity is smoothed."""
LEAD_S = 1.5
"""s for which somebody is taken to go on as before, at most."""
STILL: Vector = (0.0, 0.0, 0.0)
CARRIED_AT_M = 1.35
"""m above the floor, about: where people hold a phone."""


class Catch(Application):
    """Catch with two to eight people, or robots."""

    title = "Catch"
    summary = "Throw a ball by pointing and swinging; whoever it comes to catches it."
    kinds = (BALL, SCORE)

    def __init__(self) -> None:
        self._phase = "waits"
        self._holder: str | None = None
        self._thrower: str | None = None
        self._flight: Flight | None = None
        self._since = 0.0
        self._looked_at = 0.0
        self._rally = self._best = 0
        self._caught: dict[str, int] = {}
        self._floor: float | None = None
        self._walks: dict[str, tuple[Vector, Vector]] = {}
        """Everybody's last place and velocity (m, m/s)."""

    def begin(self, stage: Stage) -> None:
        """Go on where the objects say that it is."""
        self._looked_at = self._since = stage.t
        if (score := stage.objects.get(SCORE)) is not None and isinstance(score.data, Mapping):
            self._best, self._caught = int(score.data["best"]), dict(score.data["caught"])
            self._floor = score.data["floor"]
        if BALL in stage.objects:
            stage.remove(BALL)
        if score is not None:
            stage.remove(SCORE)

    def said(self, stage: Stage, by: str, topic: str, data: Any) -> None:
        """`throw` {"velocity": m/s in the common frame} of whoever holds the ball; `again` of anybody: from nought."""
        if topic == "throw" and by == self._holder and by in stage.players:
            if (velocity := _vector(data)) is not None:
                self._throw(stage, stage.players[by], velocity)
        elif topic == "again" and by:
            self._rally, self._best, self._caught = 0, 0, {}
            self._tell(stage)

    def tick(self, stage: Stage) -> None:
        """Go on to now."""
        self._watch(stage)
        if self._floor is None and stage.players:
            heights = sorted(player.position[2] for player in stage.players.values())
            self._floor = heights[len(heights) // 2] - CARRIED_AT_M
        if self._phase == "held":
            self._held(stage)
        elif self._phase == "flies":
            self._flies(stage)
        elif self._phase == "lies":
            self._lies(stage)
        if self._phase == "waits" and len(stage.players) >= 2:
            self._hand_to(stage, min(stage.players))
        self._looked_at = stage.t

    def _watch(self, stage: Stage) -> None:
        """How everybody walks, smoothed over a third of a second."""
        dt = stage.t - self._looked_at
        if dt <= 0.0:
            return
        share, walks = min(1.0, dt / SMOOTHED_S), {}
        for name, player in stage.players.items():
            place, before = self._walks.get(name, (player.position, STILL))
            now = [(b - a) / dt for a, b in zip(place, player.position, strict=True)]
            vx, vy, vz = (v + share * (n - v) for v, n in zip(before, now, strict=True))
            walks[name] = player.position, (vx, vy, vz)
        self._walks = walks

    def _held(self, stage: Stage) -> None:
        assert self._holder is not None
        if self._holder in stage.players:
            self._since = stage.t
        elif stage.t - self._since > GONE_S:
            self._wait_or_hand_on(stage)

    def _flies(self, stage: Stage) -> None:
        flight, floor = self._flight, self._floor
        assert flight is not None
        assert floor is not None
        lands = flight.lands(floor)
        end = min(stage.t, lands)
        reached: list[tuple[float, str]] = []
        for name, player in stage.players.items():
            begin = max(self._looked_at, flight.t)
            if name == self._thrower:
                begin = max(begin, flight.t + OWN_THROW_S)
            if begin > end:
                continue
            when, near = flight.nearest(player.hand, begin, end)
            if near <= (REACH_M if _looks_at(player, flight.at(when)) else BLIND_REACH_M):
                reached.append((when, name))
        if reached:
            _, catcher = min(reached)
            self._rally += catcher != self._thrower
            self._best = max(self._best, self._rally)
            self._caught[catcher] = self._caught.get(catcher, 0) + (catcher != self._thrower)
            self._hand_to(stage, catcher)
        elif lands <= stage.t:
            x, y, _ = flight.at(lands)
            self._phase, self._since, self._flight, self._rally = "lies", lands, None, 0
            stage.move(BALL, (x, y, floor), data={"phase": "lies"})
            self._tell(stage)

    def _lies(self, stage: Stage) -> None:
        place = stage.objects[BALL].position
        near = sorted(
            (hypot(p.position[0] - place[0], p.position[1] - place[1]), name) for name, p in stage.players.items()
        )
        if near and (near[0][0] < PICK_UP_M or stage.t - self._since > LIES_S):
            self._hand_to(stage, near[0][1])

    def _throw(self, stage: Stage, player: Player, velocity: Vector) -> None:
        hand = player.hand
        others = [
            (other.hand, self._walks.get(name, (hand, STILL))[1])
            for name, other in stage.players.items()
            if name != player.name
        ]
        self._flight = Flight(stage.t, hand, _helped(hand, velocity, others))
        self._phase, self._thrower, self._holder = "flies", player.name, None
        flown = {"t": stage.t, "position": hand, "velocity": self._flight.velocity}
        stage.move(BALL, hand, velocity=self._flight.velocity, data={"phase": "flies", "by": player.name} | flown)

    def _hand_to(self, stage: Stage, name: str) -> None:
        self._phase, self._holder, self._flight, self._since = "held", name, None, stage.t
        data = {"phase": "held", "by": name}
        if BALL in stage.objects:
            stage.move(BALL, stage.players[name].hand, data=data)
        else:
            stage.create(BALL, BALL, stage.players[name].hand, data=data)
        self._tell(stage)

    def _wait_or_hand_on(self, stage: Stage) -> None:
        self._holder, self._rally = None, 0
        if stage.players:
            place = stage.objects[BALL].position
            self._hand_to(stage, min(stage.players, key=lambda name: dist(place, stage.players[name].position)))
        else:
            self._phase = "waits"
            stage.remove(BALL)

    def _tell(self, stage: Stage) -> None:
        data = {"rally": self._rally, "best": self._best, "caught": self._caught, "floor": self._floor}
        if SCORE in stage.objects:
            stage.move(SCORE, data=data)
        else:
            stage.create(SCORE, SCORE, (0.0, 0.0, 0.0), data=data)


def _looks_at(player: Player, place: Vector) -> bool:
    to = [b - a for a, b in zip(player.position, place, strict=True)]
    length = hypot(*to)
    return length < 1e-6 or acos(max(-1.0, min(1.0, sum(map(float.__mul__, player.forward, to)) / length))) < AIM


def _helped(hand: Vector, velocity: Vector, others: list[tuple[Vector, Vector]]) -> Vector:
    """A throw with a friendly speed, and to whoever it would nearly have come to: where that hand then is.

    `others`: hands, and how they move.
    """
    speed = hypot(*velocity)
    slowed = max(SLOWEST, min(FASTEST, speed))
    if speed < 1e-6:
        return 0.0, 0.0, slowed
    wanted = atan2(velocity[1], velocity[0])
    ways = [(abs(wrap_angle(atan2(o[1] - hand[1], o[0] - hand[0]) - wanted)), o, walks) for o, walks in others]
    if hypot(velocity[0], velocity[1]) > 0.3 * speed and ways and min(ways)[0] < HELP:
        _, there, walks = min(ways)
        goal = there
        for _ in range(3):
            away = hypot(goal[0] - hand[0], goal[1] - hand[1])
            thrown = throw_to(hand, goal, max(slowed, min(FASTEST, (3.0 * away) ** 0.5 + 0.5)))
            flies = min(LEAD_S, away / max(1e-3, hypot(thrown[0], thrown[1])))
            x, y, z = (p + v * flies for p, v in zip(there, walks, strict=True))
            goal = x, y, z
        return thrown
    x, y, z = (slowed / speed * v for v in velocity)
    return x, y, z


def _vector(data: Any) -> Vector | None:
    values = data.get("velocity") if isinstance(data, Mapping) else None
    if not isinstance(values, list) or len(values) != 3:
        return None
    if not all(isinstance(v, int | float) and isfinite(v) and abs(v) < 1e3 for v in values):
        return None
    x, y, z = map(float, values)
    return x, y, z
