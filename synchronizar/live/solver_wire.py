"""What a room says to the process that solves it, and what that answers: blocks of msgpack with their length before."""

from __future__ import annotations

import struct
from typing import Any, TypeAlias

import msgspec

from synchronizar.live.messages import Quaternion, UserFrame, UserSettings, Vector

LENGTH = struct.Struct("<I")
"""Before each block: its number of bytes."""


class _Word(msgspec.Struct, array_like=True, gc=False):
    """Hundreds of thousands are kept; none of them is in a cycle, and looking for one takes long."""


class AddUser(_Word, tag="u"):
    """One more device."""

    user: UserSettings


class Pose(_Word, tag="p"):
    """A pose by the room's clock, in the device's own axes."""

    user: str
    t: float
    position: Vector
    quat_xyzw: Quaternion


class Range(_Word, tag="r"):
    """A distance by the room's clock."""

    t: float
    a: str
    b: str
    distance: float
    optional: dict[str, Any]
    """The other columns of ranges.csv, where they are known."""


class Lost(_Word, tag="l"):
    """SLAM lost track."""

    user: str


class NewFrame(_Word, tag="n"):
    """SLAM began anew."""

    user: str
    frame: int


class Advance(_Word, tag="a"):
    """It is `t`: go on and tell."""

    t: float


class Save(_Word, tag="s"):
    """Write the state into a file."""

    path: str


class Finish(_Word, tag="f"):
    """Nothing more comes after `t`: tell the answer."""

    t: float


Command: TypeAlias = AddUser | Pose | Range | Lost | NewFrame | Advance | Save | Finish


class Begin(msgspec.Struct):
    """First of all: how to solve."""

    workers: int
    """Processes that search; 0: the answer does not depend on how fast things come."""
    reference: str | None = None
    state: str | None = None
    """A file to go on from."""
    frames: dict[str, int] = {}
    """Number of each device's SLAM frame at that state, where it is not 0."""


class Block(msgspec.Struct):
    """Commands in their order."""

    serial: int
    """Rises by one from block to block."""
    commands: list[Command]


class NewestRange(_Word):
    """The newest range of a pair."""

    t: float
    a: str
    b: str
    distance: float
    residual: float | None
    used: bool


class Told(msgspec.Struct, tag="told"):
    """What is known at a moment."""

    t: float
    serial: int
    """Of the block that asked."""
    reference: str | None
    users: dict[str, UserFrame]
    events: list[str]
    ranges: list[NewestRange]
    seconds: float
    """Wall time that it took."""


class Saved(msgspec.Struct, tag="saved"):
    """The state has been written; all blocks up to `serial` are in it."""

    serial: int
    path: str
    done: bool
    """False: there is nothing to write yet, or it could not be written."""


class Finished(msgspec.Struct, tag="finished"):
    """registration.json."""

    registration: dict[str, Any]


Reply: TypeAlias = Told | Saved | Finished

_encoder = msgspec.msgpack.Encoder()
begin_decoder = msgspec.msgpack.Decoder(Begin)
block_decoder = msgspec.msgpack.Decoder(Block)
reply_decoder: msgspec.msgpack.Decoder[Reply] = msgspec.msgpack.Decoder(Reply)


def framed(word: Begin | Block | Reply) -> bytes:
    """Its bytes, with their length before them."""
    body = _encoder.encode(word)
    return LENGTH.pack(len(body)) + body
