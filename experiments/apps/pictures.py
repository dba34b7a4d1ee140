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

SCREEN = (390, 700)
FRAMES, FRAME_MS = 28, 200
WIDTH = 260
"""px of the moving pictures."""
# On the phone's page: when there is something to see.
WORTH_SEEING = {
    "catch": "synchronizar.client.objects.get('catch ball')?.data.phase === 'flies'",
    "treasure": "Object.keys(synchronizar.app.places).length > 5",
    "robot": "synchronizar.client.objects.get('robot order robot')?.data.do === 'mirror'",
}


async def look(game: Game, out: Path) -> None:
    """From when both pages are in place: stills when there is something to see, and a moving picture."""
    phone, room, seen = game.pages[PHONES[0]], game.room, WORTH_SEEING[game.app]
    assert room is not None
    while f"{LATE} registered" not in game.events:
        await asyncio.sleep(0.2)
    for page, name in ((phone, "phone"), (room, "room")):
        with suppress(TimeoutError):
            await browser.until(phone, seen, 20.0)
        await page.screenshot(path=out / f"{game.app}_{name}.png")
    frames = []
    for _ in range(FRAMES):
        frames.append(Image.open(io.BytesIO(await phone.screenshot())).convert("RGB"))
        await asyncio.sleep(0.05)
    small = [frame.resize((WIDTH, round(WIDTH * frame.height / frame.width))) for frame in frames]
    moving = out / f"{game.app}.webp"
    small[0].save(moving, save_all=True, append_images=small[1:], duration=FRAME_MS, loop=0, quality=55, method=4)


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
