"""A room with as many devices as it holds: how late the server is, what arrives and how soon, what it holds of memory.

`python -m experiments.live.load [--devices 32] [--minutes 10] [--air 11] [--generators 2] [--grow]`: native
clients in processes of their own, each device with poses 60 times a second, walking loops in SLAM that drifts not at
all; ranges of `--air` devices by their modules' firmware in the live air (as often as that ranges), of the others by
datagrams of a module of theirs, encoded as on the wire, whose truth is the same walk: each ranges to its five
neighbours on either side 10 times a second. Every device says a number that rises to the next one, once a second, and
the first one to everybody.

Told are the server's own word of how late its loop is (p50 and p99 of the last minute, the worst minute); the time from
a pose's stamp to its arrival at another client, p50 and p99 over everybody's poses at everybody; words that were lost;
how far the solver is behind, median, p99 and most; resident memory (MB) of the server and of solvers after the first
minute and at the end; CPU (cores) of the server, of solvers and of searches; how many are registered at the end.
Besides, each `--every` s: memory of each kind of process, how many are registered, and how far the solver is behind.
`--grow`: 32, 48, 64, ... devices, a shorter time each, 64 to a room, until a bar breaks: loop
p99 20 ms, poses p99 60 ms, nothing lost.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import socket
import sys
import tempfile
import time
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from contextlib import AsyncExitStack, ExitStack, suppress
from functools import cache, partial
from itertools import pairwise
from multiprocessing import get_context
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import aiohttp
import numpy as np
from numpy.typing import NDArray

from experiments.common.cpu import Usage, usage_by_kind
from experiments.common.markdown import markdown
from experiments.common.results import write_table
from synchronizar.arrays import Array
from synchronizar.io.datagrams import MEASURED, RANGE, SIGHT_UNKNOWN, RangesDatagram, encode_ranges
from synchronizar.live import Client
from synchronizar.live import messages as m
from synchronizar.live.pose_wire import PosesDown
from synchronizar.quaternions import yaw_quaternion
from synchronizar.simulation.live_air import Carried, LiveAir

POSES_HZ, RANGES_HZ, WORDS_HZ = 60.0, 10.0, 1.0
EACH_SIDE = 5
"""Neighbours on either side, to whom a device ranges."""
SIGMA_M, RANGE_OF_STAMP = 0.05, 1.5
AREA_M = (12.0, 9.0)
EPOCH = 7
MOST_IN_A_ROOM = 64
SETTLED_S = 5.0
"""s from the beginning that are not judged."""
QUIET_S = 3.0
"""s before the end in which nothing is said any more, so that nothing is on its way then."""
LOOP_MS, POSES_MS = 20.0, 60.0
BINS_MS = 2000
Counts = NDArray[np.int64]


class Task(NamedTuple):
    """What one process does: so many devices of one room."""

    address: str
    udp_port: int
    devices: tuple[int, ...]
    total: int
    """Devices of the room."""
    air: int
    """How many of these range in the air, the first ones."""
    seed: int
    begin: float
    """s since 1970: when everybody begins."""
    seconds: float


class Heard(NamedTuple):
    """What one process has heard."""

    delays: Counts
    """(BINS_MS,) how many poses arrived so many ms after their stamp."""
    said: dict[str, int]
    """How many hearers' words each of its devices has said, by device and `one` or `all`."""
    words: dict[tuple[str, str], list[int]]
    """Numbers that were heard, by hearer and speaker's device and kind."""
    late_ms: float
    """By how much the process itself came late to what was due, p99."""
    datagrams: int


class Moment(NamedTuple):
    """What was seen at a moment, s since the beginning."""

    t: float
    server: Usage
    solvers: Usage
    searches: Usage
    behind: float
    """s: of the solver that is furthest behind."""
    registered: int


class Load(NamedTuple):
    """One session."""

    lag: list[m.Lag]
    seen: list[Moment]
    heard: list[Heard]
    registered: int
    refused: dict[str, int]
    load: float


def place(seed: int, device: int, t: float) -> Array:
    """(3,) m: loops through the hall, each device's at its own pace."""
    rate, phase, height = _loop(seed, device)
    x, y = (0.5 * width * np.sin(r * t + p) for width, r, p in zip(AREA_M, rate, phase, strict=True))
    return np.array([x, y, height + 0.05 * np.sin(2.0 * t + phase[0])])


@cache
def _loop(seed: int, device: int) -> tuple[list[float], list[float], float]:
    random = np.random.default_rng([seed, device])
    rate, phase = random.uniform(0.08, 0.18, 2).tolist(), random.uniform(0.0, 2.0 * np.pi, 2).tolist()
    return rate, phase, float(random.uniform(1.1, 1.6))


def neighbours(device: int, total: int, air: int) -> list[int]:
    """Whose ranges a device's module reports: the next ones on a ring, and those before it that range in the air."""
    if device < air:
        return []
    after = [(device + k) % total for k in range(1, EACH_SIDE + 1)]
    before = [(device - k) % total for k in range(1, EACH_SIDE + 1)]
    return [*after, *(other for other in before if other < air and other not in after)]


def generate(task: Task) -> Heard:
    """One process: its devices join, walk, range and listen."""
    return asyncio.run(_generate(task))


async def _generate(task: Task) -> Heard:
    names = {device: _name(task, device) for device in task.devices}
    delays = np.zeros(BINS_MS, dtype=np.int64)
    words: defaultdict[tuple[str, str], list[int]] = defaultdict(list)
    said: dict[str, int] = {}
    late: list[float] = []
    async with AsyncExitStack() as stack:
        clients = {
            device: await stack.enter_async_context(await Client.join(task.address, [name]))
            for device, name in names.items()
        }
        keys = {device: await _module_key(client, task, device) for device, client in clients.items()}
        listening = [asyncio.create_task(_listen(client, task, delays, words)) for client in clients.values()]
        if time.time() > task.begin:
            raise RuntimeError("joining took longer than the time until the beginning: let it begin later")
        with ExitStack() as radios:
            doing = [_walk(client, device, task, late) for device, client in clients.items()]
            doing += [_speak(client, device, task, said) for device, client in clients.items()]
            port = radios.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            port.setblocking(False)
            port.connect(("127.0.0.1", task.udp_port))
            counted = [0]
            for device in task.devices:
                if peers := neighbours(device, task.total, task.air):
                    doing.append(_range(port, keys[device], device, peers, task, counted))
            in_air = [device for device in task.devices if device < task.air]
            if in_air:
                doing.append(_fly(radios, {device: keys[device] for device in in_air}, task))
            await asyncio.gather(*doing)
        await asyncio.sleep(max(QUIET_S, task.begin + task.seconds - time.time()))
        for listener in listening:
            if listener.done():
                raise ConnectionError("the room has ended a connection")
            listener.cancel()
    return Heard(delays, said, dict(words), 1000.0 * float(np.quantile(late, 0.99)), counted[0])


def _name(task: Task, device: int) -> str:
    return f"room{task.seed}-{device:02d}"


async def _module_key(client: Client, task: Task, device: int) -> m.ModuleKey:
    await client.say_message(m.Module(_name(task, device), device))
    key = await client.until(lambda message: isinstance(message, m.ModuleKey))
    assert isinstance(key, m.ModuleKey)
    return key


async def _due(task: Task, device: int, hz: float, ends: float, late: list[float] | None = None) -> Any:
    """Yields 0, 1, 2, ... at its rate, each device at a moment of its own."""
    phase = (0.618 * device) % 1.0
    for n in range(int((ends - 1.0) * hz)):
        due = task.begin + (n + phase) / hz
        if (early := due - time.time()) > 0.0:
            await asyncio.sleep(early)
        if late is not None:
            late.append(time.time() - due)
        yield n


async def _walk(client: Client, device: int, task: Task, late: list[float]) -> None:
    name = _name(task, device)
    start, turn = place(task.seed, device, 0.0), 0.7 * device
    c, s = np.cos(turn), np.sin(turn)
    async for _ in _due(task, device, POSES_HZ, task.seconds, late):
        now = time.time()
        x, y, z = place(task.seed, device, now - task.begin) - start
        heading = yaw_quaternion(0.1 * (now - task.begin) - turn).tolist()
        await client.send_pose(name, now, (float(c * x + s * y), float(c * y - s * x), float(z)), heading)


async def _speak(client: Client, device: int, task: Task, said: dict[str, int]) -> None:
    """Numbers to the next device; the first one's to everybody as well."""
    name, to = _name(task, device), _name(task, (device + 1) % task.total)
    async for n in _due(task, device, WORDS_HZ, task.seconds - QUIET_S):
        await client.say_message(m.Say("one", n, to=to))
        said[f"{name} one"] = n + 1
        if device == 0:
            await client.say_message(m.Say("all", n))
            said[f"{name} all"] = (n + 1) * (task.total - 1)


async def _range(
    port: socket.socket, key: m.ModuleKey, device: int, peers: list[int], task: Task, counted: list[int]
) -> None:
    """A module's datagrams."""
    random = np.random.default_rng([task.seed, 1, device])
    ranges = np.zeros(len(peers), RANGE)
    ranges["peer"], ranges["status"], ranges["sight"] = peers, MEASURED, SIGHT_UNKNOWN
    ranges["sigma_mm"] = round(1000 * SIGMA_M)
    ranges["rx_power_cdbm"], ranges["fp_power_cdbm"] = -8000, -8100
    secret = bytes.fromhex(key.key)
    async for n in _due(task, device, RANGES_HZ, task.seconds):
        now = time.time()
        t = now - task.begin
        true = [np.linalg.norm(place(task.seed, device, t) - place(task.seed, peer, t)) for peer in peers]
        measured = np.array(true) + SIGMA_M * random.standard_normal(len(peers))
        ranges["distance_mm"] = np.round(1000.0 * np.maximum(measured, 0.0))
        datagram = RangesDatagram(key.session, key.address, n + 1, EPOCH, int(1e9 * now), 0, ranges)
        with suppress(OSError):
            port.send(encode_ranges(datagram, secret))
            counted[0] += 1


async def _fly(radios: ExitStack, keys: dict[int, m.ModuleKey], task: Task) -> None:
    """Modules of firmware in the air."""
    random = np.random.default_rng([task.seed, 2])
    session = next(iter(keys.values())).session
    air = radios.enter_context(LiveAir(session, task.udp_port, task.seed, stamp_sigma=SIGMA_M / RANGE_OF_STAMP))
    for key in keys.values():
        air.add(key.address, Carried(bytes.fromhex(key.key), *random.uniform(-10.0, 10.0, 2).tolist()))
    async for _ in _due(task, 0, POSES_HZ / 2.0, task.seconds):
        t = max(0.0, time.time() - task.begin)
        air.places(t, {key.address: place(task.seed, device, t) for device, key in keys.items()})


async def _listen(client: Client, task: Task, delays: Counts, words: defaultdict[tuple[str, str], list[int]]) -> None:
    own = client.welcome.you[0]
    judged = task.begin + SETTLED_S
    indices = {member.name: member.index for member in client.members.values()}
    async for message in client.messages():
        match message:
            case PosesDown():
                now = time.time()
                offset = client.offset
                if offset is not None and judged < now < task.begin + task.seconds - QUIET_S:
                    # The room's clock is not quite this one's: its stamps are taken back by what pings say.
                    late = [
                        1000.0 * (now + offset - message.t + pose.age)
                        for pose in message.poses
                        if pose.member != indices.get(own)
                    ]
                    np.add.at(delays, np.clip(np.array(late, dtype=int), 0, BINS_MS - 1), 1)
            case m.Said():
                words[own, f"{message.by} {message.topic}"].append(int(message.data))
            case m.Bye():
                raise ConnectionError(message.what)
            case _:
                pass


def run(devices: int, seconds: float, air: int, generators: int, seed: int, told_every: float = 60.0) -> Load:
    """A session: a server, and devices in rooms of 64 at most."""
    return asyncio.run(_run(devices, seconds, air, generators, seed, told_every))


async def _run(devices: int, seconds: float, air: int, generators: int, seed: int, told_every: float) -> Load:
    command = (sys.executable, "-m", "synchronizar", "serve", "--json", "--no-tls", "--host", "127.0.0.1")
    with tempfile.TemporaryDirectory() as folder:
        words = ("--port", "0", "--udp-port", "0", "--keep-awake", "--record", folder)
        server = await asyncio.create_subprocess_exec(*command, *words, stdout=asyncio.subprocess.PIPE)
        try:
            assert server.stdout is not None
            where = json.loads(await server.stdout.readline())
            return await _in_rooms(server.pid, where, devices, seconds, air, generators, seed, told_every)
        finally:
            with suppress(ProcessLookupError):
                server.terminate()
            await server.wait()


async def _in_rooms(
    server: int,
    where: dict[str, Any],
    devices: int,
    seconds: float,
    air: int,
    generators: int,
    seed: int,
    told_every: float,
) -> Load:
    joins = [where["join"]]
    rooms = -(-devices // MOST_IN_A_ROOM)
    async with aiohttp.ClientSession() as session:
        base = urlsplit(where["join"])
        while len(joins) < rooms:
            async with session.post(f"{base.scheme}://{base.netloc}/api/rooms") as response:
                joins.append((await response.json())["join"])
    begin = time.time() + 10.0 + 0.3 * devices
    tasks = []
    for room, join in enumerate(joins):
        total = len(range(room, devices, rooms))
        flown = min(air, total) if room == 0 else 0
        own = list(range(total))
        # One process flies all modules of the air: they are of one network.
        shares = [own[k::generators] for k in range(generators)]
        shares[0] = sorted({*shares[0], *range(flown)})
        shares[1:] = [[device for device in share if device >= flown] for share in shares[1:]]
        tasks += [
            Task(join, where["udp_port"], tuple(share), total, flown, seed + room, begin, seconds)
            for share in shares
            if share
        ]
    lag, seen = [], []
    loop = asyncio.get_running_loop()
    with ProcessPoolExecutor(len(tasks), get_context("spawn")) as pool:
        running = [loop.run_in_executor(pool, partial(generate, task)) for task in tasks]
        async with AsyncExitStack() as stack:
            watching = [await stack.enter_async_context(await Client.join(join)) for join in joins]
            others = [asyncio.create_task(_drain(client)) for client in watching[1:]]
            async for message in watching[0].messages():
                now = time.time() - begin
                if isinstance(message, m.Status):
                    if (
                        now > min(60.0 + SETTLED_S, 0.5 * seconds) and message.lag is not None
                    ):  # joining is of no minute that counts
                        lag.append(message.lag)
                    behind = max((w.status.behind for w in watching if w.status is not None), default=0.0)
                    states = [user.state for watcher in watching for user in watcher.frames.users.values()]
                    seen.append(Moment(now, *_usage(server), behind, states.count("registered")))
                    if len(seen) > 1 and now // told_every > seen[-2].t // told_every:
                        print(_line(seen[-1]), flush=True)
                if now > seconds - 1.0 or any(r.done() and r.exception() is not None for r in running):
                    break
            refused = dict(watching[0].status.refused) if watching[0].status is not None else {}
            for watcher in watching:
                for health in [] if watcher.status is None else watcher.status.users.values():
                    for reason, count in health.refused.items():
                        refused[reason] = refused.get(reason, 0) + count
            for other in others:
                other.cancel()
            heard = await asyncio.gather(*running)
    return Load(lag, seen, list(heard), seen[-1].registered, refused, os.getloadavg()[0])


def _usage(server: int) -> tuple[Usage, Usage, Usage]:
    """Of a server, of its solvers, and of their searches."""
    of = usage_by_kind(server, {"solvers": b"live.estimating", "searches": b"incremental.worker"})
    return of["own"], of["solvers"], of["searches"]


def _line(at: Moment) -> str:
    megabytes = ", ".join(f"{name} {getattr(at, name).megabytes:.0f} MB" for name in ("server", "solvers", "searches"))
    return f"{at.t:.0f} s: {megabytes}; {at.registered} registered; {at.behind:.2f} s behind"


async def _drain(client: Client) -> None:
    async for _ in client.messages():
        pass


def lost_words(heard: list[Heard]) -> int:
    """Of numbers that were said, those that somebody did not hear, or twice or out of order."""
    numbers = [of for one in heard for of in one.words.values()]
    said = sum(sum(one.said.values()) for one in heard)
    return abs(said - sum(map(len, numbers))) + sum(a >= b for of in numbers for a, b in pairwise(of))


def quantile_ms(delays: Counts, share: float) -> int:
    """Of counts by ms."""
    return int(np.searchsorted(np.cumsum(delays), share * delays.sum()))


def row_of(devices: int, load: Load) -> dict[str, Any]:
    """A line of the table."""
    delays = np.sum([one.delays for one in load.heard], axis=0)
    first = next((at for at in load.seen if at.t > 60.0), load.seen[len(load.seen) // 2])
    begun = next(at for at in load.seen if at.t > 0.0)
    last = load.seen[-1]
    span = last.t - begun.t
    behind = [at.behind for at in load.seen if at.t > min(SETTLED_S, 0.5 * last.t)]
    return {
        "devices": devices,
        "s": round(last.t),
        "loop p50 ms": max(lag.median for lag in load.lag),
        "loop p99 ms": max(lag.p99 for lag in load.lag),
        "of the median minute": float(np.median([lag.p99 for lag in load.lag])),
        "poses p50 ms": quantile_ms(delays, 0.5),
        "poses p99 ms": quantile_ms(delays, 0.99),
        "words": sum(len(numbers) for one in load.heard for numbers in one.words.values()),
        "words lost": lost_words(load.heard),
        "behind s, median": float(np.median(behind)),
        "behind p99": float(np.quantile(behind, 0.99)),
        "at most": max(behind),
        "server MB, 1st minute": first.server.megabytes,
        "server MB, end": last.server.megabytes,
        "solver MB, 1st minute": first.solvers.megabytes,
        "solver MB, end": last.solvers.megabytes,
        "search MB, most": max(at.searches.megabytes for at in load.seen),
        "server cores": (last.server.cpu - begun.server.cpu) / span,
        "solver cores": (last.solvers.cpu - begun.solvers.cpu) / span,
        "search cores": (last.searches.cpu - begun.searches.cpu) / span,
        "all registered after s": next((round(at.t) for at in load.seen if at.registered >= devices), None),
        "generators late p99 ms": max(one.late_ms for one in load.heard),
        "registered": load.registered,
        "refused": "; ".join(f"{reason} {count}" for reason, count in sorted(load.refused.items())),
        "load": load.load,
    }


def broken(row: dict[str, Any]) -> list[str]:
    """Which bars a line breaks."""
    bars = {
        "loop": row["loop p99 ms"] > LOOP_MS,
        "poses": row["poses p99 ms"] > POSES_MS,
        "words": row["words lost"] > 0,
    }
    return [bar for bar, breaks in bars.items() if breaks]


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--devices", type=int, default=32)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--air", type=int, default=11)
    parser.add_argument("--generators", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--every", type=float, default=60.0, help="s between what is told besides")
    parser.add_argument("--grow", action="store_true")
    options = parser.parse_args()
    rows, devices = [], options.devices
    while True:
        load = run(devices, 60.0 * options.minutes, options.air, options.generators, options.seed, options.every)
        rows.append(row_of(devices, load))
        print("\n".join(f"{name}: {value}" for name, value in rows[-1].items()), flush=True)
        if bars := broken(rows[-1]):
            print(f"with {devices} devices there break: {', '.join(bars)}", flush=True)
        if not options.grow or bars:
            break
        devices += 16
    write_table("load", rows, {**vars(options), "cores": os.cpu_count(), "load": os.getloadavg()})
    print(markdown(rows, digits=2))


if __name__ == "__main__":
    main()
