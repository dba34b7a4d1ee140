"""One play of the game: who has collected what since it began."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import hypot

from synchronizar.apps.treasure.game_file import Thing, Walk
from synchronizar.live.messages import Vector

REACH_M = 0.55
"""m in the plane from a device: a coin that is so near is taken."""
TALL_M = 1.5
"""m up or down, the same."""
OBSTACLE_M = 0.45
"""m in the plane: so near somebody runs into an obstacle."""
FREE_AGAIN_S = 2.0
"""s before the same obstacle counts again."""
START_M = 0.6
MOST_POINTS = 240
_POINT_S, _POINT_M = 0.25, 0.1


@dataclass
class Player:
    """What somebody has done."""

    began: float | None
    """s: when it crossed the start, None before."""
    coins: int = 0
    path: list[tuple[float, float, float, float]] = field(default_factory=list)
    hit: dict[str, float] = field(default_factory=dict)
    """When it ran into which obstacle."""


class Playing:
    """Places are in the game's frame."""

    def __init__(self, things: dict[str, Thing], t: float) -> None:
        self.things = things
        self.left = {id_ for id_, thing in things.items() if thing.what in ("coin", "rusted")}
        """Coins that nobody has taken yet."""
        self.players: dict[str, Player] = {}
        self.began, self.ended = t, False

    def go_on(self, t: float, places: dict[str, Vector]) -> list[tuple[str, str]]:
        """At `t` (s) players are at these places; which things were taken or run into, and by whom."""
        out: list[tuple[str, str]] = []
        starts = [thing for thing in self.things.values() if thing.what == "start"]
        for name, place in places.items():
            player = self.players.setdefault(name, Player(None))
            if player.began is None and (not starts or any(_near(s.place, place, START_M) for s in starts)):
                player.began = t
            if player.began is None:
                continue
            _walk_on(player, t - player.began, place)
            out += [(id_, name) for id_ in self._met(player, t, place)]
        self.ended = not any(self.things[id_].what == "coin" for id_ in self.left)
        return out

    def _met(self, player: Player, t: float, place: Vector) -> list[str]:
        met = []
        for id_ in sorted(self.left):
            thing = self.things[id_]
            if _near(thing.place, place, REACH_M):
                self.left.discard(id_)
                player.coins += 1 if thing.what == "coin" else -1
                met.append(id_)
        for id_, thing in self.things.items():
            if thing.what != "obstacle" or not _near(thing.place, place, OBSTACLE_M):
                continue
            if t - player.hit.get(id_, -FREE_AGAIN_S) >= FREE_AGAIN_S:
                player.coins -= 1
                met.append(id_)
            player.hit[id_] = t
        return met

    def walks(self, t: float) -> list[Walk]:
        """How everybody did who has begun."""
        begun = [(name, player) for name, player in self.players.items() if player.began is not None]
        return [Walk(name, p.coins, t - (p.began or 0.0), thinned(p.path)) for name, p in begun]


def thinned(path: list[tuple[float, float, float, float]]) -> list[tuple[float, float, float, float]]:
    """At most so many points that a word can hold them, the first and the last among them."""
    if len(path) <= MOST_POINTS:
        return path
    return [path[round(n * (len(path) - 1) / (MOST_POINTS - 1))] for n in range(MOST_POINTS)]


def _walk_on(player: Player, since: float, place: Vector) -> None:
    x, y, z = (round(v, 2) for v in place)
    if player.path:
        s, *last = player.path[-1]
        if since - s < _POINT_S or hypot(x - last[0], y - last[1]) < _POINT_M:
            return
    player.path.append((round(since, 2), x, y, z))


def _near(a: Vector, b: Vector, reach: float) -> bool:
    return hypot(a[0] - b[0], a[1] - b[1]) < reach and abs(a[2] - b[2]) < TALL_M
