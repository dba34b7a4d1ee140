"""What studies of applications are judged by."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from experiments.apps.catch import LATE, meanwhile
from experiments.apps.played_again import Frame, Record, frames_of, judged
from experiments.common.cpu import usage_by_kind
from experiments.live.walkers import ranges_between
from synchronizar.apps.catch.game import BALL, SCORE
from synchronizar.apps.treasure.game import THING
from synchronizar.live import messages as m
from synchronizar.live.words_file import Word
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def thing(t: float, id_: str, kind: str, data: object, x: float = 0.0) -> Word:
    return Word(t, object=m.Object(id_, kind, (x, 0.0, 0.0), UPRIGHT, m.APP, m.APP, t=t, data=data))


def test_what_became_of_a_game_while_somebody_came_is_what_was_thrown_and_caught_then() -> None:
    words = [
        thing(1.0, SCORE, SCORE, {"caught": {"a": 2}}),
        thing(2.0, BALL, BALL, {"phase": "flies", "by": "a"}),
        Word(2.5, said=m.Said("throw", None, LATE), to=m.APP),
        thing(3.0, BALL, BALL, {"phase": "held", "by": "b"}),
        thing(3.0, SCORE, SCORE, {"caught": {"a": 2, "b": 1}}),
        thing(9.0, BALL, BALL, {"phase": "held", "by": LATE}),
    ]
    assert list(meanwhile(words, 1.5, 4.0).values()) == [1, 1, 1, 0]


def test_a_record_has_a_balls_flight_and_coins_as_they_lay_once_they_have_lain_for_a_while() -> None:
    flown = {"phase": "flies", "by": "a", "t": 2.0, "position": [0.0, 0.0, 1.0], "velocity": [1.0, 2.0, 3.0]}
    record = Record(
        [
            thing(0.0, "coin 0", THING, {"what": "coin"}, 1.0),
            thing(0.0, "coin 1", THING, {"what": "rusted"}, 2.0),
            thing(2.0, BALL, BALL, flown),
            Word(4.0, removed="coin 0"),
        ]
    )
    assert record.ball(1.0) is None
    assert record.ball(2.2) is None
    assert record.ball(3.0) == pytest.approx([1.0, 2.0])
    assert np.array_equal(record.coins(3.0), [[1.0, 0.0]])  # type: ignore[arg-type]
    assert record.coins(4.2) is None
    assert np.array_equal(record.coins(5.0), np.zeros((0, 2)))  # type: ignore[arg-type]


@pytest.mark.parametrize("own_time", [1e9, 20.0])
def test_what_a_page_drew_is_judged_while_the_recording_lasts(own_time: float) -> None:
    # A record that has just been made is not long before the room's own time.
    record = Record([thing(0.0, "coin 0", THING, {"what": "coin"}, 1.0)])
    rows = [[1, "frame", 100.0, own_time], [2, "coin", 1.1, 0.0], [2, "frame", 110.9, 1.0], [3, "frame", 111.4, 1.5]]
    frames = frames_of(rows)
    assert frames[1] == Frame(110.9, 1.0, [], [(1.1, 0.0)])
    of = judged(frames, record, [(100.0, own_time), (109.5, 0.0), (110.5, 1.0), (112.5, 3.0)])
    assert of["frames"] == of["frames with coins"] == 2
    assert of["share of these with all coins and no other"] == 0.5
    assert of["a coin off the record, p95"] == pytest.approx(0.1)
    assert of["page behind, median, s"] == pytest.approx(0.4)


def test_processes_are_told_apart_by_their_command_lines() -> None:
    command = [sys.executable, "-c", "print(flush=True); input()", "a-word-of-its-own"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        child.stdout.readline()  # before this it may not have loaded its program, and has no memory and no name
        of = usage_by_kind(os.getpid(), {"child": b"a-word-of-its-own", "none": b"no-such-word"})
        child.communicate(b"\n")
    assert of["own"].megabytes > 1.0
    assert of["child"].megabytes > 0.0
    assert of["none"].megabytes == 0.0


def test_ranges_between_two_are_theirs_alone_in_the_order_of_time() -> None:
    recording = simulate(Scene(users=3, seconds=3.0)).recording
    ranges = ranges_between(recording, "phone2", "phone0")
    assert len(ranges) > 10
    assert {frozenset((one.a, one.b)) for one in ranges} == {frozenset(("phone0", "phone2"))}
    assert [one.t for one in ranges] == sorted(one.t for one in ranges)
