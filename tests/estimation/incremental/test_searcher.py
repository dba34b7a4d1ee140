from __future__ import annotations

import os
import signal
import time
from functools import cache

import numpy as np
import pytest
from support.live import feed

from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.data.user import User
from synchronizar.estimation.incremental.asked import snapshot_of
from synchronizar.estimation.incremental.engine import Engine
from synchronizar.estimation.incremental.searcher import Searcher
from synchronizar.estimation.incremental.snapshot import Found, Snapshot
from synchronizar.estimation.incremental.told import registration_now
from synchronizar.simulation.simulate import Scene, simulate

PATIENCE = 120.0  # s: for a process to begin, on a busy machine


@cache
def recording() -> Recording:
    return simulate(Scene(users=2, seconds=8.0, rate_hz=8.0, seed=1)).recording


def snapshot() -> Snapshot:
    engine = Engine(recording().users, 0)
    feed(engine, recording(), end=4.0)
    return snapshot_of(engine.roster, engine.following, engine.log, [1], False, ())


def ended(searcher: Searcher) -> Found | None:
    """Wait for what it found."""
    limit = time.monotonic() + PATIENCE
    while time.monotonic() < limit:
        done, found = searcher.poll()
        if done:
            return found
        time.sleep(0.02)
    raise TimeoutError


def process_of(searcher: Searcher) -> int:
    assert searcher._process is not None
    return searcher._process.pid


def is_alive(pid: int) -> bool:
    """Whether a process runs, and is no zombie."""
    try:
        with open(f"/proc/{pid}/stat") as file:  # noqa: PTH123 - no file that a Path would help with
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_without_a_process_what_is_begun_is_found_at_once() -> None:
    searcher = Searcher(0)
    assert searcher.poll() == (False, None)
    assert not searcher.busy
    searcher.begin(snapshot())
    assert searcher.busy
    done, found = searcher.poll()
    assert done
    assert found is not None
    assert set(found.users) == {0, 1}
    assert not searcher.busy


def test_a_process_finds_what_is_found_without_one_and_a_killed_one_is_replaced() -> None:
    alone, beside = Searcher(0), Searcher(1)
    alone.begin(snapshot())
    _, expected = alone.poll()
    assert expected is not None
    try:
        beside.begin(snapshot())
        found = ended(beside)
        assert found is not None
        for user, own in expected.users.items():
            np.testing.assert_array_equal(found.users[user].place, own.place)
            np.testing.assert_array_equal(found.users[user].covariance, own.covariance)
            assert found.users[user].verdict.state is own.verdict.state
        first = process_of(beside)
        os.kill(first, signal.SIGKILL)
        beside.begin(snapshot())  # which may be before the pool knows that it was killed
        again = ended(beside)
        if again is None:
            assert not beside.busy
            beside.begin(snapshot())
            again = ended(beside)
        assert again is not None
        np.testing.assert_array_equal(again.users[1].place, expected.users[1].place)
        second = process_of(beside)
        assert second != first
    finally:
        beside.close()
    assert not beside.busy
    limit = time.monotonic() + PATIENCE
    while is_alive(second) and time.monotonic() < limit:
        time.sleep(0.02)
    assert not is_alive(second)


def test_an_engine_whose_process_is_killed_goes_on_and_finds() -> None:
    engine = Engine(recording().users, 0, workers=1)
    try:
        feed(engine, recording(), end=2.0)
        os.kill(process_of(engine._searcher), signal.SIGKILL)
        feed(engine, recording(), begin=2.0)
        limit, now = time.monotonic() + PATIENCE, 8.0
        while not engine.solved and time.monotonic() < limit:
            now += 0.05
            engine.advance(now)
            time.sleep(0.05)
        assert engine.solved
    finally:
        engine.close()


@pytest.mark.parametrize("workers", [0, 1])
def test_what_was_closed_is_closed_and_may_be_closed_again(workers: int) -> None:
    searcher = Searcher(workers)
    searcher.close()
    searcher.close()
    assert not searcher.busy


def test_who_is_added_while_a_search_goes_on_is_not_in_what_it_finds() -> None:
    engine = Engine(recording().users, 0)
    feed(engine, recording(), end=4.0)
    engine._searcher.begin(snapshot_of(engine.roster, engine.following, engine.log, [1], False, ()))
    engine.add_user(User("zoe"))
    assert engine.advance(4.05) is not None
    assert engine.following.tracking.noise.shape == (3, 2)
    engine.add_range(4.06, 0, 2, 2.0)
    feed(engine, recording(), begin=4.1, end=6.0)
    assert engine.state(2) is State.DISCONNECTED
    assert len(registration_now(engine).users) == 3
