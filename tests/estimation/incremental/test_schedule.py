"""How far back following and searches look."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from synchronizar.data.registration import State
from synchronizar.estimation.incremental.schedule import Schedule
from synchronizar.estimation.incremental.standing import Standing
from synchronizar.parameters import Parameters

NOW, WINDOW = 300.0, Parameters().incremental.window


def begin(followed: int, state: State, proven: bool = False) -> float:
    """Where the window begins: so many are followed, all of them since long ago; the last one is in this state."""
    standings = [Standing(State.REGISTERED, since=0.0, proven=proven) for _ in range(followed)]
    standings.append(Standing(state, since=0.0))
    roster: Any = SimpleNamespace(now=NOW, parameters=Parameters(), standings=standings)
    tracking = SimpleNamespace(members=dict.fromkeys(range(followed)))
    following: Any = SimpleNamespace(gauge=0, tracking=tracking)
    return Schedule(roster, following).window_begin()


def test_while_few_are_not_proven_all_of_a_first_stretch_is_looked_at() -> None:
    assert begin(4, State.REGISTERED) == NOW - Parameters().search.first_stretch


def test_beside_somebody_who_is_proven_two_windows_are_enough() -> None:
    assert begin(4, State.UNOBSERVABLE, proven=True) == NOW - 2.0 * WINDOW


@pytest.mark.parametrize(("state", "windows"), [(State.REGISTERED, 1.0), (State.UNOBSERVABLE, 2.0)])
def test_of_many_who_is_registered_needs_no_longer_window_than_anybody(state: State, windows: float) -> None:
    assert begin(32, state) == NOW - windows * WINDOW
