"""An application in a room without network, processes or wall time."""

from __future__ import annotations

import pytest
from support.house import House, only, refused

from synchronizar.apps.catch.game import BALL, SCORE, Catch
from synchronizar.geometry import YawFrame
from synchronizar.live import messages as m
from synchronizar.live.app_run import hear
from synchronizar.live.member import Client
from synchronizar.live.messages import MessageError
from synchronizar.live.objects import LEASE_S, ObjectStore
from synchronizar.live.stage import Stage


def test_an_application_is_let_in_by_its_secret_alone() -> None:
    house = House(app="catch")
    for said in ("", "guess", house.room.app_secret[:-1]):
        with pytest.raises(MessageError, match="only the application"):
            house.room.admit(m.Join("CODE", app=said))
    with pytest.raises(MessageError, match="only the application"):
        House().room.admit(m.Join("CODE", app=House().room.app_secret))
    with pytest.raises(MessageError, match="speaks for no device"):
        house.room.admit(m.Join("CODE", [m.UserSettings("robot")], app=house.room.app_secret))
    assert house.enter_app().name == m.APP


def test_no_device_is_called_as_the_application_is() -> None:
    with pytest.raises(MessageError, match="another name"):
        House().enter(m.APP)


def test_nobody_moves_or_takes_what_an_application_has_made() -> None:
    house = House(app="catch")
    app, _ = house.enter_app(), house.enter("ann")
    ann = house.room.devices["ann"].client
    assert ann is not None
    house.room.hear(app, m.Create("ball", "ball", (0.0, 0.0, 0.0), hold=True))
    house.clock.t += 10.0 * LEASE_S
    house.room.tick()
    house.said_to(ann)
    for word in (m.Grab("ball"), m.Move("ball", (1.0, 0.0, 0.0)), m.Remove("ball")):
        house.room.hear(ann, word)
    assert "holder" in refused(house.said_to(ann))
    assert house.room.objects.objects["ball"].holder == m.APP
    house.room.hear(app, m.Release("ball"))
    house.room.hear(ann, m.Grab("ball"))
    assert house.room.objects.objects["ball"].holder == "ann"


def test_an_applications_objects_are_its_own_after_the_rooms_restart_and_nobodys_where_it_is_gone() -> None:
    kept = [m.Object("coin", "coin", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), m.APP, m.APP)]
    for app, holder in ((True, m.APP), (False, None)):
        store = ObjectStore()
        store.restore(kept, app)
        assert store.objects["coin"].holder == holder


def test_words_to_the_application_reach_it_from_players_and_from_who_only_looks() -> None:
    house = House(app="catch")
    app = house.enter_app()
    ann, _ = house.enter("ann")
    looks = house.room.connect(house.room.admit(m.Join("CODE"))[0])
    house.said_to(app), house.said_to(ann)
    house.room.hear(ann, m.Say("throw", 1, m.APP))
    house.room.hear(looks, m.Say("again", 2, m.APP))
    house.room.hear(looks, m.Say("again", 2))
    said = [word for word in house.said_to(app) if isinstance(word, m.Said)]
    assert [(word.by, word.topic, word.data) for word in said] == [("ann", "throw", 1), ("", "again", 2)]
    assert "spectator" in refused(house.said_to(looks))
    assert [word for word in house.said_to(ann) if isinstance(word, m.Said)] == []
    house.room.hear(app, m.Say("ring", None, "ann"))
    assert only(m.Said, house.said_to(ann)).by == m.APP


def test_where_there_is_no_application_a_word_to_it_is_refused() -> None:
    house = House()
    ann, _ = house.enter("ann")
    house.room.hear(ann, m.Say("throw", 1, m.APP))
    assert "app" in refused(house.said_to(ann))


def test_an_application_that_comes_again_takes_its_place() -> None:
    house = House(app="catch")
    first = house.enter_app()
    second = house.enter_app()
    assert first.outbox.closed
    ann, _ = house.enter("ann")
    house.room.hear(ann, m.Say("throw", 1, m.APP))
    assert only(m.Said, house.said_to(second)).by == "ann"
    house.room.disconnect(first)  # it is noticed late
    house.room.hear(ann, m.Say("throw", 2, m.APP))
    assert only(m.Said, house.said_to(second)).data == 2


def test_a_room_in_which_only_its_application_is_left_is_empty() -> None:
    house = House(app="catch")
    house.enter_app()
    house.clock.t += 100.0
    assert house.room.idle_for() == 100.0
    ann, _ = house.enter("ann")
    assert house.room.idle_for() == 0.0
    house.room.disconnect(ann)
    house.clock.t += 50.0
    assert house.room.idle_for() == 50.0


class Played:
    """A whole room with its application, as its process would run it."""

    def __init__(self) -> None:
        self.house = House(app="catch")
        self.players = {name: self.house.enter(name)[0] for name in ("ann", "bob")}
        self.app = self.house.enter_app()
        words = self.house.said_to(self.app)
        welcome = words[0]
        assert isinstance(welcome, m.Welcome)
        self.stage, self.game = Stage(welcome), Catch()
        self.game.begin(self.stage)
        for word in words[1:]:
            hear(self.game, self.stage, word)

    def go_on(self, seconds: float) -> None:
        house = self.house
        for _ in range(round(30.0 * seconds)):
            house.clock.t += 1.0 / 30.0
            for x, client in enumerate(self.players.values()):
                house.pose(client, 2.0 * x)
            house.told(ann=YawFrame(), bob=YawFrame(yaw=3.14159265, x=4.0))
            house.room.tick()
            for word in house.said_to(self.app):
                hear(self.game, self.stage, word)
                for said in self.stage.take_words():
                    house.room.hear(self.app, m.decode_from_client(m.encode(said)))

    def seen_by(self, client: Client) -> dict[str, m.Object]:
        objects: dict[str, m.Object] = {}
        for word in self.house.said_to(client):
            if isinstance(word, m.Welcome):
                word = word.objects
            if isinstance(word, m.Objects):
                objects |= {o.id: o for o in word.changed}
        return objects


def test_two_play_a_game_through_the_room_and_a_third_sees_what_they_see() -> None:
    played = Played()
    played.go_on(0.5)
    assert played.house.room.objects.objects[BALL].data == {"phase": "held", "by": "ann"}
    played.house.room.hear(played.players["ann"], m.Say("throw", {"velocity": [2.5, 0.0, 1.0]}, m.APP))
    played.go_on(0.2)
    flies = played.house.room.objects.objects[BALL]
    assert flies.data["phase"] == "flies"
    assert flies.velocity is not None
    played.go_on(2.0)
    ball, score = (played.house.room.objects.objects[id_] for id_ in (BALL, SCORE))
    assert ball.data == {"phase": "held", "by": "bob"}
    assert score.data["caught"] == {"bob": 1}
    late, _ = played.house.enter("cem")
    assert played.seen_by(late) == {BALL: ball, SCORE: score}
    assert refused(played.house.said_to(played.app)) == {}


def test_a_player_that_is_a_program_sees_on_its_stage_what_the_application_moves() -> None:
    played = Played()
    ann = played.players["ann"]
    heard = played.house.said_to(ann)
    welcome = heard[0]
    assert isinstance(welcome, m.Welcome)
    stage = Stage(welcome)
    played.go_on(0.5)
    played.house.room.hear(ann, m.Say("throw", {"velocity": [2.5, 0.0, 1.0]}, m.APP))
    played.go_on(2.2)
    for word in [*heard[1:], *played.house.said_to(ann)]:
        stage.hear(word)
    assert stage.objects[BALL].data == {"phase": "held", "by": "bob"}


def test_an_old_echo_changes_nothing_on_the_stage_of_whose_objects_they_are() -> None:
    played = Played()
    stage = played.stage
    stage.create("bell", "bell", (1.0, 0.0, 0.0))
    echo = stage.objects["bell"]
    stage.move("bell", (2.0, 0.0, 0.0))
    stage.hear(m.Objects(1, [echo]))
    assert stage.objects["bell"].position == (2.0, 0.0, 0.0)
    stage.remove("bell")
    stage.create("bell", "bell", (3.0, 0.0, 0.0))
    stage.hear(m.Objects(2, [], ["bell"]))
    assert stage.objects["bell"].position == (3.0, 0.0, 0.0)


def test_a_game_whose_process_died_goes_on_with_its_score() -> None:
    played = Played()
    played.go_on(0.5)
    played.house.room.hear(played.players["ann"], m.Say("throw", {"velocity": [2.5, 0.0, 1.0]}, m.APP))
    played.go_on(2.2)
    played.app = played.house.enter_app()
    welcome = played.house.said_to(played.app)[0]
    assert isinstance(welcome, m.Welcome)
    played.stage, played.game = Stage(welcome), Catch()
    played.game.begin(played.stage)
    played.go_on(0.5)
    objects = played.house.room.objects.objects
    assert objects[BALL].data["phase"] == "held"
    assert objects[SCORE].data["caught"] == {"bob": 1}
