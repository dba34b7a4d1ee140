"""Modules in the simulated air, and what a collector makes of their datagrams."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from synchronizar.data.ranges import Ranges
from synchronizar.data.user import User
from synchronizar.io.receiver import Receiver
from synchronizar.simulation.air import Frame, events
from synchronizar.simulation.scenario import Scenario


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
    measured: list[float] = []
    count = 0
    for event in events(scenario, frames):
        if isinstance(event, Frame):
            on_air.append(event)
            continue
        count += 1
        said = receiver.take(event.payload, event.t)
        if said is not None and len(said.ranges):
            measured.append(event.measured)
    late = receiver.newest() - np.array(measured)
    late = late[np.isfinite(late)]
    behind = float(late.mean()) if len(late) else 0.0
    return Collected(receiver.ranges(users), behind, count, receiver.dropped, on_air)
