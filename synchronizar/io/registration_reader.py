"""Reads what `registration_folder` writes about a recording: registration.json, ranges.csv and the users' tracks."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from synchronizar.data.findings import Code, Finding
from synchronizar.data.jump import Jump
from synchronizar.data.recording import Recording
from synchronizar.data.registration import (
    Alternative,
    CalibrationSigma,
    RangeVerdicts,
    Registration,
    State,
    UserRegistration,
)
from synchronizar.data.survey import SURVEY
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.errors import InputError, os_faults
from synchronizar.io.json_values import (
    MALFORMED,
    PLACE,
    read_covariance,
    read_finite,
    read_frame,
    read_number,
    read_numbers,
)
from synchronizar.io.registration_folder import RANGE_COLUMNS
from synchronizar.io.text import open_text
from synchronizar.io.tum import read_tum

STAMPS_AGREE_S = 1e-6
"""Tracks are written to a nanosecond; a number of seconds since 1970 is not finer than 0.2 microseconds."""


def read_registration(
    folder: Path, recording: Recording, causal: bool = False
) -> tuple[Registration, dict[str, Track]]:
    """The registration of a recording that `register --out` wrote, and the tracks beside it.

    Tracks are those of every user that has a placement, in the common frame, at its own stamps; a static radio's has
    one pose. `causal`: `replay --out` wrote it, whose tracks are of those poses at whose moments their users were
    registered. Raises InputError where a file cannot be read, is broken, or is about another recording.
    """
    file = folder / "registration.json"
    with os_faults(file, f"`synchronizar register RECORDING --out {folder}` writes it"):
        text = file.read_bytes()
    try:
        values = json.loads(text)
        names = set(values["users"])
    except MALFORMED as error:
        raise InputError(file, "is no registration") from error
    if names != {user.name for user in recording.users}:
        raise InputError(file, "is about another recording: its users are not the same")
    verdicts = _read_verdicts(folder / "ranges.csv", len(recording.ranges))
    try:
        registration = _registration(values, recording, verdicts)
    except MALFORMED as error:
        raise InputError(file, "is no registration") from error
    tracks = {
        name: _read_track(folder / f"{name}.tum", None if causal else recording.tracks.get(name), causal)
        for name, user in registration.users.items()
        if user.common_from_user is not None and not (causal and not (folder / f"{name}.tum").exists())
    }
    return registration, tracks


class Reference(NamedTuple):
    """Whose frame a common frame is."""

    name: str
    is_survey: bool
    """Whether it is no user's, but that of a survey."""


def read_reference(file: Path) -> Reference | None:
    """The reference in a registration.json; None where there is none. Raises InputError where it cannot be read."""
    with os_faults(file):
        text = file.read_bytes()
    try:
        values = json.loads(text)
        reference = values["reference"]
        is_survey = reference == SURVEY and SURVEY not in values.get("users", {})
    except MALFORMED as error:
        raise InputError(file, "is no registration that names its reference") from error
    return None if reference is None else Reference(str(reference), is_survey)


def _read_track(file: Path, slam: Track | None, any_stamps: bool) -> Track:
    """The track in a file; its stamps must be those of SLAM's own track, or 0 for a static radio."""
    track = read_tum(file)
    if any_stamps:
        return track
    t = np.zeros(1) if slam is None else slam.t
    if len(track) != len(t) or np.abs(track.t - t).max() > STAMPS_AGREE_S:
        raise InputError(file, "is about another recording: its stamps are not those of the user's own track")
    return track


def _registration(values: Mapping[str, Any], recording: Recording, verdicts: RangeVerdicts) -> Registration:
    has_covariances = values["method"] != "pairwise"
    by_name = {user.name: user for user in recording.users}
    return Registration(
        reference=None if values["reference"] is None else str(values["reference"]),
        model=str(values["model"]),
        method=str(values["method"]),
        users={
            user.name: _user(user, recording.tracks.get(user.name), values["users"][user.name], has_covariances)
            for user in recording.users
        },
        alternatives=tuple(
            Alternative(
                read_number(other["cost"]),
                {name: read_frame(frame, by_name[name]) for name, frame in other["users"].items()},
            )
            for other in values["alternatives"]
        ),
        ranges=verdicts,
        seconds={stage: read_number(seconds) for stage, seconds in values["seconds"].items()},
        findings=tuple(_finding(finding) for finding in values["findings"]),
    )


def _finding(values: Mapping[str, Any]) -> Finding:
    user = values["user"]
    return Finding(
        Code(values["code"]), None if user is None else str(user), str(values["message"]), str(values["remedy"])
    )


def _user(user: User, slam: Track | None, values: Mapping[str, Any], has_covariances: bool) -> UserRegistration:
    """One user's part; a user without a track is a static radio. Who is disconnected has neither frame nor covariance.

    `has_covariances`: whether the method gives every frame its covariance.
    """
    state, covariance, unseen = State(values["state"]), values["covariance"], values.get("unseen_direction")
    connected = state is not State.DISCONNECTED
    if (values["x"] is not None) != connected or (covariance is not None) != (connected and has_covariances):
        raise ValueError(state)
    sigma, clock_offset, noise = values["sigma"], values["clock_offset"], values["slam_noise"]
    return UserRegistration(
        name=user.name,
        state=state,
        reason=str(values["reason"]),
        common_from_user=None if values["x"] is None else read_frame(values, user, read_finite(values["scale"])),
        covariance=read_covariance(covariance),
        static=slam is None,
        unseen_direction=None if unseen is None else read_numbers([unseen[name] for name in PLACE]),
        prior_dominated=tuple(map(str, values["prior_dominated"])),
        range_bias=read_finite(values["range_bias"]),
        clock_offset=None if slam is None and clock_offset is None else read_finite(clock_offset),
        calibration_sigma=None
        if sigma is None
        else CalibrationSigma(*(read_number(sigma[name]) for name in CalibrationSigma._fields)),
        slam_noise=None if noise is None else (read_finite(noise["place"]), read_finite(noise["heading"])),
        jumps=tuple(_jump(jump, slam) for jump in values["jumps"]),
    )


def _jump(values: Mapping[str, Any], slam: Track | None) -> Jump:
    """One jump; it must lead to a pose of SLAM's own track."""
    t, distance, turn, tilt = (read_finite(values[name]) for name in ("t", "distance", "turn", "tilt"))
    if slam is None:
        raise ValueError(values)
    pose = int(np.argmin(np.abs(slam.t - t)))
    if abs(slam.t[pose] - t) > STAMPS_AGREE_S:
        raise ValueError(values)
    return Jump(t, pose, distance, turn, tilt)


def _read_verdicts(file: Path, count: int) -> RangeVerdicts:
    """The verdicts on `count` ranges, in their order."""
    with os_faults(file), open_text(file) as lines:
        try:
            header, *rows = csv.reader(lines, strict=True)
            if tuple(header) != RANGE_COLUMNS:
                raise ValueError(header)
            columns = dict(zip(RANGE_COLUMNS, zip(*rows, strict=True) if rows else [()] * len(header), strict=True))
            verdict = np.array(columns["verdict"], dtype=str)
            weight = np.array(columns["weight"], dtype=float)
            residual = np.array([text or "nan" for text in columns["residual"]], dtype=float)
            if not np.isfinite(residual[verdict != "unusable"]).all():
                raise ValueError(residual)
        except (ValueError, csv.Error) as error:
            raise InputError(file, f"is not the table of {','.join(RANGE_COLUMNS)} that register writes") from error
    if len(verdict) != count:
        raise InputError(file, f"is about another recording: it has {len(verdict)} ranges, the recording {count}")
    return RangeVerdicts(verdict != "unusable", verdict == "used", weight, residual)
