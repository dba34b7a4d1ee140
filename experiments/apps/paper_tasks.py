"""The paper's tasks through the phone's page: pointing at spheres, following traces (figures 9 and 10, SynchronizAR).

`python -m experiments.apps.paper_tasks [--trials 12] [--seed 0]`: in each trial a room of its own, a partner without a
page, and an AR phone, emulated in headless Chromium; both walk as in `experiments.paper.pointing`, in the same room, by
the same SLAM without drift, and range by their modules' firmware in the simulated air, with 0.1 m. They walk for the
paper's 10.1 s at least, and until the phone's page says that it is in place; ranging goes on. Then the partner puts the
8 spheres down, in its own frame; the user stands as there and points at 4 of them as the page draws them. Then the
partner marks a trace on the floor, an L, an S or a spline in turn, every quarter of a metre, and the user walks along
the marks as the page draws them at that moment, at 0.7 m/s, with the sway and the straying of
`experiments.paper.traces`.

Told are, by the truth, the angle between where the user points and where the sphere is, and the modified Hausdorff
distance between the trace and the walked path; beside them those of the paper's studies, at the paper's size, which are
not of the same walks, and of the same people following a trace that is shown perfectly; and after how long pages said
that they were in place. What the page draws follows what the room tells it slowly, and the slower the fewer frames it
draws: pointing is told by both.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import os
import time
from collections.abc import Sequence
from contextlib import AsyncExitStack
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from experiments.apps.in_browsers import IN_PLACE, KEY
from experiments.common.methods import METHODS
from experiments.common.study import COLOURS, figure, options_of, results_of, save
from experiments.live import browser
from experiments.live.load import RANGE_OF_STAMP
from experiments.live.room import TICK_S, carry, listen, module_key, place_at
from experiments.live.walkers import server
from experiments.paper import pointing, traces
from experiments.paper.pointing import PARTNER, USER
from synchronizar.arrays import Array
from synchronizar.data.track import Track
from synchronizar.geometry import YawFrame, wrap_angle
from synchronizar.live import messages as m
from synchronizar.live.client import Client
from synchronizar.quaternions import yaw_of_quaternions, yaw_quaternions
from synchronizar.simulation.live_air import LiveAir
from synchronizar.simulation.simulate import Simulation

if TYPE_CHECKING:
    from playwright.async_api import Browser, Page

LONGEST_S = 90.0
"""s of a trial; who is not in place after a third of it is left out."""
RANGE_SIGMA_M = 0.1
SPEED, FOLLOWING = 1.0, 0.7
"""m/s: to a place, and along a trace."""
AHEAD_S = 0.5
"""s by which the phone's way is told to it beforehand: a page that is busy hears it late."""
TURNING_S, STARTING_S, SETTLING_S = 0.8, 1.0, 1.0
SIGHT = 30
"""Samples (cm) of a trace ahead, where somebody looks who follows it."""
MARKED = 25
"""Samples (cm) of a trace between two marks."""
DRAWN = """[
  synchronizar.frame.placing, synchronizar.objects.places, synchronizar.frame.told,
  Object.fromEntries([...synchronizar.client.objects].map(([id, { position }]) => [id, position])),
]"""
GO = """([before, rows]) => {
  phone.table = [...phone.table.filter((row) => row[0] < before), ...rows];
}"""


AIMS = ("human", "exact", "exact, by the frame told last")
"""How the user aims at what the page draws; and at where it would be drawn if the page followed the room at once."""


class Tried(NamedTuple):
    """What came of a trial."""

    registered: float
    """s of walking until the page said that it was in place."""
    angle: Array
    """(3, 4) deg, by aim (see AIMS): between the pointing and the sphere."""
    wrong: Array
    """(3, 4) whether another sphere is nearer."""
    trace: str
    perfect: float
    """m: modified Hausdorff distance of the same person's path where the trace is shown perfectly."""
    followed: float
    """m: that of the path that was walked."""
    path: Array
    """(n, 2) m: that path."""


class Person:
    """Carries an emulated phone: where that is in truth, of which its page is told by its SLAM's frame."""

    def __init__(self, page: Page, walk: Simulation) -> None:
        """It walks as in the simulation until it is told to go elsewhere."""
        true = walk.truth[USER]
        self.began = 0.0
        """s since 1970: t = 0."""
        self._page, self._own_from_room = page, walk.world_from_user[USER].inverse()
        self._t, self._place = true.t, true.position
        self._yaw = np.unwrap(yaw_of_quaternions(true.quat_xyzw))

    @property
    def now(self) -> float:
        """Of the walk, s."""
        return time.time() - self.began

    def at(self, t: float) -> Array:
        """(3,) m: where it is in the room."""
        return np.array([np.interp(t, self._t, axis) for axis in self._place.T])

    def yaw(self, t: float) -> float:
        """rad: where it looks."""
        return float(np.interp(t, self._t, self._yaw))

    async def go(self, t: Array, place: Array, yaw: Array) -> None:
        """From t[0] on be at other places (n, 3) than it was to be, looking another way (n,)."""
        kept = self._t < t[0]
        self._t, self._place = np.append(self._t[kept], t), np.vstack([self._place[kept], place])
        self._yaw = np.unwrap(np.append(self._yaw[kept], yaw))
        # Its own frame is turned about the vertical alone.
        own = Track(t, self._own_from_room @ place, yaw_quaternions(yaw + self._own_from_room.yaw))
        await self._page.evaluate(GO, [float(t[0]), browser.table(own).tolist()])

    async def walk_to(self, goal: Array) -> None:
        """Turn there and go in a straight line, as smoothly as people do; it is there at the end."""
        await self.look_at(goal)
        begin = self.now + AHEAD_S
        here = self.at(begin)
        seconds = 0.5 + float(np.linalg.norm(goal - here)) / SPEED
        share = np.linspace(0.0, 1.0, max(2, round(seconds / TICK_S)))
        await self.go(
            begin + seconds * share, here + eased(share)[:, None] * (goal - here), self.yaw(begin) + 0.0 * share
        )
        await asyncio.sleep(AHEAD_S + seconds)

    async def look_at(self, place: Array) -> None:
        """Turn there, and stand."""
        begin = self.now + AHEAD_S
        here, share = self.at(begin), np.linspace(0.0, 1.0, round(TURNING_S / TICK_S))
        away = place - here
        yaw = np.unwrap([self.yaw(begin), math.atan2(away[1], away[0])])
        turned = yaw[0] + eased(share) * (yaw[1] - yaw[0])
        await self.go(begin + TURNING_S * share, np.tile(here, (len(share), 1)), turned)
        await asyncio.sleep(AHEAD_S + TURNING_S)

    async def sees(self, ids: Sequence[str]) -> tuple[Array, Array]:
        """(n, 3) m: where in the room objects are for who looks at the page, and by the frame that it was told last.

        Waits until all of them are drawn. NaN where the room does not know the phone's frame just then.
        """
        await browser.until(self._page, f"{list(ids)}.every((id) => id in synchronizar.objects.places)", 20.0)
        placing, places, told, objects = await browser.told(self._page, DRAWN)
        room_from_own = self._own_from_room.inverse()
        drawn = room_from_own @ (YawFrame(**placing).inverse() @ np.array([places[id_] for id_ in ids]))
        if told is None or told["state"] != "registered":
            return drawn, np.full_like(drawn, np.nan)
        own_from_common = YawFrame(**{name: told[name] for name in placing}).inverse()
        return drawn, room_from_own @ (own_from_common @ np.array([objects[id_] for id_ in ids]))


def eased(share: Array) -> Array:
    """How far along, where one begins and ends at rest."""
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * share))


class Trial:
    """One room with the two in it."""

    def __init__(self, seed: int, number: int) -> None:
        self._seed, self._task = seed, (seed, number)
        self._walk = pointing.walk_of(*self._task, seconds=LONGEST_S)
        self._random = np.random.default_rng(self._task)
        self._trace = list(traces.PAPER)[number % len(traces.PAPER)]

    async def run(self, chromium: Browser, where: dict[str, Any]) -> Tried | None:
        """None: it was not in place in time, or things did not come to be drawn."""
        async with AsyncExitStack() as stack:
            partner = await stack.enter_async_context(await Client.join(where["join"], [PARTNER]))
            key = await module_key(partner, PARTNER, 0)
            page = await (await browser.context(chromium, 240, 400, phone=True)).new_page()
            stack.push_async_callback(page.context.close)
            track = self._walk.recording.tracks[USER]
            await browser.walk_in(page, where["url"], where["room"], USER, track, time.time() + LONGEST_S)
            keys = {PARTNER: key, USER: m.ModuleKey(USER, 1, key.session, await page.evaluate(KEY, 1), None)}
            stamp_sigma = RANGE_SIGMA_M / RANGE_OF_STAMP
            air = LiveAir(key.session, where["udp_port"], self._seed, stamp_sigma=stamp_sigma)
            carry(stack.enter_context(air), keys, self._seed)
            person = Person(page, self._walk)
            person.began = time.time() + 0.2
            await browser.move(page, track, person.began)
            tasks = [
                asyncio.create_task(work)
                for work in (listen(partner), self._walks(partner, person.began), self._carries(air, person))
            ]
            try:
                return await self._tries(page, partner, person)
            finally:
                for task in tasks:
                    task.cancel()

    async def _tries(self, page: Page, partner: Client, person: Person) -> Tried | None:
        try:
            await browser.until(page, IN_PLACE, LONGEST_S / 3.0)
            registered = person.now
            await asyncio.sleep(max(0.0, pointing.WALK_S - registered))
            angle, wrong = await self._points(partner, person)
            perfect, path = await self._follows(partner, person)
        except TimeoutError:
            return None
        followed = traces.modified_hausdorff(traces.trace(self._trace), path)
        return Tried(registered, angle, wrong, self._trace, perfect, followed, path)

    async def _walks(self, partner: Client, began: float) -> None:
        """The partner walks on all the time."""
        track = self._walk.recording.tracks[PARTNER]
        rows = list(zip(track.t.tolist(), track.position.tolist(), track.quat_xyzw.tolist(), strict=True))
        said = 0
        while True:
            upto = int(np.searchsorted(track.t, time.time() - began, side="right"))
            await partner.send_poses([(PARTNER, began + t, place, quat) for t, place, quat in rows[said:upto]])
            said = upto
            await asyncio.sleep(TICK_S)

    async def _carries(self, air: LiveAir, person: Person) -> None:
        """Modules go where their bearers are."""
        while True:
            if (t := person.now) > 0.0:
                air.places(t, {0: place_at(self._walk.truth[PARTNER], t), 1: person.at(t)})
            await asyncio.sleep(TICK_S)

    async def _put(self, partner: Client, kind: str, places: Array) -> list[str]:
        """The partner puts things down at places of the room, by its own frame."""
        own = (self._walk.world_from_user[PARTNER].inverse() @ places).tolist()
        ids = [f"{kind} {n}" for n in range(len(places))]
        for id_, (x, y, z) in zip(ids, own, strict=True):
            await partner.say_message(m.Create(id_, kind, (x, y, z), user=PARTNER))
        return ids

    async def _points(self, partner: Client, person: Person) -> tuple[Array, Array]:
        """At 4 spheres, as `experiments.paper.pointing.trial` has it."""
        random = self._random
        room_from_setting = YawFrame(yaw=float(random.uniform(-np.pi, np.pi)))
        target = random.choice(pointing.SPHERES, pointing.SEQUENCE, replace=False)
        error = pointing.AIM_SIGMA * random.standard_normal((pointing.SEQUENCE, 2))
        true = room_from_setting @ pointing.spheres()
        ids = await self._put(partner, "ball", true)
        await person.walk_to(room_from_setting @ np.array([-pointing.STAND_M, 0.0, pointing.VIEW_HEIGHT_M]))
        await asyncio.sleep(SETTLING_S)
        angle, wrong = np.empty((len(AIMS), len(target))), np.empty((len(AIMS), len(target)), bool)
        for n, (which, off) in enumerate(zip(target.tolist(), error, strict=True)):
            await person.look_at((await person.sees(ids))[0][which])
            (drawn, told), view = await person.sees(ids), person.at(person.now)
            for aim, (seen, scatter) in enumerate(((drawn, off), (drawn, np.zeros(2)), (told, np.zeros(2)))):
                at = pointing.aimed((seen - view)[[which]], scatter[None])
                angle[aim, n] = np.degrees(pointing.angle_between(at, (true - view)[[which]])[0])
                wrong[aim, n] = pointing.nearest(at, true - view)[0] != which
        for id_ in ids:
            await partner.say_message(m.Remove(id_))
        return angle, wrong

    async def _follows(self, partner: Client, person: Person) -> tuple[float, Array]:
        """A trace, as somebody of `experiments.paper.traces` follows it: how far off that one is at best; its path."""
        true = traces.trace(self._trace)
        marked = np.append(np.arange(0, len(true) - 1, MARKED), len(true) - 1)
        ids = await self._put(partner, "marker", np.column_stack([true, np.zeros(len(true))])[marked])
        same = self._random.integers(2**32)

        async def way() -> Array:
            """(n, 2) m: how this one goes along the marks as they are shown now."""
            shown = (await person.sees(ids))[0][:, :2]
            line = np.column_stack([np.interp(np.arange(len(true)), marked, axis) for axis in shown.T])
            return traces.walked(np.random.default_rng(same), line)

        begin = (await way())[0]
        await person.walk_to(np.append(begin, pointing.VIEW_HEIGHT_M))
        await asyncio.sleep(SETTLING_S)
        await person.look_at(np.append((await way())[SIGHT], pointing.VIEW_HEIGHT_M))
        seconds, path = traces.SAMPLED_M * len(true) / FOLLOWING, [begin]
        began = before = person.now
        yaw = person.yaw(before + AHEAD_S)
        while (t := person.now) < began + seconds + STARTING_S:
            now = await way()
            # It begins slowly, and looks where it goes next.
            gone = FOLLOWING * max(0.0, t - began - STARTING_S * (1.0 - math.exp((began - t) / STARTING_S)))
            row = min(round(gone / traces.SAMPLED_M), len(now) - 1)
            # What is shown may jump; people do not.
            away = now[row] - path[-1]
            path.append(path[-1] + away * min(1.0, SPEED * (t - before) / max(1e-9, float(np.linalg.norm(away)))))
            ahead = now[min(row + SIGHT, len(now) - 1)] - now[max(0, row - 1)]
            turn = float(wrap_angle(math.atan2(ahead[1], ahead[0]) - yaw))
            yaw += float(np.clip(turn, -1.0, 1.0)) * (1.0 - math.exp((before - t) / TURNING_S))
            before = t
            there = np.append(path[-1], pointing.VIEW_HEIGHT_M)
            await person.go(np.array([t + AHEAD_S]), there[None], np.array([yaw]))
            await asyncio.sleep(TICK_S)
        perfect = traces.walked(np.random.default_rng(same), true)
        return traces.modified_hausdorff(true, perfect), traces.evenly(np.array(path))


async def in_browser(seed: int, number: int) -> Tried | None:
    """A trial with a server and a browser of its own."""
    from playwright.async_api import async_playwright

    with server("--no-tls", "--keep-awake") as where:
        async with async_playwright() as playwright:
            chromium = await browser.launch(playwright)
            try:
                return await Trial(seed, number).run(chromium, where)
            finally:
                await chromium.close()


def quantiles(values: Array) -> dict[str, float]:
    """What is told of those that are known."""
    values = values[np.isfinite(values)]
    return {"n": values.size, "median": float(np.median(values)), "p95": float(np.quantile(values, 0.95))}


def table(
    tried: Sequence[Tried], trials: Sequence[pointing.Trial], followed: Sequence[traces.Follow]
) -> list[dict[str, Any]]:
    """A row for each task and way."""
    rows = []

    def add(task: str, by: str, values: Array, wrong: Array | None = None) -> None:
        share: float | str = "" if wrong is None else float(wrong.mean())
        rows.append({"task": task, "by": by, **quantiles(values), "wrong sphere": share})

    add("in place after, s", "page", np.array([one.registered for one in tried]))
    for a, aim in enumerate(AIMS):
        angle, wrong = (np.array([of[a] for of in by]) for by in zip(*((t.angle, t.wrong) for t in tried), strict=True))
        add("pointing, deg", f"page, {aim} aim", angle, wrong)
    for k, method in enumerate(METHODS):
        for a, aim in enumerate(pointing.AIMS):
            angle, wrong = np.array([t.angle[k, a] for t in trials]), np.array([t.wrong[k, a] for t in trials])
            add("pointing, deg", f"study, {method}, {aim} aim", angle, wrong)
    add("traces, m", "page", np.array([one.followed for one in tried]))
    add("traces, m", "shown perfectly", np.array([one.perfect for one in tried]))
    for k, method in enumerate(METHODS):
        add("traces, m", f"study, {method}", np.array([one.estimated[k] for one in followed]))
    return rows


def main() -> None:
    """The table and the figure."""
    began = perf_counter()

    def add(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--trials", type=int, help="12, or the paper's 33 with --full")

    options = options_of(__doc__, add=add)
    count = options.trials or (pointing.USERS * pointing.TRIALS if options.full else 12)
    tried: list[Tried] = []
    for number in range(count):
        one = asyncio.run(in_browser(options.seed, number))
        print(f"{number}: {'left out' if one is None else one[:-1]}", flush=True)
        if one is not None:
            tried.append(one)
    trials = results_of(pointing.trial, [(options.seed, n) for n in range(pointing.USERS * pointing.TRIALS)], options)
    walks = range(pointing.USERS * traces.FOLLOWED)
    followed = results_of(traces.follow, [(options.seed, n, name) for name in traces.PAPER for n in walks], options)
    made, axes = figure(columns=2, height=3.2)
    _draw_angles(axes[0, 0], np.array([one.angle[0] for one in tried]), trials)
    _draw_paths(axes[0, 1], tried)
    options.load = os.getloadavg()
    save("paper_tasks", table(tried, trials, followed), made, options, began)


def _draw_angles(ax: Axes, angle: Array, trials: Sequence[pointing.Trial]) -> None:
    ax.ecdf(angle.ravel(), color=COLOURS["bound"], linewidth=1.5, label="page")
    for k, method in enumerate(METHODS):
        of = np.array([t.angle[k, pointing.AIMS.index("human")] for t in trials])
        ax.ecdf(of.ravel(), color=COLOURS[method], linewidth=1.0, label=f"study, {method}")
    ax.axvline(pointing.PAPER["mean"], color="0.6", linestyle="--", linewidth=1.0, label="the paper's mean")
    ax.set(xlabel="angle (deg)", ylabel="share of pointings within", xlim=(0.0, 12.0), ylim=(0.0, 1.02))
    ax.legend(frameon=False, loc="lower right")


def _draw_paths(ax: Axes, tried: Sequence[Tried]) -> None:
    """Traces one above the other, and how they were followed."""
    names = list(traces.PAPER)
    for one in tried:
        up = -3.8 * names.index(one.trace)
        ax.plot(one.path[:, 0], one.path[:, 1] + up, color=COLOURS["joint"], linewidth=0.7, alpha=0.8)
    for k, name in enumerate(names):
        true = traces.trace(name)
        ax.plot(true[:, 0], true[:, 1] - 3.8 * k, color="black", linewidth=1.2, linestyle=":")
    ax.set(xlabel="x (m)", ylabel="y (m), one trace below the other", aspect="equal")


if __name__ == "__main__":
    main()
