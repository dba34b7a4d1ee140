"""The paper's own wiring on one machine: module to device by UDP, device to device by WebRTC, samples to the solver.

`python -m experiments.live.paper_wiring [--users 2] [--seconds 30]`; needs the extra `webrtc`. Each module, in the air,
sends to its own device, which hands its datagrams on to the room. Devices say their poses to each other by data
channels that the room signals, and to the room by one of its own, so that all samples go by UDP. Each device places
the others by itself, from their own words and the frames that the room tells; that is held against the truth.
"""

from __future__ import annotations

import argparse
import asyncio
import time
from collections.abc import Callable
from contextlib import AsyncExitStack
from typing import Any, NamedTuple

import numpy as np

from experiments.live.room import (
    CRYSTAL_PPM,
    STAMP_SIGMA,
    TICK_S,
    Seen,
    block,
    common_from_world_of,
    drifting,
    listen,
    module_key,
    own_axes,
    place_at,
    summary,
    table,
    up_of,
)
from experiments.live.walkers import server
from synchronizar.live import Client
from synchronizar.live.drained_socket import DrainedSocket
from synchronizar.simulation.live_air import Carried, LiveAir
from synchronizar.simulation.simulate import Simulation, simulate

_REPORTER = slice(12, 14)
"""Where a datagram has the address of its module."""


class Counted(NamedTuple):
    """How the samples went."""

    seen: list[Seen]
    """Of each device, where another one placed it by itself."""
    by_channel: dict[str, int]
    """Messages that each data channel took, by `alice to bob`."""


class ByModule:
    """The air sends to one port: from here each module's datagrams go to its own device, and orders back to it."""

    def __init__(self, port_of: dict[int, int]) -> None:
        """`port_of`: each device's port, by its module's address."""
        self._port_of = port_of
        self._near = DrainedSocket("127.0.0.1", 0, self._from_air)
        self._far: dict[int, DrainedSocket] = {}
        self.port = self._near.port

    def close(self) -> None:
        """No more."""
        for one in (self._near, *self._far.values()):
            one.close()

    def _from_air(self, data: bytes, source: Any) -> None:
        address = int.from_bytes(data[_REPORTER], "little")
        if address not in self._far:
            self._far[address] = DrainedSocket("127.0.0.1", 0, lambda order, _: self._near.send(order, source))
        self._far[address].send(data, ("127.0.0.1", self._port_of[address]))


async def walk_as_in_the_paper(
    simulation: Simulation,
    address: str,
    seed: int,
    enough: Callable[[list[Seen]], bool] = lambda _: False,
    clock: Callable[[], float] = time.time,
) -> Counted:
    """All devices of a walk join a room, wire themselves, and walk to the walk's end, or until `enough` is seen.

    `clock` (s) is the time that they walk by, and all devices' own.
    """
    random = np.random.default_rng(seed)
    names = [user.name for user in simulation.recording.users]
    own = {name: own_axes(simulation, name) for name in names}
    async with AsyncExitStack() as stack:
        clients: dict[str, Client] = {}
        for name in names:
            clients[name] = await stack.enter_async_context(
                await Client.join(address, [name], up=up_of(simulation, name), clock=clock)
            )
        keys = {name: await module_key(client, name, n) for n, (name, client) in enumerate(clients.items())}
        for client in clients.values():
            stack.callback(asyncio.create_task(listen(client)).cancel)
            client.answer_calls()
        ports = {keys[name].address: client.forward_module(host="127.0.0.1") for name, client in clients.items()}
        channels = {f"{name} to room": await client.call() for name, client in clients.items()}
        for n, name in enumerate(names):
            for other in names[n + 1 :]:
                channels[f"{name} to {other}"] = await clients[name].call(other)
        for channel in channels.values():
            await channel.opened()
        by_module = ByModule(ports)
        stack.callback(by_module.close)
        air = stack.enter_context(
            LiveAir(next(iter(keys.values())).session, by_module.port, seed, stamp_sigma=STAMP_SIGMA)
        )
        for key in keys.values():
            radio, board = random.uniform(-CRYSTAL_PPM, CRYSTAL_PPM, 2).tolist()
            air.add(key.address, Carried(bytes.fromhex(key.key), radio, board))
        block(air, simulation, keys)
        began = clock()
        seen: list[Seen] = []
        said = dict.fromkeys(names, 0)
        while (t := clock() - began) < simulation.scene.seconds and not enough(seen):
            for name in names:
                track, (position, quat) = simulation.recording.tracks[name], own[name]
                upto = int(np.searchsorted(track.t, t, side="right"))
                rows = range(said[name], upto)
                await clients[name].send_poses([(name, began + track.t[i], position[i], quat[i]) for i in rows])
                said[name] = upto
                air.place(keys[name].address, t, place_at(simulation.truth[name], t))
            seen += [one for name, client in clients.items() for one in _placed(client, name, simulation, began)]
            await asyncio.sleep(TICK_S)
        return Counted(seen, {way: channel.sent for way, channel in channels.items()})


def _placed(client: Client, own: str, simulation: Simulation, began: float) -> list[Seen]:
    """Where a device puts the others by itself."""
    if client.frames.reference is None:
        return []
    common_from_world = common_from_world_of(simulation, client.frames.reference)
    out = []
    for name, pose in client.peer_poses.items():
        place = client.place_of_peer(name)
        if place is None or name == own:
            continue
        t = pose.t - began
        error = float(
            np.linalg.norm((np.array(place[0]) - common_from_world @ place_at(simulation.truth[name], t))[:2])
        )
        out.append(Seen(t, name, client.frames.users[name].state == "registered", error))
    return out


def main() -> None:
    """Open a room, wire and walk, and say how far off each device is where the others put it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--users", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    simulation = simulate(drifting(options.users, options.seconds, options.seed))
    with server() as where:
        counted = asyncio.run(walk_as_in_the_paper(simulation, where["join"], options.seed))
    print(table(summary(counted.seen)))
    print("; ".join(f"{way}: {sent} messages" for way, sent in counted.by_channel.items()))


if __name__ == "__main__":
    main()
