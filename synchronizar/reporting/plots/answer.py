"""The answer to a recording, read from where `register --out` wrote it."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synchronizar.arrays import Array
from synchronizar.data.jump import Jump
from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.registration import (
    Alternative,
    CalibrationSigma,
    RangeVerdicts,
    Registration,
    State,
    UserRegistration,
)
from synchronizar.data.track import Track
from synchronizar.errors import InputError, os_faults
from synchronizar.geometry import YawFrame
from synchronizar.io.registration_folder import PLACE, RANGE_COLUMNS
from synchronizar.io.text import open_text
from synchronizar.io.tum import read_tum

# What is raised by JSON that is broken, or that lacks something, or has something else in its place.
MALFORMED = (ValueError, OverflowError, RecursionError, KeyError, TypeError, AttributeError)
STAMPS_AGREE_S = 1e-6
"""Tracks are written to a nanosecond; a number of seconds since 1970 is not finer than 0.2 microseconds."""


@dataclass(frozen=True)
class Answer:
    """A registration and what it is about."""

    registration: Registration
    tracks: Mapping[str, Track]
    """Of every user that has a placement, in the common frame, at its own stamps; one pose for a static radio."""
    slam: Mapping[str, Track]
    """Of every user that is not static, in its own frame: its poses as SLAM gave them."""
    ranges: Ranges

    @property
    def names(self) -> list[str]:
        """All users in the order that the ranges count them."""
        return list(self.registration.users)

    @property
    def reference(self) -> str:
        """Whose frame the common one is; blank where nobody's is."""
        return self.registration.reference or ""

    @property
    def corrects_slam(self) -> bool:
        """Whether the answer takes SLAM to drift and jump, and devices to have a scale, a bias and a clock."""
        return self.registration.model == "full"

    @property
    def moving(self) -> list[str]:
        """Users that have a placement and walk."""
        return [name for name in self.tracks if not self.registration.users[name].static]

    @property
    def began(self) -> float:
        """s, range clock: where axes of time begin: the first range, or the first pose where there is none."""
        if len(self.ranges):
            return float(self.ranges.t.min())
        return min((float(self.tracks[name].t[0]) - self.clock_offset(name) for name in self.moving), default=0.0)

    def clock_offset(self, name: str) -> float:
        """s: the user's own stamp minus the range stamp of the same event; 0 for a static radio."""
        return self.registration.users[name].clock_offset or 0.0

    def elapsed(self, name: str, t: Array) -> Array:
        """(n,) s since `began`, from the user's own stamps (n,)."""
        return np.asarray(t - self.clock_offset(name) - self.began)

    def ends(self, rows: NDArray[np.intp]) -> Array:
        """(n, 2, 3) m: where in the common frame the two devices were at some of the ranges; NaN where unknown."""
        t = self.ranges.t[rows]
        places = np.full((len(rows), 2, 3), np.nan)
        for index, name in enumerate(self.names):
            track = self.tracks.get(name)
            if track is None:
                continue
            for end, who in enumerate((self.ranges.a[rows], self.ranges.b[rows])):
                mine = np.flatnonzero(who == index)
                if self.registration.users[name].static:
                    places[mine, end] = track.position[0]
                else:
                    poses = track.at(t[mine] + self.clock_offset(name), np.inf)
                    places[mine[poses.valid], end] = poses.position[poses.valid]
        return places


def read_answer(folder: Path, recording: Recording) -> Answer:
    """What `register --out` wrote about a recording.

    Raises InputError where a file is missing or broken, or is about another recording.
    """
    file = folder / "registration.json"
    with os_faults(file):
        text = file.read_bytes()
    try:
        said = json.loads(text)
        told = set(said["users"])
    except MALFORMED as error:
        raise InputError(file, "is no registration") from error
    if told != {user.name for user in recording.users}:
        raise InputError(file, "is about another recording: its users are not the same")
    verdicts = _read_verdicts(folder / "ranges.csv", len(recording.ranges))
    try:
        registration = _registration(said, recording, verdicts)
    except MALFORMED as error:
        raise InputError(file, "is no registration") from error
    tracks = {
        name: _read_track(folder / f"{name}.tum", recording.tracks.get(name))
        for name, user in registration.users.items()
        if user.common_from_user is not None
    }
    return Answer(registration, tracks, recording.tracks, recording.ranges)


def _read_track(file: Path, slam: Track | None) -> Track:
    track = read_tum(file)
    t = np.zeros(1) if slam is None else slam.t
    if len(track) != len(t) or np.abs(track.t - t).max() > STAMPS_AGREE_S:
        raise InputError(file, "is about another recording: its stamps are not those of the user's own track")
    return track


def _registration(said: Mapping[str, Any], recording: Recording, verdicts: RangeVerdicts) -> Registration:
    return Registration(
        reference=str(said["reference"]),
        model=str(said["model"]),
        method=str(said["method"]),
        users={
            user.name: _user(
                user.name, recording.tracks.get(user.name), said["users"][user.name], said["method"] != "pairwise"
            )
            for user in recording.users
        },
        alternatives=tuple(
            Alternative(_number(other["cost"]), {name: _frame(place, 1.0) for name, place in other["users"].items()})
            for other in said["alternatives"]
        ),
        ranges=verdicts,
        seconds={stage: _number(seconds) for stage, seconds in said["seconds"].items()},
    )


def _user(name: str, slam: Track | None, said: Mapping[str, Any], sure: bool) -> UserRegistration:
    """What is said of a user; one without a track is a static radio. `sure`: who is placed has a covariance."""
    state, covariance, unseen = State(said["state"]), said["covariance"], said.get("unseen_direction")
    placed = state is not State.DISCONNECTED
    if (said["x"] is not None) != placed or (covariance is not None) != (placed and sure):
        raise ValueError(state)
    sigma, clock_offset, noise = said["sigma"], said["clock_offset"], said["slam_noise"]
    return UserRegistration(
        name=name,
        state=state,
        reason=str(said["reason"]),
        common_from_user=None if said["x"] is None else _frame(said, _finite(said["scale"])),
        covariance=None if covariance is None else _numbers([x for row in covariance for x in row]).reshape(4, 4),
        static=slam is None,
        unseen_direction=None if unseen is None else _numbers([unseen[name] for name in PLACE]),
        prior_dominated=tuple(map(str, said["prior_dominated"])),
        range_bias=_finite(said["range_bias"]),
        clock_offset=None if slam is None and clock_offset is None else _finite(clock_offset),
        calibration_sigma=None
        if sigma is None
        else CalibrationSigma(*(_number(sigma[name]) for name in CalibrationSigma._fields)),
        slam_noise=None if noise is None else (_finite(noise["place"]), _finite(noise["heading"])),
        jumps=tuple(_jump(jump, slam) for jump in said["jumps"]),
    )


def _jump(said: Mapping[str, Any], slam: Track | None) -> Jump:
    """A jump leads to a pose of SLAM's own track."""
    t, distance, turn, tilt = (_finite(said[name]) for name in ("t", "distance", "turn", "tilt"))
    if slam is None:
        raise ValueError(said)
    pose = int(np.argmin(np.abs(slam.t - t)))
    if abs(slam.t[pose] - t) > STAMPS_AGREE_S:
        raise ValueError(said)
    return Jump(t, pose, distance, turn, tilt)


def _frame(place: Mapping[str, Any], scale: float) -> YawFrame:
    """A static radio has no yaw: its frame is not turned."""
    x, y, z = (_finite(place[name]) for name in PLACE[:3])
    if scale <= 0.0:
        raise ValueError(scale)
    return YawFrame(x, y, z, _finite(place["yaw"] or 0.0), scale)


def _numbers(said: list[Any]) -> Array:
    return np.array([_number(x) for x in said])


def _finite(said: Any) -> float:
    number = float(said)
    if not np.isfinite(number):
        raise ValueError(said)
    return number


def _number(said: Any) -> float:
    """NaN where there is none."""
    return np.nan if said is None else float(said)


def _read_verdicts(file: Path, count: int) -> RangeVerdicts:
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
