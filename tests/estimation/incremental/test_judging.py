from __future__ import annotations

import pytest
from support.live import feed

from synchronizar.data.registration import State
from synchronizar.estimation.incremental.contradictions import Contradicted, Contradictions
from synchronizar.estimation.incremental.engine import Engine
from synchronizar.simulation.simulate import Scene, simulate


def test_who_was_suspected_when_another_was_contradicted_is_registered_again_once_its_ranges_fit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recording = simulate(Scene(users=4, seconds=12.0, rate_hz=8.0, seed=4)).recording
    engine = Engine(recording.users, 0)
    feed(engine, recording, end=8.0)
    assert [engine.state(u) for u in range(4)] == [State.REGISTERED] * 4

    with monkeypatch.context() as once:
        once.setattr(Contradictions, "found", lambda *_: Contradicted([3], "it is somewhere else"))
        engine.following.contradictions.suspected = frozenset({2, 3})
        engine.advance(8.0)
    assert [engine.state(u) for u in range(4)] == [State.REGISTERED, State.REGISTERED, *[State.UNOBSERVABLE] * 2]
    assert "others were contradicted" in engine.reason(2)

    feed(engine, recording, begin=8.0, end=9.5)
    assert engine.state(2) is State.REGISTERED
