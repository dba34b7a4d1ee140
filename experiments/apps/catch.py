"""Catch with somebody who comes late, with a phone's page, and ranges with one of the others only.

`python -m experiments.apps.catch [--seconds 120] [--seed 0] [--out DIR]`: the game of `experiments.apps.in_browsers`
but for that one, who walks in after a quarter of the time, where two programs and another phone play already. It has no
module in the air; one of the programs says simulated ranges with it. Until it is in place it touches its screen all the
time. Told are what its page told it to do, after how long it was in place and had the ball, what became of the game
meanwhile, and how well all is shown (lengths in m, 95 of 100 are within). With `--out`, a picture of its page before it
is in place, and after.
"""

from __future__ import annotations

import argparse
import asyncio
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from experiments.apps.in_browsers import IN_PLACE, PHONES, PROGRAM, Game, record, scene
from experiments.common.results import as_lines
from synchronizar.apps.catch.game import BALL, SCORE
from synchronizar.live.words_file import Word, read_words

FIRST, LATE = PHONES
FLIES = f"synchronizar.client.objects.get('{BALL}')?.data.phase === 'flies'"


def meanwhile(words: Sequence[Word], begin: float, end: float) -> dict[str, Any]:
    """What became of the game between two moments (s, the room's clock)."""
    balls = [w.object.data for w in words if w.object is not None and w.object.id == BALL and begin < w.t < end]
    scores = [w.object.data for w in words if w.object is not None and w.object.id == SCORE and w.t < end]
    before = [w.object.data for w in words if w.object is not None and w.object.id == SCORE and w.t < begin]
    caught = [sum(of[-1]["caught"].values()) if of else 0 for of in (before, scores)]
    said = [w.said for w in words if w.said is not None and begin < w.t < end]
    return {
        "it said throw, times": sum(word.by == LATE and word.topic == "throw" for word in said),
        "the others threw": sum(data["phase"] == "flies" for data in balls),
        "the others caught": caught[1] - caught[0],
        "the ball was its own": sum(data.get("by") == LATE for data in balls),
    }


async def look(game: Game, out: Path) -> None:
    """Pictures of the page of the one who is late, in the game."""
    page = game.pages[LATE]
    while f"{LATE} came" not in game.events:
        await asyncio.sleep(0.2)
    for name, wanted in {"waits": f"!({IN_PLACE}) && {FLIES}", "plays": f"{IN_PLACE} && {FLIES}"}.items():
        taken = False
        while not taken and (name == "plays" or f"{LATE} registered" not in game.events):
            await asyncio.sleep(0.1)
            with suppress(Exception):  # the page is being loaded anew
                if taken := await page.evaluate(f"Boolean(globalThis.synchronizar?.app && ({wanted}))"):
                    await page.screenshot(path=out / f"catch_late_{name}.png")


def judged(game: Game, words: Sequence[Word]) -> dict[str, Any]:
    """Of one game. The room's clock is taken for the wall's: both are of this machine."""
    came, registered = game.events[f"{LATE} came"], game.events.get(f"{LATE} registered", game.simulation.scene.seconds)
    has_ball = [
        w.t
        for w in words
        if w.object is not None and w.object.id == BALL and w.object.data == {"phase": "held", "by": LATE}
    ]
    begin, end = game.began + came, game.began + registered
    of = game.judged()
    return {
        "frames": of["frames"],
        "beside the truth": of["beside the truth"],
        "beside the other page": of["beside the other page"],
        "largest step in a frame": of["largest step in a frame"],
        "complaints": of["complaints"],
        "late one in place after, s": of["late one in place after, s"],
        "has the ball after that, s": has_ball[0] - end if has_ball else None,
        "has the ball, times": len(has_ball),
        **{f"meanwhile: {what}": n for what, n in meanwhile(words, begin, end).items()},
        "meanwhile: largest step in a frame of the other page": game.walked().swims(FIRST, begin, end),
        "its page said": " / ".join(game.advised[LATE]),
        "load": os.getloadavg()[0],
    }


def main() -> None:
    """Play, and say how it was."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    game = Game("catch", scene(options.seconds, options.seed), options.seed, late=LATE, partner=PROGRAM)
    out: Path | None = options.out
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    recorded = record(game, None if out is None else lambda playing: look(playing, out))
    print(as_lines(judged(game, read_words(recorded))), f"recorded in {recorded}", sep="\n")


if __name__ == "__main__":
    main()
