"""Runs modules in the simulated air and collects their datagrams as ranges."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from synchronizar.data.ranges import Ranges
from synchronizar.data.user import User
from synchronizar.io.datagrams import RangesDatagram
from synchronizar.io.receiver import Receiver, ranges_of, stamp_all
from synchronizar.simulation.air import Frame, events
from synchronizar.simulation.scenario import Scenario


class Collected(NamedTuple):
    """Ranges that the collector received, with what only the simulation knows."""

    ranges: Ranges
    """Ranges, stamped by the collector's clock, which is simulated time."""
    behind: float
    """s: true mean delay of the ranges' stamps after their measurement, the delay that all datagrams share."""
    datagrams: int
    dropped: int
    """Ranges that modules dropped because they could not send them in time."""
    frames: list[Frame]
    """Frames on air, where asked for."""


def collect(scenario: Scenario, users: Sequence[User], frames: bool = False) -> Collected:
    """Ranges from a scenario whose modules are those of `users`, in their order. Raises InputError as `events` does."""
    receiver = Receiver(scenario.keys())
    told: list[RangesDatagram] = []
    arrived: list[float] = []
    on_air: list[Frame] = []
    measured: list[float] = []
    count = 0
    for event in events(scenario, frames):
        if isinstance(event, Frame):
            on_air.append(event)
            continue
        count += 1
        taken = receiver.take(event.payload, event.t)
        if taken is not None and len(taken.datagram.ranges):
            told.append(taken.datagram)
            arrived.append(event.t)
            measured.append(event.measured)
    stamped = stamp_all(told, arrived)
    delay = np.array([one.t.max() for one in stamped]) - np.array(measured)
    delay = delay[np.isfinite(delay)]
    behind = float(delay.mean()) if len(delay) else 0.0
    ranges = ranges_of(stamped, users, {i: user.name for i, user in enumerate(users)})
    return Collected(ranges, behind, count, receiver.dropped, on_air)
