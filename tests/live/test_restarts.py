"""A solver that ends again and again is begun again ever later, and everybody is told."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import pytest
from support.house import House
from support.serving import run

from synchronizar.live.restarts import CALM_S, LONGEST_WAIT_S, Restarts
from synchronizar.live.solver import SolverProcess
from synchronizar.live.solver_wire import Begin, Told


class Clock:
    def __init__(self) -> None:
        self.t = 100.0

    def __call__(self) -> float:
        return self.t


def test_waits_grow_to_the_longest() -> None:
    restarts = Restarts(Clock())
    waits = []
    for _ in range(40):
        restarts.began()
        waits.append(restarts.ended())
    assert waits[:6] == [0.05, 0.1, 0.2, 0.4, 0.8, 1.6]
    assert waits[10:] == [LONGEST_WAIT_S] * 30
    assert restarts.all == 40


def test_who_has_worked_for_long_begins_again_at_once_and_who_has_not_does_not() -> None:
    clock = Clock()
    restarts = Restarts(clock)

    def lives(seconds: float, answers: bool = True) -> float:
        restarts.began()
        if answers:
            restarts.works()
        clock.t += seconds
        return restarts.ended()

    assert [lives(1.0) for _ in range(4)] == [0.05, 0.1, 0.2, 0.4]
    assert lives(CALM_S, answers=False) == 0.8
    assert lives(CALM_S) == 0.05
    assert lives(1.0) == 0.1


def test_what_it_is_told_is_blamed_where_it_ends_three_times_without_an_answer() -> None:
    restarts = Restarts(Clock())
    blamed = []
    for answers in (False, False, True, False, False, False, False):
        restarts.began()
        if answers:
            assert restarts.works()
            assert not restarts.works()
        restarts.ended()
        blamed.append(restarts.blames_what_came)
    assert blamed == [False, False, False, False, False, True, False]


def test_trouble_is_told_until_it_works_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    python, events, waits = sys.executable, [], []
    told: list[Told] = []

    async def test() -> None:
        async def rest(seconds: float) -> None:
            waits.append(seconds)
            if len(waits) == 7:
                assert solver.trouble is not None
                assert "7 times in a row" in solver.trouble
                monkeypatch.setattr(sys, "executable", python)

        solver = SolverProcess(
            told.append, lambda _: None, events.append, tmp_path / "state", Begin(0), clock=Clock(), rest=rest
        )
        solver.advance(1.0)
        monkeypatch.setattr(sys, "executable", str(tmp_path / "nothing"))
        running = asyncio.create_task(solver.run())
        while len(waits) < 7:
            await asyncio.sleep(0)
        solver.advance(2.0)
        while not told or solver.trouble is not None:
            await asyncio.sleep(0.01)
        await solver.close()
        await running

    run(test)
    assert waits == [0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2]
    assert events[0] == "the solver ended by itself and is begun again; nothing that was measured is lost"
    assert events[2].endswith("is left out")
    assert "7 times in a row" in events[6]
    assert events[7:] == ["the solver works again"]


def test_a_rooms_status_tells_of_the_trouble() -> None:
    house = House()
    assert house.room.status().solver is None
    house.solver.trouble = "the solver has ended 7 times in a row"
    assert house.room.status().solver == house.solver.trouble
