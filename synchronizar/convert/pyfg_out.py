"""Writes a recording as a PyFG factor graph, which CORA and PyFactorGraph read.

| line | what |
|---|---|
| VERTEX_SE3:QUAT t A0 x y z qx qy qz qw | a device's antenna at the moment of a range; its first and last pose |
| VERTEX_XYZ L0 x y z | a static radio |
| VERTEX_XYZ:PRIOR t L0 x y z cov(6) | where it was surveyed to be |
| EDGE_SE3:QUAT t A0 A1 x y z qx qy qz qw cov(21) | what SLAM says of the way from one to the next |
| EDGE_RANGE t A0 L0 range variance | a range |

A is the first device by name that moves, B the second (the format keeps L for landmarks), L0 the first static radio.
All is in space, z up. The covariance of a step is that of this program's own model of SLAM's drift, the same along all
axes, since CORA takes one number for places and one for attitudes. A range has the variance that the recording gives
it, else the model's.

The format's vertices hold true values, which a recording does not have: they are SLAM's own poses. With an answer they
are the poses in the common frame, poses are read at the clock offsets that it found, and ranges that it rejected are
left out; their numbers stay as they were measured.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from string import ascii_lowercase, ascii_uppercase
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.data.exported import Exported
from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration
from synchronizar.data.track import Track
from synchronizar.errors import InputError, os_faults
from synchronizar.parameters import Parameters
from synchronizar.quaternions import inverse_quaternions, multiply_quaternions, rotate_by_quaternions

_LETTERS = [letter for letter in ascii_uppercase + ascii_lowercase if letter not in "Ll"]
_LEAST_VARIANCE = 1e-8
"""m^2 and rad^2: two antennas of one device at one moment have no noise between them, and a graph needs some."""


class _Chain(NamedTuple):
    """The n vertices of one device, in the order of time."""

    t: Array
    """(n,) s, range clock."""
    antenna: Array
    """(n,) index of the antenna."""
    position: Array
    """(n, 3) m: the antenna, in the frame of the device's SLAM."""
    quat_xyzw: Array
    """(n, 4)."""


def write_pyfg(path: Path, exported: Exported) -> None:
    """Write the file. Raises InputError where it cannot be written, or the format has no letter for so many devices."""
    recording, registration = exported.recording, exported.registration
    moving = [user.name for user in recording.users if not user.static]
    if len(moving) > len(_LETTERS):
        raise InputError(path, f"has letters for {len(_LETTERS)} devices that move, and these are {len(moving)}")
    letters = dict(zip(moving, _LETTERS, strict=False))
    offsets = {name: _clock_offset(registration, name) for name in moving}
    rows = _rows(recording, registration, offsets)
    ranges = recording.ranges.select(rows)
    chains = {name: _chain(recording, name, ranges, offsets[name]) for name in moving}
    with os_faults(path), path.open("w", encoding="utf-8", newline="\n") as file:
        for name, chain in chains.items():
            seen = _in_common(chain, exported.tracks.get(name), recording, name, offsets[name])
            file.writelines(_vertices(letters[name], seen))
        file.writelines(_landmarks(recording, exported.tracks))
        file.writelines(_priors(recording))
        for name, chain in chains.items():
            file.writelines(_steps(letters[name], chain))
        file.writelines(_ranges(recording, ranges, chains, letters))


def _clock_offset(registration: Registration | None, name: str) -> float:
    return 0.0 if registration is None else registration.users[name].clock_offset or 0.0


def _rows(recording: Recording, registration: Registration | None, offsets: Mapping[str, float]) -> Mask:
    """(n,): which ranges have a distance and both devices' poses, and were not rejected."""
    ranges, gap = recording.ranges, Parameters().slam.longest_pose_gap
    there = np.isfinite(ranges.distance) & (ranges.distance > 0.0)
    if registration is not None:
        there &= registration.ranges.used
    for index, user in enumerate(recording.users):
        if user.static:
            continue
        for who in (ranges.a, ranges.b):
            mine = np.flatnonzero(who == index)
            there[mine] &= recording.tracks[user.name].at(ranges.t[mine] + offsets[user.name], gap).valid
    return there


def _chain(recording: Recording, name: str, ranges: Ranges, offset: float) -> _Chain:
    """A vertex for each moment and antenna of its ranges, and for its first and last pose."""
    index, track = recording.index(name), recording.tracks[name]
    ends = [
        np.column_stack([ranges.t[who == index], antenna[who == index]])
        for who, antenna in ((ranges.a, ranges.antenna_a), (ranges.b, ranges.antenna_b))
    ]
    border = np.column_stack([track.t[[0, -1]] - offset, [-1.0, -1.0]])
    t, antenna = np.unique(np.concatenate([*ends, border]), axis=0).T
    antenna = antenna.astype(np.intp)
    poses = track.at(np.clip(t + offset, track.t[0], track.t[-1]), np.inf)
    levers = rotate_by_quaternions(poses.quat_xyzw, recording.users[index].levers[antenna])
    return _Chain(t, antenna, poses.position + levers, poses.quat_xyzw)


def _in_common(chain: _Chain, track: Track | None, recording: Recording, name: str, offset: float) -> _Chain:
    """The same antennas where the answer puts them; as SLAM has them where it does not put them anywhere."""
    if track is None:
        return chain
    poses = track.at(np.clip(chain.t + offset, track.t[0], track.t[-1]), np.inf)
    levers = rotate_by_quaternions(poses.quat_xyzw, recording.users[recording.index(name)].levers[chain.antenna])
    return chain._replace(position=poses.position + levers, quat_xyzw=poses.quat_xyzw)


def _vertices(letter: str, chain: _Chain) -> Iterator[str]:
    for k, (t, place, quat) in enumerate(zip(chain.t, chain.position, chain.quat_xyzw, strict=True)):
        yield f"VERTEX_SE3:QUAT {t:.9f} {letter}{k} {_numbers(place)} {_numbers(quat)}\n"


def _landmarks(recording: Recording, tracks: Mapping[str, Track]) -> Iterator[str]:
    for name, landmark in _landmark_names(recording).items():
        track, surveyed = tracks.get(name), recording.users[recording.index(name)].position
        place = np.array(surveyed or np.zeros(3)) if track is None else track.position[0]
        yield f"VERTEX_XYZ {landmark} {_numbers(place)}\n"


def _priors(recording: Recording) -> Iterator[str]:
    """Surveyed places, at the first stamp of all, since the format has priors at a time."""
    begin = min((track.t[0] for track in recording.tracks.values()), default=0.0)
    for name, landmark in _landmark_names(recording).items():
        user = recording.users[recording.index(name)]
        if user.position is not None:
            sigma = user.position_sigma or Parameters().priors.survey_sigma
            covariance = (sigma**2 * np.eye(3))[np.triu_indices(3)]
            place = _numbers(np.array(user.position))
            yield f"VERTEX_XYZ:PRIOR {begin:.9f} {landmark} {place} {_numbers(covariance)}\n"


def _landmark_names(recording: Recording) -> dict[str, str]:
    return {name: f"L{k}" for k, name in enumerate(user.name for user in recording.users if user.static)}


def _steps(letter: str, chain: _Chain) -> Iterator[str]:
    """The way from each vertex to the next, in the axes of the first."""
    back = inverse_quaternions(chain.quat_xyzw[:-1])
    moved = np.diff(chain.position, axis=0)
    steps = rotate_by_quaternions(back, moved)
    turns = multiply_quaternions(back, chain.quat_xyzw[1:])
    drift, dt, ds = Parameters().slam, np.diff(chain.t), np.linalg.norm(moved, axis=1)
    place = drift.drift_m_per_sqrt_s**2 * dt + drift.drift_m_per_sqrt_m**2 * ds + _LEAST_VARIANCE
    turn = drift.drift_rad_per_sqrt_s**2 * dt + drift.drift_rad_per_sqrt_m**2 * ds + _LEAST_VARIANCE
    for k, (step, quat) in enumerate(zip(steps, turns, strict=True)):
        variances = np.repeat([place[k], turn[k]], 3)
        covariance = np.diag(variances)[np.triu_indices(6)]
        head = f"EDGE_SE3:QUAT {chain.t[k + 1]:.9f} {letter}{k} {letter}{k + 1}"
        yield f"{head} {_numbers(step)} {_numbers(quat)} {_numbers(covariance)}\n"


def _ranges(
    recording: Recording, ranges: Ranges, chains: Mapping[str, _Chain], letters: Mapping[str, str]
) -> Iterator[str]:
    names, landmarks = [user.name for user in recording.users], _landmark_names(recording)
    vertex = {
        (name, t, antenna): f"{letters[name]}{k}"
        for name, chain in chains.items()
        for k, (t, antenna) in enumerate(zip(chain.t.tolist(), chain.antenna.tolist(), strict=True))
    }
    sigma = np.where(np.isnan(ranges.sigma), Parameters().ranges.sigma, ranges.sigma)
    for n in np.argsort(ranges.t, kind="stable").tolist():
        t, ends = float(ranges.t[n]), []
        for who, antenna in ((ranges.a[n], ranges.antenna_a[n]), (ranges.b[n], ranges.antenna_b[n])):
            name = names[who]
            ends.append(landmarks[name] if name in landmarks else vertex[name, t, int(antenna)])
        # PyFactorGraph and CORA have a landmark second.
        ends.sort(key=lambda end: end.startswith("L"))
        yield f"EDGE_RANGE {t:.9f} {ends[0]} {ends[1]} {ranges.distance[n]:.9g} {sigma[n] ** 2:.9g}\n"


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.9g}" for value in (values + 0.0).tolist())
