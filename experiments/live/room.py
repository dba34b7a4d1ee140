"""The whole system on one machine: a room, walkers with modules in the simulated air, and the page that shows them.

`python -m experiments.live.room [--users 3] [--seconds 60] [--late-share 0.1]`, or `make live`. Each walker is a client
of the room by itself: it says its SLAM's poses, and its module, whose firmware ranges in the air, says its ranges by
UDP. Once a second it is told who is registered, and by how much everybody is off the truth in the common frame.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import time
from collections.abc import Mapping
from contextlib import AsyncExitStack, suppress
from typing import Any, NamedTuple

import numpy as np

from experiments.live.walkers import server
from synchronizar.arrays import Array
from synchronizar.data.track import Track
from synchronizar.geometry import YawFrame
from synchronizar.live import Client
from synchronizar.live import messages as m
from synchronizar.live.pose_wire import PosesDown
from synchronizar.quaternions import yaw_of_quaternions
from synchronizar.simulation.live_air import Carried, LiveAir
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

TICK_S = 1.0 / 30.0
STAMP_SIGMA = 0.02
"""m."""
CRYSTAL_PPM = 10.0


class Seen(NamedTuple):
    """What the room said about a device at a moment, beside the truth."""

    t: float
    """s since the walk began."""
    user: str
    registered: bool
    error: float
    """m, in the plane: of the pose that the room sends."""


def main() -> None:
    """Open a room, walk, and say how it went."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--users", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--late-share", type=float, default=0.1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep-awake", action="store_true", help="modules range all the time")
    parser.add_argument("--record", metavar="DIR", help="the room is written here")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    simulation = simulate(drifting(options.users, options.seconds, options.seed, options.late_share))
    asked = ["--no-tls", *(["--record", options.record] if options.record else [])]
    with suppress(KeyboardInterrupt), server(*asked, *(["--keep-awake"] if options.keep_awake else [])) as where:
        print(f"look: {where['url']}/room#{where['room']}", file=sys.stderr)
        seen = asyncio.run(walk_in_room(simulation, where["join"], where["udp_port"], options.seed))
        print(json.dumps(summary(seen)) if options.json else table(summary(seen)))


def drifting(users: int, seconds: float, seed: int, late_share: float = 0.0) -> Scene:
    """Phones whose SLAM drifts and has a wrong scale, with biased radios."""
    return Scene(
        users=users,
        seconds=seconds,
        late_share=late_share,
        seed=seed,
        scale_sigma=0.01,
        bias_sigma=0.03,
        drift_m_per_sqrt_s=0.005,
        drift_rad_per_sqrt_s=0.002,
        up="y",
    )


async def walk_in_room(simulation: Simulation, address: str, udp_port: int, seed: int) -> list[Seen]:
    """All devices of a walk join a room, each by a connection of its own, and walk in it as it was simulated."""
    names = [user.name for user in simulation.recording.users]
    async with AsyncExitStack() as stack:
        clients = {
            name: await stack.enter_async_context(await Client.join(address, [name], up=up_of(simulation, name)))
            for name in names
        }
        keys = {name: await module_key(client, name, n) for n, (name, client) in enumerate(clients.items())}
        air = stack.enter_context(LiveAir(next(iter(keys.values())).session, udp_port, seed, stamp_sigma=STAMP_SIGMA))
        carry(air, keys, seed)
        block(air, simulation, keys)
        walkers = Walkers(simulation, clients, keys, air)
        began = time.time()
        seen: list[Seen] = []
        watching = asyncio.create_task(_watch(clients[names[0]], simulation, began, seen))
        others = [asyncio.create_task(listen(clients[name])) for name in names[1:]]
        while (t := time.time() - began) < simulation.scene.seconds:
            await walkers.go_on(began, t)
            await asyncio.sleep(TICK_S)
        for task in (watching, *others):
            task.cancel()
        return seen


class Walkers:
    """Those of a simulation who walk in a room: SLAM's poses go there, and their modules where they are in truth."""

    def __init__(
        self, simulation: Simulation, clients: Mapping[str, Client], keys: Mapping[str, m.ModuleKey], air: LiveAir
    ) -> None:
        self._simulation, self._clients, self._keys, self._air = simulation, clients, keys, air
        self._own = {user.name: own_axes(simulation, user.name) for user in simulation.recording.users}
        self._said = dict.fromkeys(self._own, 0)

    async def go_on(self, began: float, t: float) -> None:
        """To `t` (s) of a walk whose t = 0 is at `began`, s since 1970."""
        for name, (position, quat) in self._own.items():
            track = self._simulation.recording.tracks[name]
            upto = int(np.searchsorted(track.t, t, side="right"))
            rows = range(self._said[name], upto)
            await self._clients[name].send_poses([(name, began + track.t[i], position[i], quat[i]) for i in rows])
            self._said[name] = upto
            self._air.place(self._keys[name].address, t, place_at(self._simulation.truth[name], t))


def carry(air: LiveAir, keys: Mapping[str, m.ModuleKey], seed: int) -> None:
    """A module for each device, with crystals of its own."""
    random = np.random.default_rng(seed)
    for key in keys.values():
        radio, board = random.uniform(-CRYSTAL_PPM, CRYSTAL_PPM, 2).tolist()
        air.add(key.address, Carried(bytes.fromhex(key.key), radio, board))


async def _watch(client: Client, simulation: Simulation, began: float, seen: list[Seen]) -> None:
    """Note where the room says that everybody is, beside where they are."""
    second = 0
    async for message in client.messages():
        names = {member.index: member.name for member in client.members.values()}
        if not isinstance(message, PosesDown) or client.frames.reference is None:
            continue
        common_from_world = common_from_world_of(simulation, client.frames.reference)
        for pose in message.poses:
            name, t = names[pose.member], message.t - pose.age - began
            true = common_from_world @ place_at(simulation.truth[name], t)
            error = float(np.linalg.norm((np.array(pose.position) - true)[:2]))
            seen.append(Seen(message.t - began, name, pose.state == "registered", error))
        if int(message.t - began) > second:
            second = int(message.t - began)
            latest = {one.user: one for one in seen[-len(names) :]}
            states = (
                f"{name} {user.state} {100 * (user.progress or 0):.0f} %"
                + (f" off {latest[name].error:.2f} m" if name in latest else "")
                for name, user in client.frames.users.items()
            )
            print(f"{second:4d} s  " + "; ".join(states), file=sys.stderr)


async def listen(client: Client) -> None:
    """Hear everything, so that what a client keeps is kept up."""
    async for _ in client.messages():
        pass


async def module_key(client: Client, name: str, address: int) -> m.ModuleKey:
    """What a device's module is provisioned with."""
    await client.say_message(m.Module(name, address))
    key = await client.until(lambda message: isinstance(message, m.ModuleKey))
    assert isinstance(key, m.ModuleKey)
    return key


def block(air: LiveAir, simulation: Simulation, keys: Mapping[str, m.ModuleKey]) -> None:
    """Signals that were late in the simulated walk are late in the air."""
    ranges, users = simulation.recording.ranges, simulation.recording.users
    step = 1.0 / simulation.scene.round_hz
    for row in np.flatnonzero(simulation.late).tolist():
        a, b = (keys[users[end[row]].name].address for end in (ranges.a, ranges.b))
        t = float(ranges.t[row])
        air.block(a, b, max(0.0, t - 0.5 * step), t + 0.5 * step, float(simulation.extra[row]))


def own_axes(simulation: Simulation, name: str) -> tuple[Any, Any]:
    """SLAM's positions and attitudes in the device's own axes."""
    track, own_from_z_up = simulation.recording.tracks[name], YawFrame(up_a=up_of(simulation, name))
    return (own_from_z_up @ track.position).tolist(), own_from_z_up.rotate_quaternions(track.quat_xyzw).tolist()


def up_of(simulation: Simulation, name: str) -> Any:
    """Which axis of a device points up."""
    return next(user.up for user in simulation.recording.users if user.name == name)


def place_at(track: Track, t: float) -> Array:
    """(3,) m: the true place at a moment of the walk."""
    return np.array([np.interp(t, track.t, track.position[:, axis]) for axis in range(3)])


def common_from_world_of(simulation: Simulation, reference: str) -> YawFrame:
    """The common frame is the reference's own at its first pose."""
    own, true = simulation.recording.tracks[reference], simulation.truth[reference]
    turned = yaw_of_quaternions(own.quat_xyzw[:1])[0] - yaw_of_quaternions(true.quat_xyzw[:1])[0]
    turn = YawFrame(yaw=float(turned))
    x, y, z = (own.position[0] - turn @ true.position[0]).tolist()
    return YawFrame(x, y, z, float(turned))


def summary(seen: list[Seen]) -> dict[str, Any]:
    """Of each device: when it was registered first, and how far off it was while it was (m, in the plane)."""
    out: dict[str, Any] = {}
    for name in sorted({one.user for one in seen}):
        own = [one for one in seen if one.user == name and one.registered]
        errors = np.array([one.error for one in own])
        out[name] = {
            "registered_at": own[0].t if own else None,
            "median": float(np.median(errors)) if len(errors) else None,
            "p95": float(np.percentile(errors, 95)) if len(errors) else None,
            "largest": float(errors.max()) if len(errors) else None,
        }
    return out


def table(of: Mapping[str, Any]) -> str:
    """A row for each device."""
    lines = ["user      registered after (s)  median (m)  p95 (m)  largest (m)"]
    for name, row in of.items():
        cells = [
            "-" if row[key] is None else f"{row[key]:.2f}" for key in ("registered_at", "median", "p95", "largest")
        ]
        lines.append(f"{name:8}  {cells[0]:>20}  {cells[1]:>10}  {cells[2]:>7}  {cells[3]:>11}")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
