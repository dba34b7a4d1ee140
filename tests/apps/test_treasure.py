from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.house import user_frame

from synchronizar.apps.treasure.finding import FITS_M
from synchronizar.apps.treasure.game import GHOST, KEPT_EVERY_S, SCORE, THING, Treasure
from synchronizar.apps.treasure.game_file import Game, read_game
from synchronizar.apps.treasure.playing import MOST_POINTS, thinned
from synchronizar.errors import InputError
from synchronizar.geometry import YawFrame
from synchronizar.live import messages as m
from synchronizar.live.app_run import hear
from synchronizar.live.pose_wire import PoseDown, PosesDown
from synchronizar.live.stage import HAND_M, Stage

ALONG_X = (0.5, -0.5, -0.5, 0.5)  # of a phone that is held upright
STEP = 1.0 / 30.0
RADIOS = {"door": (0.0, 0.0, 1.0), "window": (4.0, 0.5, 1.2), "shelf": (2.0, 5.0, 2.0)}
PLAYERS = ("ann", "bob", "cem")


class Day:
    """A room on some day, whose common frame lies elsewhere than on others; places in tests are the first day's."""

    def __init__(
        self, folder: Path, common: YawFrame | None = None, radios: dict[str, tuple[float, float, float]] | None = None
    ) -> None:
        """`common`: where the first day's frame lies in this one; `radios`: those that stand there."""
        self.common = common or YawFrame()
        self.places: dict[str, tuple[float, float, float]] = {}
        self.t, self.sequence, self.radios = 1000.0, 0, RADIOS if radios is None else radios
        members = [m.Member(name, n, True, False, "y", 0) for n, name in enumerate(PLAYERS)]
        members += [m.Member(name, len(PLAYERS) + n, True, True, "z", 0) for n, name in enumerate(self.radios)]
        self.index = {member.name: member.index for member in members}
        self.frames = {name: user_frame(YawFrame(*self._here(at))) for name, at in self.radios.items()}
        welcome = m.Welcome("ROOM", [], 1, self.t, members, m.Frames(0, self.t, None, {}), m.Objects(0))
        self.stage = Stage(welcome, folder)
        self.words: list[m.FromClient] = []
        self.begin()

    def begin(self) -> None:
        self.game = Treasure()
        self.game.begin(self.stage)

    def _here(self, place: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = (self.common @ place).tolist()
        return x, y, z

    def go_on(self, seconds: float = STEP) -> None:
        for _ in range(max(1, round(seconds / STEP))):
            self.t, self.sequence = self.t + STEP, self.sequence + 1
            hear(self.game, self.stage, m.Frames(self.sequence, self.t, None, self.frames))
            poses = [
                PoseDown(self.index[name], "registered", 0, 0.0, self._here(place), ALONG_X)
                for name, place in self.places.items()
            ]
            hear(self.game, self.stage, PosesDown(self.sequence, self.t, poses))
            self.words += self.stage.take_words()

    def says(self, by: str, topic: str, data: object = None) -> None:
        hear(self.game, self.stage, m.Said(topic, data, by))

    def puts(self, by: str, what: str, x: float, y: float) -> None:
        """So that it lies there, whichever way the phone looks: always along the common x."""
        ahead = self.common.inverse() @ (HAND_M, 0.0, 0.0) - self.common.inverse() @ (0.0, 0.0, 0.0)
        self.places[by] = (x - float(ahead[0]), y - float(ahead[1]), 0.0)
        self.go_on()
        self.says(by, "put", {"what": what})

    def walks(self, name: str, *way: tuple[float, float]) -> None:
        for goal in way:
            x, y, _ = self.places.get(name, (*way[0], 0.0))
            for share in np.linspace(0.0, 1.0, 30):
                self.places[name] = (x + share * (goal[0] - x), y + share * (goal[1] - y), 0.0)
                self.go_on()

    def things(self) -> dict[str, list[tuple[float, float]]]:
        """What lies where, in the first day's frame."""
        out: dict[str, list[tuple[float, float]]] = {}
        for thing in self.stage.objects.values():
            if thing.kind == THING:
                x, y, _ = (self.common.inverse() @ thing.position).tolist()
                out.setdefault(thing.data["what"], []).append((x, y))
        return {what: sorted(places) for what, places in out.items()}

    @property
    def score(self) -> dict[str, object]:
        data = self.stage.objects[SCORE].data
        assert isinstance(data, dict)
        return data


def built(folder: Path) -> Day:
    day = Day(folder)
    for x, y in ((1.0, 0.0), (2.0, 0.0), (3.0, 0.0)):
        day.puts("ann", "coin", x, y)
    day.puts("bob", "rusted", 1.0, 2.0)
    day.puts("bob", "obstacle", 3.0, 2.0)
    day.go_on(1.5 * KEPT_EVERY_S)
    return day


def test_what_is_put_down_lies_in_front_of_who_put_it_and_is_on_disk_at_once(tmp_path: Path) -> None:
    day = Day(tmp_path)
    day.puts("ann", "coin", 1.0, 0.5)
    (x, y), *more = day.things()["coin"]
    assert ((x, y), more) == (pytest.approx((1.0, 0.5)), [])
    (thing,) = read_game(tmp_path / "game.json").things.values()  # whatever is killed now
    assert (thing.what, thing.by, thing.place) == ("coin", "ann", pytest.approx((1.0, 0.5, 0.0)))


def test_each_builder_undoes_what_it_did_itself(tmp_path: Path) -> None:
    day = Day(tmp_path)
    day.puts("ann", "coin", 1.0, 0.0)
    day.puts("bob", "coin", 2.0, 0.0)
    day.puts("ann", "coin", 3.0, 0.0)
    day.says("bob", "undo")
    assert [round(x) for x, _ in day.things()["coin"]] == [1, 3]
    day.says("bob", "undo")  # nothing of his is left
    day.says("ann", "undo")
    assert [round(x) for x, _ in day.things()["coin"]] == [1]
    day.says("ann", "undo")
    assert day.things() == {}


def test_what_somebody_else_has_taken_away_is_not_undone_twice(tmp_path: Path) -> None:
    day = Day(tmp_path)
    day.puts("ann", "coin", 1.0, 0.0)
    day.places["bob"] = day.places["ann"]
    day.go_on()
    day.says("bob", "take")
    assert day.things() == {}
    day.says("ann", "undo")
    assert day.things() == {}
    day.says("bob", "undo")
    assert [round(x) for x, _ in day.things()["coin"]] == [1]


def test_coins_are_collected_by_walking_and_rusted_ones_and_obstacles_cost(tmp_path: Path) -> None:
    day = built(tmp_path)
    day.places = {"cem": (-1.0, 0.0, 0.0)}
    day.go_on()
    day.says("cem", "play")
    day.walks("cem", (1.0, 0.0), (1.0, 2.0), (3.0, 2.0))
    assert day.score["coins"] == {"cem": -1}  # one found, one rusted, one obstacle
    assert day.score["left"] == 2
    day.walks("cem", (3.0, 0.0), (2.0, 0.0))
    assert day.score["playing"] is None
    assert len(day.things()["coin"]) == 3  # for the next ones
    assert day.score["best"][0][:2] == ["cem", 1]  # type: ignore[index]
    (walk,) = read_game(tmp_path / "game.json").walks
    assert (walk.name, walk.coins) == ("cem", 1)
    assert walk.path[-1][0] == pytest.approx(walk.seconds, abs=0.6)


def test_with_a_start_nobody_collects_before_it_has_crossed_that(tmp_path: Path) -> None:
    day = built(tmp_path)
    day.puts("ann", "start", 5.0, 5.0)
    day.places = {"cem": (-1.0, 0.0, 0.0)}
    day.go_on()
    day.says("cem", "play")
    day.walks("cem", (1.0, 0.0))
    assert day.score["left"] == 3
    day.walks("cem", (5.0, 5.0), (1.0, 0.0))
    assert day.score["left"] == 2


def test_on_another_day_two_radios_are_enough_for_all_to_be_where_it_was(tmp_path: Path) -> None:
    built(tmp_path)
    radios = {"door": RADIOS["door"], "shelf": RADIOS["shelf"], "new": (9.0, 9.0, 1.0)}
    day = Day(tmp_path, YawFrame(5.0, -3.0, 0.4, 2.1), radios)
    assert day.things() == {}
    day.places = {"cem": (1.0, 3.0, 0.0)}
    day.go_on()
    first = day.things()
    assert first["coin"] == [pytest.approx(place, abs=1e-6) for place in ((1.0, 0.0), (2.0, 0.0), (3.0, 0.0))]
    assert first["obstacle"] == [pytest.approx((3.0, 2.0), abs=1e-6)]


def test_a_radio_that_was_moved_meanwhile_is_left_out(tmp_path: Path) -> None:
    built(tmp_path)
    moved = RADIOS | {"window": (4.0 - 2.0 * FITS_M, 1.5, 1.2)}
    day = Day(tmp_path, YawFrame(1.0, 2.0, 0.0, -0.7), moved)
    day.go_on()
    assert day.things()["coin"][0] == pytest.approx((1.0, 0.0), abs=1e-6)


def test_one_radio_is_not_enough_and_that_is_told(tmp_path: Path) -> None:
    built(tmp_path)
    day = Day(tmp_path, YawFrame(1.0, 2.0, 0.0, -0.7), {"door": RADIOS["door"]})
    day.places = {"cem": (0.0, 0.0, 0.0)}
    day.go_on(1.0)
    assert day.things() == {}
    assert day.score["found"] is False
    assert "shelf" in day.score["by"]  # type: ignore[operator]
    day.says("cem", "put", {"what": "coin"})
    day.says("cem", "play")
    assert day.things() == {}
    day.says("cem", "new")
    day.go_on()
    day.puts("cem", "coin", 1.0, 1.0)
    assert len(day.things()["coin"]) == 1
    assert len(list(tmp_path.glob("game-*.json"))) == 1  # nothing is lost


def test_a_device_that_kept_its_frame_finds_the_game_without_radios(tmp_path: Path) -> None:
    first = built(tmp_path)
    own = YawFrame(2.0, 1.0, 0.1, 0.9)
    first.frames["ann"] = user_frame(own)
    first.go_on(1.5 * KEPT_EVERY_S)
    day = Day(tmp_path, YawFrame(5.0, -3.0, 0.4, 2.1), {})
    day.frames["ann"] = user_frame(day.common @ own)
    day.go_on()
    assert day.things() == {}  # nobody has said that it is the same frame
    day.says("ann", "kept")
    day.go_on()
    assert day.things()["coin"][0] == pytest.approx((1.0, 0.0), abs=1e-6)


def test_best_walks_of_others_go_along_as_ghosts_in_the_frame_of_that_day(tmp_path: Path) -> None:
    first = built(tmp_path)
    first.places = {"cem": (-1.0, 0.0, 0.0)}
    first.go_on()
    first.says("cem", "play")
    first.walks("cem", (1.0, 0.0), (2.0, 0.0), (3.0, 0.0))
    day = Day(tmp_path, YawFrame(5.0, -3.0, 0.4, 2.1))
    day.places = {"ann": (0.0, 3.0, 0.0)}
    day.go_on()
    day.says("ann", "play")
    (ghost,) = (o for o in day.stage.objects.values() if o.kind == GHOST)
    assert (ghost.data["name"], ghost.data["began"]) == ("cem", day.t)
    begun, ended = (day.common.inverse() @ ghost.data["path"][n][1:] for n in (0, -1))
    assert begun[:2] == pytest.approx((-1.0, 0.0), abs=0.1)
    assert ended[:2] == pytest.approx((2.5, 0.0), abs=0.3)
    assert not m.data_too_large(ghost.data)


def test_the_longest_walk_fits_into_a_word() -> None:
    path = [(round(0.3 * n, 2), -12.34, -12.34, -1.23) for n in range(5000)]
    thin = thinned(path)
    assert (len(thin), thin[0], thin[-1]) == (MOST_POINTS, path[0], path[-1])
    assert not m.data_too_large({"name": "x" * 64, "began": 1764367200.123456, "path": thin})


def test_an_application_that_is_begun_again_in_the_same_room_has_everything_where_it_was(tmp_path: Path) -> None:
    day = built(tmp_path)
    before = day.things()
    day.begin()
    day.go_on()
    assert day.things() == before


def test_a_file_that_is_no_game_is_refused_with_a_way_on(tmp_path: Path) -> None:
    path = tmp_path / "game.json"
    path.write_text("{")
    with pytest.raises(InputError, match=r"is no game.*move it away"):
        read_game(path)
    path.write_text('{"format": 9}')
    with pytest.raises(InputError, match="of format 9"):
        read_game(path)
    assert read_game(tmp_path / "nothing.json") == Game()


@pytest.mark.parametrize("data", [None, {}, {"what": "gold"}, {"what": ["coin"]}, "coin", 3])
def test_what_cannot_be_put_down_is_not(tmp_path: Path, data: object) -> None:
    day = Day(tmp_path)
    day.places["ann"] = (0.0, 0.0, 0.0)
    day.go_on()
    day.says("ann", "put", data)
    day.go_on()
    assert day.things() == {}
