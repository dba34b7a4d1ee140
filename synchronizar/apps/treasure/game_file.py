"""A game that persists: what was put where, what it can be found again by, and who has played. One JSON file a game."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec

from synchronizar.errors import InputError, os_faults
from synchronizar.live.messages import Vector

_FORMAT = 1


class Thing(msgspec.Struct):
    """Something that was put down."""

    what: str
    """`coin`, `rusted`, `obstacle` or `start`."""
    place: Vector
    """m, in the game's frame."""
    by: str


class KeptFrame(msgspec.Struct):
    """Where a device's own SLAM frame lay in the game's: `game_from_user` between z-up axes."""

    x: float
    y: float
    z: float
    yaw: float
    scale: float


class Walk(msgspec.Struct):
    """Somebody's play."""

    name: str
    coins: int
    seconds: float
    path: list[tuple[float, float, float, float]]
    """s since it began, and the place (m, the game's frame)."""


class Game(msgspec.Struct):
    """All of it. Its frame is the common one of the room in which it was begun."""

    things: dict[str, Thing] = {}
    radios: dict[str, Vector] = {}
    """Places (m) of radios that stand still, in the game's frame."""
    frames: dict[str, KeptFrame] = {}
    walks: list[Walk] = []
    """The best ones, the best first."""
    next_thing: int = 0
    format: int = _FORMAT


_decoder = msgspec.json.Decoder(Game)


def read_game(path: Path) -> Game:
    """An empty one where there is no file. Raises InputError where it is something else."""
    with os_faults(path):
        if not path.exists():
            return Game()
        data = path.read_bytes()
    try:
        game = _decoder.decode(data)
    except msgspec.DecodeError as error:
        raise InputError(path, f"is no game: {error}; move it away to begin a new one") from error
    if game.format != _FORMAT:
        raise InputError(path, f"is a game of format {game.format}, this version reads {_FORMAT}")
    return game


def write_game(path: Path, game: Game) -> None:
    """As a whole: an older one is there until the new one is on disk. Raises InputError where that cannot be."""
    half = path.with_suffix(".half")
    with os_faults(half):
        path.parent.mkdir(parents=True, exist_ok=True)
        with half.open("wb") as out:
            out.write(msgspec.json.encode(game))
            out.flush()
            os.fsync(out.fileno())
        half.replace(path)
