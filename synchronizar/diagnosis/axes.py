"""Which axis of a track is vertical, and in which order its quaternions are written.

A device in a hand, on a head or on wheels turns about the vertical far more than about any other axis. So of the
directions of the track's own frame, seen in body axes, the vertical alone keeps its place: the mean of R^T e over a
walk has a length near 1 for it (its concentration) and near 0 for any other axis e, once the device has turned around.
The mean of a rotation matrix is linear in the second moments of the quaternion, so all of a walk is one 4 x 4 matrix,
and another order of the quaternion is the same matrix with rows and columns in another order.

Besides, people and wheels move far less along the vertical than along the other two. Only where both agree, or one of
them leaves no doubt and the other says nothing, is there a finding.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.findings import Code, Finding
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.diagnosis.attitudes import NOT_USED
from synchronizar.geometry import Up, YawFrame
from synchronizar.parameters import DiagnosisParameters, Parameters
from synchronizar.quaternions import rotate_by_quaternions

Order = Literal["xyzw", "wxyz"]
ORDERS: tuple[Order, Order] = ("xyzw", "wxyz")
OWN_AXES = {"z": "xyz", "y": "zxy"}
"""Which axes of a track's file the three axes in memory are, where `up` is z and where it is y."""


@dataclass(frozen=True)
class Posture:
    """What a track's attitudes, read in one order, and its positions say of the vertical."""

    concentration: Array
    """(3,) of each axis of the frame, seen in body axes."""
    in_body: Array
    """(3, 3) unit vectors: where each axis of the frame lies in body axes on average."""
    forward: Array
    """(3,) the mean direction of motion in body axes; its length is its concentration. NaN where it hardly moves."""
    vertical: int | None
    """The axis about which the device turns; None where it does not turn enough to tell."""


def posture(track: Track, order: Order, up: Up, parameters: Parameters) -> Posture:
    """The posture of a track whose quaternions are taken to be written in that order, in a file with `up` upwards."""
    q = track.quat_xyzw
    if order == "wxyz":  # what is reordered are the numbers of the file, before its axes are brought to z up
        of_file = YawFrame(up_a=up).rotate_quaternions(q)
        q = YawFrame(up_b=up).rotate_quaternions(of_file[:, [1, 2, 3, 0]])
    mean = _mean_rotation(q)
    concentration = np.linalg.norm(mean, axis=1)
    in_body = mean / np.maximum(concentration, 1e-12)[:, None]
    return Posture(
        concentration,
        in_body,
        _forward(track, q, parameters.diagnosis),
        _vertical(concentration, parameters.diagnosis),
    )


def axis_findings(recording: Recording, signs: Mapping[str, Sign], parameters: Parameters) -> list[Finding]:
    """Of each track whose vertical is not z, or whose quaternions are written as w x y z."""
    return [
        _finding(recording.users[recording.index(name)], recording.tracks[name], sign, parameters)
        for name, sign in signs.items()
    ]


def with_z_up(recording: Recording, signs: Mapping[str, Sign]) -> Recording:
    """The same recording, the places of tracks whose vertical is another axis turned so that it is z."""
    tracks = dict(recording.tracks)
    for name, sign in signs.items():
        track = tracks[name]
        tracks[name] = replace(track, position=np.roll(track.position, 2 - sign.vertical, axis=1))
    return replace(recording, tracks=tracks)


def signs_of(recording: Recording, parameters: Parameters) -> dict[str, Sign]:
    """Of each track with whose axes or attitudes something is likely wrong.

    Turns about x are turns about z whose quaternions begin with w. Where another's do, so do these: no format has x up.
    """
    up = {user.name: user.up for user in recording.users}
    signs = {name: sign_of(track, up[name], parameters) for name, track in recording.tracks.items()}
    found = {name: sign for name, sign in signs.items() if sign is not None}
    if all(sign.code is not Code.QUATERNION_ORDER for sign in found.values()):
        return found
    as_w_first = {
        name: Sign(Code.QUATERNION_ORDER, 2)
        for name, sign in found.items()
        if sign == Sign(Code.UP_AXIS, 0)
        and up[name] == "z"  # in a file with y up it is the z axis
        and posture(recording.tracks[name], "wxyz", "z", parameters).vertical == 2
    }
    return found | as_w_first


class Sign(NamedTuple):
    """What is wrong with a track's axes or attitudes."""

    code: Code
    vertical: int
    """The axis of the positions that is likely vertical."""


def sign_of(track: Track, up: Up, parameters: Parameters) -> Sign | None:
    """What is likely wrong with a track's axes or attitudes; None where nothing plain speaks against them."""
    limits = parameters.diagnosis
    if len(track) < limits.axes_fewest_poses:
        return None
    as_read, reordered = (posture(track, order, up, parameters) for order in ORDERS)
    spread = track.position.std(axis=0)
    flat = _flat(spread, limits)
    vertical = as_read.vertical
    if vertical == 2:
        reads_better = flat in (None, 2) and _carried_better(as_read, reordered, limits)
        return Sign(Code.QUATERNION_ORDER, 2) if reads_better else None
    if vertical is None:
        still = as_read.concentration.min() > limits.vertical_concentration
        return _other_up(as_read, flat, limits) if flat in (0, 1) and still else None
    if reordered.vertical == 2 and flat != vertical and not spread[vertical] < limits.lower_share * spread[2]:
        # No format has x up; y up is common, so that the positions have to speak against it.
        if vertical == 0 or flat == 2 or spread[2] < limits.lower_share * spread[vertical]:
            return Sign(Code.QUATERNION_ORDER, 2)
        return None
    return _other_up(as_read, vertical, limits) if flat in (None, vertical) else None


def _carried_better(as_read: Posture, reordered: Posture, limits: DiagnosisParameters) -> bool:
    """Whether the device is carried forwards in the other order, and in all directions as it is read."""
    upright = bool(reordered.concentration[2] > limits.vertical_concentration)
    astray = _length(as_read.forward) < limits.astray_concentration
    return upright and astray and _length(reordered.forward) > limits.carried_concentration


def _other_up(as_read: Posture, axis: int, limits: DiagnosisParameters) -> Sign:
    return Sign(Code.OPTICAL_AXES if axis == 1 and _points_down(as_read, limits) else Code.UP_AXIS, axis)


def _points_down(posture: Posture, limits: DiagnosisParameters) -> bool:
    """Whether a vertical y points down, by the body axes that are in use and by where the device is carried.

    Cameras: x right, y down, z forward. Robots: x forward, z up. Graphics (ARKit, OpenXR): y up, z backward.
    """
    up, forward = posture.in_body[1], posture.forward
    if not _length(forward) > limits.carried_concentration:
        return False
    ahead = int(np.argmax(np.abs(forward)))
    if ahead == 2 and forward[2] > 0.0:
        return bool(up[1] > limits.upside_down)
    return bool(ahead == 0 and forward[0] > 0.0 and up[2] < limits.upside_down)


def _finding(user: User, track: Track, sign: Sign, parameters: Parameters) -> Finding:
    name, up = user.name, user.up
    as_read, reordered = (posture(track, order, up, parameters) for order in ORDERS)
    spread = track.position.std(axis=0)
    if sign.code is Code.QUATERNION_ORDER:
        seen = (
            f"read so, the device stays upright as it turns ({reordered.concentration[2]:.2f} of 1), read as x y z w "
            f"it does not ({as_read.concentration[2]:.2f} of 1)"
            if as_read.vertical != 2
            else f"read so, the device faces where it goes ({_length(reordered.forward):.2f} of 1), read as x y z w it "
            f"does not ({_length(as_read.forward):.2f} of 1)"
        )
        return Finding(
            sign.code,
            name,
            f"its quaternions are likely in the order w x y z: {seen}" + (NOT_USED if user.antennas else ""),
            "write them in the order qx qy qz qw",
        )
    letter, taken = OWN_AXES[up][sign.vertical], OWN_AXES[up][2]
    turns = (
        f"the device turns about {letter} ({as_read.concentration[sign.vertical]:.2f} of 1, about {taken} "
        f"{as_read.concentration[2]:.2f}) and "
        if as_read.vertical == sign.vertical
        else ""
    )
    seen = (
        f"its {letter} axis is likely vertical, not {taken}: {turns}its positions spread by "
        f"{spread[sign.vertical]:.2f} m along {letter} and {spread[2]:.2f} m along {taken}"
    )
    if sign.code is Code.OPTICAL_AXES and up == "z":
        remedy = "turn its track from a camera's axes (x right, y down, z forward): x = z, y = -x, z = -y"
        return Finding(sign.code, name, f"{seen}, and {letter} points down as in a camera's axes", remedy)
    return Finding(sign.code, name, seen, _remedy(name, letter))


def _remedy(name: str, vertical: str) -> str:
    """What to say in recording.toml; what it cannot say has to be done to the track."""
    if vertical == "x":
        return "turn its track so that z points up"
    return f'write `up = "{vertical}"` in recording.toml, at the top or under [users.{name}]'


def _length(vector: Array) -> float:
    return float(np.linalg.norm(vector))


def _vertical(concentration: Array, limits: DiagnosisParameters) -> int | None:
    axis = int(np.argmax(concentration))
    others = np.delete(concentration, axis)
    turns = concentration[axis] > limits.vertical_concentration and others.max() < limits.horizontal_concentration
    return axis if turns else None


def _flat(spread: Array, limits: DiagnosisParameters) -> int | None:
    axis = int(np.argmin(spread))
    others = np.delete(spread, axis)
    return axis if others.min() > limits.flat_least_spread and spread[axis] < limits.flat_share * others.min() else None


def _mean_rotation(q: Array) -> Array:
    """(3, 3) mean of the rotation matrices of unit quaternions (n, 4): body axes into the frame's."""
    s = q.T @ q / len(q)
    x, y, z, w = range(4)
    return np.array(
        [
            [s[x, x] - s[y, y] - s[z, z] + s[w, w], 2.0 * (s[x, y] - s[z, w]), 2.0 * (s[x, z] + s[y, w])],
            [2.0 * (s[x, y] + s[z, w]), s[y, y] - s[x, x] - s[z, z] + s[w, w], 2.0 * (s[y, z] - s[x, w])],
            [2.0 * (s[x, z] - s[y, w]), 2.0 * (s[y, z] + s[x, w]), s[z, z] - s[x, x] - s[y, y] + s[w, w]],
        ]
    )


def _forward(track: Track, q: Array, limits: DiagnosisParameters) -> Array:
    """(3,) the mean unit direction of motion in body axes; NaN where there is too little motion."""
    begin = np.linspace(0, len(track) - 1, min(len(track), limits.direction_most)).astype(int)
    end = np.searchsorted(track.t, track.t[begin] + limits.direction_interval)
    inside = end < len(track)
    begin, end = begin[inside], end[inside]
    dt = track.t[end] - track.t[begin]
    way = track.position[end] - track.position[begin]
    length = np.linalg.norm(way, axis=1)
    moving = (length > limits.direction_speed * dt) & (dt < 2.0 * limits.direction_interval)
    if moving.sum() < limits.direction_fewest:
        return np.full(3, np.nan)
    middle = ((begin + end) // 2)[moving]
    unturned = q[middle] * np.array([-1.0, -1.0, -1.0, 1.0])
    return np.asarray(rotate_by_quaternions(unturned, way[moving] / length[moving, None]).mean(axis=0))
