"""What was recorded after the solver's state was last written, to be said to it again."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from synchronizar.errors import InputError
from synchronizar.io.ranges_csv import OPTIONAL, REQUIRED
from synchronizar.live.recorder import RESUME_FILE, STATE_FILE, recorded_name
from synchronizar.live.roster import KnownDevice
from synchronizar.live.solver_wire import AddUser, Advance, Begin, Command, NewFrame, Pose, Range

_STEP_S = 0.1


def begin_again(folder: Path, workers: int, sizes: Mapping[str, int]) -> tuple[Begin, dict[str, int]]:
    """How the solver begins, and the bytes of each file that its state knows already; `sizes`: of all files now.

    A state may know more than was written before the server was killed: what comes from now on is news to it.
    """
    state = folder / STATE_FILE
    try:
        noted = json.loads((folder / RESUME_FILE).read_text(encoding="utf-8"))
        offsets = {str(name): min(int(size), sizes.get(str(name), 0)) for name, size in noted["offsets"].items()}
        frames = {str(name): int(frame) for name, frame in noted["frames"].items()}
    except (OSError, ValueError, KeyError, AttributeError, TypeError):
        return Begin(workers), {}
    return (Begin(workers, state=str(state), frames=frames), offsets) if state.exists() else (Begin(workers), {})


def tail(folder: Path, devices: list[KnownDevice], begin: Begin, offsets: Mapping[str, int]) -> Iterator[Command]:
    """Everything that came after these bytes, in the order of time, and ten times a second of it to go on.

    Raises InputError where a file cannot be read.
    """
    users = {recorded_name(known.settings.name, known.session): known.settings.name for known in devices}
    said: list[tuple[float, Command]] = []
    for recorded, name in users.items():
        file = f"tracks/{recorded}.tum"
        said += _poses(folder / file, offsets.get(file, 0), name)
    said += _ranges(folder / "ranges.csv", offsets.get("ranges.csv", 0), users)
    said.sort(key=lambda one: one[0])
    for known in devices:
        yield AddUser(known.settings)
    for known in devices:
        if begin.state is not None and begin.frames.get(known.settings.name, 0) != known.frame:
            yield NewFrame(known.settings.name, known.frame)
    due = None
    for t, command in said:
        if due is None:
            due = t + _STEP_S
        if t >= due:
            yield Advance(t)
            due = t + _STEP_S
        yield command


def _poses(path: Path, offset: int, user: str) -> Iterator[tuple[float, Command]]:
    for line in _lines(path, offset):
        t, x, y, z, qx, qy, qz, qw = map(float, line.split())
        yield t, Pose(user, t, (x, y, z), (qx, qy, qz, qw))


def _ranges(path: Path, offset: int, users: Mapping[str, str]) -> Iterator[tuple[float, Command]]:
    rows = csv.reader(_lines(path, offset))
    columns = REQUIRED + OPTIONAL
    for row in rows:
        if row == list(columns):
            continue
        values = dict(zip(columns, row, strict=True))
        if values["a"] not in users or values["b"] not in users:
            continue  # of a frame that has ended
        t, distance = float(values["t"]), float(values["range"])
        optional = {name: _value(name, values[name]) for name in OPTIONAL if values[name] != ""}
        yield t, Range(t, users[values["a"]], users[values["b"]], distance, optional)


def _value(column: str, text: str) -> Any:
    return text if column in ("antenna_a", "antenna_b", "source") else float(text)


def _lines(path: Path, offset: int) -> io.StringIO | list[str]:
    """Whole lines from a byte on; whoever was killed while it wrote left half a line."""
    try:
        with path.open("rb") as file:
            file.seek(offset)
            data = file.read()
    except FileNotFoundError:
        return []
    except OSError as error:
        raise InputError(path, error.strerror or str(error)) from error
    return io.StringIO(data[: data.rfind(b"\n") + 1].decode("utf-8"))
