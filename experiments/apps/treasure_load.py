"""Treasure with many players and coins on one machine: whether the game keeps its pace and its coins.

`python -m experiments.apps.treasure_load [--players 8] [--coins 100] [--seconds 90] [--seed 0]`: a server that records
its room, native clients whose modules' firmware ranges in the simulated air, SLAM that drifts. Each puts its share of
the coins down once it is registered, one a second; then they play, game after game, by walking about. Server,
application, solver, search, air and all players share the machine.

Told are how often a second everybody's poses come, with which the application's own ticks do, at one player while they
play, and the pause that 99 of 100 stay below; how late the server's loop is by its own word (p50 and p99 of the last
minute); after how long who puts a coin sees it; CPU (cores) of each kind of process while they play. Of the coins, how
many there were in all games that were played to the end, how many of these were told to be found (the fewest and the
most that a player heard of), how many were told to be gone more than once in a game, and how many are in the game's
file at the end.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import tempfile
import time
from collections import Counter
from contextlib import AsyncExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments.common.cpu import Usage, usage_by_kind
from experiments.common.results import as_lines, write_table
from experiments.live.room import STAMP_SIGMA, TICK_S, Walkers, carry, drifting, module_key
from experiments.live.walkers import server
from synchronizar.apps.treasure.game import SCORE, THING
from synchronizar.apps.treasure.game_file import Game, read_game
from synchronizar.live import messages as m
from synchronizar.live.client import Client
from synchronizar.live.pose_wire import PosesDown
from synchronizar.live.stage import Stage
from synchronizar.simulation.live_air import LiveAir
from synchronizar.simulation.simulate import Simulation, simulate

PUT_EVERY_S = 1.0
AGAIN_S = 1.0
"""s after which who leads asks once more to play."""
KINDS = {
    "server": b"\0serve\0",
    "application": b"live.app_run",
    "solver": b"live.estimating",
    "search": b"incremental.worker",
    "air": b"synchronizar-air",
}


class Session(NamedTuple):
    """What was seen of one."""

    players: list[Player]
    lag: m.Lag
    seconds: float
    """s of playing."""
    cores: dict[str, float]
    """CPU s a second of playing, by kind of process."""


class Player:
    """Puts its coins down, plays, and counts what it is told of."""

    def __init__(self, client: Client, name: str, coins: int, everybodys: int, leads: bool) -> None:
        """`coins`: of its own; `everybodys`: how many there are in all. `leads`: begins the games."""
        self.stage = Stage(client.welcome)
        self.found: list[int] = []
        """By game, how many coins it was told to be found."""
        self.gone: list[Counter[str]] = []
        """By game, how often each thing was told to be gone."""
        self.late: list[float] = []
        """s from asking for a coin to seeing it."""
        self.ticks: list[float] = []
        """s: when poses came since they play."""
        self._client, self._name, self._coins, self._all, self._leads = client, name, coins, everybodys, leads
        self._asked = self._began = float("-inf")

    async def run(self) -> None:
        """Until it is cancelled."""
        async for word in self._client.messages():
            self.stage.hear(word)
            score = self.stage.objects.get(SCORE)
            playing = None if score is None else score.data["playing"]
            if playing is not None and playing != self._began:
                self._began = playing
                self.found.append(0)
                self.gone.append(Counter())
            if isinstance(word, m.Objects) and self.gone:
                self.gone[-1].update(id_ for id_ in word.removed if id_.startswith(THING))
            elif isinstance(word, m.Said) and word.topic == "met" and self.found:
                self.found[-1] += word.data["what"] == "coin"
            elif isinstance(word, PosesDown):
                if self.found:
                    self.ticks.append(time.monotonic())
                if playing is None and self._name in self.stage.players:
                    await self._build(time.monotonic())

    async def _build(self, now: float) -> None:
        things = [o for o in self.stage.objects.values() if o.kind == THING]
        own = sum(o.data["by"] == self._name for o in things)
        if own > len(self.late):
            self.late.append(now - self._asked)
        if own < self._coins and not self.found:
            if own == len(self.late) and now - self._asked > PUT_EVERY_S:
                self._asked = now
                await self._client.say_message(m.Say("put", {"what": "coin"}, m.APP))
        elif self._leads and len(things) == self._all and now - self._asked > AGAIN_S:
            self._asked = now
            await self._client.say_message(m.Say("play", None, m.APP))


async def played(simulation: Simulation, where: dict[str, Any], coins: int) -> Session:
    """A session. Raises RuntimeError where not all have begun to play by its end."""
    names, seed = [user.name for user in simulation.recording.users], simulation.scene.seed
    async with AsyncExitStack() as stack:
        clients = {n: await stack.enter_async_context(await Client.join(where["join"], [n], up="y")) for n in names}
        keys = {name: await module_key(client, name, i) for i, (name, client) in enumerate(clients.items())}
        session = keys[names[0]].session
        air = stack.enter_context(LiveAir(session, where["udp_port"], seed, stamp_sigma=STAMP_SIGMA))
        carry(air, keys, seed)
        walkers = Walkers(simulation, clients, keys, air)
        players = [
            Player(client, name, len(range(i, coins, len(names))), coins, leads=i == 0)
            for i, (name, client) in enumerate(clients.items())
        ]
        tasks = [asyncio.create_task(player.run()) for player in players]
        began, since, before = time.time(), 0.0, dict[str, Usage]()
        while (t := time.time() - began) < simulation.scene.seconds:
            await walkers.go_on(began, t)
            if not before and all(player.found for player in players):
                since, before = t, usage_by_kind(os.getpid(), KINDS)
            await asyncio.sleep(TICK_S)
        after, status = usage_by_kind(os.getpid(), KINDS), clients[names[0]].status
        for task in tasks:
            if task.done():
                task.result()
            task.cancel()
    if not before or status is None or status.lag is None:
        raise RuntimeError("nobody has begun to play: let it last longer")
    cores = {kind: (after[kind].cpu - before[kind].cpu) / (t - since) for kind in after}
    return Session(players, status.lag, t - since, {"players": cores.pop("own"), **cores})


def judged(session: Session, coins: int, game: Game) -> dict[str, Any]:
    """A line of the table. `game`: its file at the end."""
    pauses = 1000.0 * np.array([after - before for before, after in pairwise(session.players[0].ticks)])
    late = 1000.0 * np.array([s for player in session.players for s in player.late])
    # All but the newest game were played to the end.
    found = [player.found[:-1] for player in session.players]
    return {
        "players": len(session.players),
        "coins": coins,
        "s of playing": session.seconds,
        "ticks a second": 1000.0 / float(np.mean(pauses)),
        "pause p99 ms": float(np.quantile(pauses, 0.99)),
        "loop p50 ms": session.lag.median,
        "loop p99 ms": session.lag.p99,
        "coin seen after, p50 ms": float(np.median(late)),
        "coin seen after, p99 ms": float(np.quantile(late, 0.99)),
        "games to the end": min(map(len, found)),
        "coins in these": coins * min(map(len, found)),
        "found, fewest": min(map(sum, found)),
        "found, most": max(map(sum, found)),
        "gone more than once": sum(n > 1 for p in session.players for of in p.gone for n in of.values()),
        "in the file": sum(thing.what == "coin" for thing in game.things.values()),
        **{f"{kind}, cores": cores for kind, cores in session.cores.items()},
        "load": os.getloadavg()[0],
    }


def run(players: int, coins: int, seconds: float, seed: int) -> dict[str, Any]:
    """A session with a server of its own."""
    simulation = simulate(drifting(players, seconds, seed))
    with tempfile.TemporaryDirectory() as folder:
        with server("--no-tls", "--record", folder, "--app", "treasure") as where:
            session = asyncio.run(played(simulation, where, coins))
        return judged(session, coins, read_game(Path(folder) / "apps" / "treasure" / "game.json"))


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--players", type=int, default=8)
    parser.add_argument("--coins", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=90.0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    row = run(options.players, options.coins, options.seconds, options.seed)
    write_table("treasure_load", [row], {**vars(options), "cores": os.cpu_count(), "load": os.getloadavg()})
    print(as_lines(row))


if __name__ == "__main__":
    main()
