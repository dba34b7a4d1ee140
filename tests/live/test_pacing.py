"""How often a solver is asked."""

from __future__ import annotations

import pytest

from synchronizar.live.pacing import RARELY_S, Pacing


def asked(pacing: Pacing, took: float, seconds: float = 10.0) -> int:
    """Of questions that come ten times a second, those that are asked, each of which takes so long."""
    count = 0
    for n in range(round(10 * seconds)):
        if pacing.is_due(0.1 * n):
            pacing.answered(took)
            count += 1
    return count


def test_one_that_answers_soon_is_asked_each_time() -> None:
    assert asked(Pacing(), 0.045) == 100


def test_one_that_takes_longer_is_asked_so_rarely_that_half_of_its_time_is_free() -> None:
    assert asked(Pacing(), 0.15) * 0.15 == pytest.approx(5.0, abs=0.3)


def test_no_question_waits_for_long() -> None:
    assert asked(Pacing(), 3.0) == pytest.approx(10.0 / RARELY_S, abs=2)


def test_one_that_is_fast_again_is_asked_each_time_again() -> None:
    pacing = Pacing()
    assert pacing.is_due(0.0)
    pacing.answered(3.0)
    assert pacing.is_due(0.1)
    assert not pacing.is_due(0.3)
    pacing.answered(0.01)
    assert pacing.is_due(0.1 + RARELY_S)
    assert pacing.is_due(0.2 + RARELY_S)
