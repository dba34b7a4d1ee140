"""What all files of one track have in common: whose it is, units and axes as asked."""

from __future__ import annotations

from synchronizar.arrays import Array
from synchronizar.convert.asked import LENGTH_UNITS, Asked
from synchronizar.convert.axes import axes_named, turned
from synchronizar.convert.imported import Imported
from synchronizar.data.user import User
from synchronizar.errors import InputError


def add_track(
    imported: Imported, name: str, rows: Array, asked: Asked, world: str = "flu", body: str | None = None
) -> None:
    """Take poses (n, 8) t x y z qx qy qz qw for a user's track; `world` and `body` are the format's own axes.

    Raises InputError where axes were asked for that do not go together.
    """
    user = asked.user or name
    if asked.length_unit not in (None, "m"):
        rows = rows.copy()
        rows[:, 1:4] *= LENGTH_UNITS[asked.length_unit or "m"]
    world = axes_named("--world", asked.world) if asked.world is not None else world
    body = axes_named("--body", asked.body) if asked.body is not None else body
    try:
        poses, up = turned(rows, world, body)
    except ValueError as error:
        raise InputError("--body", str(error)) from error
    imported.tracks[user] = poses
    imported.users[user] = User(user, up=up)
