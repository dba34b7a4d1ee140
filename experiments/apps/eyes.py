"""Look through my eyes, end to end: a furnished room that two scan, a phone in a browser, the room's page.

`python -m experiments.apps.eyes [--seconds 60] [--seed 0] [--out DIR]`: a server on this machine and three native
devices that walk; two of them tell what they see of the furniture and walls about them, one shows still frames. The
phone asks to see through that one's eyes; the room's page asks the phone, which says yes, and stops it again; it asks
to see through the other's eyes as well, and puts a stored scan, a .glb file of a shelf, on the floor. The phone points
at the middle of its picture three times. Judged, in m: how far the model's cells lie from the true surfaces, as each
sees them, the model's floor on its own; how far they would if all had told at once, and at the height at which the
room had them, what they saw; how far the screen of the other's view is drawn from where that one is, in the room, by
where the phone has put the common frame; how far apart the phone and the room's page draw marks. With `--out`,
pictures of both pages. `--without-pages`: of the model alone.
"""

from __future__ import annotations

import argparse
import asyncio
import base64
import json
import struct
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
from synchronizar.apps.bodies import camera
from synchronizar.apps.bodies.drive import Ground
from synchronizar.apps.eyes.scan import CELL_M, FLOOR, SCAN, Cube, Sightings, cells_of, middles
from synchronizar.apps.stills import Stills
from synchronizar.arrays import Array
from synchronizar.geometry import YawFrame
from synchronizar.live import messages as m
from synchronizar.live.client import Client
from synchronizar.live.stage import Stage, heading_of
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
KNOWN_M = 0.15
"""m: as phones do it, who is known less well adds nothing."""
WALKS_S = 3.5
SHELF = ((-0.6, 0.0, -0.2), (0.6, 1.6, 0.2))
"""m: of the stored scan, y up."""
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
# Whether the other's view is near the middle of the phone's screen, and the phone is in place.
ON_SCREEN = """(() => {
  const { app, avatars, frame, stage } = synchronizar;
  const at = app.places.Ben;
  if (!at || !frame.registered || frame.opacity < 1) return false;
  const m = stage.common.matrix.elements;
  const now = (performance.timeOrigin + performance.now()) / 1000;
  const [x, y, z, qx, qy, qz, qw] = phone.place(now - phone.began);
  const [fx, fz] = [-2 * (qx * qz + qw * qy), -(1 - 2 * (qx * qx + qy * qy))];
  const there = [0, 1, 2].map((i) => m[i] * at[0] + m[4 + i] * at[1] + m[8 + i] * at[2] + m[12 + i]);
  const [dx, dz] = [there[0] - x, there[2] - z];
  const distance = Math.hypot(dx, dz);
  // And not from the side.
  const [qx2, qy2, qz2, qw2] = avatars.placeOf("Ben").quat_xyzw;
  const ahead = [1 - 2 * (qy2 * qy2 + qz2 * qz2), 2 * (qx2 * qy2 + qw2 * qz2), 2 * (qx2 * qz2 - qw2 * qy2)];
  const [sx, , sz] = [0, 1, 2].map((i) => m[i] * ahead[0] + m[4 + i] * ahead[1] + m[8 + i] * ahead[2]);
  if (Math.abs(sx * dx + sz * dz) < 0.75 * distance * Math.hypot(sx, sz)) return false;
  if (distance < 0.8 || distance > 3 || (dx * fx + dz * fz) / distance < 0.98) return false;
  // A picture takes its time on a busy machine: all of it stays as it is until then.
  const [placing, here, walks] = [frame.step(0, "things"), [x, y, z, qx, qy, qz, qw], phone.place];
  const before = [frame.step, avatars.update, app.update];
  Object.assign(phone, { place: () => here });
  frame.step = () => placing;
  avatars.update = app.update = () => {};
  globalThis.goOn = () => {
    phone.place = walks;
    [frame.step, avatars.update, app.update] = before;
  };
  return true;
})()"""
NOTE = """() => {
  const { client } = synchronizar;
  const { say } = client;
  globalThis.told = [];
  client.say = function (topic, data, to) {
    if (topic === "seen") told.push(...data);
    return say.call(client, topic, data, to);
  };
}"""
CHOOSE = """(text) => {
  const chosen = new DataTransfer();
  chosen.items.add(new File([Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0))], "shelf.glb"));
  const input = document.querySelector("#eyes-file");
  input.files = chosen.files;
  input.dispatchEvent(new Event("change"));
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
    recording, points, told, sightings = simulation.recording, surfaces(), 0.0, Sightings()
    truth, own_from_world = simulation.truth[IDS[name]], simulation.world_from_user[IDS[name]].inverse()
    async with await Client.join(address, [name]) as client:
        walking = asyncio.create_task(walk(client, renamed(recording), [name], began, heard=True))
        stage = Stage(client.welcome)
        stills = Stills(name, lambda: view_of(stage, name))
        try:
            async for word in client.messages():
                stage.hear(word)
                result["objects"], result["reference"] = client.objects, stage.frames.reference
                t = time.time() - began
                if t - told < EVERY_S or name not in stage.players:
                    continue
                told = t
                if name == SHOWS:
                    for said in stills.words(t, client.objects):
                        await client.say_message(said)
                frame = stage.frames.users[name]
                if name not in SCANNERS or None in (frame.x, frame.y, frame.z, frame.yaw):
                    continue
                row = int(np.searchsorted(truth.t, t).clip(0, len(truth.t) - 1))
                common_from_world = YawFrame(frame.x, frame.y, frame.z, frame.yaw, frame.scale) @ own_from_world
                near = common_from_world @ in_view(points, truth.position[row], truth.quat_xyzw[row])
                result["at once"].append(near)
                if frame.sigma is None or frame.sigma > KNOWN_M:
                    continue
                own_floor = float((common_from_world @ np.zeros((1, 3)))[0, 2])
                floor = client.objects.get(FLOOR)
                if floor is None:
                    await client.say_message(m.Say("floor", {"z": own_floor}, m.APP))
                    continue
                sightings.add(near - [0.0, 0.0, own_floor - floor.position[2]], t)
                for data in sightings.take():
                    await client.say_message(m.Say("seen", data, m.APP))
        finally:
            walking.cancel()


def in_view(points: Array, eye: Array, quat_xyzw: Array) -> Array:
    """Those of points (n, 3) that a device there sees, as if nothing hid anything; it looks along its own x."""
    way = rotate_by_quaternions(quat_xyzw[None], np.array([[1.0, 0.0, 0.0]]))[0]
    there = points - eye
    distance = np.linalg.norm(there, axis=1)
    return points[(distance < REACH_M) & (there @ way > distance * np.cos(FIELD_RAD))]


def view_of(stage: Stage, name: str) -> Any:
    """What a device sees of the others; None while it does not know where it is."""
    if (me := stage.players.get(name)) is None:
        return None
    others = {other: player.position[:2] for other, player in stage.players.items() if other != name}
    return camera.view(Ground(*me.position[:2], heading_of(me.forward)), others)


def shelf() -> bytes:
    """A stored scan: a box, as binary glTF."""
    (x0, y0, z0), (x1, y1, z1) = SHELF
    corners = np.array([(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in (z0, z1)], dtype="<f4")
    faces = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    order = np.array([n for a, b, c, d in faces for n in (a, b, c, a, c, d)], dtype="<u2")
    body = corners.tobytes() + order.tobytes()
    views = [(0, corners.nbytes), (corners.nbytes, order.nbytes)]
    text = json.dumps(
        {
            "asset": {"version": "2.0"},
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
            "accessors": [
                {"bufferView": 0, "componentType": 5126, "count": len(corners), "type": "VEC3"},
                {"bufferView": 1, "componentType": 5123, "count": len(order), "type": "SCALAR"},
            ],
            "bufferViews": [{"buffer": 0, "byteOffset": at, "byteLength": size} for at, size in views],
            "buffers": [{"byteLength": len(body)}],
        }
    ).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(body))
    return head + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body


async def visit(simulation: Simulation, out: Path | None) -> dict[str, Any]:
    """All of it; what was drawn."""
    from playwright.async_api import async_playwright

    seconds = simulation.scene.seconds
    result: dict[str, Any] = {"at once": []}
    track = looking_at_others(simulation)
    with server("--app", "eyes") as where:
        async with async_playwright() as playwright:
            chromium = await browser.launch(playwright)
            room = await (await browser.context(chromium, 1200, 900)).new_page()
            await room.goto(f"{where['url']}/room#{where['room']}")
            phone = await (await browser.context(chromium, 390, 844, phone=True)).new_page()
            await browser.arrive(phone, where["url"], where["room"], PHONE)
            result["began"] = began = time.time() + 0.5
            tasks = [
                asyncio.create_task(native(where["join"], simulation, name, began, result))
                for name in ("Anna", "Ben", "Cleo")
            ]
            heard = browser.complaints(phone), browser.complaints(room)
            await browser.start(phone, track, began)
            await phone.evaluate(LOG)
            await browser.until(phone, "synchronizar.frame.registered", seconds)
            await phone.evaluate("synchronizar.client.say('ask', { whom: 'Ben' }, 'app')")
            await room.evaluate("synchronizar.client.say('ask', { whom: 'Emre' }, 'app')")
            await browser.until(phone, "document.querySelector('#app [role=status] button')")
            if out is not None:
                out.mkdir(parents=True, exist_ok=True)
                await phone.screenshot(path=out / "eyes_asked.png")
            await phone.evaluate(PRESS, "Yes")
            await room.evaluate("synchronizar.client.say('ask', { whom: 'Ben' }, 'app')")
            for wait in (0.5, 0.6, 0.7):
                await asyncio.sleep(max(0.0, began + wait * seconds - time.time()))
                await phone.evaluate(PRESS, "Point at this")
            await asyncio.sleep(max(0.0, began + 0.8 * seconds - time.time()))
            result["scan"] = {o.id: o for o in result["objects"].values() if o.kind == SCAN}
            result["stored"] = await put_shelf(room, result)
            if out is not None:
                await photograph(room, phone, out)
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


async def put_shelf(room: Any, result: dict[str, Any]) -> list[Cube]:
    """As one does at the room's page: what that adds to the model."""
    await room.evaluate(NOTE)
    await room.evaluate(CHOOSE, base64.b64encode(shelf()).decode())
    await browser.until(room, "document.querySelector('#app [role=status]').textContent.includes('where you look')")
    await room.evaluate(PRESS, "Put it down here")
    await browser.until(room, "document.querySelector('#app [role=status]').textContent.includes('is in the room')")
    await asyncio.sleep(1.0)
    told = [Cube((i, j, k), cells_of(text) or 0) for i, j, k, text in await browser.told(room, "told")]
    objects = result["objects"]
    assert all(cube.cells & ~(cells_of(objects[cube.id].data) or 0) == 0 for cube in told), "not all of it is there"
    return told


async def photograph(room: Any, phone: Any, out: Path) -> None:
    """Both pages; the phone's once the other's view is on its screen."""
    # Through the wall, into the room.
    await room.focus(".app-space")
    await room.keyboard.down("ArrowUp")
    await asyncio.sleep(WALKS_S)
    await room.keyboard.up("ArrowUp")
    await room.evaluate("document.querySelector('#app').scrollIntoView({ block: 'end' })")
    await room.screenshot(path=out / "eyes_room.png")
    with suppress(TimeoutError):
        await browser.until(phone, ON_SCREEN, 30.0)
    await phone.screenshot(path=out / "eyes_phone.png")
    await phone.evaluate("globalThis.goOn?.()")


async def model_alone(simulation: Simulation, seconds: float) -> dict[str, Any]:
    """What the native devices make of the room, without pages."""
    result: dict[str, Any] = {"at once": [], "drawn": [], "marks": {}, "complaints": []}
    with server("--app", "eyes") as where:
        began = time.time() + 0.5
        tasks = [
            asyncio.create_task(native(where["join"], simulation, name, began, result)) for name in (*SCANNERS, "Cleo")
        ]
        await asyncio.sleep(seconds)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    result["scan"] = {o.id: o for o in result["objects"].values() if o.kind == SCAN}
    return result


def judged(simulation: Simulation, result: dict[str, Any]) -> dict[str, Any]:
    """Lengths in m."""
    from scipy.spatial import KDTree

    objects = result["objects"].values()
    scan = [Cube(at_of(o), cells_of(o.data) or 0) for o in result["scan"].values()]
    true = common_from_world(simulation, IDS[result["reference"]]) @ surfaces()
    at_once = np.unique(np.floor(np.concatenate([np.zeros((0, 3)), *result["at once"]]) / CELL_M), axis=0)
    floor = next((o.position[2] for o in objects if o.id == FLOOR), float("nan"))
    higher = floor - float(true[0, 2])
    # The first of the surfaces is the floor's lower face.
    higher += FURNITURE[0][0][2] - FURNITURE[0][1][2]
    tree = KDTree(true)

    def off(cells: Array) -> float:
        return p95(tree.query(cells)[0].tolist()) if len(cells) else float("nan")

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
        "cells": sum(cube.cells.bit_count() for cube in scan),
        "a cell's middle from the true surface, p95": off(scan_middles(scan) - [0.0, 0.0, higher]),
        "the same, in the room's own heights": off(scan_middles(scan)),
        "the same, told at once in the room's own heights": off((at_once + 0.5) * CELL_M),
        "the model's floor above the true one": higher,
        "size of the stored shelf less its true one, largest": shelf_off(result.get("stored", [])),
        "the other's screen from where it is, in the plane, p95": p95(screen),
        "frames with a screen": len(screen),
        "marks": len(marks),
        "a mark on the phone's page from the room's, largest": max(apart, default=float("nan")),
        "it is over when the phone says so": result.get("stopped", False),
        "complaints of the pages": result["complaints"],
    }


def scan_middles(cubes: list[Cube]) -> Array:
    """(n, 3) m: of all their cells."""
    return np.concatenate([np.zeros((0, 3)), *(middles(cube) for cube in cubes)])


def shelf_off(stored: list[Cube]) -> float:
    """m: by which its cells reach farther, or less far, than the shelf itself, however it is turned."""
    cells = scan_middles(stored)
    if not len(cells):
        return float("nan")
    across = np.linalg.norm(cells[:, :2] - cells[:, :2].mean(axis=0), axis=1).max()
    (x0, y0, z0), (x1, y1, z1) = SHELF
    return float(max(abs(across - np.hypot(x1 - x0, z1 - z0) / 2.0), abs(np.ptp(cells[:, 2]) - (y1 - y0))))


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
    parser.add_argument("--without-pages", action="store_true")
    options = parser.parse_args()
    if not options.without_pages and (reason := browser.why_not()):
        raise SystemExit(reason)
    simulation = simulate(Scene(users=5, seconds=options.seconds + 20.0, seed=options.seed, speed=0.6))
    visited = model_alone(simulation, options.seconds) if options.without_pages else visit(simulation, options.out)
    print(as_lines(judged(simulation, asyncio.run(visited))))


if __name__ == "__main__":
    main()
