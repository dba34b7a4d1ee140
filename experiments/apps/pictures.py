"""Pictures of each application, as people see them: a phone's page, the room's page, and some seconds of the phone's.

`python -m experiments.apps.pictures [--apps catch treasure robot] [--seconds 60] [--out build/apps]`: the games of
`experiments.apps.in_browsers`, with screens of a phone's size. The ones in docs/apps/ are these.
"""

from __future__ import annotations

import argparse
import asyncio
import io
from contextlib import suppress
from pathlib import Path

from PIL import Image

from experiments.apps.in_browsers import APPS, LATE, PHONES, Game, run
from experiments.live import browser

SCREEN = (360, 640)
FRAMES, FRAME_MS = 24, 250
WIDTH = 260
"""px of the moving pictures."""
WAIT_S = 6.0
# On the phone's page: whether there is something to see.
WORTH_SEEING = {
    "catch": "synchronizar.client.objects.get('catch ball')?.data.phase === 'flies'",
    "treasure": "Object.keys(synchronizar.app.places).length > 3",
    "robot": "synchronizar.client.objects.get('robot order robot')?.data.do === 'mirror'",
}
# How many of the others and of the application's things are on the phone's screen, its things counted threefold.
ON_SCREEN = """() => {
  const { app, avatars, frame, stage } = synchronizar;
  if (!frame.registered || frame.opacity < 1) return 0;
  const m = stage.common.matrix.elements;
  const now = (performance.timeOrigin + performance.now()) / 1000;
  const [x, y, z, qx, qy, qz, qw] = phone.place(now - phone.began);
  const [fx, fz] = [-2 * (qx * qz + qw * qy), -(1 - 2 * (qx * qx + qy * qy))];
  const seen = ([a, b, c]) => {
    const [dx, , dz] = [0, 1, 2].map((i) => m[i] * a + m[4 + i] * b + m[8 + i] * c + m[12 + i] - [x, y, z][i]);
    const distance = Math.hypot(dx, dz);
    return distance > 0.5 && (dx * fx + dz * fz) / distance > 0.96;
  };
  const people = Object.values(avatars.places).map(({ position }) => position);
  const things = [app.at, ...Object.values(app.places ?? {}), avatars.places.robot?.position].filter(Boolean);
  return people.filter(seen).length + 3 * things.filter(seen).length;
}"""


async def look(game: Game, out: Path) -> None:
    """From when all are in place: a moving picture of the phone's page, the best of its frames, and the room's page."""
    phone, room = game.pages[PHONES[0]], game.room
    assert room is not None
    while f"{LATE} registered" not in game.events:
        await asyncio.sleep(0.2)
    with suppress(TimeoutError):
        await browser.until(phone, WORTH_SEEING[game.app], WAIT_S)
    await room.screenshot(path=out / f"{game.app}_room.png")
    frames: list[Image.Image] = []
    best = -1
    try:
        for _ in range(FRAMES):
            shot = await phone.screenshot()
            if (seen := await phone.evaluate(ON_SCREEN)) > best:
                best = seen
                (out / f"{game.app}_phone.png").write_bytes(shot)
            frames.append(Image.open(io.BytesIO(shot)).convert("RGB"))
    finally:
        # On a slow machine the walk ends first.
        if frames:
            save(frames, out / f"{game.app}.webp")


def save(frames: list[Image.Image], path: Path) -> None:
    """The moving picture."""
    first, *rest = [frame.resize((WIDTH, round(WIDTH * frame.height / frame.width))) for frame in frames]
    first.save(path, save_all=True, append_images=rest, duration=FRAME_MS, loop=0, quality=60, method=0)


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
        run(app, options.seconds, options.seed, lambda game: look(game, options.out), size=SCREEN)
        print(*(f"{file} {file.stat().st_size}" for file in sorted(options.out.glob(f"{app}*"))), sep="\n")


if __name__ == "__main__":
    main()
