"""From entering a room to being registered: the wall clock beside the data.

`python -m experiments.live.entering [--users 2 4] [--seeds 3] [--seconds 20]`: a walk is said to a server as it comes,
poses and ranges of all by one client, and a client that only looks notes when it is told that somebody is registered.
Beside that stands after how much data an `Estimator` without server, of one thread, says so of the same walk. Told are
both, medians and the longest, and by how much the room is later than the data, at most (bar: 1 s).
"""

from __future__ import annotations

import argparse
import asyncio
import os
import time
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from experiments.common.live import estimator_of, fed, first_registered, one_at_a_time, told
from experiments.common.results import write_table
from experiments.live.walkers import server, walk
from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.live import Client
from synchronizar.live import messages as m
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

SECONDS = 20.0
USERS, SEEDS = (2, 4), 3


class Task(NamedTuple):
    """One walk."""

    users: int
    seed: int
    seconds: float


class Entered(NamedTuple):
    """(k - 1,) s after the first range, of all but the reference; infinite for never."""

    data: Array
    wall: Array


def enter(task: Task) -> Entered:
    """One walk, without a server and with one."""
    recording = simulate(Scene(users=task.users, seconds=task.seconds, seed=task.seed)).recording
    estimator = estimator_of(recording)
    of = told(recording, fed(recording, estimator), estimator)
    others = [name for name in recording.tracks if name != of.reference]
    with server() as where:
        wall = asyncio.run(_said_to(where["join"], recording, task.seconds))
    return Entered(
        np.array([first_registered(of, name) for name in others]), np.array([wall.get(name, np.inf) for name in others])
    )


async def _said_to(address: str, recording: Recording, seconds: float) -> dict[str, float]:
    """By name, s after the first range: when each was told to be registered."""
    names = list(recording.tracks)
    wall: dict[str, float] = {}
    async with await Client.join(address) as watching, await Client.join(address, names) as client:
        began = time.time() + 0.5
        first = began + float(recording.ranges.t.min())
        walking = asyncio.create_task(walk(client, recording, names, began))
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds + 3.0):
                async for message in watching.messages():
                    if not isinstance(message, m.Frames):
                        continue
                    for name, user in message.users.items():
                        if user.state == "registered" and name not in wall:
                            wall[name] = time.time() - first
                    if len(wall) == len(names):
                        break
        walking.cancel()
        with suppress(asyncio.CancelledError):
            await walking
    return wall


def row_of(users: int, walks: list[Entered]) -> dict[str, Any]:
    """A line of the table."""
    data, wall = (np.concatenate([getattr(w, of) for w in walks]) for of in ("data", "wall"))
    both = np.isfinite(data)
    return {
        "users": users,
        "n": len(walks),
        "median s of data": float(np.median(data)),
        "longest": float(data.max()),
        "median s of wall": float(np.median(wall)),
        "longest, wall": float(wall.max()),
        "wall later than data by s, median": float(np.median(wall[both] - data[both])) if both.any() else None,
        "at most": float((wall[both] - data[both]).max()) if both.any() else None,
    }


def rows_of(users: tuple[int, ...], seeds: int, seconds: float) -> list[dict[str, Any]]:
    """The table; one walk at a time."""
    return [
        row_of(count, list(one_at_a_time(enter, [Task(count, seed, seconds) for seed in range(seeds)])))
        for count in users
    ]


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--users", type=int, nargs="+", default=list(USERS))
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    options = parser.parse_args()
    rows = rows_of(tuple(options.users), options.seeds, options.seconds)
    print(write_table("entering", rows, {**vars(options), "cores": os.cpu_count(), "load": os.getloadavg()}))


if __name__ == "__main__":
    main()
