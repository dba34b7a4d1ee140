"""The game in a room: builders put things down, players collect them, and all of it is in a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from synchronizar.apps.treasure.finding import found, frames_of, radios_of
from synchronizar.apps.treasure.game_file import Game, Thing, read_game, write_game
from synchronizar.apps.treasure.playing import Playing
from synchronizar.geometry import YawFrame
from synchronizar.live.applications import Application
from synchronizar.live.messages import Vector
from synchronizar.live.stage import Player, Stage

THING, SCORE, GHOST = "treasure thing", "treasure score", "treasure ghost"
WHAT = ("coin", "rusted", "obstacle", "start")
REACH_M = 0.8
"""m: so near to a hand a thing is taken away again."""
MOST_THINGS = 500
MOST_WALKS, GHOSTS = 10, 3
KEPT_EVERY_S = 10.0
"""s between times at which radios' places and devices' frames are kept."""


class Treasure(Application):
    """Words of players: `put` {"what"}, `take`, `undo`, `play`, `build`, `kept` (my frame is as it was then), `new`."""

    title = "Treasure"
    summary = "Hide coins in the room; others collect them by walking, also on another day."
    kinds = (THING, SCORE, GHOST)

    def __init__(self) -> None:
        self._path: Path | None = None
        self._game = Game()
        self._common_from_game: YawFrame | None = None
        self._playing: Playing | None = None
        self._done: dict[str, list[tuple[str, str, Thing]]] = {}
        """What each builder has done: `put` or `take`, and what."""
        self._kept: set[str] = set()
        self._kept_at = float("-inf")
        self._told: Any = None

    def begin(self, stage: Stage) -> None:
        """Go on with the game of the room's folder; in the room where it was, things are where they were."""
        self._path = stage.folder / "game.json"
        self._game = read_game(self._path)
        score = stage.objects.get(SCORE)
        if score is not None:
            self._common_from_game = YawFrame(*score.data["common_from_game"]) if score.data["found"] else None
        elif not self._game.things:
            self._common_from_game = YawFrame()
        for id_ in [o.id for o in stage.objects.values() if o.kind in self.kinds]:
            stage.remove(id_)
        if self._common_from_game is not None:
            self._show(stage)
        self._tell(stage)

    def said(self, stage: Stage, by: str, topic: str, data: Any) -> None:
        """A word of somebody."""
        if topic == "kept" and by:
            self._kept.add(by)
        if topic == "new" and by:
            self._new(stage)
        player = stage.players.get(by)
        if self._common_from_game is None or player is None:
            return
        if topic == "play" and self._playing is None and any(t.what == "coin" for t in self._game.things.values()):
            self._playing = Playing(dict(self._game.things), stage.t)
            self._show_ghosts(stage)
        elif topic == "build" and self._playing is not None:
            self._end(stage)
        elif self._playing is None:
            self._build(stage, player, topic, data)
        self._tell(stage)

    def tick(self, stage: Stage) -> None:
        """Go on to now."""
        if self._common_from_game is None:
            self._common_from_game = found(stage, self._game, self._kept)
            if self._common_from_game is None:
                return
            self._show(stage)
        if stage.t - self._kept_at > KEPT_EVERY_S and self._game.things:
            self._kept_at = stage.t
            self._keep(stage)
        playing = self._playing
        if playing is not None:
            game_from_common = self._common_from_game.inverse()
            places = {name: _place(game_from_common, p.position) for name, p in stage.players.items()}
            for id_, name in playing.go_on(stage.t, places):
                thing = playing.things[id_]
                stage.say("met", {"what": thing.what, "by": name})
                if thing.what != "obstacle":
                    stage.remove(_id(id_))
            if playing.ended:
                self._end(stage)
        self._tell(stage)

    # Building

    def _build(self, stage: Stage, player: Player, topic: str, data: Any) -> None:
        done = self._done.setdefault(player.name, [])
        if topic == "put" and isinstance(data, dict) and data.get("what") in WHAT:
            if len(self._game.things) < MOST_THINGS:
                id_ = str(self._game.next_thing)
                self._game.next_thing += 1
                assert self._common_from_game is not None
                place = _place(self._common_from_game.inverse(), player.hand)
                self._put(stage, id_, Thing(data["what"], place, player.name))
                done.append(("put", id_, self._game.things[id_]))
        elif topic == "take" and (nearest := self._nearest(stage, player)) is not None:
            done.append(("take", nearest, self._game.things[nearest]))
            self._take(stage, nearest)
        elif topic == "undo":
            self._undo(stage, done)

    def _undo(self, stage: Stage, done: list[tuple[str, str, Thing]]) -> None:
        """One's own last step that is still to be undone: somebody else may have taken the thing away since."""
        while done:
            what, id_, thing = done.pop()
            if what == "take" and id_ not in self._game.things:
                return self._put(stage, id_, thing)
            if what == "put" and id_ in self._game.things:
                return self._take(stage, id_)
        return None

    def _put(self, stage: Stage, id_: str, thing: Thing) -> None:
        self._game.things[id_] = thing
        self._show_thing(stage, id_, thing)
        self._write()

    def _take(self, stage: Stage, id_: str) -> None:
        del self._game.things[id_]
        stage.remove(_id(id_))
        self._write()

    def _nearest(self, stage: Stage, player: Player) -> str | None:
        hand = player.hand
        away = {
            id_: sum((a - b) ** 2 for a, b in zip(stage.objects[_id(id_)].position, hand, strict=True)) ** 0.5
            for id_ in self._game.things
        }
        nearest = min(away, key=away.__getitem__, default=None)
        return nearest if nearest is not None and away[nearest] < REACH_M else None

    def _new(self, stage: Stage) -> None:
        """Another game, where this one cannot be found; the file of this one is kept under another name."""
        if self._common_from_game is not None or self._path is None:
            return
        self._path.replace(self._path.with_name(f"game-{round(stage.t)}.json"))
        self._game, self._common_from_game = Game(), YawFrame()

    # Playing

    def _end(self, stage: Stage) -> None:
        assert self._playing is not None
        walks = self._playing.walks(stage.t)
        if self._playing.ended:
            best = sorted([*self._game.walks, *walks], key=lambda walk: (-walk.coins, walk.seconds))
            self._game.walks = best[:MOST_WALKS]
        self._playing = None
        self._write()
        for id_ in [o.id for o in stage.objects.values() if o.kind in (THING, GHOST)]:
            stage.remove(id_)
        self._show(stage)

    def _show_ghosts(self, stage: Stage) -> None:
        """The best walks until now go beside the players."""
        assert self._common_from_game is not None
        for n, walk in enumerate(self._game.walks[:GHOSTS]):
            path = [[s, *(round(v, 2) for v in _place(self._common_from_game, (x, y, z)))] for s, x, y, z in walk.path]
            if path:
                data = {"name": walk.name, "began": stage.t, "path": path}
                stage.create(f"{GHOST} {n}", GHOST, (path[0][1], path[0][2], path[0][3]), data=data)

    # What is shown and kept

    def _show(self, stage: Stage) -> None:
        for id_, thing in self._game.things.items():
            self._show_thing(stage, id_, thing)

    def _show_thing(self, stage: Stage, id_: str, thing: Thing) -> None:
        assert self._common_from_game is not None
        place = _place(self._common_from_game, thing.place)
        stage.create(_id(id_), THING, place, data={"what": thing.what, "by": thing.by})

    def _keep(self, stage: Stage) -> None:
        """What the game can be found by another day."""
        assert self._common_from_game is not None
        game_from_common = self._common_from_game.inverse()
        radios = {name: _place(game_from_common, place) for name, place in radios_of(stage).items()}
        self._game.radios |= radios
        self._game.frames |= frames_of(stage, game_from_common)
        self._write()

    def _write(self) -> None:
        assert self._path is not None
        write_game(self._path, self._game)

    def _tell(self, stage: Stage) -> None:
        frame, playing = self._common_from_game, self._playing
        players = {} if playing is None else playing.players
        data = {
            "found": frame is not None,
            "common_from_game": None if frame is None else [frame.x, frame.y, frame.z, frame.yaw],
            "by": sorted(self._game.radios.keys() | self._game.frames.keys())[:50],
            "playing": None if playing is None else playing.began,
            "left": 0 if playing is None else sum(playing.things[i].what == "coin" for i in playing.left),
            "things": len(self._game.things),
            "coins": {name: player.coins for name, player in players.items()},
            "best": [[walk.name, walk.coins, round(walk.seconds, 1)] for walk in self._game.walks[:3]],
        }
        if data == self._told and SCORE in stage.objects:
            return
        self._told = data
        if SCORE in stage.objects:
            stage.move(SCORE, data=data)
        else:
            stage.create(SCORE, SCORE, (0.0, 0.0, 0.0), data=data)


def _id(thing: str) -> str:
    return f"{THING} {thing}"


def _place(frame: YawFrame, point: Vector) -> Vector:
    x, y, z = (frame @ point).tolist()
    return x, y, z
