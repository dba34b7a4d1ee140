"""An application on two phones' pages, with modules in the air: what is drawn, beside the truth."""

from __future__ import annotations

import shutil

import pytest
from support.air_built import needs_air

from experiments.apps.in_browsers import run
from experiments.live import browser


@pytest.fixture(autouse=True)
def _chromium() -> None:
    if reason := browser.why_not():
        pytest.skip(reason)


@needs_air
def test_what_two_phones_show_of_a_game_is_where_it_is_and_the_game_is_recorded() -> None:
    of, recorded = run("catch", seconds=45.0, seed=0, frames=60, size=(120, 200))  # however slow the machine is
    shutil.rmtree(recorded.parent)
    assert of["complaints"] == []
    assert of["frames"] >= 60
    # Not known of a game in which, on a slow machine, no page has drawn a ball in flight or two pages none together.
    assert not of["balls that fly, beside one another"] > 0.02
    assert not of["beside the other page"] > 0.3
    assert of["largest step in a frame"] < 0.03
    assert of["words written"] > of["objects written"] > 0
