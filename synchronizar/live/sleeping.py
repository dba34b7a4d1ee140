"""When modules sleep: as soon as nobody needs their ranges, and no longer than until somebody does.

Somebody needs ranges until they have been registered, sure of their place and undoubted for a while; and again when
they are doubted, or less sure than they may become. The modules of whom they range with are awake as long. Who is in
need and has ranged with nobody, as one who joins while all others sleep, has everybody woken: whom they are near nobody
knows. One whose module has not been heard for a while, empty or carried off, keeps nobody awake.

An order can only answer a datagram, and a module that sleeps sends none. So sleep is a nap, until a moment that is the
same for all: then all range for a second, which keeps drift at bay, and are told to range on or to sleep again.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from math import floor, inf
from typing import NamedTuple

from synchronizar.parameters import SleepParameters

RANGE_ON = 0
"""Order: range on."""


class Standing(NamedTuple):
    """What is known of a user whose device ranges."""

    registered: bool
    sigma: float
    """m: 1 sigma of its place in the plane."""
    doubted: bool = False
    """Whether something speaks against its place, as a correction larger than its sigma."""


@dataclass
class _Known:
    """What is kept of a user. Times s."""

    calm_since: float | None = None
    """Since when nothing asks for ranges."""
    settled: bool = False
    heard: float = -inf
    """Latest datagram of its module, or range with it."""
    spoke: float = -inf
    """Latest datagram of its module."""
    woke: float = -inf
    """The first after it said nothing."""
    answered: float = -inf
    sleeps: bool = False
    """What it was told then."""


class Sleeping:
    """Decides for all modules of one room; deterministic in what it is told. Times are the room's (s)."""

    def __init__(self, parameters: SleepParameters | None = None) -> None:
        self._parameters = parameters or SleepParameters()
        self._known: defaultdict[str, _Known] = defaultdict(_Known)
        self._ranged: dict[tuple[str, str], float] = {}
        self._awake: dict[str, str] = {}

    @property
    def awake(self) -> Mapping[str, str]:
        """Whose modules have to be awake, and whose need that is."""
        return self._awake

    def ranged(self, t: float, a: str, b: str) -> None:
        """There was a range between two users."""
        self._ranged[min(a, b), max(a, b)] = self._known[a].heard = self._known[b].heard = t

    def update(self, t: float, users: Mapping[str, Standing]) -> None:
        """How all users stand now; who is not among them has left, and needs nothing."""
        p = self._parameters
        for user, standing in users.items():
            known = self._known[user]
            most = p.wake_sigma if known.settled else p.sigma
            if not standing.registered or standing.doubted or not standing.sigma <= most:
                known.calm_since = None
            elif known.calm_since is None:
                known.calm_since = t
            known.settled = known.calm_since is not None and t - known.calm_since >= p.settled
        for user in self._known.keys() - users.keys():
            self._known[user].calm_since, self._known[user].settled = None, False
            if t - self._known[user].heard > p.partners:
                del self._known[user]
        self._ranged = {
            (a, b): at for (a, b), at in self._ranged.items() if t - at <= p.partners and a in users and b in users
        }
        self._awake = self._needed(t, users)

    def answer(self, t: float, user: str) -> int | None:
        """The order that answers a datagram of a user's module: s to sleep, RANGE_ON, or None where none is due.

        Orders are repeated, since a datagram may be lost, and since a module that is told nothing sleeps by itself.
        """
        p, known = self._parameters, self._known[user]
        if t - known.spoke > p.gone:
            known.woke = t
        known.spoke = known.heard = t
        sleeps = user not in self._awake
        if sleeps and t - known.woke < p.glance:
            return None
        if sleeps == known.sleeps and t - known.answered < (p.sleep_every if sleeps else p.range_on_every):
            return None
        known.answered, known.sleeps = t, sleeps
        return self.nap(t) if sleeps else RANGE_ON

    def is_asleep(self, t: float, user: str) -> bool:
        """Whether a user's module was told to sleep, and is not due to wake yet."""
        known = self._known.get(user, _Known())
        return known.sleeps and t < known.answered + self.nap(known.answered)

    def nap(self, t: float) -> int:
        """From t to the end of a nap, which all share: s to the next multiple of `nap` that is not too near."""
        p = self._parameters
        return max(round((floor((t + p.shortest_nap) / p.nap) + 1) * p.nap - t), 1)

    def _needed(self, t: float, users: Mapping[str, Standing]) -> dict[str, str]:
        """Whose modules have to be awake, and whose need that is."""
        needed: dict[str, str] = {}
        partners: defaultdict[str, list[str]] = defaultdict(list)
        for a, b in self._ranged:
            partners[a].append(b)
            partners[b].append(a)
        lonely = None
        for user in users:
            if self._known[user].settled or t - self._known[user].heard > self._parameters.unheard:
                continue
            needed[user] = user
            for partner in partners[user]:
                needed.setdefault(partner, user)
            lonely = lonely or (None if partners[user] else user)
        if lonely is not None:
            for user in users:
                needed.setdefault(user, lonely)
        return needed


def standing_of(state: str, sigma: float | None, doubted: bool = False) -> Standing:
    """Of what a room tells of a user; without a sigma nobody is sure."""
    return Standing(state == "registered", inf if sigma is None else sigma, doubted)
