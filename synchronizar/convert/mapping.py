"""What a user says of topics, fields, columns and radios: a TOML file, and the same in options.

types = "msgs/"                        # folder of .msg files, for a bag that does not have them

[topics."/uwb/ranges"]
range = "nodes[].dis"                  # path of a field; [] for each item of a list
a = "alice"                            # a field's path, or a name
b = "nodes[].id"
unit = "mm"
time = "log"                           # a field's path, `header` or `log`

[topics."/alice/odom"]
pose = "pose.pose"                     # position and orientation below it
user = "alice"

[topics."/mocap/alice"]
truth = "pose"
user = "alice"

[topics."/noise"]
skip = true

[radios.10]                            # whose a radio is, and which of its antennas
user = "alice"
antenna = "0"
lever = [0.1, 0.0, 0.05]               # m, in alice's body axes

[radios.A1]                            # one that stands still, and was surveyed
position = [0.0, 4.0, 2.5]             # m, z up
position_sigma = 0.05

[robots.alice]                         # of `synchronizar ros` alone: settings as in recording.toml, frame, tf
height_sigma = 0.1

[columns]                              # of a csv: t, user, x y z, qx qy qz qw | qw .. | yaw, or t, a, b, range, ...
t = "timestamp"
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any

from synchronizar.convert.asked import LENGTH_UNITS, Asked
from synchronizar.errors import InputError, os_faults
from synchronizar.io.text import MAX_LENGTH, MIN_SIGMA, quoted

_RADIO_KEYS = ("user", "antenna", "lever", "position", "position_sigma")
TABLES = ("topics", "radios", "columns", "types", "robots")
"""Of a map; `robots` is read by the bridge to ROS."""
TOPIC_KEYS = (
    *("pose", "truth", "tf", "range", "skip"),
    *("user", "a", "b", "time", "unit", "sigma", "rx_power", "fp_power", "nlos", "antenna_a", "antenna_b"),
)


@dataclass(frozen=True)
class Radio:
    """Whose a radio is."""

    user: str
    antenna: str = ""
    lever: tuple[float, float, float] | None = None
    """m, in the user's body axes."""
    position: tuple[float, float, float] | None = None
    """m, z up: where one that stands still was surveyed to be."""
    position_sigma: float | None = None
    """m, 1 sigma of that; None: the model's default."""


@dataclass(frozen=True)
class Mapped:
    """What was said."""

    topics: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    radios: Mapping[str, Radio] = field(default_factory=dict)
    columns: Mapping[str, str] = field(default_factory=dict)
    types: tuple[Path, ...] = ()


def mapped(asked: Asked) -> Mapped:
    """What the map and the options say together, options before the map. Raises InputError for what is not known."""
    table = table_of(asked)
    place = "--map" if asked.map is None else str(asked.map)
    for key in table:
        if key not in TABLES:
            raise InputError(place, f"there is no setting {quoted(key)}: there are {', '.join(TABLES)}")
    topics = {name: _topic(place, f"topics.{name}", of) for name, of in _table(place, table, "topics").items()}
    topics |= dict(_option(text) for text in asked.topics)
    radios = {str(name): _radio(place, str(name), of) for name, of in _table(place, table, "radios").items()}
    columns = {str(name): str(of) for name, of in _table(place, table, "columns").items()} | dict(asked.columns)
    types = table.get("types", [])
    folders = [types] if isinstance(types, str) else types
    if not isinstance(folders, list) or not all(isinstance(folder, str) for folder in folders):
        raise InputError(place, "types must be a folder of .msg files, or a list of them")
    base = Path() if asked.map is None else asked.map.parent
    return Mapped(topics, radios, columns, tuple(base / folder for folder in folders))


def table_of(asked: Asked) -> dict[str, Any]:
    """The map as TOML has it; empty where there is none. Raises InputError where it cannot be read."""
    return {} if asked.map is None else _parsed(asked.map)


def _parsed(path: Path) -> dict[str, Any]:
    with os_faults(path):
        data = path.read_bytes()
    try:
        return tomllib.loads(data.decode("utf-8-sig"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(path, f"is no TOML: {error}") from error


def _table(place: str, table: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    of = table.get(name, {})
    if not isinstance(of, Mapping):
        raise InputError(place, f"{name} must be a table")
    return of


def _topic(place: str, where: str, settings: Any) -> dict[str, str]:
    if not isinstance(settings, Mapping):
        raise InputError(place, f"{where} must be a table of {', '.join(TOPIC_KEYS)}")
    for key, value in settings.items():
        if key not in TOPIC_KEYS:
            raise InputError(place, f"{where} has no setting {quoted(key)}: there are {', '.join(TOPIC_KEYS)}")
        if key == "unit" and value not in LENGTH_UNITS:
            raise InputError(place, f"{where}.unit is {quoted(str(value))}: there are {', '.join(LENGTH_UNITS)}")
    return {key: str(value) for key, value in settings.items()}


def _option(text: str) -> tuple[str, dict[str, str]]:
    words = text.split()
    if not words:
        raise InputError("--topic", "names no topic")
    name, pairs = words[0], words[1:]
    settings: dict[str, str] = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if key in ("skip", "tf") and not equals:
            value = "true"
        elif not value:
            raise InputError("--topic", f"{quoted(pair)} is not KEY=VALUE")
        settings[key] = value
    return name, _topic("--topic", name, settings)


def _radio(place: str, name: str, settings: Any) -> Radio:
    if isinstance(settings, str):
        return Radio(settings)
    keys = set(settings) if isinstance(settings, Mapping) else set()
    if keys - set(_RADIO_KEYS) or not keys & {"user", "position"}:
        raise InputError(place, f"radios.{name} must be a user's name, or some of {', '.join(_RADIO_KEYS)}")
    lever, position = (_three(place, f"radios.{name}", key, settings) for key in ("lever", "position"))
    if position is not None and lever is not None:
        raise InputError(place, f"radios.{name} cannot have both: a lever is a moving device's, a position is not")
    sigma = settings.get("position_sigma")
    if sigma is not None and not (_is_number(sigma) and position is not None and MIN_SIGMA <= sigma <= MAX_LENGTH):
        raise InputError(place, f"radios.{name}.position_sigma must be a positive number, of a position (m)")
    antenna = str(settings.get("antenna", "0" if lever is not None else ""))
    return Radio(str(settings.get("user", name)), antenna, lever, position, sigma)


def _three(place: str, where: str, key: str, settings: Mapping[str, Any]) -> tuple[float, float, float] | None:
    value = settings.get(key)
    if value is None:
        return None
    good = isinstance(value, Sequence) and len(value) == 3 and all(map(_is_number, value))
    if not good or max(map(abs, value)) > MAX_LENGTH:
        raise InputError(place, f"{where}.{key} must be three numbers, [x, y, z] in m")
    return float(value[0]), float(value[1]), float(value[2])


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)
