"""A recorded game played again: what the room's page draws of it, beside what was recorded.

`python -m experiments.apps.played_again FOLDER [--speed 1] [--out DIR]`: FOLDER is what `serve --record` has written
of a room with catch or treasure; without one a game of a minute is recorded first (`--app`), as
`experiments.apps.in_browsers` has it. A new server with that application, `synchronizar play` by its command, and the
room's page in headless Chromium, from whose canvas the circles of the ball and of coins are taken as they are drawn.

Told are, in m, how far a ball that flies or lies is drawn from where the record says at the moment that the page says
that it is; the same of coins, and the share of frames with all coins of the record and no other, while the record has
had no change for half a second; and how far behind the page is, in s of the record, beside who hears the same room
without a page. With `--out`, a picture of the page when most are in place and most things lie there.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
import time
from bisect import bisect_right
from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments.apps.shown import p95
from experiments.common.results import as_lines
from experiments.live import browser
from experiments.live.walkers import server
from synchronizar.apps.catch.flight import Flight
from synchronizar.apps.catch.game import BALL
from synchronizar.apps.treasure.game import THING
from synchronizar.arrays import Array
from synchronizar.live import messages as m
from synchronizar.live.client import Client
from synchronizar.live.pose_wire import PosesDown
from synchronizar.live.words_file import Word, read_words

COLOURS = {"#f58a1f": "ball", "#f2b705": "coin"}
STANDS_S = 0.5
MARGIN_S = 30.0
"""s of a recording before its first thing and after its last."""
# Circles of these colours, in m of the common frame, and what time of the room it is then: a row for each.
LOG = """async (colours) => {
  globalThis.drawn = [];
  let camera = null, circle = null, frame = 0;
  const { Camera } = await import(new URL("pages/view/camera.js", location.href));
  const { toScreen } = Camera.prototype;
  Camera.prototype.toScreen = function (place) {
    camera = this;
    return toScreen.call(this, place);
  };
  const { arc, fill } = CanvasRenderingContext2D.prototype;
  CanvasRenderingContext2D.prototype.arc = function (x, y, ...rest) {
    circle = [x, y];
    return arc.call(this, x, y, ...rest);
  };
  CanvasRenderingContext2D.prototype.fill = function (...rest) {
    const what = colours[this.fillStyle];
    if (what && circle && camera) drawn.push([frame, what, ...camera.toRoom(circle)]);
    circle = null;
    return fill.call(this, ...rest);
  };
  requestAnimationFrame(function each() {
    requestAnimationFrame(each);
    // The page has just drawn this frame: it asked for it before.
    const now = (performance.timeOrigin + performance.now()) / 1000;
    const { roomTime } = synchronizar.client;
    if (roomTime !== null) drawn.push([frame, "frame", now, roomTime]);
    frame += 1;
  });
}"""


class Frame(NamedTuple):
    """What the page has drawn at once."""

    wall: float
    """s since 1970."""
    t: float
    """s, the recorded room's time, as the page knows it."""
    balls: list[tuple[float, float]]
    coins: list[tuple[float, float]]
    """m, in the plane of the common frame."""


def frames_of(rows: Sequence[Sequence[Any]]) -> list[Frame]:
    """What a page has noted."""
    circles: dict[tuple[int, str], list[tuple[float, float]]] = defaultdict(list)
    frames = []
    for number, what, a, b in rows:
        if what == "frame":
            frames.append(Frame(a, b, circles[number, "ball"], circles[number, "coin"]))
        else:
            circles[number, what].append((a, b))
    return frames


class Record:
    """What stood where, by the words of a recording."""

    def __init__(self, words: Sequence[Word]) -> None:
        self._at: list[float] = []
        self._objects: list[dict[str, m.Object]] = []
        now: dict[str, m.Object] = {}
        for word in words:
            if word.object is not None:
                now = now | {word.object.id: word.object}
            elif word.removed is not None:
                now = {id_: o for id_, o in now.items() if id_ != word.removed}
            else:
                continue
            self._at.append(word.t)
            self._objects.append(now)

    def lasts(self, t: float) -> bool:
        """Whether a moment may be one of the recording."""
        return self._at[0] - MARGIN_S < t < self._at[-1] + MARGIN_S

    def ball(self, t: float) -> Array | None:
        """(2,) m; None where somebody holds it or there is none, or it has been otherwise just now."""
        objects = self._standing(t)
        ball = None if objects is None else objects.get(BALL)
        if ball is None or ball.data["phase"] not in ("flies", "lies"):
            return None
        if ball.data["phase"] == "lies":
            return np.array(ball.position[:2])
        return np.array(Flight(ball.data["t"], tuple(ball.data["position"]), tuple(ball.data["velocity"])).at(t)[:2])

    def coins(self, t: float) -> Array | None:
        """(n, 2) m; None where there are others just now."""
        objects = self._standing(t)
        if objects is None:
            return None
        coins = [o.position[:2] for o in objects.values() if o.kind == THING and o.data["what"] == "coin"]
        return np.array(coins).reshape(-1, 2)

    def _standing(self, t: float) -> dict[str, m.Object] | None:
        now, before = bisect_right(self._at, t), bisect_right(self._at, t - STANDS_S)
        return self._objects[now - 1] if 0 < now == before else None


def judged(frames: Sequence[Frame], record: Record, heard: Sequence[tuple[float, float]]) -> dict[str, Any]:
    """Of all frames. `heard`: pairs of s since 1970 and the room's time, of who hears without a page."""
    balls: list[float] = []
    coins: list[float] = []
    alike: list[bool] = []
    # Before it is played the room has a time of its own: now, which is not long after a record that was just made.
    heard = [(wall, t) for wall, t in heard if record.lasts(t)]
    heard = heard[min(range(len(heard)), key=lambda k: heard[k][1], default=0) :]
    frames = [f for f in frames if heard and f.wall >= heard[0][0] and heard[0][1] <= f.t <= heard[-1][1]]
    for frame in frames:
        ball, there = record.ball(frame.t), record.coins(frame.t)
        if ball is not None and frame.balls:
            balls.append(float(np.linalg.norm(np.subtract(frame.balls[0], ball))))
        if there is None or not (len(there) or frame.coins):
            continue
        alike.append(len(there) == len(frame.coins))
        coins += [float(np.linalg.norm(there - coin, axis=1).min()) for coin in np.array(frame.coins) if len(there)]
    behind = [float(np.interp(frame.wall, *np.transpose(heard))) - frame.t for frame in frames]
    return {
        "frames": len(frames),
        "frames with a ball that flies or lies": len(balls),
        "the ball off the record, p95": p95(balls),
        "frames with coins": len(alike),
        "share of these with all coins and no other": float(np.mean(alike)) if alike else float("nan"),
        "a coin off the record, p95": p95(coins),
        "page behind, median, s": float(np.median(behind)) if behind else float("nan"),
        "page behind, p95, s": p95(behind),
        "load": os.getloadavg()[0],
    }


async def watched(
    where: dict[str, Any], playing: Sequence[str], out: Path | None
) -> tuple[list[Frame], list[tuple[float, float]]]:
    """What the room's page draws while a command plays in its room, and what is heard without a page meanwhile."""
    from playwright.async_api import async_playwright

    heard: list[tuple[float, float]] = []
    async with async_playwright() as playwright, await Client.join(where["join"]) as client:

        async def listen() -> None:
            async for word in client.messages():
                if isinstance(word, PosesDown):
                    heard.append((time.time(), word.t))

        chromium = await browser.launch(playwright)
        page = await (await browser.context(chromium, 900, 700)).new_page()
        await page.goto(f"{where['url']}/room#{where['room']}")
        await browser.until(page, "synchronizar.client.state === 'open'")
        await page.evaluate(LOG, COLOURS)
        listening = asyncio.create_task(listen())
        process = await asyncio.create_subprocess_exec(*playing, stdout=asyncio.subprocess.DEVNULL)
        ending = asyncio.create_task(process.wait())
        rows: list[list[Any]] = []
        most = (0, 0)
        while not ending.done():
            await asyncio.sleep(0.5)
            new = await browser.told(page, "drawn.splice(0)")
            rows += new
            if out is not None:
                in_place = await page.evaluate("parseInt(document.getElementById('count-registered').textContent) || 0")
                drawn = max(Counter(number for number, what, *_ in new if what != "frame").values(), default=0)
                if (in_place, drawn) > most:
                    await page.screenshot(path=out / "played_again.png")
                    most = in_place, drawn
        rows += await browser.told(page, "drawn.splice(0)")
        listening.cancel()
        await chromium.close()
    if ending.result():
        raise RuntimeError(f"it was not played to the end: status {ending.result()}")
    return frames_of(rows), heard


def run(folder: Path, app: str, speed: float = 1.0, out: Path | None = None) -> dict[str, Any]:
    """Play a recorded room."""
    with server("--no-tls", "--app", app) as where:
        play = [sys.executable, "-m", "synchronizar", "play", str(folder), where["join"], "--speed", str(speed)]
        frames, heard = asyncio.run(watched(where, play, out))
    return judged(frames, Record(read_words(folder)), heard)


def main() -> None:
    """Play it, and say how it was shown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", metavar="FOLDER", type=Path, nargs="?")
    parser.add_argument("--app", choices=("catch", "treasure"), default="catch", help="what is recorded first")
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    folder: Path | None = options.folder
    if folder is None:
        from experiments.apps.in_browsers import Game, record, scene

        folder = record(Game(options.app, scene(60.0, 0)))
    app = next((word.app for word in read_words(folder) if word.app is not None), options.app)
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
    print(as_lines(run(folder, app, options.speed, options.out)))


if __name__ == "__main__":
    main()
