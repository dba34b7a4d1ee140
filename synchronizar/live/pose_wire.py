"""Poses as bytes: what devices send, and everybody's in one message.

All numbers are little-endian. A device sends one record of UP or several in one binary message; the room sends one
message of DOWN_HEAD and a record of DOWN for each device, 30 times a second. The same bytes go over WebSocket,
WebTransport datagrams and WebRTC data channels.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from synchronizar.live.messages import MessageError

POSE, POSES = 1, 2
"""First byte: what the message is."""
STATES = ("registered", "ambiguous", "unobservable", "disconnected")
"""States by their number in a DOWN record."""

UP = np.dtype(
    [
        ("kind", "u1"),
        ("frame", "u1"),
        ("user", "<u2"),
        ("sequence", "<u4"),
        ("t", "<f8"),
        ("position", "<f8", 3),
        ("quat_xyzw", "<f4", 4),
    ]
)
"""A pose of a device in the axes of its own SLAM: kind POSE, number of its frame (0 until it says `reset`), its index
in `welcome.you`, a number that rises with each pose, its own stamp (s), position (m), attitude. Several may stand one
after the other in one message."""

DOWN_HEAD = struct.Struct("<BBHId")
"""Kind POSES, 0, number of records, a number that rises with each message, the room's clock (s)."""
DOWN = np.dtype(
    [
        ("member", "<u2"),
        ("state", "u1"),
        ("frame", "u1"),
        ("age", "<f4"),
        ("position", "<f8", 3),
        ("quat_xyzw", "<f4", 4),
    ]
)
"""A device in the common frame, z up: its `index` in `members`, state by its number below, number of its SLAM frame, s
since it was there, position (m), attitude of its body, whose axes stay as the device has them. Who has no frame yet is
left out; only who is registered is known to be there."""
MOST_POSES = 256
"""Records in one message."""
_UP = struct.Struct("<BBHId3d4f")
"""A record of UP: most messages are one, for which numpy takes longer."""
_LARGEST_POSITION = 1e7
_LARGEST_STAMP = 1e12


class PoseUp(NamedTuple):
    """A pose that a device sends."""

    user: int
    frame: int
    sequence: int
    t: float
    position: tuple[float, float, float]
    quat_xyzw: tuple[float, float, float, float]


class PoseDown(NamedTuple):
    """A device's pose that the room sends."""

    member: int
    state: str
    frame: int
    age: float
    position: tuple[float, float, float]
    quat_xyzw: tuple[float, float, float, float]


class PosesDown(NamedTuple):
    """Everybody's poses at one moment."""

    sequence: int
    t: float
    poses: list[PoseDown]


def encode_poses_up(poses: Iterable[PoseUp]) -> bytes:
    """Bytes of a device's poses."""
    rows = [(POSE, p.frame, p.user, p.sequence, p.t, p.position, p.quat_xyzw) for p in poses]
    return np.array(rows, UP).tobytes()


def decode_poses_up(data: bytes) -> list[PoseUp]:
    """A device's poses. Raises MessageError for other bytes, and for values that no device can mean."""
    if not data or len(data) % UP.itemsize or len(data) > MOST_POSES * UP.itemsize:
        raise MessageError("size", f"poses are 1 to {MOST_POSES} records of {UP.itemsize} bytes each")
    poses = []
    for kind, frame, user, sequence, t, x, y, z, qx, qy, qz, qw in _UP.iter_unpack(data):
        if kind != POSE:
            raise MessageError("kind", f"the first byte of a pose is {POSE}")
        # A comparison with NaN is false: whatever is not finite is refused here as well.
        if not (abs(t) < _LARGEST_STAMP and abs(x) + abs(y) + abs(z) < _LARGEST_POSITION):
            raise MessageError("value", "a stamp or position of a pose is not finite, or too large")
        if not 1e-12 < qx * qx + qy * qy + qz * qz + qw * qw < 1e12:
            raise MessageError("value", "a quaternion is zero or not finite")
        poses.append(PoseUp(user, frame, sequence, t, (x, y, z), (qx, qy, qz, qw)))
    return poses


def encode_poses_down(poses: PosesDown) -> bytes:
    """Bytes of everybody's poses."""
    rows = [(p.member, STATES.index(p.state), p.frame, p.age, p.position, p.quat_xyzw) for p in poses.poses]
    return encode_rows_down(poses.sequence, poses.t, np.array(rows, DOWN))


def encode_rows_down(sequence: int, t: float, rows: NDArray[np.void]) -> bytes:
    """The same of (n,) rows of DOWN."""
    return DOWN_HEAD.pack(POSES, 0, len(rows), sequence & 0xFFFFFFFF, t) + rows.tobytes()


def parts_of_poses(message: bytes, largest: int) -> list[bytes]:
    """A message of everybody's poses as several of at most `largest` bytes, each a whole message by itself."""
    if len(message) <= largest:
        return [message]
    kind, _, _, sequence, t = DOWN_HEAD.unpack_from(message)
    step = (largest - DOWN_HEAD.size) // DOWN.itemsize * DOWN.itemsize
    records = [message[at : at + step] for at in range(DOWN_HEAD.size, len(message), step)]
    return [DOWN_HEAD.pack(kind, 0, len(part) // DOWN.itemsize, sequence, t) + part for part in records]


def decode_poses_down(data: bytes) -> PosesDown:
    """Everybody's poses. Raises MessageError for other bytes."""
    if len(data) < DOWN_HEAD.size:
        raise MessageError("size", "too short for poses")
    kind, _, count, sequence, t = DOWN_HEAD.unpack_from(data)
    if kind != POSES or len(data) != DOWN_HEAD.size + count * DOWN.itemsize:
        raise MessageError("size", "no message of everybody's poses")
    rows = np.frombuffer(data, DOWN, count, DOWN_HEAD.size)
    if np.count_nonzero(rows["state"] >= len(STATES)):
        raise MessageError("value", "a state that there is not")
    columns = (rows[name].tolist() for name in ("member", "state", "frame", "age", "position", "quat_xyzw"))
    poses = [
        PoseDown(member, STATES[state], frame, age, tuple(xyz), tuple(xyzw))
        for member, state, frame, age, xyz, xyzw in zip(*columns, strict=True)
    ]
    return PosesDown(sequence, t, poses)
