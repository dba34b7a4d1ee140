"""Look through my eyes: who may see whom, what surrounds everybody, what was pointed at."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synchronizar.apps.eyes.game import MOST_MARKS, Eyes
from synchronizar.apps.eyes.scan import (
    AGAIN_S,
    CELL_M,
    FLOOR,
    MARK,
    MOST_SEEN,
    SCAN,
    SIDE,
    Cube,
    Sightings,
    cells_of,
    cubes_of,
    middles,
    seen,
)
from synchronizar.apps.looks import LOOK, REFUSED_S, WAITS_S
from synchronizar.live import messages as m
from synchronizar.live.app_run import hear
from synchronizar.live.pose_wire import PoseDown, PosesDown
from synchronizar.live.stage import Stage

NAMES = ("ann", "ben", "cem")


class Room:
    """Three phones that are in place, and the room's page."""

    def __init__(self) -> None:
        self.t = 100.0
        self.members = [m.Member(name, n, True, False, "y", 0) for n, name in enumerate(NAMES)]
        self.members.append(m.Member("shelf", 3, True, True, "z", 0))
        welcome = m.Welcome("ROOM", [], 1, self.t, self.members, m.Frames(0, self.t, None, {}), m.Objects(0))
        self.stage, self.game = Stage(welcome, Path()), Eyes()
        self.game.begin(self.stage)
        self.go_on(0.1)

    def go_on(self, seconds: float) -> None:
        self.t += seconds
        poses = [PoseDown(n, "registered", 0, 0.0, (float(n), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)) for n in range(3)]
        hear(self.game, self.stage, PosesDown(0, self.t, poses))

    def say(self, by: str, topic: str, data: object) -> None:
        hear(self.game, self.stage, m.Said(topic, data, by))

    def gone(self, name: str) -> None:
        self.members = [m.Member(x.name, x.index, x.name != name, x.static, x.up, 0) for x in self.members]
        hear(self.game, self.stage, m.Members(self.members))

    @property
    def looks(self) -> list[tuple[str, str, str]]:
        found = [o.data for o in self.stage.objects.values() if o.kind == LOOK]
        return sorted((data["who"], data["whom"], data["state"]) for data in found)

    def of(self, kind: str) -> list[m.Object]:
        return [o for o in self.stage.objects.values() if o.kind == kind]


def test_nobody_sees_through_anybodys_eyes_before_that_one_has_said_yes() -> None:
    room = Room()
    room.say("ann", "ask", {"whom": "ben"})
    assert room.looks == [("ann", "ben", "asked")]
    room.say("ann", "allow", {"who": "ann"})
    room.say("cem", "allow", {"who": "ann"})
    room.say("", "allow", {"who": "ann"})
    assert room.looks == [("ann", "ben", "asked")]
    room.say("ben", "allow", {"who": "ann"})
    assert room.looks == [("ann", "ben", "on")]


@pytest.mark.parametrize("by", ["ann", "ben"])
def test_either_of_the_two_ends_it_and_nobody_else(by: str) -> None:
    room = Room()
    room.say("ann", "ask", {"whom": "ben"})
    room.say("ben", "allow", {"who": "ann"})
    for other in ("cem", ""):
        room.say(other, "stop", {"who": "ann", "whom": "ben"})
    assert room.looks == [("ann", "ben", "on")]
    room.say(by, "stop", {"who": "ann", "whom": "ben"})
    assert room.looks == []


def test_who_was_refused_waits_before_asking_again_and_old_questions_go() -> None:
    room = Room()
    room.say("", "ask", {"whom": "ben"})
    room.say("ben", "refuse", {"who": ""})
    room.say("", "ask", {"whom": "ben"})
    assert room.looks == [("", "ben", "refused")]
    room.go_on(REFUSED_S + 0.1)
    assert room.looks == []
    room.say("", "ask", {"whom": "ben"})
    room.go_on(WAITS_S - 0.1)
    assert room.looks == [("", "ben", "asked")]
    room.go_on(0.2)
    assert room.looks == []


@pytest.mark.parametrize("gone", ["ann", "ben"])
def test_it_is_over_when_one_of_them_leaves(gone: str) -> None:
    room = Room()
    room.say("ann", "ask", {"whom": "ben"})
    room.say("ben", "allow", {"who": "ann"})
    room.gone(gone)
    room.go_on(0.1)
    assert room.looks == []


@pytest.mark.parametrize("data", [None, {}, {"whom": "ann"}, {"whom": "nobody"}, {"whom": "shelf"}, {"whom": 3}, "ben"])
def test_a_question_to_nobody_is_none(data: object) -> None:
    room = Room()
    room.say("ann", "ask", data)
    assert room.looks == []


def test_what_several_have_seen_is_one_model() -> None:
    room = Room()
    one, other = np.array([[0.1, 0.1, 0.1], [2.0, 0.0, 0.0]]), np.array([[0.1, 0.1, 0.5], [-2.0, 0.0, 0.0]])
    for name, points in (("ann", one), ("ben", other), ("ben", other)):
        for data in seen(points):
            room.say(name, "seen", data)
    cells = np.concatenate([middles(cube) for cube in map(cube_of, room.of(SCAN))])
    expected = np.unique(np.floor(np.concatenate([one, other]) / CELL_M), axis=0)
    np.testing.assert_allclose(np.unique(cells, axis=0), (expected + 0.5) * CELL_M, atol=1e-9)


def test_who_is_not_in_place_adds_nothing_to_the_model_and_the_rooms_page_does() -> None:
    room = Room()
    room.say("dan", "seen", seen(np.zeros((1, 3)))[0])
    assert not room.of(SCAN)
    room.say("", "seen", seen(np.zeros((1, 3)))[0])
    assert len(room.of(SCAN)) == 1
    room.say("", "forget", None)
    assert not room.of(SCAN)


def test_the_floor_is_where_who_saw_it_first_has_it() -> None:
    room = Room()
    for by, z in (("", -1.0), ("dan", -1.0), ("ann", None), ("ann", float("nan")), ("ann", -1.31), ("ben", -1.5)):
        room.say(by, "floor", {"z": z})
    assert [o.position for o in room.of(FLOOR)] == [(0.0, 0.0, -1.31)]
    room.say("ann", "forget", None)
    room.say("ben", "floor", {"z": -1.5})
    assert [o.position for o in room.of(FLOOR)] == [(0.0, 0.0, -1.5)]


def test_a_program_tells_once_what_it_has_seen_in_two_different_seconds() -> None:
    sightings, wall, person = Sightings(), np.array([[1.0, 0.0, 0.0]]), np.array([[0.5, 0.0, 0.0]])
    sightings.add(np.concatenate([wall, person]), 10.0)
    sightings.add(wall, 10.0 + 0.9 * AGAIN_S)
    assert sightings.take() == []
    sightings.add(wall, 10.0 + 1.1 * AGAIN_S)
    (data,) = sightings.take()
    (cube,) = cubes_of(data)
    np.testing.assert_allclose(middles(cube), (np.floor(wall / CELL_M) + 0.5) * CELL_M)
    sightings.add(wall, 20.0)
    assert sightings.take() == []


@pytest.mark.parametrize(
    "data", [None, [], {}, [[0, 0, 0]], [[0, 0, 0, "x"]], [[0.5, 0, 0, "AAAA"]], [[0, 0, 1e9, 5]], [[True, 0, 0, ""]]]
)
def test_a_malformed_sight_is_left_alone(data: object) -> None:
    room = Room()
    room.say("ann", "seen", data)
    assert not room.of(SCAN)


@settings(deadline=None)
@given(st.lists(st.tuples(*[st.floats(-20.0, 20.0)] * 3), min_size=1, max_size=60))
def test_points_come_back_as_the_cells_that_they_are_in(points: list[tuple[float, float, float]]) -> None:
    told = seen(np.array(points))
    assert all(len(data) <= MOST_SEEN and not m.data_too_large(data) for data in told)
    cubes = [cube for data in told for cube in cubes_of(data)]
    cells = np.concatenate([middles(cube) for cube in cubes])
    expected = np.unique(np.floor(np.array(points) / CELL_M), axis=0)
    np.testing.assert_allclose(np.unique(np.round(cells / CELL_M - 0.5), axis=0), expected)
    for cube in cubes:
        assert cells_of(cube.text) == cube.cells
        assert not m.data_too_large(cube.text)
        inside = middles(cube) - cube.corner
        assert ((inside > 0.0) & (inside < SIDE * CELL_M)).all()


def test_as_many_full_cubes_as_a_word_has_fit_into_one() -> None:
    full = Cube((-99, -99, -99), (1 << SIDE**3) - 1)
    assert not m.data_too_large([[*full.at, full.text]] * MOST_SEEN)


def test_a_mark_stands_where_it_was_put_and_the_oldest_go_first() -> None:
    room = Room()
    room.say("ann", "mark", {"position": [1, 2.5, 0.5]})
    room.say("", "mark", {"position": [0.0, 0.0, 0.0]})
    assert [(o.id, o.position, o.data["by"]) for o in room.of(MARK)] == [
        ("mark 0", (1.0, 2.5, 0.5), "ann"),
        ("mark 1", (0.0, 0.0, 0.0), ""),
    ]
    for _ in range(MOST_MARKS):
        room.say("ben", "mark", {"position": [0.0, 0.0, 1.0]})
    assert len(room.of(MARK)) == MOST_MARKS
    assert {o.data["by"] for o in room.of(MARK)} == {"ben"}
    room.say("cem", "unmark", {"id": room.of(MARK)[0].id})
    assert len(room.of(MARK)) == MOST_MARKS - 1


@pytest.mark.parametrize("position", [None, [1, 2], [1, 2, "3"], [1e4, 0, 0], [1, 2, None], "123"])
def test_a_mark_that_is_nowhere_is_none(position: object) -> None:
    room = Room()
    room.say("ann", "mark", {"position": position})
    assert not room.of(MARK)


def cube_of(o: m.Object) -> Cube:
    x, y, z = map(int, o.id.split()[1:])
    cells = cells_of(o.data)
    assert cells is not None
    return Cube((x, y, z), cells)
