"""What a recording says of its users: `up`, `static`, `height_sigma` and `antennas` in recording.toml."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from synchronizar.data.user import User
from synchronizar.errors import InputError, os_faults
from synchronizar.io.text import MAX_LENGTH, MIN_SIGMA, is_name, quoted
from synchronizar.io.tum import Up


@dataclass(frozen=True)
class Settings:
    """What is said of the users, and which axis of their tracks points up."""

    users: Mapping[str, User] = field(default_factory=dict)
    """Those that the file names."""
    up: Up = "z"
    up_of_user: Mapping[str, Up] = field(default_factory=dict)
    """Where a user's own differs from `up`, or may."""


def read_recording_toml(path: Path) -> Settings:
    """Read the settings. Raises InputError where the file cannot be read or says what cannot be meant."""
    table = _parse(path)
    _refuse_unknown(path, "", table, ("up", "users"))
    users = {}
    up_of_user = {}
    for name, settings in _table(path, "users", table.get("users", {})).items():
        where = f"users.{name}"
        if not is_name(name):
            raise InputError(path, f"{quoted(name)} cannot be the name of a user")
        settings = _table(path, where, settings)
        _refuse_unknown(path, where, settings, ("up", "static", "height_sigma", "antennas"))
        users[name] = _user(path, where, name, settings)
        if "up" in settings:
            up_of_user[name] = _up(path, f"{where}.up", settings["up"])
    return Settings(users, _up(path, "up", table.get("up", Settings.up)), up_of_user)


def write_recording_toml(path: Path, users: Iterable[User]) -> None:
    """Write what is known of the users besides their tracks, which are z up."""
    lines = ['up = "z"']
    for user in users:
        settings = []
        if user.static:
            settings.append("static = true")
        if user.height_sigma is not None:
            settings.append(f"height_sigma = {float(user.height_sigma)!r}")
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
        # A number of thousands of digits, tables nested a thousand deep.
        raise InputError(path, f"cannot be read: {error}") from error


def _user(path: Path, where: str, name: str, settings: dict[str, Any]) -> User:
    static = settings.get("static", False)
    if not isinstance(static, bool):
        raise InputError(path, f"{where}.static must be true or false")
    height_sigma = settings.get("height_sigma")
    if height_sigma is not None and not (_is_length(height_sigma) and height_sigma >= MIN_SIGMA):
        raise InputError(path, f"{where}.height_sigma must be a number between {MIN_SIGMA:g} and {MAX_LENGTH:g} (m)")
    levers = _table(path, f"{where}.antennas", settings.get("antennas", {}))
    if static and levers:
        raise InputError(path, f"{where} is static: without an attitude its antennas have no place")
    antennas = {antenna: _lever(path, where, antenna, lever) for antenna, lever in levers.items()}
    return User(name, static, None if height_sigma is None else float(height_sigma), antennas)


def _lever(path: Path, where: str, antenna: str, lever: object) -> tuple[float, float, float]:
    if not is_name(antenna):
        raise InputError(path, f"{where}.antennas: {quoted(antenna)} cannot be the name of an antenna")
    if not (isinstance(lever, list) and len(lever) == 3 and all(_is_length(x) for x in lever)):
        raise InputError(path, f"{where}.antennas.{antenna} must be three numbers, [x, y, z] in m")
    x, y, z = lever
    return float(x), float(y), float(z)


def _up(path: Path, where: str, value: object) -> Up:
    if value == "z":
        return "z"
    if value == "y":
        return "y"
    raise InputError(path, f'{where} must be "z" or "y"')


def _is_length(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= MAX_LENGTH


def _table(path: Path, where: str, value: object) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError(path, f"{where} must be a table")
    return value


def _refuse_unknown(path: Path, where: str, table: Mapping[str, object], known: Sequence[str]) -> None:
    for key in table:
        if key not in known:
            place = f"{where} has" if where else "there is"
            raise InputError(path, f"{place} no setting {quoted(key)}; there are {', '.join(known)}")


def _key(name: str) -> str:
    """A quoted key: of printable text, JSON and TOML make the same."""
    return json.dumps(name, ensure_ascii=False)
