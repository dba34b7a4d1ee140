"""Each application as people have it: two phones with pages, programs, modules in the air, a late joiner, a reload.

`python -m experiments.apps.in_browsers [--apps catch treasure robot] [--seconds 120] [--seed 0] [--out DIR]`: a server
on this machine that records its room; two AR phones, emulated in headless Chromium, and the room's page, where nobody
joins; a program that walks from the beginning and one that comes after a quarter of the time; ranges by the modules'
firmware in the simulated air, over UDP; SLAM that drifts. At two thirds of the time a phone's page is loaded anew. All
play by a script. What each page has drawn, frame by frame, is put beside the truth and beside the other page, while the
page says that its phone is in place (lengths in m, 95 of 100 are within): a table, and with `--out` the same as
JSON. `experiments.apps.pictures` takes pictures of the same games.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import tempfile
import time
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.apps.shown import LOG, SETTLED_S, Frame, Judged, Walker, frames_of, p95
from experiments.common.markdown import markdown
from experiments.live import browser
from experiments.live.room import CRYSTAL_PPM, STAMP_SIGMA, TICK_S, drifting, place_at
from experiments.live.walkers import ranges_between, say_ranges, server
from synchronizar.apps.bodies.body import SimulatedBody
from synchronizar.apps.bodies.drive import Drive, Ground, Twist
from synchronizar.apps.catch.game import BALL
from synchronizar.apps.robot.__main__ import SETTINGS
from synchronizar.apps.robot.client import RobotClient
from synchronizar.apps.treasure.game import THING
from synchronizar.data.track import Track
from synchronizar.live import messages as m
from synchronizar.live.client import Client
from synchronizar.live.pose_wire import PosesDown
from synchronizar.live.stage import Stage
from synchronizar.live.words_file import read_words
from synchronizar.quaternions import multiply_quaternions, yaw_of_quaternions, yaw_quaternions
from synchronizar.simulation.live_air import Carried, LiveAir
from synchronizar.simulation.simulate import Simulation, simulate

if TYPE_CHECKING:
    from playwright.async_api import Page

APPS = ("catch", "treasure", "robot")
PHONES, PROGRAM, LATE, ROBOT = ("phone1", "phone2"), "phone0", "phone3", "robot"
NAMES = (PROGRAM, *PHONES, LATE, ROBOT)
"""By the addresses of their modules."""
LATE_AT, RELOADED_AT = 0.25, 2.0 / 3.0
"""Shares of the time."""
LONGER_S = 240.0
"""s: so much longer they play at most, until enough is drawn."""
HELD_S = 1.5
PUT_EVERY_S = 4.0
RADIO_M = 0.35
"""m above the floor: the robot's radio."""
STARTS, OPERATOR = Ground(3.5, 3.5, -2.4), Twist(0.35, 0.45)
"""Of the robot, and how somebody drives it until it is registered."""
THROW = "() => { synchronizar.app.select.start(); synchronizar.app.select.end(); }"
IN_PLACE = "synchronizar.frame?.registered && synchronizar.frame.opacity === 1"
ADVICE = "() => document.querySelector('#advice').textContent"
KEY = """(address) => new Promise((resolve) => {
  const { client } = synchronizar;
  client.addEventListener("module_key", ({ detail }) => resolve(detail.key), { once: true });
  client.module(address);
})"""

Look = Callable[["Game"], Awaitable[None]]


def scene(seconds: float, seed: int) -> Simulation:
    """Four people; those with pages look at the middle of the others, as one does who plays."""
    simulation = simulate(replace(drifting(4, seconds, seed), speed=0.5))
    tracks, truth = dict(simulation.recording.tracks), dict(simulation.truth)
    for name in PHONES:
        tracks[name], truth[name] = _looking(simulation, name)
    return replace(simulation, recording=replace(simulation.recording, tracks=tracks), truth=truth)


def _looking(simulation: Simulation, name: str) -> tuple[Track, Track]:
    own, true = simulation.recording.tracks[name], simulation.truth[name]
    others = [
        np.column_stack([np.interp(true.t, track.t, axis) for axis in track.position.T])
        for other, track in simulation.truth.items()
        if other != name
    ]
    away = np.mean(others, axis=0) - true.position
    width = round(1.5 * simulation.scene.track_rate_hz)
    smooth = [np.convolve(np.pad(v, width, mode="edge"), np.ones(width) / width, "same")[width:-width] for v in away.T]
    yaw = np.arctan2(smooth[1], smooth[0])
    down = np.array([0.0, np.sin(0.06), 0.0, np.cos(0.06)])
    drift = yaw_of_quaternions(own.quat_xyzw) - yaw_of_quaternions(true.quat_xyzw)

    def held(turns: Any) -> Any:
        return np.array([multiply_quaternions(quat, down) for quat in yaw_quaternions(turns)])

    return replace(own, quat_xyzw=held(yaw + drift)), replace(true, quat_xyzw=held(yaw))


class Game:
    """One application with everybody in it, and what was seen of it."""

    def __init__(
        self,
        app: str,
        simulation: Simulation,
        seed: int = 0,
        size: tuple[int, int] = (240, 400),
        late: str = LATE,
        partner: str | None = None,
        seconds: float | None = None,
        frames: int = 0,
    ) -> None:
        """`size`: of the phones' screens, px. `late`: who comes late.

        `partner`: the program with which alone that one ranges, by simulated ranges that the program says; None: it has
        a module in the air, as all others have. `seconds`: how long they play, None: as long as they walk; where fewer
        than `frames` were drawn in place until then, as on a slow machine, they play on while they walk.
        """
        self.app, self.simulation, self._seed, self._size = app, simulation, seed, size
        self.late, self._partner = late, partner
        self.seconds, self._frames = simulation.scene.seconds if seconds is None else seconds, frames
        self.pages: dict[str, Page] = {}
        self.room: Page | None = None
        self.clients: dict[str, Client] = {}
        self.stages: dict[str, Stage] = {}
        self.drawn: dict[str, list[list[Frame]]] = {name: [] for name in PHONES}
        self.began = 0.0
        self.robot: list[tuple[float, float, float]] = []
        """t (s since 1970), x, y: where the robot was in truth."""
        self.things: dict[str, tuple[float, str]] = {}
        """Of what was put down, of when the pose was (s, the room's clock) at which it was, and by whom."""
        self.events: dict[str, float] = {}
        """s since the walk began, by what happened first then."""
        self.advised: dict[str, list[str]] = {name: [] for name in PHONES}
        """What each page has told its phone to do before it was in place, one after the other."""
        self.complaints: list[list[str]] = []

    async def play(self, where: dict[str, Any], look: Look | None = None) -> None:
        """Until the end. `look`: does something beside it, from when the first page is in place."""
        from playwright.async_api import async_playwright

        seconds = self.seconds
        async with AsyncExitStack() as stack:
            playwright = await stack.enter_async_context(async_playwright())
            chromium = await browser.launch(playwright)
            self.room = await (await browser.context(chromium, 900, 600)).new_page()
            for name in PHONES:
                self.pages[name] = await (await browser.context(chromium, *self._size, phone=True)).new_page()
            self.complaints = [browser.complaints(page) for page in (self.room, *self.pages.values())]
            await self.room.goto(f"{where['url']}/room#{where['room']}")
            # However long pages take to load, people have the whole time.
            for name, page in self.pages.items():
                await browser.arrive(page, where["url"], where["room"], name)
            self.began = time.time() + 0.5
            session, key = await self._enter(stack, where, PROGRAM)
            air = stack.enter_context(LiveAir(session, where["udp_port"], self._seed, stamp_sigma=STAMP_SIGMA))
            tasks = [asyncio.create_task(self._walks(air, PROGRAM, key))]
            if self.app == "robot":
                tasks.append(asyncio.create_task(self._drives(stack, air, where)))
            for name in (*PHONES, LATE):
                if name != self.late:
                    tasks += await self._begins(stack, air, where, name)
            if look is not None:
                tasks.append(asyncio.create_task(self._looks(look)))
            await self._until(LATE_AT * seconds)
            tasks += await self._begins(stack, air, where, self.late)
            await self._until(RELOADED_AT * seconds)
            await self._reload(PHONES[1])
            await self._until(seconds)
            await self._gather_all()
            while self._in_place() < self._frames and time.time() - self.began < self.simulation.scene.seconds:
                await asyncio.sleep(1.0)
                await self._gather_all()
            for task in tasks:
                if task.done():
                    task.result()
                task.cancel()
            await chromium.close()

    async def _until(self, t: float) -> None:
        await asyncio.sleep(max(0.0, self.began + t - time.time()))

    async def _log(self, page: Page) -> None:
        await browser.until(page, "globalThis.synchronizar?.app")
        await page.evaluate(LOG, self.app)

    async def _gather(self, name: str) -> None:
        rows = json.loads(await self.pages[name].evaluate("JSON.stringify(drawn.splice(0))"))
        self.drawn[name].append(frames_of(rows))

    async def _gather_all(self) -> None:
        for name in PHONES:
            await self._gather(name)

    def _in_place(self) -> int:
        return sum(frame.sure for pieces in self.drawn.values() for piece in pieces for frame in piece)

    async def _reload(self, name: str) -> None:
        await self._gather(name)
        page = self.pages[name]
        await page.reload()
        await browser.start(page, self.simulation.recording.tracks[name], self.began)
        await self._log(page)

    # Who walks, and with what

    async def _begins(
        self, stack: AsyncExitStack, air: LiveAir, where: dict[str, Any], name: str
    ) -> list[asyncio.Task[None]]:
        """Somebody comes, walks and plays from now on."""
        if name not in PHONES:
            _, key = await self._enter(stack, where, name)
            return [asyncio.create_task(self._walks(air, name, key))]
        page, recording = self.pages[name], self.simulation.recording
        await browser.start(page, recording.tracks[name], self.began)
        self.events[f"{name} came"] = time.time() - self.began
        await self._log(page)
        acts = asyncio.create_task(self._acts(name))
        if name == self.late and self._partner is not None:
            ranges = ranges_between(recording, name, self._partner)
            return [acts, asyncio.create_task(say_ranges(self.clients[self._partner], ranges, self.began))]
        return [acts, asyncio.create_task(self._carries(air, name, await page.evaluate(KEY, NAMES.index(name))))]

    async def _enter(self, stack: AsyncExitStack, where: dict[str, Any], name: str) -> tuple[int, str]:
        """A program: its session among modules and its module's key."""
        settings = SETTINGS if name == ROBOT else {"up": "y"}
        client = await stack.enter_async_context(await Client.join(where["join"], {name: settings}))
        self.clients[name], self.stages[name] = client, Stage(client.welcome)
        await client.say_message(m.Module(name, NAMES.index(name)))
        key = await client.until(lambda word: isinstance(word, m.ModuleKey))
        assert isinstance(key, m.ModuleKey)
        self.events[f"{name} came"] = time.time() - self.began
        return key.session, key.key

    def _carried(self, air: LiveAir, name: str, key: str) -> None:
        random = np.random.default_rng([self._seed, NAMES.index(name)])
        radio, board = random.uniform(-CRYSTAL_PPM, CRYSTAL_PPM, 2).tolist()
        air.add(NAMES.index(name), Carried(bytes.fromhex(key), radio, board))

    async def _carries(self, air: LiveAir, name: str, key: str) -> None:
        """A module goes where its bearer is in truth."""
        self._carried(air, name, key)
        while True:
            t = time.time() - self.began
            if t > 0.0:
                air.place(NAMES.index(name), t, place_at(self.simulation.truth[name], t))
            await asyncio.sleep(TICK_S)

    async def _walks(self, air: LiveAir, name: str, key: str) -> None:
        """A program says SLAM's poses, and plays."""
        client = self.clients[name]
        tasks = [asyncio.create_task(self._carries(air, name, key)), asyncio.create_task(self._plays(name))]
        table = browser.table(self.simulation.recording.tracks[name]).tolist()
        t = self.simulation.recording.tracks[name].t
        said = int(np.searchsorted(t, time.time() - self.began))
        try:
            while True:
                upto = int(np.searchsorted(t, time.time() - self.began, side="right"))
                rows = table[said:upto]
                await client.send_poses([(name, self.began + row[0], row[1:4], row[4:]) for row in rows])
                said = upto
                await asyncio.sleep(TICK_S)
        finally:
            for task in tasks:
                task.cancel()

    async def _drives(self, stack: AsyncExitStack, air: LiveAir, where: dict[str, Any]) -> None:
        """The robot, by hand until it is registered, and from its first order on by itself."""
        _, key = await self._enter(stack, where, ROBOT)
        self._carried(air, ROBOT, key)
        drive = Drive(STARTS, self._seed)
        body = SimulatedBody(drive)
        robot = RobotClient(self.clients[ROBOT], ROBOT, body)
        running = asyncio.create_task(robot.run())
        try:
            while True:
                if robot.asked is None:
                    registered = self._registered(ROBOT)
                    await body.command(Twist(0.0, 0.0) if registered else OPERATOR)
                t = time.time() - self.began
                body.odometry()
                if t > 0.0:
                    air.place(NAMES.index(ROBOT), t, np.array([drive.truth.x, drive.truth.y, RADIO_M]))
                self.robot.append((time.time(), drive.truth.x, drive.truth.y))
                await asyncio.sleep(TICK_S)
        finally:
            running.cancel()

    def _registered(self, name: str) -> bool:
        told = self.clients[PROGRAM].frames.users.get(name)
        return told is not None and told.state == "registered"

    # What they do

    async def _plays(self, name: str) -> None:
        """A program that plays: it throws the ball to somebody, or puts coins down."""
        client, stage = self.clients[name], self.stages[name]
        acted = time.monotonic()
        of_when: dict[str, float] = {}
        async for word in client.messages():
            stage.hear(word)
            if isinstance(word, PosesDown):
                of_when |= {stage.members[pose.member].name: word.t - pose.age for pose in word.poses}
            if name in stage.players:
                self.events.setdefault(f"{name} registered", time.time() - self.began)
            for thing in stage.objects.values():
                if thing.kind == THING and isinstance(thing.data, dict):
                    by = thing.data["by"]
                    self.things.setdefault(thing.id, (of_when.get(by, thing.t), by))
            if self.app == "catch" and self._has_ball(stage, name):
                self.events.setdefault(f"{name} has the ball", time.time() - self.began)
                others = [player for other, player in stage.players.items() if other != name]
                if time.monotonic() - acted > HELD_S and others:
                    acted = time.monotonic()
                    (x, y, _), (ox, oy, _) = stage.players[name].position, others[int(acted) % len(others)].position
                    await client.say_message(m.Say("throw", {"velocity": [ox - x, oy - y, 1.0]}, m.APP))
            elif self.app == "catch":
                acted = time.monotonic()
            elif self.app == "treasure" and time.monotonic() - acted > 2.0 * PUT_EVERY_S:
                acted = time.monotonic()
                await client.say_message(m.Say("put", {"what": "coin"}, m.APP))

    def _has_ball(self, stage: Stage, name: str) -> bool:
        ball = stage.objects.get(BALL)
        return ball is not None and name in stage.players and ball.data == {"phase": "held", "by": name}

    async def _acts(self, name: str) -> None:
        """A person with a phone, who touches its page."""
        page, last, orders = self.pages[name], 0.0, 0
        while True:
            await asyncio.sleep(0.2)
            t = time.time() - self.began
            with suppress(Exception):  # the page is being loaded anew
                if not await page.evaluate(f"Boolean({IN_PLACE})"):
                    await self._waits(name)
                    continue
                self.events.setdefault(f"{name} registered", t)
                if self.app == "catch":
                    held = f"synchronizar.client.objects.get('{BALL}')?.data"
                    if await page.evaluate(f"{held}?.phase === 'held' && {held}.by === '{name}'"):
                        await asyncio.sleep(HELD_S)
                        await page.evaluate(THROW)
                elif self.app == "treasure" and t - last > PUT_EVERY_S:
                    last, what = t, ("Coin", "Coin", "Rusted coin")[round(t) % 3]
                    await page.evaluate(CLICK, self._wanted(name, t) or what)
                elif self.app == "robot" and name == PHONES[0] and t - last > 20.0 and self._registered(ROBOT):
                    last, orders = t, orders + 1
                    await page.evaluate(CLICK, ("Mirror me", "Come")[orders % 4 == 0])

    async def _waits(self, name: str) -> None:
        """Somebody who is not in place yet reads what to do, and touches the screen all the same."""
        said = await self.pages[name].evaluate(ADVICE)
        if f"{name} registered" not in self.events and said and said not in self.advised[name][-1:]:
            self.advised[name].append(said)
        if self.app == "catch":
            await self.pages[name].evaluate(THROW)

    def _wanted(self, name: str, t: float) -> str | None:
        """In the middle third of the time the coins are collected, then they are put down again."""
        share = t / self.seconds
        if name != PHONES[0]:
            return "Undo" if share > 0.9 else None
        return "Play" if 0.45 < share < 0.65 else "Back to building" if 0.65 <= share < 0.7 else None

    async def _looks(self, look: Look) -> None:
        # The other one is loaded anew on its way.
        await browser.until(self.pages[PHONES[0]], IN_PLACE)
        await look(self)

    # How it was

    def walked(self) -> Judged:
        """What the pages have drawn, beside where everybody was."""
        names = [name for name in NAMES if name != ROBOT]
        return Judged({name: Walker(self.simulation, name, self.began) for name in names}, self.drawn)

    def judged(self) -> dict[str, Any]:
        """Lengths in m."""
        of = self.walked()
        walkers = of.walkers
        phases: dict[str, tuple[Any, float]] = {}
        robot = np.array(self.robot or [(0.0, 0.0, 0.0)])

        def truth(id_: str, frame: Frame, page: str) -> Any:
            if self.app == "treasure":
                t, by = self.things.get(id_, (0.0, ""))
                return walkers[by].hand(t) if by in walkers else None
            if self.app == "robot":
                return np.array([*(np.interp(frame.shown[ROBOT], robot[:, 0], axis) for axis in robot[:, 1:].T), 0.0])
            before, since = phases.get(page, (None, 0.0))
            if before != frame.ball:
                phases[page] = frame.ball, frame.wall
                return None
            if frame.ball is None or frame.ball["phase"] != "held" or frame.wall - since < SETTLED_S:
                return None
            at = frame.shown.get(frame.ball["by"])
            return None if at is None else walkers[frame.ball["by"]].hand(at)

        off, beside, arcs = of.off(truth), of.beside_one_another(), of.arcs()
        came, late = self.events.get(f"{self.late} came"), self.events.get(f"{self.late} registered")
        return {
            "application": self.app,
            "frames": of.frames(),
            "beside the truth": p95(off),
            "beside the other page": p95(beside),
            "balls that fly, beside one another": p95(arcs),
            "largest step in a frame": of.swims(),
            "late one in place after, s": None if came is None or late is None else late - came,
            "complaints": sorted({line for heard in self.complaints for line in heard if "GL Driver" not in line}),
        }


# A button of the application, by its words.
CLICK = """(words) => [...document.querySelectorAll("#app button")]
  .find((button) => button.textContent === words && button.offsetParent !== null)?.click()"""


def record(game: Game, look: Look | None = None) -> Path:
    """Play it; the folder in which its room is recorded."""
    folder = Path(tempfile.mkdtemp(prefix=f"{game.app}-"))
    with server("--app", game.app, "--record", str(folder)) as where:
        asyncio.run(game.play(where, look))
    (recorded,) = folder.glob("room-*")
    return recorded


def run(
    app: str, seconds: float, seed: int, look: Look | None = None, frames: int = 0, **options: Any
) -> tuple[dict[str, Any], Path]:
    """One game: how it was, and the folder in which its room is recorded; `frames` as `Game` has it."""
    walk = scene(seconds + LONGER_S * (frames > 0), seed)
    game = Game(app, walk, seed, seconds=seconds, frames=frames, **options)
    recorded = record(game, look)
    words = read_words(recorded)
    newest = {word.object.id: word.object for word in words if word.object is not None}
    return game.judged() | {"words written": len(words), "objects written": len(newest)}, recorded


def main() -> None:
    """Play, and say how it was."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--apps", nargs="+", choices=APPS, default=APPS)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows = []
    for app in options.apps:
        of, recorded = run(app, options.seconds, options.seed)
        rows.append({name: f"{v:.3f}" if isinstance(v, float) else str(v) for name, v in of.items()})
        print(markdown(rows[-1:]), f"recorded in {recorded}\n", sep="\n", flush=True)
        if options.out is not None:
            options.out.mkdir(parents=True, exist_ok=True)
            (options.out / f"{app}.json").write_text(json.dumps(of))
    print(markdown(rows))


if __name__ == "__main__":
    main()
