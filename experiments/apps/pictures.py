"""Pictures of each application, as people see them: a phone's page, the room's page, and some seconds of the phone's.

`python -m experiments.apps.pictures [--apps catch treasure robot] [--seconds 120] [--out build/apps]`: three programs
walk and play, beside a phone that is emulated in a browser, whose bearer looks where something happens. With `robot` a
simulated one drives among them. The ones in docs/apps/ are these.
"""

from __future__ import annotations

import argparse
import asyncio
import base64
import io
import tempfile
import time
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from experiments.live import browser
from experiments.live.screenshots import NAMES, renamed
from experiments.live.walkers import server, walk
from synchronizar.apps.bodies.body import SimulatedBody
from synchronizar.apps.bodies.drive import Drive, Ground, Twist
from synchronizar.apps.catch.game import BALL
from synchronizar.apps.robot.__main__ import SETTINGS
from synchronizar.apps.robot.client import RobotClient
from synchronizar.geometry import wrap_angle
from synchronizar.live import messages as m
from synchronizar.live.client import Client
from synchronizar.live.stage import Stage
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

if TYPE_CHECKING:
    from playwright.async_api import Page

APPS = ("catch", "treasure", "robot")
PEOPLE, PHONE, ROBOT = ("Anna", "Ben", "Cleo"), "Dilip", "robot"
IDS = {name: id_ for id_, name in NAMES.items()}
SCREEN, ROOM = (390, 844), (1200, 900)
FILMED_S, SHOWN_S = 25.0, 7.0
"""s: so long the phone's page is filmed, and so long the best piece of that is."""
MOMENT_S = 45.0
"""s: so long a moment is waited for that is worth a picture; else it is the best one of the film."""
FRAMES, WIDTH = 28, 260
"""Of the moving pictures; px."""
HELD_S, PUT_EVERY_S = 1.5, 3.0
MOST_PUT = 4
RANGED_EVERY_S, RANGE_M = 0.1, 0.05
"""The robot's ranges: s, and m of noise."""
STARTS, OPERATOR = Ground(2.0, 2.0, -2.4), Twist(0.35, 0.45)
"""Of the robot, and how somebody drives it until it is registered."""
CLICK = """(words) => [...document.querySelectorAll("#app button")]
  .find((button) => button.textContent === words && button.offsetParent !== null)?.click()"""

LOOKS = """([what, name]) => {
  const { app, avatars, client, frame, stage } = synchronizar;
  const walks = phone.place;
  const seen = (globalThis.seen = []);
  globalThis.stop = Infinity;
  const data = () => client.objects.get("catch ball")?.data;
  const others = () => Object.entries(avatars.places).filter(([, { state }]) => state === "registered");
  const heads = () => others().filter(([other]) => other !== "robot").map(([, { position }]) => position);
  const alone = (p) => Number(heads().every((q) => Math.hypot(...p.map((v, i) => v - q[i])) > 0.6));
  const device = ([a, b, c]) => {
    const m = stage.common.matrix.elements;
    return [0, 1, 2].map((i) => m[i] * a + m[4 + i] * b + m[8 + i] * c + m[12 + i]);
  };
  const things = () => {
    // Who has the ball looks at somebody to throw it to.
    if (what === "catch" && data()?.by === name && data().phase === "held") return heads();
    if (what === "catch") return app.at ? [app.at] : [];
    if (what === "robot") return avatars.places.robot ? [avatars.places.robot.position] : [];
    const coins = Object.entries(app.places).filter(([id]) => client.objects.get(id)?.data.what === "coin");
    return coins.map(([, place]) => place);
  };
  let [yaw, pitch, at, last] = [null, 0, 0, null];
  phone.place = (t) => {
    const [x, y, z, ...q] = walks(t);
    const near = things().map(device).map((p) => [p[0] - x, p[1] - y, p[2] - z]);
    near.sort((a, b) => Math.abs(Math.hypot(...a) - 2) - Math.abs(Math.hypot(...b) - 2));
    const [goal] = near.length ? near : [[-2 * (q[0] * q[2] + q[3] * q[1]), 0, 2 * (q[0] * q[0] + q[1] * q[1]) - 1]];
    const wanted = Math.atan2(-goal[0], -goal[2]);
    // A little below it, where the screen has room.
    const down = Math.max(-0.7, Math.min(0.3, Math.atan2(goal[1], Math.hypot(goal[0], goal[2])) - 0.12));
    const turns = 2.5 * Math.max(0, Math.min(0.2, t - at));
    const off = yaw === null ? 0 : Math.atan2(Math.sin(wanted - yaw), Math.cos(wanted - yaw));
    yaw = yaw === null ? wanted : yaw + Math.max(-turns, Math.min(turns, off));
    pitch += Math.max(-turns, Math.min(turns, down - pitch));
    at = t;
    last = [x, y, z];
    const [sy, cy, sp, cp] = [Math.sin(yaw / 2), Math.cos(yaw / 2), Math.sin(pitch / 2), Math.cos(pitch / 2)];
    return [x, y, z, cy * sp, sy * cp, -sy * sp, cy * cp];
  };
  /** How far to the side of where the phone looks something is, rad; null of what is too near. */
  const aside = (place) => {
    const [dx, dy, dz] = device(place).map((v, i) => v - last[i]);
    if (Math.hypot(dx, dz) < 0.7) return null;
    const [off, above] = [Math.atan2(-dx, -dz) - yaw, Math.atan2(dy, Math.hypot(dx, dz)) - pitch - 0.12];
    return Math.hypot(Math.atan2(Math.sin(off), Math.cos(off)), 0.5 * above);
  };
  const shown = (places) => places.map(aside).filter((off) => off !== null && off < 0.22).length;
  /** Whether something stands in the way. */
  const hidden = () =>
    [...Object.values(app.places ?? {}), ...heads()].map(device).some((p) => {
      const [ahead, way] = [last.map((v, i) => p[i] - v), [-Math.sin(yaw), -Math.cos(yaw)]];
      return Math.hypot(ahead[0], ahead[2]) < 1.3 && ahead[0] * way[0] + ahead[2] * way[1] > 0;
    });
  const worth = () => {
    if (!frame.registered || frame.opacity < 1 || !last) return 0;
    const mine = Math.min(3, shown(things()));
    const people = Math.min(1, shown(heads()));
    if (what === "catch" && data()?.phase === "flies") return mine ? 2 + people + alone(app.at) : 0;
    if (what === "catch") return data()?.phase === "held" ? mine : 0;
    if (what === "robot") return mine ? mine + 2 * shown(Object.values(app.places)) + people : 0;
    return hidden() ? 0 : mine + people;
  };
  const update = app.update;
  app.update = (...args) => {
    update.apply(app, args);
    const now = worth();
    seen.push([(performance.timeOrigin + performance.now()) / 1000, now]);
    if (now < stop) return;
    // A picture takes its time on a busy machine: all of it stays as it is.
    const [placing, here, told] = [frame.step(0, "things"), phone.place(at), seen.at(-1)];
    frame.step = () => placing;
    phone.place = () => here;
    avatars.update = synchronizar.objects.update = synchronizar.overlay.update = app.update = () => {};
    globalThis.stopped = told;
  };
}"""
# From how much there is to see on: with less than all of it in the end.
WORTH = (4, 3, 1)
ASK = "(whom) => synchronizar.client.say('ask', { whom }, 'app')"


async def person(address: str, simulation: Simulation, name: str, app: str, began: float) -> None:
    """A program that walks and plays: it throws the ball to the others in turn, or puts things down."""
    acted, done = time.time(), 0
    async with await Client.join(address, [name]) as client:
        walking = asyncio.create_task(walk(client, renamed(simulation.recording), [name], began, heard=True))
        stage = Stage(client.welcome)
        try:
            async for word in client.messages():
                stage.hear(word)
                others = [player for other, player in sorted(stage.players.items()) if other != name]
                ball = stage.objects.get(BALL)
                holds = ball is not None and ball.data == {"phase": "held", "by": name}
                if name not in stage.players or not (holds or app == "treasure"):
                    acted = time.time()
                elif app == "catch" and others and time.time() - acted > HELD_S:
                    acted, done = time.time(), done + 1
                    (x, y, _), (ox, oy, _) = stage.players[name].position, others[done % len(others)].position
                    await client.say_message(m.Say("throw", {"velocity": [ox - x, oy - y, 1.2]}, m.APP))
                elif app == "treasure" and done < MOST_PUT and time.time() - acted > PUT_EVERY_S:
                    acted, done = time.time(), done + 1
                    what = ("coin", "coin", "rusted", "obstacle")[done % 4]
                    await client.say_message(m.Say("put", {"what": what}, m.APP))
        finally:
            walking.cancel()


async def robot(address: str, simulation: Simulation, began: float, sees: asyncio.Event) -> None:
    """It ranges with everybody, and does as it is told once it is registered. `sees`: while somebody is before it."""
    noise = np.random.default_rng(7)
    drive = Drive(STARTS, 7)
    body = SimulatedBody(drive)
    async with await Client.join(address, {ROBOT: SETTINGS}) as client:
        runs = RobotClient(client, ROBOT, body)
        running = asyncio.create_task(runs.run())
        try:
            while True:
                await asyncio.sleep(RANGED_EVERY_S)
                told = client.frames.users.get(ROBOT)
                if runs.asked is None:
                    await body.command(OPERATOR if told is None or told.state != "registered" else Twist(0.0, 0.0))
                if runs.at is not None and any(before(runs.at, place) for place in runs.pilot.places.values()):
                    sees.set()
                else:
                    sees.clear()
                body.odometry()
                now, at = time.time(), np.array([drive.truth.x, drive.truth.y, 0.0])
                ranges = []
                for name in {*PEOPLE, PHONE} & client.members.keys() if now > began else ():
                    truth = simulation.truth[IDS[name]]
                    there = np.array([np.interp(now - began, truth.t, axis) for axis in truth.position.T])
                    distance = float(np.linalg.norm(there - at) + noise.normal(0.0, RANGE_M))
                    ranges.append(m.MeasuredRange(now, ROBOT, name, distance))
                await client.send_ranges(ranges)
        finally:
            running.cancel()


def before(at: Ground, place: tuple[float, float]) -> bool:
    """Whether somebody there is well seen by a robot."""
    dx, dy = place[0] - at.x, place[1] - at.y
    return 1.2 < np.hypot(dx, dy) < 4.5 and abs(wrap_angle(np.arctan2(dy, dx) - at.heading)) < 0.4


async def orders(phone: Page) -> None:
    """Whoever holds the phone is mirrored, as soon as the robot is there, and anew where it was told to stay."""
    while True:
        await asyncio.sleep(2.0)
        if not await phone.evaluate("synchronizar.client.objects.get('robot order robot')?.data.mirror"):
            await phone.evaluate(CLICK, "Mirror me")


async def throws(phone: Page) -> None:
    """Whoever holds the phone throws the ball on."""
    while True:
        await asyncio.sleep(HELD_S)
        await phone.evaluate("() => { synchronizar.app.select.start(); synchronizar.app.select.end(); }")


async def take(app: str, simulation: Simulation, out: Path) -> None:
    """Walk and play, and take the pictures."""
    from playwright.async_api import async_playwright

    sees = asyncio.Event()
    # A game of another day is none of this one.
    with tempfile.TemporaryDirectory() as folder, server("--app", app, "--record", folder) as where:
        async with async_playwright() as playwright:
            chromium = await browser.launch(playwright)
            room = await (await browser.context(chromium, *ROOM)).new_page()
            await room.goto(f"{where['url']}/room#{where['room']}")
            phone = await (await browser.context(chromium, *SCREEN, phone=True)).new_page()
            await browser.arrive(phone, where["url"], where["room"], PHONE)
            began = time.time() + 0.5
            running = [person(where["join"], simulation, name, app, began) for name in PEOPLE]
            if app == "robot":
                running.append(robot(where["join"], simulation, began, sees))
            tasks = [asyncio.create_task(one) for one in running]
            await browser.start(phone, renamed(simulation.recording).tracks[PHONE], began)
            await browser.until(phone, "globalThis.synchronizar?.app")
            await phone.evaluate(LOOKS, [app, PHONE])
            if app in ("robot", "catch"):
                tasks.append(asyncio.create_task(orders(phone) if app == "robot" else throws(phone)))
            await browser.until(phone, BEGUN[app], simulation.scene.seconds)
            if app == "robot":
                for page in (phone, room):
                    await page.evaluate(ASK, ROBOT)
                with suppress(TimeoutError):
                    await asyncio.wait_for(sees.wait(), MOMENT_S)
                await asyncio.sleep(1.0)
            await room.evaluate("document.querySelector('#app').scrollIntoView({ block: 'nearest' })")
            await room.screenshot(path=out / f"{app}_room.png")
            # Two pages are more than a busy machine draws well.
            await room.close()
            await look(app, phone, out)
            for task in tasks:
                if task.done():
                    task.result()
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await chromium.close()


# On the phone's page: whether all is there of which pictures are taken.
BEGUN = {
    "catch": "synchronizar.frame.registered && synchronizar.client.objects.get('catch score')?.data.rally > 0",
    "treasure": "synchronizar.frame.registered && Object.keys(synchronizar.app.places).length > 8",
    "robot": "synchronizar.frame.registered && synchronizar.client.objects.get('robot order robot')?.data.mirror",
}


async def look(app: str, phone: Page, out: Path) -> None:
    """A moving picture of the phone's page, and a moment of it."""
    film = await filmed(phone, FILMED_S)
    seen: list[tuple[float, float]] = await phone.evaluate("seen")
    save(best_of(film, seen), out / f"{app}.webp")
    best = max(seen, key=lambda row: row[1])[0]
    min(film, key=lambda shot: abs(shot[0] - best))[1].save(out / f"{app}_phone.png")
    for least in WORTH:
        await phone.evaluate("(least) => (globalThis.stop = least)", least)
        with suppress(TimeoutError):
            await browser.until(phone, "globalThis.stopped", MOMENT_S / len(WORTH))
            await phone.screenshot(path=out / f"{app}_phone.png")
            return


async def filmed(page: Page, seconds: float) -> list[tuple[float, Image.Image]]:
    """What a page shows, each picture with its time (s since 1970)."""
    film: list[tuple[float, Image.Image]] = []
    session = await page.context.new_cdp_session(page)

    async def take(frame: dict[str, Any]) -> None:
        film.append((frame["metadata"]["timestamp"], Image.open(io.BytesIO(base64.b64decode(frame["data"])))))
        await session.send("Page.screencastFrameAck", {"sessionId": frame["sessionId"]})

    taking: set[asyncio.Task[None]] = set()
    session.on("Page.screencastFrame", lambda frame: taking.add(asyncio.create_task(take(frame))))
    await session.send("Page.startScreencast", {"format": "jpeg", "quality": 90})
    await asyncio.sleep(seconds)
    await session.send("Page.stopScreencast")
    await asyncio.gather(*taking, return_exceptions=True)
    return sorted(film, key=lambda shot: shot[0])


def best_of(film: list[tuple[float, Image.Image]], seen: list[tuple[float, float]]) -> list[tuple[float, Image.Image]]:
    """The piece of it in which there is most to see; `seen`: how much at what time."""
    when, much = np.array(seen).T

    def of(begin: float) -> float:
        inside = (when >= begin) & (when < begin + SHOWN_S)
        return float(much[inside].mean()) if inside.any() else -1.0

    begin = max((t for t, _ in film if t <= max(film[0][0], film[-1][0] - SHOWN_S)), key=of)
    piece = [(t, shot) for t, shot in film if begin <= t < begin + SHOWN_S]
    every = -(-len(piece) // FRAMES)
    return piece[::every]


def save(film: list[tuple[float, Image.Image]], path: Path) -> None:
    """The moving picture, at the pace at which it went."""
    shots = [shot.convert("RGB").resize((WIDTH, round(WIDTH * shot.height / shot.width))) for _, shot in film]
    lasts = [max(40, round(1000.0 * (b - a))) for (a, _), (b, _) in pairwise(film)] + [400]
    shots[0].save(path, save_all=True, append_images=shots[1:], duration=lasts, loop=0, quality=60, method=4)


def main() -> None:
    """Take them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--apps", nargs="+", choices=APPS, default=APPS)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("build/apps"))
    options = parser.parse_args()
    if reason := browser.why_not():
        raise SystemExit(reason)
    options.out.mkdir(parents=True, exist_ok=True)
    for app in options.apps:
        scene = Scene(users=len(PEOPLE) + 1, seconds=options.seconds + 120.0, seed=options.seed, speed=0.5, area=5.0)
        asyncio.run(take(app, simulate(scene), options.out))
        print(*(f"{file} {file.stat().st_size}" for file in sorted(options.out.glob(f"{app}*"))), sep="\n")


if __name__ == "__main__":
    main()
