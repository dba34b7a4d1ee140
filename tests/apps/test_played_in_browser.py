"""A recorded game played again, in the room's page."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments.apps.played_again import run
from experiments.live import browser
from synchronizar.apps.catch.game import BALL
from synchronizar.apps.treasure.game import THING
from synchronizar.io.recording_folder import save_recording
from synchronizar.live import messages as m
from synchronizar.live.words_file import WORDS_FILE, Word, line_of
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

UPRIGHT = (0.0, 0.0, 0.0, 1.0)


@pytest.fixture(autouse=True)
def _chromium() -> None:
    if reason := browser.why_not():
        pytest.skip(reason)


def ball(t: float, phase: str, x: float, y: float) -> Word:
    flown = {"t": t, "position": [x, y, 1.0], "velocity": [1.0, 0.5, 2.0]} if phase == "flies" else {}
    data = {"phase": phase, "by": "phone0"} | flown
    return Word(t, object=m.Object(BALL, BALL, (x, y, 1.0), UPRIGHT, m.APP, m.APP, t=t, data=data))


def coin(t: float, n: int) -> Word:
    data = {"what": "coin", "by": "phone0"}
    return Word(t, object=m.Object(f"coin {n}", THING, (float(n), 1.0, 1.0), UPRIGHT, m.APP, m.APP, t=t, data=data))


def recorded(folder: Path, app: str, words: list[Word]) -> Path:
    save_recording(simulate(Scene(users=2, seconds=8.0, seed=4, up="y")).recording, folder)
    (folder / WORDS_FILE).write_text("".join(map(line_of, [Word(0.0, app=app), *words])))
    return folder


def test_the_page_draws_the_ball_of_a_recorded_game_where_the_record_has_it(tmp_path: Path) -> None:
    words = [ball(0.5, "lies", 1.0, 0.5), ball(3.0, "flies", 0.0, 0.0), ball(4.5, "lies", 1.5, 0.75)]
    of = run(recorded(tmp_path / "game", "catch", words), "catch")
    assert of["frames with a ball that flies or lies"] > 10
    assert of["the ball off the record, p95"] < 0.05


def test_the_page_draws_the_coins_of_a_recorded_game_and_no_other(tmp_path: Path) -> None:
    words = [coin(0.5, 0), coin(1.0, 1), coin(1.5, 2), Word(4.0, removed="coin 1")]
    of = run(recorded(tmp_path / "game", "treasure", words), "treasure")
    assert of["frames with coins"] > 10
    assert of["share of these with all coins and no other"] > 0.9
    assert of["a coin off the record, p95"] < 0.01
