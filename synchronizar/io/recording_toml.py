"""Reads and writes recording.toml: the vertical axis and what is known of each user besides its track."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from synchronizar.data.user import User
from synchronizar.errors import InputError, os_faults
from synchronizar.geometry import Up
from synchronizar.io.text import MAX_LENGTH, MAX_PLACE, MIN_SIGMA, is_name, quoted

SETTINGS = (
    *("up", "static", "height_sigma", "position", "position_sigma", "range_bias", "range_bias_sigma"),
    "antennas",
)
"""What a user has."""
SIGMAS = ("height_sigma", "position_sigma", "range_bias_sigma")


@dataclass(frozen=True)
class Settings:
    """Settings of the users, and the vertical axis of their tracks."""

    users: Mapping[str, User] = field(default_factory=dict)
    """The users that the file names."""
    up: Up = "z"
    """Vertical axis of the tracks of all other users."""


def read_recording_toml(path: Path, unknown: list[str] | None = None) -> Settings:
    """The settings in a file. Raises InputError where it cannot be read, or a value is of the wrong kind or size.

    An unknown setting is refused; with a list `unknown` its name is appended there and the rest is read.
    """
    table = _parse(path)
    _note_unknown(path, "", table, ("up", "users"), unknown)
    up = read_up(path, "up", table.get("up", Settings.up))
    users = {}
    for name, settings in _table(path, "users", table.get("users", {})).items():
        where = f"users.{name}"
        if not is_name(name):
            raise InputError(path, f"{quoted(name)} cannot be the name of a user")
        users[name] = read_user(path, where, name, settings, up, unknown)
    return Settings(users, up)


def write_recording_toml(path: Path, users: Collection[User]) -> None:
    """Write the users' settings. Raises InputError where the file cannot be written."""
    ups = {user.up for user in users}
    up: Up = ups.pop() if len(ups) == 1 else "z"
    lines = [f'up = "{up}"']
    for user in users:
        settings = []
        if user.up != up:
            settings.append(f'up = "{user.up}"')
        if user.static:
            settings.append("static = true")
        if user.height_sigma is not None:
            settings.append(f"height_sigma = {float(user.height_sigma)!r}")
        if user.position is not None:
            settings.append(f"position = {[float(x) for x in user.position]!r}")
        for name in ("position_sigma", "range_bias", "range_bias_sigma"):
            if (value := getattr(user, name)) is not None:
                settings.append(f"{name} = {float(value)!r}")
        for name, lever in user.antennas.items():
            settings.append(f"antennas.{_key(name)} = {[float(x) for x in lever]!r}")
        if settings:
            lines += ["", f"[users.{_key(user.name)}]", *settings]
    with os_faults(path):
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _parse(path: Path) -> dict[str, Any]:
    with os_faults(path):
        data = path.read_bytes()
    try:
        return tomllib.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise InputError(path, "is not UTF-8 text", line) from error
    except tomllib.TOMLDecodeError as error:
        place = re.search(r" \(at line (\d+), column \d+\)$| \(at end of document\)$", str(error))
        last_line = data.rstrip().count(b"\n") + 1
        line = int(place[1]) if place and place[1] else last_line
        raise InputError(path, str(error)[: place.start() if place else None], line) from error
    except (ValueError, RecursionError) as error:
        # Numbers of thousands of digits, or tables nested a thousand deep.
        raise InputError(path, f"cannot be read: {error}") from error


def read_user(
    path: str | Path, where: str, name: str, settings: object, up: Up, unknown: list[str] | None = None
) -> User:
    """The user with these settings of recording.toml; `up` is the default vertical axis.

    Raises InputError that names `path` and the setting, at `where`. An unknown setting is refused; with a list
    `unknown` its name is appended there instead.
    """
    settings = _table(path, where, settings)
    _note_unknown(path, where, settings, SETTINGS, unknown)
    static = settings.get("static", False)
    if not isinstance(static, bool):
        raise InputError(path, f"{where}.static must be true or false")
    sigmas = {name: _sigma(path, where, name, settings) for name in SIGMAS}
    levers = _table(path, f"{where}.antennas", settings.get("antennas", {}))
    if static and levers:
        raise InputError(path, f"{where} is static: without an attitude its antennas have no place")
    antennas = {antenna: _lever(path, where, antenna, lever) for antenna, lever in levers.items()}
    position, bias = settings.get("position"), settings.get("range_bias")
    if position is not None:
        if not static:
            raise InputError(path, f"{where}.position is that of a radio that stands still: it needs static = true")
        position = _three(path, f"{where}.position", position, MAX_PLACE)
    elif sigmas["position_sigma"] is not None:
        raise InputError(path, f"{where}.position_sigma is that of a position, which it does not have")
    if bias is not None and not _is_length(bias):
        raise InputError(path, f"{where}.range_bias must be a number within {MAX_LENGTH:g} (m)")
    own_up = read_up(path, f"{where}.up", settings.get("up", up))
    return User(
        name,
        static,
        antennas=antennas,
        up=own_up,
        position=position,
        range_bias=None if bias is None else float(bias),
        **sigmas,
    )


def _sigma(path: str | Path, where: str, name: str, settings: Mapping[str, Any]) -> float | None:
    value = settings.get(name)
    if value is not None and not (_is_length(value) and value >= MIN_SIGMA):
        raise InputError(path, f"{where}.{name} must be a number between {MIN_SIGMA:g} and {MAX_LENGTH:g} (m)")
    return None if value is None else float(value)


def _lever(path: str | Path, where: str, antenna: str, lever: object) -> tuple[float, float, float]:
    if not is_name(antenna):
        raise InputError(path, f"{where}.antennas: {quoted(antenna)} cannot be the name of an antenna")
    return _three(path, f"{where}.antennas.{antenna}", lever)


def _three(path: str | Path, where: str, value: object, most: float = MAX_LENGTH) -> tuple[float, float, float]:
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if not (isinstance(value, list | tuple) and len(value) == 3 and all(_is_length(x, most) for x in value)):
        raise InputError(path, f"{where} must be three numbers, [x, y, z] in m")
    x, y, z = value
    return float(x), float(y), float(z)


def read_up(path: str | Path, where: str, value: object) -> Up:
    """The vertical axis in a setting. Raises InputError for anything but z and y."""
    if value == "z":
        return "z"
    if value == "y":
        return "y"
    raise InputError(path, f'{where} must be "z" or "y"')


def _is_length(value: object, most: float = MAX_LENGTH) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= most


def _table(path: str | Path, where: str, value: object) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(path, f"{where} must be a table")
    return dict(value)


def _note_unknown(
    path: str | Path, where: str, table: Mapping[str, object], known: Sequence[str], unknown: list[str] | None
) -> None:
    for key in table:
        if key in known:
            continue
        if unknown is not None:
            unknown.append(f"{where}.{key}" if where else key)
        else:
            place = f"{where} has" if where else "there is"
            raise InputError(path, f"{place} no setting {quoted(key)}; there are {', '.join(known)}")


def _key(name: str) -> str:
    """The name as a quoted key; JSON and TOML quote printable text alike."""
    return json.dumps(name, ensure_ascii=False)
