"""What the bridge is asked to do: options of the command, and the table `robots` of a map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any
from urllib.parse import urlsplit

import msgspec
import numpy as np

from synchronizar.arrays import Array
from synchronizar.convert.asked import Asked
from synchronizar.convert.axes import axes_matrix, axes_named
from synchronizar.convert.mapping import Mapped, mapped, table_of
from synchronizar.convert.tf_out import COMMON
from synchronizar.convert.track_file import poses_as_asked
from synchronizar.errors import InputError
from synchronizar.io.text import is_name, quoted
from synchronizar.live import messages as m

_OWN_KEYS = ("frame", "tf")


@dataclass(frozen=True)
class RobotSettings:
    """What is said of one robot, or of a radio that stands still."""

    room: Mapping[str, Any] = field(default_factory=dict)
    """As in recording.toml: what its room is told."""
    frame: str | None = None
    """The frame of its odometry; None: as its messages have it."""
    tf: str | None = None
    """Topic of its transforms; None: `tf` in the namespace of its odometry where there is one, or /tf."""


@dataclass(frozen=True)
class BridgeOptions:
    """What `ros` was asked for. Raises InputError for what cannot be."""

    join: str
    bridges: Sequence[tuple[str | None, str]]
    """Addresses of rosbridges, and whose all tracks there are, where there is only one robot."""
    asked: Asked = field(default_factory=Asked)
    common: str = COMMON
    """Name of the common frame in TF."""
    simulated: bool = False
    """Whether stamps are a simulation's or a bag's, and the room's time goes by them."""

    def __post_init__(self) -> None:
        for _, address in self.bridges:
            if urlsplit(address).scheme not in ("ws", "wss") or not urlsplit(address).hostname:
                raise InputError(address, "is no rosbridge's address; one looks like ws://robot:9090")
        addresses = [address for _, address in self.bridges]
        if len(set(addresses)) < len(addresses):
            raise InputError("--bridge", "one address is named twice")
        for name in (*(name for name, _ in self.bridges if name), *self.asked.static, *self.robots):
            if not is_name(name):
                raise InputError("--bridge", f"{quoted(name)} cannot be a device's name")
        self.own_from_ros  # noqa: B018  (faults of axes are told now)

    @cached_property
    def said(self) -> Mapped:
        """What the map and options say of topics and radios."""
        return mapped(self.asked)

    @cached_property
    def robots(self) -> dict[str, RobotSettings]:
        """By name; those of --static, and of radios' levers, among them."""
        found = {}
        place, table = str(self.asked.map), table_of(self.asked).get("robots", {})
        if not isinstance(table, Mapping):
            raise InputError(place, "robots must be a table")
        for name, of in table.items():
            if not isinstance(of, Mapping):
                raise InputError(place, f"robots.{name} must be a table")
            found[name] = _settings(place, name, of)
        for name in self.asked.static:
            known = found.get(name, RobotSettings())
            found[name] = RobotSettings({**known.room, "static": True}, known.frame, known.tf)
        for radio in self.said.radios.values():
            if radio.lever is not None:
                known = found.get(radio.user, RobotSettings())
                antennas = {**known.room.get("antennas", {}), radio.antenna: radio.lever}
                found[radio.user] = RobotSettings({**known.room, "antennas": antennas}, known.frame, known.tf)
        return found

    @cached_property
    def own_from_ros(self) -> Array:
        """(3, 3): from axes of the robots' frames to those in which the room has them."""
        if self.asked.world is not None and np.linalg.det(axes_matrix(axes_named("--world", self.asked.world))) < 0.0:
            raise InputError("--world", "frames of ROS are right-handed")
        unit = np.column_stack([np.zeros(3), np.eye(3), np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))])
        return poses_as_asked(unit, self.asked, "flu", None).rows[:, 1:4].T


def _settings(place: str, name: str, of: Mapping[str, Any]) -> RobotSettings:
    room = {key: value for key, value in of.items() if key not in _OWN_KEYS}
    for key in _OWN_KEYS:
        if not isinstance(of.get(key, ""), str):
            raise InputError(place, f"robots.{name}.{key} must be a text")
    try:
        msgspec.convert({"name": name, **room}, m.UserSettings)
    except msgspec.ValidationError as error:
        raise InputError(place, f"robots.{name}: {error}") from error
    return RobotSettings(room, of.get("frame"), of.get("tf"))
