"""A whole game of catch: two phones in browsers, two programs, one of which comes late and ranges with one other only.

`python -m experiments.apps.catch [--seconds 120] [--seed 0] [--out DIR]`: a server on this machine, one page for each
phone, a page that looks, and a reload of one phone at two thirds of the time. Whoever has the ball throws it to
somebody else within two seconds: programs by a word, phones by a touch of their screen. Judged by what each page has
drawn, frame by frame, beside the arc that the game told, beside the other page, and beside the truth of where the
holder's phone is; lengths in m. With `--out`, pictures of the pages while the ball flies.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import random
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.common.results import as_lines
from experiments.live import browser
from experiments.live.walkers import server, walk
from synchronizar.apps.catch.flight import Flight
from synchronizar.apps.catch.game import BALL, SCORE
from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.geometry import YawFrame
from synchronizar.live import messages as m
from synchronizar.live.client import Client
from synchronizar.live.stage import Player, Stage
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

if TYPE_CHECKING:
    from playwright.async_api import Page

PHONES, PROGRAM, LATE = ("phone1", "phone2"), "phone0", "phone3"
LATE_AFTER_S = 30.0
HELD_S = 1.5
SETTLED_S = 0.5
"""s after which a ball that has changed hands has glided to its place."""
# What is drawn with each frame: [room's time, what the ball does, its flight, place, where the frame is, whether sure].
LOG = """() => {
  globalThis.drawn = [];
  const each = () => {
    requestAnimationFrame(each);
    const { app, client, frame } = synchronizar;
    const ball = client.objects.get("catch ball");
    const last = drawn.at(-1);
    if (!app?.at || !ball || !frame.placing) return;
    const { x, y, z, yaw, scale } = frame.placing;
    const sure = frame.registered && frame.opacity === 1;
    const now = [client.roomTime, ball.data, app.at, [x, y, z, yaw, scale], sure];
    if (!last || last[2].some((v, i) => v !== app.at[i])) drawn.push(now);
  };
  requestAnimationFrame(each);
}"""
THROW = "() => { synchronizar.app.select.start(); synchronizar.app.select.end(); }"


async def play(simulation: Simulation, out: Path | None) -> dict[str, Any]:
    """The game; what the pages drew, when the one who comes late was let in and first had the ball, and the score."""
    from playwright.async_api import async_playwright

    seconds, recording = simulation.scene.seconds, ranging_with_one(simulation.recording)
    result: dict[str, Any] = {"drawn": {name: [] for name in PHONES}}
    with server("--app", "catch") as where:
        async with async_playwright() as playwright:
            chromium = await browser.launch(playwright)
            pages = {name: await (await browser.context(chromium, 390, 700, phone=True)).new_page() for name in PHONES}
            room = await (await browser.context(chromium, 1000, 700)).new_page()
            await room.goto(f"{where['url']}/room#{where['room']}")
            result["began"] = began = time.time() + 0.5
            programs = [asyncio.create_task(program(where["join"], recording, PROGRAM, began, result))]
            await asyncio.sleep(1.0)
            for name, page in pages.items():
                await browser.walk_in(page, where["url"], where["room"], name, recording.tracks[name], began)
                await page.evaluate(LOG)
            await asyncio.sleep(max(0.0, began + LATE_AFTER_S - time.time()))
            programs.append(asyncio.create_task(program(where["join"], recording, LATE, began, result)))
            throwing = [asyncio.create_task(throws(page, name)) for name, page in pages.items()]
            if out is not None:
                await pictures(pages[PHONES[0]], room, out)
            await asyncio.sleep(max(0.0, began + 2.0 * seconds / 3.0 - time.time()))
            await gather(pages, result)
            await pages[PHONES[1]].reload()
            await browser.start(pages[PHONES[1]], recording.tracks[PHONES[1]], began)
            await pages[PHONES[1]].evaluate(LOG)
            await asyncio.sleep(max(0.0, began + seconds - time.time()))
            await gather(pages, result)
            for task in (*throwing, *programs):
                task.cancel()
            await chromium.close()
    return result


async def gather(pages: dict[str, Page], result: dict[str, Any]) -> None:
    """What the pages have drawn until now."""
    for name, page in pages.items():
        result["drawn"][name].append(json.loads(await page.evaluate("JSON.stringify(drawn.splice(0))")))


async def throws(page: Page, name: str) -> None:
    """A person who throws the ball soon after it has come."""
    mine = f"synchronizar.client.objects.get('{BALL}')?.data.by === '{name}'"
    held = f"{mine} && synchronizar.client.objects.get('{BALL}').data.phase === 'held'"
    while True:
        await asyncio.sleep(0.2)
        with suppress(Exception):  # the page is being loaded anew
            if await page.evaluate(f"Boolean({held})"):
                await asyncio.sleep(HELD_S)
                await page.evaluate(THROW)


async def program(address: str, recording: Recording, name: str, began: float, result: dict[str, Any]) -> None:
    """A player without a page: walks, and throws to somebody else."""
    choice = random.Random(name)
    async with await Client.join(address, [name]) as client:
        walking = asyncio.create_task(walk(client, recording, [name], began, heard=True))
        stage, held_since = Stage(client.welcome), None
        result.setdefault(f"{name} came", time.time() - began)
        try:
            async for word in client.messages():
                stage.hear(word)
                if score := client.objects.get(SCORE):
                    result["score"] = score.data
                ball = client.objects.get(BALL)
                if name in stage.players:
                    result.setdefault(f"{name} registered", time.time() - began)
                if ball is None or ball.data["phase"] != "held" or ball.data["by"] != name:
                    held_since = None
                    continue
                result.setdefault(f"{name} has the ball", time.time() - began)
                held_since = held_since or time.monotonic()
                others = [player for other, player in stage.players.items() if other != name]
                if others and time.monotonic() - held_since > HELD_S:
                    (x, y, _), (ox, oy, _) = stage.players[name].position, choice.choice(others).position
                    await client.say_message(m.Say("throw", {"velocity": [ox - x, oy - y, 1.0]}, m.APP))
                    held_since = time.monotonic()
        finally:
            walking.cancel()


def ranging_with_one(recording: Recording) -> Recording:
    """Who comes late has ranges with one of the others only."""
    names = [user.name for user in recording.users]
    late, one = names.index(LATE), names.index(PHONES[0])
    r = recording.ranges
    ends = np.stack([r.a, r.b])
    keep = ~(ends == late).any(0) | (ends == one).any(0)
    return replace(recording, ranges=r.select(keep))


async def pictures(phone: Page, room: Page, out: Path) -> None:
    """Of both pages, while the ball flies and is seen."""
    out.mkdir(parents=True, exist_ok=True)
    flies = f"synchronizar.client.objects.get('{BALL}')?.data.phase === 'flies'"
    with suppress(TimeoutError):
        await browser.until(phone, flies, 30.0)
        await room.screenshot(path=out / "catch-room.png")
        await browser.until(phone, flies, 30.0)
        await phone.screenshot(path=out / "catch-phone.png")


def judged(simulation: Simulation, result: dict[str, Any]) -> dict[str, Any]:
    """Lengths in m."""
    arcs: list[float] = []
    steps: list[float] = []
    off: list[float] = []
    flights: dict[str, dict[tuple[float, float], Array]] = {name: {} for name in PHONES}
    for name, parts in result["drawn"].items():
        for part in parts:
            begun, before = -np.inf, None
            for now in part:
                t, data, at, placing, sure = now
                if before is not None and data != before[1]:
                    begun = t
                if before is not None and sure and before[4] and 0.0 < t - before[0] < 0.05:
                    steps.append(float(np.linalg.norm(np.subtract(at, before[2]))) / (t - before[0]) / 60.0)
                before = now
                if not sure or t - begun < SETTLED_S:
                    continue
                if data["phase"] == "flies":
                    told = Flight(data["t"], tuple(data["position"]), tuple(data["velocity"])).at(t)
                    arcs.append(float(np.linalg.norm(np.subtract(at, told))))
                    world = world_of(simulation, name, at, placing)
                    flights[name][data["t"], round(60.0 * (t - data["t"]))] = world
                elif data["phase"] == "held" and data["by"] != name:
                    true = hand(simulation, data["by"], t - result["began"])
                    off.append(float(np.linalg.norm((world_of(simulation, name, at, placing) - true)[:2])))
    first, second = (flights[name] for name in PHONES)
    both = [float(np.linalg.norm(first[key] - second[key])) for key in first.keys() & second.keys()]
    return {
        "frames": sum(len(part) for parts in result["drawn"].values() for part in parts),
        "beside the arc that was told, p95": p95(arcs),
        "one page beside the other, p95": p95(both),
        "beside the truth of the holder's hand, in the plane, p95": p95(off),
        "largest step a 60th of a second": max(steps, default=float("nan")),
        "late one: registered after coming, s": since(result, f"{LATE} came", f"{LATE} registered"),
        "late one: has the ball after that, s": since(result, f"{LATE} registered", f"{LATE} has the ball"),
        "score": result.get("score"),
    }


def world_of(simulation: Simulation, name: str, at: Any, placing: Any) -> Array:
    """Where in the room something is that a page draws at a place of the common frame: by where that has put it."""
    common_from_user = YawFrame(*placing)
    return simulation.world_from_user[name] @ (common_from_user.inverse() @ np.array(at))


def hand(simulation: Simulation, name: str, t: float) -> Array:
    """Where somebody's ball is, in the room, at a moment of the walk."""
    track: Track = simulation.truth[name]
    row = int(np.searchsorted(track.t, t).clip(0, len(track.t) - 1))
    place = np.array([np.interp(t, track.t, axis) for axis in track.position.T])
    return np.array(Player(name, tuple(place.tolist()), tuple(track.quat_xyzw[row].tolist()), "z").hand)


def p95(values: list[float]) -> float:
    """NaN where there are none."""
    return float(np.percentile(values, 95)) if values else float("nan")


def since(result: dict[str, Any], begin: str, end: str) -> float | None:
    """None where the end was not seen."""
    return result[end] - result[begin] if begin in result and end in result else None


def main() -> None:
    """Play, and say how it was."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    simulation = simulate(Scene(users=4, seconds=options.seconds, seed=options.seed, speed=0.5))
    print(as_lines(judged(simulation, asyncio.run(play(simulation, options.out)))))


if __name__ == "__main__":
    main()
