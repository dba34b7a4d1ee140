"""Pictures of the pages, with a server, native devices and a phone that is emulated.

`python -m experiments.live.screenshots [--out build/screenshots] [--seconds 20]`: everybody walks for that long by the
wall clock, while pictures are taken of the join page, of the room's page (light, dark, on a phone) and
of the phone's page before and after it is registered. The ones in docs/ are room-light-1.png and phone-2.png.
"""

from __future__ import annotations

import argparse
import asyncio
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from experiments.live import browser
from experiments.live.walkers import server, walk
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.live.client import Client
from synchronizar.quaternions import multiply_quaternions, yaw_quaternion
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

if TYPE_CHECKING:
    from playwright.async_api import Browser, Page

NAMES = {"phone0": "Anna", "phone1": "Ben", "phone2": "Cleo", "phone3": "Dilip", "phone4": "Emre"}
PHONE = "phone4"
WINDOWS = {
    "light": (1400, 900, False),
    "dark": (1400, 900, True),
    "phone": (390, 844, False),
}


async def take(simulation: Simulation, out: Path, seconds: float) -> None:
    """All pictures."""
    from playwright.async_api import async_playwright

    recording = renamed(simulation.recording)
    own = sorted(set(recording.tracks) - {NAMES[PHONE]})
    out.mkdir(parents=True, exist_ok=True)
    with server() as where:
        async with async_playwright() as playwright:
            chromium = await browser.launch(playwright)
            address = f"{where['url']}/room#{where['room']}"
            rooms = {name: await _page(chromium, address, *window) for name, window in WINDOWS.items()}
            client = await Client.join(str(where["join"]), own)
            began = time.time() + 0.5
            walking = asyncio.create_task(walk(client, recording, own, began))
            await _join_page(chromium, str(where["join"]), out)
            phone = await (await browser.context(chromium, 420, 800, phone=True)).new_page()
            track = looking_at_others(simulation)
            await browser.walk_in(phone, str(where["url"]), str(where["room"]), NAMES[PHONE], track, began)
            await asyncio.sleep(1.5)
            await phone.screenshot(path=out / "phone-1.png")
            await _shoot(rooms, out, 1)
            await asyncio.sleep(seconds - 7.0)
            await _shoot(rooms, out, 2)
            await _stand_where_most_are_seen(phone)
            await browser.until(phone, "phone.still")
            await phone.screenshot(path=out / "phone-2.png")
            walking.cancel()
            await client.close()
            await chromium.close()


def renamed(recording: Recording) -> Recording:
    """With people's names."""
    tracks = {NAMES[name]: track for name, track in recording.tracks.items()}
    return replace(
        recording, users=tuple(replace(user, name=NAMES[user.name]) for user in recording.users), tracks=tracks
    )


def looking_at_others(simulation: Simulation) -> Track:
    """The phone's own track, held so that it looks at the middle of the others."""
    truth = simulation.truth
    own_from_world = simulation.world_from_user[PHONE].inverse()
    track = simulation.recording.tracks[PHONE]
    others = [
        np.column_stack(
            [np.interp(track.t, truth[name].t, axis) for axis in own_from_world.apply(truth[name].position).T]
        )
        for name in NAMES
        if name != PHONE
    ]
    away = np.mean(others, axis=0) - track.position
    yaw = np.arctan2(away[:, 1], away[:, 0])
    # Held a little downwards.
    down = np.array([0.0, np.sin(0.06), 0.0, np.cos(0.06)])
    quat = np.array([multiply_quaternions(yaw_quaternion(float(turn)), down) for turn in yaw])
    return replace(track, quat_xyzw=quat)


async def _stand_where_most_are_seen(phone: Page) -> None:
    """Stop, put a marker there and step back, as soon as two of the others are on the screen and it hides nobody."""
    seen = """(last) => {
      const { avatars, frame, stage } = synchronizar;
      if (frame.opacity < 1 && !last) return false;
      const m = stage.common.matrix.elements;
      const now = (performance.timeOrigin + performance.now()) / 1000;
      const [x, y, z, qx, qy, qz, qw] = phone.place(now - phone.began);
      const [fx, fz] = [-2 * (qx * qz + qw * qy), -(1 - 2 * (qx * qx + qy * qy))];
      const [bx, bz] = [x - 1.2 * fx, z - 1.2 * fz];
      // Those within 16 degrees of the middle are on the screen; the marker and its name take up the inner 4.
      const ahead = Object.values(avatars.places).map(({ position: [a, b, c] }) => {
        const [dx, , dz] = [0, 1, 2].map((i) => m[i] * a + m[4 + i] * b + m[8 + i] * c + m[12 + i] - [bx, y, bz][i]);
        const distance = Math.hypot(dx, dz);
        return distance > 2.5 ? (dx * fx + dz * fz) / distance : -1;
      }).filter((cosine) => cosine > 0.96);
      if ((ahead.length < 2 || Math.max(...ahead) > 0.9975) && !last) return false;
      const here = [x, y, z, qx, qy, qz, qw];
      phone.table = [[0, ...here], [1, ...here]];
      document.getElementById("mark").click();
      // The picture stays as it is then: on a busy machine a screenshot comes seconds later.
      const still = setInterval(() => {
        if (!synchronizar.objects.ids.length) return;
        clearInterval(still);
        const back = [bx, y, bz, qx, qy, qz, qw];
        phone.table = [[0, ...back], [1, ...back]];
        setTimeout(() => {
          const placing = frame.step(0, "things");
          frame.step = () => placing;
          avatars.update = synchronizar.objects.update = synchronizar.overlay.update = () => {};
          phone.still = true;
        }, 100);
      }, 20);
      return true;
    }"""
    end = time.monotonic() + 30.0
    while not await phone.evaluate(seen, time.monotonic() > end):
        await asyncio.sleep(0.05)


async def _page(chromium: Browser, address: str, width: int, height: int, dark: bool) -> Page:
    page = await (await browser.context(chromium, width, height, dark)).new_page()
    await page.goto(address)
    return page


async def _join_page(chromium: Browser, address: str, out: Path) -> None:
    for name, dark in (("light", False), ("dark", True)):
        page = await (await browser.context(chromium, 420, 800, dark, phone=True)).new_page()
        await page.goto(address)
        await page.screenshot(path=out / f"join-{name}.png", full_page=True)
        await page.context.close()


async def _shoot(rooms: dict[str, Page], out: Path, number: int) -> None:
    for name, page in rooms.items():
        last = "" if number == 2 else f"-{number}"
        await page.screenshot(path=out / f"room-{name}{last}.png", full_page=name == "phone")


def main() -> None:
    """Take them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("build/screenshots"))
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args()
    if reason := browser.why_not():
        raise SystemExit(reason)
    scene = Scene(
        users=len(NAMES), seconds=2.0 * options.seconds + 20.0, seed=4, late_share=0.1, drift_m_per_sqrt_s=0.005
    )
    asyncio.run(take(simulate(scene), options.out, options.seconds))
    print(*sorted(str(path) for path in options.out.glob("*.png")), sep="\n")


if __name__ == "__main__":
    main()
