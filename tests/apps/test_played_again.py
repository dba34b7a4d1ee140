"""What is said and moved in a recorded room, on disk and played again."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from support.house import House, refused
from support.serving import run, serving

from synchronizar.apps.catch.game import BALL, SCORE, Catch
from synchronizar.errors import InputError
from synchronizar.geometry import YawFrame
from synchronizar.live import messages as m
from synchronizar.live import recorder as recorder_module
from synchronizar.live.app_run import hear
from synchronizar.live.client import Client
from synchronizar.live.play import play
from synchronizar.live.recorder import FolderRecorder
from synchronizar.live.stage import Stage
from synchronizar.live.words_file import WORDS_FILE, Word, read_words
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def ball(t: float, phase: str) -> Word:
    return Word(t, object=m.Object(BALL, BALL, (1.0, t, 0.0), UPRIGHT, m.APP, m.APP, t=t, data={"phase": phase}))


def recorded_game(folder: Path) -> House:
    """Ann throws to Bob, who is told something by himself."""
    recorder = FolderRecorder(folder)
    house = House(recorder, app="catch")
    players = {name: house.enter(name)[0] for name in ("ann", "bob")}
    app = house.enter_app()
    welcome, *_ = house.said_to(app)
    assert isinstance(welcome, m.Welcome)
    stage, game = Stage(welcome), Catch()
    game.begin(stage)

    def go_on(seconds: float) -> None:
        for _ in range(round(30.0 * seconds)):
            house.clock.t += 1.0 / 30.0
            for x, client in enumerate(players.values()):
                house.pose(client, 2.0 * x)
            house.told(ann=YawFrame(), bob=YawFrame(yaw=3.14159265, x=4.0))
            house.room.tick()
            for word in house.said_to(app):
                hear(game, stage, word)
                for said in stage.take_words():
                    house.room.hear(app, m.decode_from_client(m.encode(said)))

    go_on(0.5)
    house.room.hear(players["ann"], m.Say("throw", {"velocity": [2.5, 0.0, 1.0]}, m.APP))
    house.room.hear(app, m.Say("well thrown", None, "ann"))
    house.room.hear(app, m.Say("look", {"at": "ball"}))
    go_on(2.2)
    recorder.flush()
    return house


def test_a_recorded_room_has_what_was_told_of_objects_and_what_was_said_by_whom_to_whom(tmp_path: Path) -> None:
    house = recorded_game(tmp_path)
    words = read_words(tmp_path)
    assert [word.t for word in words] == sorted(word.t for word in words)
    assert (words[0].app, words[0].reference) == ("catch", "ann")
    said = [(word.said.by, word.said.topic, word.to) for word in words if word.said is not None]
    assert said == [("ann", "throw", m.APP), (m.APP, "well thrown", "ann"), (m.APP, "look", None)]
    phases = [word.object.data["phase"] for word in words if word.object is not None and word.object.id == BALL]
    assert phases == ["held", "flies", "held"]
    newest = {word.object.id: word.object for word in words if word.object is not None}
    assert newest == house.room.objects.objects


def test_a_word_that_was_half_written_is_left_out_and_what_is_no_word_is_told_with_its_line(tmp_path: Path) -> None:
    recorded_game(tmp_path)
    path = tmp_path / WORDS_FILE
    words = read_words(tmp_path)
    with path.open("ab") as file:
        file.write(b'{"t": 1')
    assert read_words(tmp_path) == words
    FolderRecorder(tmp_path).close()
    assert path.read_bytes().endswith(b"\n")
    path.write_text('{"t": 1}\n{"t": "noon"}\n')
    with pytest.raises(InputError, match="line 2"):
        read_words(tmp_path)
    assert read_words(tmp_path / "no such folder") == []


def test_a_full_file_of_words_is_told_once_and_tracks_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "MOST_BYTES", 400)
    house = House(FolderRecorder(tmp_path))
    ann, _ = house.enter("ann")
    for n in range(10):
        house.pose(ann, float(n))
        house.room.hear(ann, m.Say("hello", "x" * 100))
    events = [word for word in house.said_to(ann) if isinstance(word, m.Events)]
    assert len(events) == 1
    assert "recorded no more" in events[0].events[0]
    assert house.recorder is not None
    house.recorder.flush()
    assert len((tmp_path / "tracks" / "ann.tum").read_text().splitlines()) == 10
    assert len(read_words(tmp_path)) < 10


def test_who_plays_a_recording_says_again_what_became_of_objects_and_nobody_else_does() -> None:
    house = House(app="catch")
    plays, looks = house.enter("ann", time="recorded")[0], house.room.connect(house.room.admit(m.Join("CODE"))[0])
    app = house.enter_app()
    ended: list[bool] = []
    house.room.again.begun = lambda: ended.append(True)
    house.room.hear(app, m.Create("own", "ball", (0.0, 0.0, 0.0), hold=True))
    for word in (ball(1.0, "held"), ball(2.0, "flies")):
        house.room.hear(plays, m.decode_from_client(m.encode(m.Again(object=word.object))))
    house.room.hear(plays, m.Again(said=m.Said("look", 3, m.APP)))
    assert house.room.objects.objects == {BALL: ball(2.0, "flies").object}
    assert ended == [True]
    assert app.outbox.closed
    house.room.tick()
    heard = house.said_to(looks)
    assert [word.by for word in heard if isinstance(word, m.Said)] == [m.APP]
    house.room.hear(plays, m.Again(removed=BALL))
    assert house.room.objects.objects == {}
    house.room.hear(plays, m.Again(object=m.Object("x", "x", (1e9, 0.0, 0.0), UPRIGHT, "ann")))
    assert "value" in refused(house.said_to(plays))
    house.room.hear(looks, m.Again(removed=BALL))
    assert "time" in refused(house.said_to(looks))
    late = house.enter_app()
    house.room.hear(late, m.Create("own", "ball", (0.0, 0.0, 0.0), hold=True))
    assert house.room.objects.objects == {}
    live = House()
    ann, _ = live.enter("ann")
    live.room.hear(ann, m.Again(object=ball(1.0, "held").object))
    assert live.room.objects.objects == {}


def test_a_room_in_which_a_recording_is_played_shows_its_objects_instead_of_a_game_of_its_own() -> None:
    walk = simulate(Scene(users=3, seconds=10.0, seed=4, up="y")).recording
    words = [ball(t, phase) for t, phase in ((2.0, "held"), (4.0, "flies"), (9.0, "lies"))]
    words.append(Word(9.5, said=m.Said("look", None, m.APP)))
    words.append(Word(9.6, said=m.Said("alone", None, m.APP), to="ann"))

    async def test() -> None:
        async with serving(app="catch") as (_, address), await Client.join(address) as looks:
            # It hears meanwhile: who does not for half a minute is let go.
            looked = looks.until(lambda word: isinstance(word, m.Said) and word.topic == "look")
            answer, _ = await asyncio.gather(play(walk, address, 1e9, words=words), looked)
            if looks.objects[BALL] != words[2].object:  # objects are told at the room's next tick, words at once
                await looks.until(lambda _: looks.objects[BALL] == words[2].object)
            assert SCORE not in looks.objects
        async with serving() as (_, address):
            assert answer == await play(walk, address, 1e9)

    run(test)


def test_a_client_is_told_that_it_looks_at_a_recording() -> None:
    house = House()
    looks = house.room.connect(house.room.admit(m.Join("CODE"))[0])
    house.room.hear(looks, m.Ping(1.0))
    house.enter("ann", time="recorded")
    house.room.hear(looks, m.Ping(2.0))
    assert [word.recorded for word in house.said_to(looks) if isinstance(word, m.Pong)] == [False, True]


def test_objects_of_a_room_that_goes_on_are_written_once_more(tmp_path: Path) -> None:
    house = House(FolderRecorder(tmp_path))
    held = ball(1.0, "held").object
    assert held is not None
    house.room.objects.restore([held])
    house.room.tick()
    assert house.recorder is not None
    house.recorder.flush()
    assert [word.object.id for word in read_words(tmp_path) if word.object is not None] == [BALL]


def test_playing_goes_through_words_that_came_when_nothing_was_measured() -> None:
    """Before the first range, and after the last."""
    walk = simulate(Scene(users=2, seconds=5.0, seed=1)).recording
    words = [ball(-5.0, "held"), ball(99.0, "lies")]

    async def test() -> None:
        async with serving() as (_, address), await Client.join(address) as looks:

            async def look() -> None:
                await looks.until(lambda _: BALL in looks.objects)
                await looks.until(lambda _: looks.objects[BALL].t == 99.0)

            await asyncio.gather(play(walk, address, 1e9, words=words), look())

    run(test)
