from __future__ import annotations

from math import dist, sqrt

import pytest

from synchronizar.apps.catch import game
from synchronizar.apps.catch.flight import GRAVITY, Flight
from synchronizar.apps.catch.game import BALL, SCORE, Catch
from synchronizar.live import messages as m
from synchronizar.live.app_run import hear
from synchronizar.live.pose_wire import PoseDown, PosesDown
from synchronizar.live.stage import HAND_M, Player, Stage

STEP = 1.0 / 30.0
HALF = sqrt(0.5)
# A phone (y up, it looks along -z) that is held upright and looks along x, or against it, of a frame with z up.
ALONG_X = (0.5, -0.5, -0.5, 0.5)
AGAINST_X = (0.5, 0.5, 0.5, 0.5)


class Table:
    """A room in miniature: who stands where, and what the game does about it."""

    def __init__(self, **players: tuple[tuple[float, float, float], tuple[float, float, float, float]]) -> None:
        self.players = dict(players)
        self.unknown: set[str] = set()
        self.t, self.sequence = 100.0, 0
        members = [m.Member(name, i, True, False, "y", 0) for i, name in enumerate(["ann", "bob", "cem", "dan"])]
        self.index = {member.name: member.index for member in members}
        frames = m.Frames(0, self.t, None, {})
        self.stage = Stage(m.Welcome("ROOM", [], 1, self.t, members, frames, m.Objects(0)))
        self.game = Catch()
        self.game.begin(self.stage)
        self.words: list[m.FromClient] = []

    def go_on(self, seconds: float = STEP) -> None:
        for _ in range(max(1, round(seconds / STEP))):
            self.t, self.sequence = self.t + STEP, self.sequence + 1
            poses = [
                PoseDown(self.index[name], "ambiguous" if name in self.unknown else "registered", 0, 0.0, *pose)
                for name, pose in self.players.items()
            ]
            hear(self.game, self.stage, PosesDown(self.sequence, self.t, poses))
            self.words += self.stage.take_words()

    def says(self, by: str, topic: str, data: object) -> None:
        hear(self.game, self.stage, m.Said(topic, data, by))

    def throws(self, by: str, *velocity: float) -> None:
        self.says(by, "throw", {"velocity": list(velocity)})

    @property
    def ball(self) -> m.Object:
        return self.stage.objects[BALL]

    @property
    def score(self) -> dict[str, object]:
        data = self.stage.objects[SCORE].data
        assert isinstance(data, dict)
        return data


def two() -> Table:
    table = Table(ann=((0.0, 0.0, 0.0), ALONG_X), bob=((3.0, 0.0, 0.0), AGAINST_X))
    table.go_on()
    return table


def test_a_phone_that_looks_along_x_holds_its_ball_there() -> None:
    assert Player("ann", (1.0, 2.0, 3.0), ALONG_X, "y").hand == pytest.approx((1.0 + HAND_M, 2.0, 3.0))
    assert Player("bob", (1.0, 2.0, 3.0), AGAINST_X, "y").hand == pytest.approx((1.0 - HAND_M, 2.0, 3.0))


def test_a_robot_holds_its_ball_in_front_of_it() -> None:
    quarter_left = (0.0, 0.0, HALF, HALF)
    assert Player("robot", (0.0, 0.0, 0.0), quarter_left, "z").hand == pytest.approx((0.0, HAND_M, 0.0))


def test_nobody_has_a_ball_until_two_are_registered() -> None:
    table = Table(ann=((0.0, 0.0, 0.0), ALONG_X), bob=((3.0, 0.0, 0.0), AGAINST_X))
    table.unknown = {"bob"}
    table.go_on(2.0)
    assert BALL not in table.stage.objects
    table.unknown = set()
    table.go_on()
    assert table.ball.data == {"phase": "held", "by": "ann"}


def test_a_ball_that_is_thrown_to_somebody_is_caught_there_and_counts() -> None:
    table = two()
    table.throws("ann", 2.5, 0.3, 1.0)
    table.go_on()
    assert table.ball.data["phase"] == "flies"
    table.go_on(3.0)
    assert table.ball.data == {"phase": "held", "by": "bob"}
    assert (table.score["rally"], table.score["best"], table.score["caught"]) == (1, 1, {"bob": 1})


def test_a_throw_to_somebody_who_walks_comes_where_that_hand_will_be() -> None:
    table = two()
    for n in range(30):
        table.players["bob"] = ((3.0, 0.02 * n, 0.0), AGAINST_X)  # 0.6 m/s
        table.go_on()
    table.throws("ann", 2.5, 0.5, 1.0)
    table.go_on()
    flight = Flight(table.ball.data["t"], table.ball.data["position"], table.ball.data["velocity"])
    passes = min(
        dist(flight.at(flight.t + s), (3.0 - HAND_M, 0.58 + 0.6 * s, 0.0)) for s in [0.01 * n for n in range(250)]
    )
    assert passes < 0.1


def test_every_page_can_work_out_the_same_arc_from_what_it_is_told() -> None:
    table = two()
    table.throws("ann", 2.5, 0.0, 1.0)
    table.go_on(0.4)
    told = table.ball.data
    assert table.ball.velocity == told["velocity"]
    flight = Flight(told["t"], told["position"], told["velocity"])
    hand = table.stage.players["ann"].hand
    assert flight.at(told["t"]) == pytest.approx(hand)
    bob = table.stage.players["bob"].hand
    assert flight.nearest(bob, told["t"], told["t"] + 3.0)[1] < 1e-3  # a throw that nearly comes to somebody does


@pytest.mark.parametrize("looks", [True, False])
def test_a_ball_that_passes_at_half_a_metre_is_caught_by_who_looks_at_it_alone(looks: bool) -> None:
    table = two()
    falls, miss = HAND_M + 1.2, 0.52
    hand = falls + miss
    assert game.BLIND_REACH_M < miss < game.REACH_M
    table.players["bob"] = ((hand + HAND_M, 0.0, 0.0), AGAINST_X) if looks else ((hand - HAND_M, 0.0, 0.0), ALONG_X)
    table.go_on()
    table.throws("ann", 1.2 * GRAVITY / (2.0 * 5.0), 0.0, 5.0)  # so steep that nobody is meant
    table.go_on(4.0)
    assert table.score["caught"] == ({"bob": 1} if looks else {})


def test_a_ball_that_nobody_catches_lies_ends_the_rally_and_is_picked_up_by_who_comes() -> None:
    table = two()
    table.throws("ann", 2.5, 0.3, 1.0)
    table.go_on(3.0)
    table.throws("bob", 0.0, 4.0, 1.0)
    table.go_on(3.0)
    assert table.ball.data["phase"] == "lies"
    assert table.ball.position[2] == pytest.approx(-game.CARRIED_AT_M)
    assert (table.score["rally"], table.score["best"]) == (0, 1)
    x, y, _ = table.ball.position
    table.players["ann"] = ((x + 0.5, y, 0.0), AGAINST_X)
    table.go_on()
    assert table.ball.data == {"phase": "held", "by": "ann"}


def test_a_ball_that_nobody_fetches_comes_to_who_is_nearest() -> None:
    table = two()
    table.throws("bob", 0.0, 4.0, 1.0)  # only ann holds it: this is nobody's throw
    table.go_on()
    assert table.ball.data["by"] == "ann"
    table.throws("ann", 0.0, -4.0, 1.0)
    table.go_on(3.0 + game.LIES_S)
    assert table.ball.data["phase"] == "held"


def test_a_third_plays_from_the_moment_it_is_registered() -> None:
    table = two()
    table.players["cem"] = ((0.0, 3.0, 0.0), (HALF, 0.0, 0.0, HALF))
    table.unknown = {"cem"}
    table.throws("ann", -0.3, 2.5, 1.0)
    table.go_on(3.0)
    assert table.ball.data["phase"] == "lies"  # nobody is there yet, as far as the game knows
    table.unknown = set()
    table.go_on(game.LIES_S)
    while table.ball.data["by"] != "ann":
        table.throws(table.ball.data["by"], *toward(table, "ann"))
        table.go_on(3.0)
    table.throws("ann", *toward(table, "cem"))
    table.go_on(3.0)
    assert table.score["caught"].get("cem") == 1  # type: ignore[attr-defined]


def toward(table: Table, name: str) -> tuple[float, float, float]:
    begin, goal = (table.stage.players[n].hand for n in (table.ball.data["by"], name))
    d = dist(begin, goal)
    return 3.0 * (goal[0] - begin[0]) / d, 3.0 * (goal[1] - begin[1]) / d, 1.0


def test_who_is_lost_with_the_ball_loses_it_after_some_seconds() -> None:
    table = two()
    table.unknown = {"ann"}
    table.go_on(0.9 * game.GONE_S)
    assert table.ball.data["by"] == "ann"
    table.go_on(0.2 * game.GONE_S)
    assert table.ball.data["by"] == "bob"
    table.unknown = {"ann", "bob"}
    table.go_on(1.2 * game.GONE_S)
    assert BALL not in table.stage.objects


@pytest.mark.parametrize(
    "data", [None, {}, {"velocity": [1, 2]}, {"velocity": [1, 2, float("nan")]}, {"velocity": ["1", 2, 3]}, [1, 2, 3]]
)
def test_a_throw_that_makes_no_sense_is_none(data: object) -> None:
    table = two()
    table.says("ann", "throw", data)
    table.go_on()
    assert table.ball.data["phase"] == "held"


def test_an_application_that_is_begun_again_keeps_the_score() -> None:
    table = two()
    table.throws("ann", 2.5, 0.3, 1.0)
    table.go_on(3.0)
    table.game = Catch()
    table.game.begin(table.stage)
    table.go_on()
    assert table.ball.data["phase"] == "held"
    assert (table.score["best"], table.score["caught"]) == (1, {"bob": 1})
