"""Modules in the simulated air, and what a collector makes of their datagrams."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from synchronizar.live.air import Datagram, Frame, Said, events
from synchronizar.live.receiver import Receiver
from synchronizar.live.scenario import Scenario
from synchronizar.live.wire import RangesDatagram
from synchronizar.ranges import Ranges
from synchronizar.user import User

COORDINATES = "coordinates"
"""What a module is said to do once it has begun a network."""


class Collected(NamedTuple):
    """What came to the collector, and what it cannot know."""

    ranges: Ranges
    """By its own clock, which is the simulated time."""
    behind: float
    """s, in truth: how much later than when they were measured ranges are stamped, the delay that all datagrams had."""
    datagrams: int
    dropped: int
    """Ranges that modules gave up because they could not be sent in time."""
    frames: list[Frame]
    """All that was on air, if asked for."""


def collect(scenario: Scenario, users: Sequence[User], frames: bool = False) -> Collected:
    """Run a scenario whose modules are the users', in their order. Raises InputError where that cannot be done."""
    receiver = Receiver(scenario.session, scenario.key, {i: user.name for i, user in enumerate(users)})
    on_air: list[Frame] = []
    truth = _NetworkClocks()
    behind, count = float("inf"), 0
    for event in events(scenario, frames):
        match event:
            case Datagram(t, payload):
                count += 1
                said = receiver.take(payload, t)
                if said is not None and len(said.ranges):
                    behind = min(behind, t - truth.newest(said))
            case Said():
                truth.hear(event)
            case Frame():
                on_air.append(event)
    ranges = receiver.ranges(users)
    return Collected(ranges, behind if len(ranges) else 0.0, count, receiver.dropped, on_air)


class _NetworkClocks:
    """When in simulated time the modules' networks began: at that moment their clocks are at 0."""

    def __init__(self) -> None:
        self._coordinates: dict[int, float] = {}
        self._began: dict[int, float] = {}

    def hear(self, said: Said) -> None:
        if said.what == COORDINATES:
            self._coordinates[said.module] = said.t

    def newest(self, said: RangesDatagram) -> float:
        """When (s) the newest range in a datagram was measured, in simulated time."""
        # The upper half of an epoch is the address of who began it, and may begin another one later.
        began = self._began.setdefault(said.epoch, self._coordinates[said.epoch >> 16])
        return began + 1e-9 * said.time_ns + 1e-6 * float(said.ranges["offset_us"].max())
