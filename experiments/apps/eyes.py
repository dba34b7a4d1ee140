"""Look through my eyes, end to end: a furnished room that two scan, a phone in a browser, the room's page.

`python -m experiments.apps.eyes [--seconds 60] [--seed 0] [--out DIR]`: a server on this machine and three native
devices that walk; two of them tell what they see of the furniture and walls about them, one shows still frames. The
phone asks to see through that one's eyes; the room's page asks the phone, which says yes, and stops it again. The phone
points at the middle of its picture three times. Judged, in m: how far the model's cells lie from the true surfaces; how
far the screen of the other's view is drawn from where that one is, in the room, by where the phone has put the common
frame; how far apart the phone and the room's page draw marks. With `--out`, pictures of both pages.
"""

from __future__ import annotations

import argparse
import asyncio
import base64
import io
import json
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from experiments.apps.shown import p95
from experiments.common.full_oracle import common_from_world
from experiments.common.results import as_lines
from experiments.live import browser
from experiments.live.screenshots import looking_at_others, renamed
from experiments.live.walkers import server, walk
from synchronizar.apps.eyes.game import SCAN
from synchronizar.apps.eyes.scan import Cube, cells_of, middles, seen
from synchronizar.arrays import Array
from synchronizar.geometry import YawFrame
from synchronizar.live import messages as m
from synchronizar.live.client import Client
from synchronizar.live.stage import Stage
from synchronizar.quaternions import rotate_by_quaternions
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

PHONE, SCANNERS, SHOWS = "Emre", ("Anna", "Ben"), "Ben"
IDS = {"Anna": "phone0", "Ben": "phone1", "Cleo": "phone2", "Emre": "phone4"}  # in the simulation
# Boxes of the room, m: least and greatest x, y, z.
FURNITURE = [
    ((-4.0, -4.0, -0.05), (4.0, 4.0, 0.0)),
    ((-4.0, 4.0, 0.0), (4.0, 4.1, 2.4)),
    ((-4.1, -4.0, 0.0), (-4.0, 4.0, 2.4)),
    ((1.8, 2.6, 0.0), (3.6, 3.4, 0.75)),
    ((-3.6, 2.9, 0.0), (-1.6, 3.7, 0.45)),
    ((-3.9, -2.0, 0.0), (-3.5, 0.5, 1.9)),
    ((-0.6, 3.5, 0.0), (0.2, 3.9, 1.1)),
]
SAMPLE_M, REACH_M, FIELD_RAD = 0.05, 4.0, 0.7
EVERY_S = 0.5
LOG = """() => {
  globalThis.drawn = [];
  const each = () => {
    requestAnimationFrame(each);
    const { app, avatars, frame } = synchronizar;
    if (!app || !frame.placing) return;
    const { x, y, z, yaw, scale } = frame.placing;
    const at = app.places.Ben, t = avatars.places.Ben?.t;
    if (at && t && frame.registered && frame.opacity === 1) drawn.push([t, at, [x, y, z, yaw, scale]]);
  };
  requestAnimationFrame(each);
}"""
PRESS = "(text) => [...document.querySelectorAll('#app button')].find((b) => b.textContent === text)?.click()"


def surfaces() -> Array:
    """(n, 3) m: points of all faces of the furniture, in the room."""
    points = []
    for low, high in FURNITURE:
        for axis in range(3):
            spans = [np.arange(a, b + SAMPLE_M, SAMPLE_M) for a, b in zip(low, high, strict=True)]
            for side in (low[axis], high[axis]):
                spans[axis] = np.array([side])
                points.append(np.stack(np.meshgrid(*spans), axis=-1).reshape(-1, 3))
    return np.concatenate(points)


async def native(address: str, simulation: Simulation, name: str, began: float, result: dict[str, Any]) -> None:
    """A device without a page: it walks, and tells what it sees."""
    recording, points, told = simulation.recording, surfaces(), 0.0
    truth, own_from_world = simulation.truth[IDS[name]], simulation.world_from_user[IDS[name]].inverse()
    async with await Client.join(address, [name]) as client:
        walking = asyncio.create_task(walk(client, renamed(recording), [name], began, heard=True))
        stage = Stage(client.welcome)
        try:
            async for word in client.messages():
                stage.hear(word)
                result["objects"], result["reference"] = client.objects, stage.frames.reference
                t = time.time() - began
                if t - told < EVERY_S or name not in stage.players:
                    continue
                told = t
                frame = stage.frames.users[name]
                if name in SCANNERS and None not in (frame.x, frame.y, frame.z, frame.yaw):
                    row = int(np.searchsorted(truth.t, t).clip(0, len(truth.t) - 1))
                    near = in_view(points, truth.position[row], truth.quat_xyzw[row])
                    common_from_user = YawFrame(frame.x, frame.y, frame.z, frame.yaw, frame.scale)
                    for data in seen(common_from_user @ (own_from_world @ near)):
                        await client.say_message(m.Say("seen", data, m.APP))
                if name == SHOWS:
                    await show(client, t)
        finally:
            walking.cancel()


def in_view(points: Array, eye: Array, quat_xyzw: Array) -> Array:
    """Those of points (n, 3) that a device there sees, as if nothing hid anything; it looks along its own x."""
    way = rotate_by_quaternions(quat_xyzw[None], np.array([[1.0, 0.0, 0.0]]))[0]
    there = points - eye
    distance = np.linalg.norm(there, axis=1)
    return points[(distance < REACH_M) & (there @ way > distance * np.cos(FIELD_RAD))]


async def show(client: Client, t: float) -> None:
    """Say yes to whoever asks, and send a picture to those who may look."""
    for look in [o.data for o in client.objects.values() if o.kind == "eyes look" and o.data["whom"] == SHOWS]:
        if look["state"] == "asked":
            await client.say_message(m.Say("allow", {"who": look["who"]}, m.APP))
        elif look["state"] == "on":
            data = {"jpeg": picture(t), "half": 0.47, "aspect": 4.0 / 3.0}
            await client.say_message(m.Say("eye", data, look["who"] or None))


def picture(t: float) -> str:
    """A picture of some camera, as base64 of JPEG: a sky, a floor, and the time."""
    from PIL import Image, ImageDraw

    image = Image.new("RGB", (160, 120), (150, 190, 230))
    paint = ImageDraw.Draw(image)
    paint.rectangle((0, 70, 160, 120), fill=(120, 100, 80))
    paint.rectangle((50, 45, 110, 90), fill=(200, 120, 60))
    paint.text((8, 8), f"{t:.1f} s", fill=(0, 0, 0))
    out = io.BytesIO()
    image.save(out, "JPEG", quality=60)
    return base64.b64encode(out.getvalue()).decode("ascii")


async def visit(simulation: Simulation, out: Path | None) -> dict[str, Any]:
    """All of it; what was drawn."""
    from playwright.async_api import async_playwright

    seconds, result = simulation.scene.seconds, {}
    track = looking_at_others(simulation)
    with server("--app", "eyes") as where:
        async with async_playwright() as playwright:
            chromium = await browser.launch(playwright)
            room = await (await browser.context(chromium, 1200, 900)).new_page()
            await room.goto(f"{where['url']}/room#{where['room']}")
            result["began"] = began = time.time() + 0.5
            tasks = [
                asyncio.create_task(native(where["join"], simulation, name, began, result))
                for name in ("Anna", "Ben", "Cleo")
            ]
            phone = await (await browser.context(chromium, 390, 780, phone=True)).new_page()
            heard = browser.complaints(phone), browser.complaints(room)
            await browser.walk_in(phone, where["url"], where["room"], PHONE, track, began)
            await phone.evaluate(LOG)
            await browser.until(phone, "synchronizar.frame.registered", seconds)
            await phone.evaluate("synchronizar.client.say('ask', { whom: 'Ben' }, 'app')")
            await room.evaluate("synchronizar.client.say('ask', { whom: 'Emre' }, 'app')")
            await browser.until(phone, "document.querySelector('#app [role=status] button')")
            if out is not None:
                out.mkdir(parents=True, exist_ok=True)
                await phone.screenshot(path=out / "eyes_asked.png")
            await phone.evaluate(PRESS, "Yes")
            for wait in (0.3, 0.5, 0.7):
                await asyncio.sleep(max(0.0, began + wait * seconds - time.time()))
                await phone.evaluate(PRESS, "Point at this")
            await asyncio.sleep(max(0.0, began + 0.8 * seconds - time.time()))
            if out is not None:
                await room.screenshot(path=out / "eyes_room.png")
                await phone.screenshot(path=out / "eyes_phone.png")
            result["drawn"] = json.loads(await phone.evaluate("JSON.stringify(drawn)"))
            result["complaints"] = [text for page in heard for text in page if "GPU stall" not in text]
            result["marks"] = json.loads(await phone.evaluate("JSON.stringify(synchronizar.app.places)"))
            await phone.evaluate(PRESS, "Stop")
            with suppress(TimeoutError):
                await browser.until(phone, "!document.querySelector('#app .seen')", 10.0)
                result["stopped"] = True
            for task in tasks:
                task.cancel()
            await chromium.close()
    return result


def judged(simulation: Simulation, result: dict[str, Any]) -> dict[str, Any]:
    """Lengths in m."""
    from scipy.spatial import KDTree

    objects = result["objects"].values()
    scan = [Cube(at_of(o), cells_of(o.data) or 0) for o in objects if o.kind == SCAN]
    cells = np.concatenate([middles(cube) for cube in scan]) if scan else np.zeros((0, 3))
    true = common_from_world(simulation, IDS[result["reference"]]) @ surfaces()
    off = KDTree(true).query(cells)[0] if len(cells) else np.zeros(0)
    screen = []
    truth = simulation.truth["phone1"]
    for t, at, placing in result["drawn"]:
        world = simulation.world_from_user["phone4"] @ (YawFrame(*placing).inverse() @ np.array(at))
        there = np.array([np.interp(t - result["began"], truth.t, axis) for axis in truth.position.T])
        screen.append(float(np.linalg.norm((world - there)[:2])))
    marks = {o.id: o.position for o in objects if o.kind == "eyes mark"}
    apart = [float(np.linalg.norm(np.subtract(at, marks[id_]))) for id_, at in result["marks"].items() if id_ in marks]
    return {
        "cubes": len(scan),
        "cells": len(cells),
        "a cell's middle from the true surface, p95": p95(off.tolist()),
        "the other's screen from where it is, in the plane, p95": p95(screen),
        "frames with a screen": len(screen),
        "marks": len(marks),
        "a mark on the phone's page from the room's, largest": max(apart, default=float("nan")),
        "it is over when the phone says so": result.get("stopped", False),
        "complaints of the pages": result["complaints"],
    }


def at_of(o: m.Object) -> tuple[int, int, int]:
    """Which cube an object is."""
    x, y, z = map(int, o.id.split()[1:])
    return x, y, z


def main() -> None:
    """Walk, and say how it was."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    if reason := browser.why_not():
        raise SystemExit(reason)
    simulation = simulate(Scene(users=5, seconds=options.seconds + 20.0, seed=options.seed, speed=0.6))
    print(as_lines(judged(simulation, asyncio.run(visit(simulation, options.out)))))


if __name__ == "__main__":
    main()
