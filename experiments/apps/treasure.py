"""Treasure on two days: some put coins down, the server is killed, others come with other devices and find them.

`python -m experiments.apps.treasure [--seed 0] [--seconds 40] [--coins 6]`: two walkers and two radios
that stand still build; `kill -9`; then two others and the same radios, in another room of another server, which finds
the game by the radios alone. Told is how far each coin lies from where it was put in truth, on the first day and on
the second (m, in the plane and in height), and after how long it was found.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import signal
import tempfile
import time
from contextlib import AsyncExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np

from experiments.apps.shown import Walker
from experiments.common.markdown import markdown
from experiments.live.room import common_from_world_of, listen
from experiments.live.walkers import server, walk
from synchronizar.apps.treasure.game import SCORE, THING
from synchronizar.apps.treasure.game_file import read_game
from synchronizar.arrays import Array
from synchronizar.live import messages as m
from synchronizar.live.client import Client
from synchronizar.live.stage import Stage
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

FIRST, SECOND, RADIOS = ("phone0", "phone1"), ("phone2", "phone3"), ("radio0", "radio1")


async def day(
    simulation: Simulation, where: dict[str, Any], walkers: tuple[str, ...], seconds: float, coins: int
) -> dict[str, Any]:
    """One day: who walks, who puts how many coins; where they lie in truth and by the room, and when that was known."""
    out: dict[str, Any] = {"put": {}, "found": None, "lie": {}}
    async with AsyncExitStack() as stack:
        clients = {n: await stack.enter_async_context(await Client.join(where["join"], [n])) for n in walkers}
        still = await stack.enter_async_context(await Client.join(where["join"], {n: {"static": True} for n in RADIOS}))
        began = time.time()
        first, client = next(iter(clients.items()))
        tasks = [
            asyncio.create_task(walk(c, simulation.recording, [n], began, heard=c is client))
            for n, c in clients.items()
        ]
        tasks.append(asyncio.create_task(listen(still)))
        stage, wanted = Stage(client.welcome), 0
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                async for word in client.messages():
                    stage.hear(word)
                    score = client.objects.get(SCORE)
                    if score is not None and score.data["found"] and out["found"] is None:
                        out["found"] = time.time() - began
                    known = [o for o in client.objects.values() if o.kind == THING]
                    t = stage.t - began
                    if (
                        wanted < coins
                        and len(known) == wanted
                        and first in stage.players
                        and _apart(stage, first, known)
                    ):
                        await client.say_message(m.Say("put", {"what": "coin"}, m.APP))
                        wanted += 1
                    for thing in known:
                        if coins:
                            out["put"].setdefault(thing.id, Walker(simulation, first, 0.0).hand(t))
                        out["lie"][thing.id] = _in_world(simulation, stage, thing)
        for task in tasks:
            task.cancel()
        out["states"] = {name: (told.state, told.sigma) for name, told in stage.frames.users.items()}
    return out


def _apart(stage: Stage, name: str, known: list[m.Object]) -> bool:
    """Whether no coin lies near: they are put a metre apart."""
    here = stage.players[name].hand
    return all(np.hypot(here[0] - o.position[0], here[1] - o.position[1]) > 0.8 for o in known)


def _in_world(simulation: Simulation, stage: Stage, thing: m.Object) -> Array:
    assert stage.frames.reference is not None
    return common_from_world_of(simulation, stage.frames.reference).inverse() @ np.array(thing.position)


def main() -> None:
    """Two days, and how far off coins lay."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--coins", type=int, default=6)
    options = parser.parse_args()
    scene = Scene(users=4, static_radios=2, seconds=options.seconds + 5.0, seed=options.seed, speed=0.7)
    simulation = simulate(scene)
    with tempfile.TemporaryDirectory() as folder:
        asked = ("--no-tls", "--record", folder, "--app", "treasure")
        with server(*asked) as where:
            first = asyncio.run(day(simulation, where, FIRST, options.seconds, options.coins))
            os.kill(where["pid"], signal.SIGKILL)
        kept = read_game(Path(folder) / "apps" / "treasure" / "game.json")
        with server(*asked) as where:
            second = asyncio.run(day(simulation, where, SECOND, options.seconds, 0))
    print(f"put {len(first['put'])}, in the file after kill -9 {len(kept.things)}, by {sorted(kept.radios)}")
    print(f"found on the second day after {second['found']} s; {second['states']}")
    rows = []
    for name, lie in (("first day", first["lie"]), ("second day", second["lie"])):
        off = np.array([lie[id_] - put for id_, put in first["put"].items() if id_ in lie])
        if len(off):
            plane = np.linalg.norm(off[:, :2], axis=1)
            row = {"": name, "coins": len(off), "plane, median": np.median(plane), "plane, largest": plane.max()}
            rows.append(row | {"height, largest": np.abs(off[:, 2]).max()})
    print(markdown(rows))


if __name__ == "__main__":
    main()
