"""The answer on paper: registration.json, the tracks in the common frame, each range's verdict, a table to read."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from synchronizar.data.findings import finding_json
from synchronizar.data.recording import Recording
from synchronizar.data.registration import RangeVerdicts, Registration, State, UserRegistration
from synchronizar.data.updates import Replay
from synchronizar.errors import os_faults
from synchronizar.geometry import YawFrame
from synchronizar.io.json_values import PLACE, covariance_json, frame_json, number_json
from synchronizar.io.tum import write_tum
from synchronizar.io.updates_jsonl import UPDATES_FILE, write_updates

RANGE_COLUMNS = ("t", "a", "b", "range", "residual", "weight", "verdict")


def registration_json(registration: Registration) -> dict[str, Any]:
    """What registration.json holds: m, rad, s; None for every number that there is not."""
    static = {name for name, user in registration.users.items() if user.static}
    return {
        "reference": registration.reference,
        "model": registration.model,
        "method": registration.method,
        "users": {name: _user_json(user) for name, user in registration.users.items()},
        "alternatives": [
            {
                "cost": number_json(alternative.cost),
                "users": {name: frame_json(f, name in static) for name, f in alternative.common_from_user.items()},
            }
            for alternative in registration.alternatives
        ],
        "ranges": range_counts(registration.ranges),
        "findings": [finding_json(finding) for finding in registration.findings],
        "seconds": dict(registration.seconds),
    }


def write_registration(registration: Registration, recording: Recording, out_dir: str | Path) -> None:
    """Write registration.json, ranges.csv, and <user>.tum for every user that has a placement.

    ranges.csv has a line for each range of the recording, in its order: residual in m (blank where there is none),
    weight in 1/m^2, and whether it was used, rejected or unusable. An earlier answer is replaced; tracks of users who
    are not in this one are removed. Raises InputError where something cannot be written.
    """
    folder = Path(out_dir)
    with os_faults(folder):
        folder.mkdir(parents=True, exist_ok=True)
    tracks = registration.tracks(recording)
    earlier = {file.stem for file in folder.glob("[!.]*.tum")} if (folder / "registration.json").exists() else set()
    for name in sorted((earlier | registration.users.keys()) - tracks.keys()):
        with os_faults(folder / f"{name}.tum"):
            (folder / f"{name}.tum").unlink(missing_ok=True)
    for name, track in tracks.items():
        write_tum(folder / f"{name}.tum", track)
    with os_faults(folder / UPDATES_FILE):
        (folder / UPDATES_FILE).unlink(missing_ok=True)
    _write_ranges(folder / "ranges.csv", registration.ranges, recording)
    file = folder / "registration.json"
    with os_faults(file):
        file.write_text(json.dumps(registration_json(registration), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def write_replay(replayed: Replay, recording: Recording, out_dir: str | Path) -> None:
    """The registration at the end, tracks as they were known at each pose's own moment, and updates.jsonl.

    A user that was never registered has no track. Raises InputError where something cannot be written.
    """
    write_registration(replayed.registration, recording, out_dir)
    folder = Path(out_dir)
    last = replayed.registration.users
    ever = {
        name for update in replayed.updates for name, user in update.users.items() if user.state is State.REGISTERED
    }
    for name in last:
        if name not in replayed.tracks and not (last[name].static and name in ever):
            with os_faults(folder / f"{name}.tum"):
                (folder / f"{name}.tum").unlink(missing_ok=True)
    write_updates(folder / UPDATES_FILE, replayed.updates, replayed.registration.reference)


def range_counts(verdicts: RangeVerdicts) -> dict[str, int]:
    """How many ranges were used, rejected and unusable."""
    return {
        "used": int(verdicts.used.sum()),
        "rejected": int((verdicts.usable & ~verdicts.used).sum()),
        "unusable": int((~verdicts.usable).sum()),
    }


def _write_ranges(file: Path, verdicts: RangeVerdicts, recording: Recording) -> None:
    names = np.array([user.name for user in recording.users], dtype=object)
    ranges = recording.ranges
    columns = (
        ranges.t,
        names[ranges.a],
        names[ranges.b],
        ranges.distance,
        np.where(np.isnan(verdicts.residual), "", verdicts.residual.astype(object)),
        verdicts.weight,
        np.select([verdicts.used, verdicts.usable], ["used", "rejected"], default="unusable"),
    )
    with os_faults(file), file.open("w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(RANGE_COLUMNS)
        writer.writerows(zip(*(column.tolist() for column in columns), strict=True))


def _user_json(user: UserRegistration) -> dict[str, Any]:
    frame = user.common_from_user
    out: dict[str, Any] = {"state": str(user.state), "reason": user.reason}
    out |= frame_json(frame, user.static)
    out |= {
        "covariance": covariance_json(user.covariance),
        "scale": 1.0 if frame is None else frame.scale,
        "matrix": None if frame is None else _matrix(frame, user.static),
        "range_bias": user.range_bias,
        "clock_offset": user.clock_offset,
        "sigma": None
        if user.calibration_sigma is None
        else {k: number_json(v) for k, v in user.calibration_sigma._asdict().items()},
        "slam_noise": None
        if user.slam_noise is None
        else dict(zip(("place", "heading"), user.slam_noise, strict=True)),
        "prior_dominated": list(user.prior_dominated),
        "jumps": [{"t": j.t, "distance": j.distance, "turn": j.turn, "tilt": j.tilt} for j in user.jumps],
    }
    if user.state is State.UNOBSERVABLE and user.unseen_direction is not None:
        out["unseen_direction"] = dict(zip(PLACE, map(number_json, user.unseen_direction), strict=True))
    return out


def _matrix(frame: YawFrame, static: bool) -> list[list[float]]:
    """4x4, row by row; a static radio is not turned."""
    rows: list[list[float]] = (replace(frame, yaw=0.0) if static else frame).matrix.tolist()
    return rows
