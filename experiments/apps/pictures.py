"""Pictures of each application, as people see them: a phone's page, the room's page, and some seconds of the phone's.

`python -m experiments.apps.pictures [--apps catch treasure robot] [--seconds 60] [--out build/apps]`: the games of
`experiments.apps.in_browsers`, with screens of a phone's size. The ones in docs/apps/ are these.
"""

from __future__ import annotations

import argparse
import asyncio
import base64
import io
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from experiments.apps.in_browsers import APPS, LATE, PHONES, Game, run
from experiments.live import browser

if TYPE_CHECKING:
    from playwright.async_api import Page

SCREEN, ROOM = (390, 844), (1200, 900)
FILMED_S, SHOWN_S = 25.0, 7.0
"""s: so long the phone's page is filmed, and so long the best piece of that is."""
MOMENT_S = 45.0
"""s: so long a moment is waited for that is worth a picture; else it is the best one of the film."""
FRAMES, WIDTH = 28, 260
"""Of the moving pictures; px."""

# Whoever holds the phone looks where something happens: at the ball, at things that lie about, at the robot. Notes with
# each frame how much there is to see, and stops in a moment that is worth a picture, once it is asked for.
LOOKS = """([what, name]) => {
  const { app, avatars, client, frame, stage } = synchronizar;
  const walks = phone.place;
  const seen = (globalThis.seen = []);
  globalThis.stop = Infinity;
  const data = () => client.objects.get("catch ball")?.data;
  const others = () => Object.entries(avatars.places).filter(([, { state }]) => state === "registered");
  const device = ([a, b, c]) => {
    const m = stage.common.matrix.elements;
    return [0, 1, 2].map((i) => m[i] * a + m[4 + i] * b + m[8 + i] * c + m[12 + i]);
  };
  const things = () => {
    if (what === "catch") return app.at && data()?.by !== name ? [app.at] : [];
    if (what === "robot") return avatars.places.robot ? [avatars.places.robot.position] : [];
    return Object.values(app.places);
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
  const worth = () => {
    if (!frame.registered || frame.opacity < 1 || !last) return 0;
    const mine = Math.min(3, shown(things()));
    const heads = others().filter(([other]) => other !== "robot").map(([, { position }]) => position);
    const people = Math.min(1, shown(heads));
    if (what === "catch") return data()?.phase === "flies" && mine ? 3 + people : data()?.phase === "held" ? mine : 0;
    if (what === "robot") return mine ? mine + 2 * shown(Object.values(app.places)) + people : 0;
    return mine + people;
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
# From how much there is to see on, by application: with less than all of it in the end.
WORTH = {"catch": (4, 3, 1), "treasure": (4, 3, 1), "robot": (4, 3, 1)}
ASK = "(whom) => synchronizar.client.say('ask', { whom }, 'app')"


async def look(game: Game, out: Path) -> None:
    """From when all are in place: a moving picture of the phone's page, a moment of it, and the room's page."""
    phone, room = game.pages[PHONES[0]], game.room
    assert room is not None
    await phone.evaluate(LOOKS, [game.app, PHONES[0]])
    while f"{LATE} registered" not in game.events:
        await asyncio.sleep(0.2)
    if game.app == "robot":
        for page in (phone, room):
            await page.evaluate(ASK, "robot")
    film = await filmed(phone, FILMED_S)
    seen: list[tuple[float, float]] = await phone.evaluate("seen")
    await room.evaluate("document.querySelector('#app').scrollIntoView({ block: 'nearest' })")
    await room.screenshot(path=out / f"{game.app}_room.png")
    save(best_of(film, seen), out / f"{game.app}.webp")
    best = max(seen, key=lambda row: row[1])[0]
    min(film, key=lambda shot: abs(shot[0] - best))[1].save(out / f"{game.app}_phone.png")
    for least in WORTH[game.app]:
        await phone.evaluate("(least) => (globalThis.stop = least)", least)
        with suppress(TimeoutError):
            await browser.until(phone, "globalThis.stopped", MOMENT_S / len(WORTH[game.app]))
            await phone.screenshot(path=out / f"{game.app}_phone.png")
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
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("build/apps"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for app in options.apps:
        run(app, options.seconds, options.seed, lambda game: look(game, options.out), size=SCREEN, room_size=ROOM)
        print(*(f"{file} {file.stat().st_size}" for file in sorted(options.out.glob(f"{app}*"))), sep="\n")


if __name__ == "__main__":
    main()
