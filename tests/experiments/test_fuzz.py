from __future__ import annotations

import asyncio
from collections import Counter

import pytest

from experiments.live.fuzz import Clock, FuzzError, Watching, fuzz
from synchronizar.live.solver_wire import Pose, Range


def test_rubbish_is_refused_and_the_room_goes_on() -> None:
    told = asyncio.run(fuzz(2000, 3))
    assert told.count == 2000
    assert {"datagram tag", "datagram size", "malformed", "message", "join room"} <= told.refused.keys()
    assert min(told.solver["Pose"], told.solver["Range"]) > 0


@pytest.mark.parametrize(
    "command",
    [
        Pose("alice", 1.8e9, (float("nan"), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
        Pose("nobody", 1.8e9, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
        Range(1.8e9 + 60.0, "alice", "bob", 3.0, {}),
        Range(1.8e9, "alice", "bob", float("inf"), {}),
    ],
)
def test_what_must_not_reach_a_solver_is_seen(command: Pose | Range) -> None:
    watching = Watching(Clock(), lambda: ["alice", "bob"])
    watching.feed(Range(1.8e9, "alice", "bob", 3.0, {}))
    assert watching.counted == Counter(Range=1)
    with pytest.raises(FuzzError):
        watching.feed(command)
