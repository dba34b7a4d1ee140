"""kill -9 of the server, of a room's solver, of its search: what is lost, who comes back, what is left running.

`python -m experiments.live.kills [--what server solver search] [--kills 10] [--users 4] [--seed 0]`: walkers with
poses 30 times a second and ranges between all, native clients that join again with their secrets where their connection
ends; a room that is recorded. Kills come at random moments (seeded): one before anybody is registered, each further one
0.5 to 4 s after all who were registered at the last one are so again.

Told of each: the oldest pose or range that was said before a kill and is not in the recording, and how many are missing
that were said more than a second before it; how long after a kill all who were registered then are told to be so again,
from what came after it (median and longest); the longest time in which a client heard no poses; how many processes of
the killed one still ran 5 s later.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
import socket
import sys
import tempfile
import time
from asyncio.subprocess import Process
from bisect import bisect_right
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments.common.cpu import processes_below
from experiments.common.markdown import markdown
from experiments.common.results import write_table
from synchronizar.data.recording import Recording
from synchronizar.errors import InputError
from synchronizar.live import Client
from synchronizar.live import messages as m
from synchronizar.live.pose_wire import PosesDown
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

WHAT = ("server", "solver", "search")
LONGEST_S = 600.0
BEAT_S = 0.04
LEFT_AFTER_S = 5.0
GIVEN_UP_S = 30.0
"""s after which somebody who is not registered again is not waited for."""
LOST_S = 1.0


class Said(NamedTuple):
    """A pose or range that a client has sent."""

    wall: float
    """s since 1970."""
    key: tuple[str, ...]
    """By which it is found in the recording."""


@dataclass
class House:
    """A server that is begun again where it was killed."""

    folder: Path
    port: int
    process: Process | None = None
    join: str = ""
    up: asyncio.Event = field(default_factory=asyncio.Event)

    async def start(self, *options: str) -> None:
        """Begin it."""
        words = ["serve", "--json", "--no-tls", "--host", "127.0.0.1", "--port", str(self.port), "--udp-port", "0"]
        environment = {**os.environ, "XDG_STATE_HOME": str(self.folder / "state")}
        self.process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "synchronizar", *words, "--record", str(self.folder / "rooms"), *options),
            stdout=asyncio.subprocess.PIPE,
            env=environment,
        )
        assert self.process.stdout is not None
        self.join = json.loads(await self.process.stdout.readline())["join"]
        self.up.set()

    def find(self, what: str) -> int | None:
        """The process to be killed; None where there is none now."""
        assert self.process is not None
        if what == "server":
            return self.process.pid
        module = {"solver": "synchronizar.live.estimating", "search": "synchronizar.estimation.incremental.worker"}
        for number in processes_below(self.process.pid):
            with suppress(OSError):
                if module[what].encode() in Path(f"/proc/{number}/cmdline").read_bytes():
                    return number
        return None


@dataclass
class Watched:
    """What a client that only looks has heard."""

    frames: m.Frames | None = None
    quiet: float = 0.0
    """s: the longest time without poses, while the server was there."""


async def walk(house: House, recording: Recording, name: str, began: float, said: list[Said]) -> None:
    """A device that walks, and joins again with its secret."""
    track, resume = recording.tracks[name], None
    ranges, names = recording.ranges, [user.name for user in recording.users]
    own = [row for row in range(len(ranges)) if names[ranges.a[row]] == name]
    stamps, at = track.t.tolist(), ranges.t[own].tolist()
    while True:
        await house.up.wait()
        try:
            async with await Client.join(house.join, [name], resume=resume) as client:
                resume = client.resume
                hearing = asyncio.create_task(_hear(client))
                now = time.time() - began
                pose, row = bisect_right(stamps, now), bisect_right(at, now)
                while not hearing.done():
                    now = time.time() - began
                    upto = bisect_right(stamps, now)
                    poses = [
                        (name, began + stamps[i], track.position[i].tolist(), track.quat_xyzw[i].tolist())
                        for i in range(pose, upto)
                    ]
                    pose = upto
                    await client.send_poses(poses)
                    said += [Said(time.time(), _key(xyz)) for _, _, xyz, _ in poses]
                    upto = bisect_right(at, now)
                    measured = [
                        m.MeasuredRange(began + at[i], name, names[ranges.b[own[i]]], float(ranges.distance[own[i]]))
                        for i in range(row, upto)
                        if at[i] > 1.0 and names[ranges.b[own[i]]] in client.members  # who has said where it is
                    ]
                    row = upto
                    if measured:
                        await client.send_ranges(measured)
                        said += [Said(time.time(), _key([one.distance])) for one in measured]
                    await asyncio.sleep(BEAT_S)
        except (InputError, ConnectionError):
            await asyncio.sleep(0.1)


def _key(numbers: Sequence[float]) -> tuple[str, ...]:
    """As they are written."""
    return tuple(f"{number:.9f}" for number in numbers)


async def _hear(client: Client) -> None:
    async for _ in client.messages():
        pass


async def watch(house: House, watched: Watched) -> None:
    """Somebody who looks, and joins again."""
    while True:
        await house.up.wait()
        with suppress(InputError, ConnectionError):
            async with await Client.join(house.join) as client:
                last = None
                async for message in client.messages():
                    if isinstance(message, PosesDown):
                        now = time.time()
                        if last is not None:
                            watched.quiet = max(watched.quiet, now - last)
                        last = now
                    watched.frames = client.frames
        await asyncio.sleep(0.05)


class Killed(NamedTuple):
    """One kill."""

    at: float
    """s since 1970."""
    back: float
    """s until all were registered again who were so; infinite for never, NaN where nobody was."""
    left: int
    """Processes of it that still ran."""
    up: float
    """s since 1970: when there was a server again; what was said to none until then is not lost by one."""


def registered(frames: m.Frames | None) -> set[str]:
    """Whose frames are known."""
    return set() if frames is None else {name for name, user in frames.users.items() if user.state == "registered"}


async def kill(house: House, what: str, watched: Watched) -> Killed | None:
    """Kill it, and see how all go on; None where there is nothing to kill."""
    number = house.find(what)
    if number is None:
        return None
    before, below = registered(watched.frames), processes_below(number)
    at = time.time()
    os.kill(number, signal.SIGKILL)
    left = asyncio.create_task(_left(below))
    if what == "server":
        assert house.process is not None
        house.up.clear()
        await house.process.wait()
        watched.frames = None
        await house.start("--resume")
    up, back = time.time() if what == "server" else at, np.inf
    while time.time() - at < GIVEN_UP_S:
        if watched.frames is not None and watched.frames.t > at and before <= registered(watched.frames):
            back = time.time() - at
            break
        await asyncio.sleep(0.02)
    return Killed(at, back if before else np.nan, await left, up)


async def _left(processes: list[int]) -> int:
    await asyncio.sleep(LEFT_AFTER_S)
    return sum(Path(f"/proc/{number}").exists() for number in processes)


async def session(what: str, kills: int, users: int, seed: int) -> dict[str, Any]:
    """A line of the table."""
    random = np.random.default_rng([seed, WHAT.index(what)])
    recording = simulate(Scene(users=users, seconds=LONGEST_S, seed=seed)).recording
    said: list[Said] = []
    killed: list[Killed] = []
    watched = Watched()
    with tempfile.TemporaryDirectory() as folder:
        house = House(Path(folder), _free_port())
        await house.start()
        began = time.time() + 0.5
        people = [asyncio.create_task(walk(house, recording, name, began, said)) for name in recording.tracks]
        people.append(asyncio.create_task(watch(house, watched)))
        await asyncio.sleep(float(random.uniform(1.5, 5.0)))
        while len(killed) < kills and time.time() - began < LONGEST_S - GIVEN_UP_S:
            one = await kill(house, what, watched)
            if one is None:
                await asyncio.sleep(0.2)
                continue
            killed.append(one)
            print(f"{what}: killed at {one.at - began:.1f} s, back after {one.back:.2f} s, left {one.left}", flush=True)
            if np.isnan(one.back):
                await _until_all(watched, users)
            await asyncio.sleep(float(random.uniform(0.5, 4.0)))
        for person in people:
            person.cancel()
        await asyncio.gather(*people, return_exceptions=True)
        end = time.time()
        assert house.process is not None
        house.process.terminate()
        await house.process.wait()
        (room,) = (house.folder / "rooms").iterdir()
        oldest, older = lost(said, Recording.load(room), killed, end)
    back = np.array([one.back for one in killed if not np.isnan(one.back)])
    return {
        "killed": what,
        "times": len(killed),
        "said": len(said),
        "oldest lost, s before": oldest,
        f"lost, older than {LOST_S:.0f} s": older,
        "back after s, median": float(np.median(back)) if len(back) else None,
        "longest": float(back.max()) if len(back) else None,
        "longest without poses, s": watched.quiet,
        "left running": sum(one.left for one in killed),
        "load": os.getloadavg()[0],
    }


async def _until_all(watched: Watched, users: int) -> None:
    until = time.time() + GIVEN_UP_S
    while len(registered(watched.frames)) < users and time.time() < until:
        await asyncio.sleep(0.05)


def lost(said: list[Said], recorded: Recording, killed: list[Killed], end: float) -> tuple[float, int]:
    """How old (s) the oldest was at the next kill that is not in the recording, and how many were older than 1 s."""
    there = {_key(row) for track in recorded.tracks.values() for row in track.position.tolist()}
    there |= {_key([distance]) for distance in recorded.ranges.distance.tolist()}
    ages = [
        min((one.at for one in killed if one.at >= word.wall), default=end) - word.wall
        for word in said
        if word.key not in there and not any(one.at <= word.wall <= one.up for one in killed)
    ]
    return max(ages, default=0.0), sum(age > LOST_S for age in ages)


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--what", nargs="+", choices=WHAT, default=list(WHAT))
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--users", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rows = [asyncio.run(session(what, options.kills, options.users, options.seed)) for what in options.what]
    write_table("kills", rows, {**vars(options), "cores": os.cpu_count(), "load": os.getloadavg()})
    print(markdown(rows, digits=2))


if __name__ == "__main__":
    main()
