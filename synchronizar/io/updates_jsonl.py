"""A replay's updates as updates.jsonl, written and read: one JSON object a line, in the order of time; s, m, rad."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.data.updates import Update, UserUpdate
from synchronizar.data.user import User
from synchronizar.errors import InputError, os_faults
from synchronizar.io.json_values import (
    MALFORMED,
    covariance_json,
    frame_json,
    read_covariance,
    read_finite,
    read_frame,
)
from synchronizar.io.text import open_text

UPDATES_FILE = "updates.jsonl"
"""Its name in the folder of an answer."""


def update_json(update: Update, reference: str | None) -> dict[str, Any]:
    """One line of the file as an object; None for each number that is not known."""
    return {
        "t": update.t,
        "update_ms": 1e3 * update.seconds,
        "reference": reference,
        "users": {name: _user_json(user) for name, user in update.users.items()},
        "events": update.events,
    }


def write_updates(file: Path, updates: Iterable[Update], reference: str | None) -> None:
    """Write a line for each update. Raises InputError where the file cannot be written."""
    with os_faults(file), file.open("w", encoding="utf-8", newline="") as out:
        for update in updates:
            out.write(json.dumps(update_json(update, reference), allow_nan=False) + "\n")


def read_updates(file: Path, recording: Recording) -> list[Update]:
    """The updates of a replay of the recording, in the order of time.

    Raises InputError where the file cannot be read, a line is no update or not later than the one before, or its users
    are not the recording's.
    """
    by_name = {user.name: user for user in recording.users}
    updates: list[Update] = []
    with os_faults(file), open_text(file) as lines:
        for number, text in enumerate(lines, start=1):
            try:
                update = _update(json.loads(text), by_name)
                if update is not None and updates and update.t <= updates[-1].t:
                    raise ValueError(update.t)
            except MALFORMED as error:
                raise InputError(file, "is no update of a replay", number) from error
            if update is None:
                raise InputError(file, "is about another recording: its users are not the same", number)
            updates.append(update)
    return updates


def _user_json(user: UserUpdate) -> dict[str, Any]:
    frame = user.common_from_user
    return {
        "state": str(user.state),
        **frame_json(frame, user.static),
        "covariance": covariance_json(user.covariance),
        "scale": 1.0 if frame is None else frame.scale,
        "progress": user.progress,
        "cue": user.cue,
    }


def _update(line: Mapping[str, Any], by_name: Mapping[str, User]) -> Update | None:
    """The update in a line; None where its users are not those `by_name`."""
    if line["users"].keys() != by_name.keys():
        return None
    return Update(
        t=read_finite(line["t"]),
        seconds=1e-3 * read_finite(line["update_ms"]),
        users={name: _user(user, by_name[name]) for name, user in line["users"].items()},
        events=[str(event) for event in line["events"]],
    )


def _user(values: Mapping[str, Any], user: User) -> UserUpdate:
    progress = read_finite(values["progress"])
    if not 0.0 <= progress <= 1.0:
        raise ValueError(progress)
    return UserUpdate(
        state=State(values["state"]),
        common_from_user=None if values["x"] is None else read_frame(values, user, read_finite(values["scale"])),
        covariance=read_covariance(values["covariance"]),
        progress=progress,
        static=user.static,
        cue=None if values["cue"] is None else str(values["cue"]),
    )
