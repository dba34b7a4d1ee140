"""What a client says to a room, and what it asks for before it joins one."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from synchronizar.live.messages.basics import PROTOCOL, Quaternion, Vector
from synchronizar.live.messages.from_room import Object, Said


class _Message(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    pass


class UserSettings(_Message):
    """A device, as in recording.toml."""

    name: str
    """At most 64 characters of a file's name; nobody else in the room has it."""
    up: Literal["y", "z"] = "z"
    """Which of its axes points up: "y" for WebXR, ARKit, ARCore, Unity (mirrored), "z" for ROS."""
    static: bool = False
    """A radio that stands still and sends no poses."""
    height_sigma: float | None = None
    """m, 1 sigma: how far its origin may lie above or below the others'."""
    position: Vector | None = None
    """m, z up: where a radio that stands still was surveyed to be. The common frame is the survey's then."""
    position_sigma: float | None = None
    """m, 1 sigma of that on each axis."""
    range_bias: float | None = None
    """m: what its radio is known to add to a range."""
    range_bias_sigma: float | None = None
    """m, 1 sigma of that."""
    antennas: dict[str, Vector] = {}
    """Lever arm of each antenna in body axes; none: one antenna at the origin."""


class Join(_Message):
    """Body of `POST /api/join`: what a client asks for, with the room's code, before it opens a connection."""

    room: str
    """The room's code."""
    users: list[UserSettings] = []
    """The devices that the connection speaks for: one for a phone, several for a gateway, none for who only looks."""
    time: Literal["live", "recorded"] = "live"
    """`recorded`: stamps are those of a recording, and the room's time is what this client's `clock` says."""
    resume: str | None = None
    """The `resume` of an earlier answer, to be the same devices again after a reload or in another network.
    One that the room does not know opens nothing, and is answered by a new one."""
    app: str | None = None
    """The secret that the room's application has from its server; nobody else says it."""


class OpenRoom(_Message):
    """Body of `POST /api/rooms`: one more room, asked for by somebody who has the code of one."""

    room: str
    """The code of a room that there is."""
    app: str | None = None
    """What is done in the new one: a name of `GET /api/apps`; None: what the server was started with."""


class Hello(_Message, tag="hello"):
    """The first message on a connection; nothing else is heard before it."""

    token: str
    """The one that joining bought."""
    protocol: int = PROTOCOL
    """Version of this protocol that the client speaks; the room refuses another one than its own."""


class Ping(_Message, tag="ping"):
    """Compares clocks: answered by `pong` at once. A device says it four times at first, then every 2 s."""

    t: float
    """By the device's own clock, the one that stamps its poses."""
    offset: float | None = None
    """What the device has worked out from the pongs so far: room's clock minus its own; None at first."""
    round_trip: float | None = None
    """s of the quickest recent ping and pong."""


class MeasuredRange(_Message):
    """A distance between two devices; one of them is the sender's. Columns as in ranges.csv."""

    t: float
    """By the clock that stamps the sender's poses."""
    a: str
    """A device by its name."""
    b: str
    """The other one, in either order."""
    distance: float
    """m, between their antennas; slightly below 0 is noise, and welcome."""
    sigma: float | None = None
    """m, 1 sigma in line of sight; null: 0.1."""
    antenna_a: str | None = None
    """Which of `antennas` of a; null where it has none or one."""
    antenna_b: str | None = None
    rx_power: float | None = None
    """dBm, received in all."""
    fp_power: float | None = None
    """dBm, received in the first path."""
    nlos: bool | None = None
    """Whether the radio itself says that there was no line of sight."""
    source: str | None = None
    """Who measured: a word of ranges.csv."""


class Ranges(_Message, tag="ranges"):
    """Distances that the sender's devices measured."""

    ranges: list[MeasuredRange]


class Reset(_Message, tag="reset"):
    """A device's SLAM began anew, in another frame: it is looked for anew, and poses of the old frame are left out."""

    user: str
    """The device, one of the sender's."""
    frame: int
    """Number of the new frame, which its poses carry from now on: 0 at first, one more with each reset, modulo 256."""


class Lost(_Message, tag="lost"):
    """A device's SLAM lost track; it may find itself again."""

    user: str


class Module(_Message, tag="module"):
    """A device's module will send ranges by UDP: asks for its key. Answered by `module_key`."""

    user: str
    """The device, one of the sender's."""
    address: int
    """0 to 65533: the module's own in the session. One that another device has had is refused: somebody has its key."""


class Clock(_Message, tag="clock"):
    """Recorded time only: all poses and ranges before `t` have been sent; the room goes on to it."""

    t: float


class Finish(_Message, tag="finish"):
    """Recorded time only: all has been sent, up to `t`. Answered by `answer` when all of it is solved."""

    t: float


class Again(_Message, tag="again"):
    """Recorded time only: what became of an object in the recorded room, or was said there, in whoever's name.

    The room's application, where there is one, ends with the first of these words.
    """

    object: Object | None = None
    """As it then stood, `holder` and `t` included."""
    removed: str | None = None
    """Id of an object that was gone."""
    said: Said | None = None
    """To all."""


class Create(_Message, tag="create"):
    """Puts an object into the room. It belongs to the room and stays when its creator leaves."""

    id: str
    """Chosen by the client; another object with that id is refused."""
    kind: str
    """A word of the application's, which says what to draw."""
    position: Vector
    quat_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)
    user: str | None = None
    """None: the place is in the common frame. A device: in that device's own frame and axes; the object waits until the
    device is registered, and then stands where that is in the common frame."""
    data: Any = None
    """Whatever the application wants to keep with it."""
    hold: bool = False
    """Whether its creator holds it from the start."""


class Grab(_Message, tag="grab"):
    """Asks for an object; who holds it may move it. Refused where somebody else does."""

    id: str


class Move(_Message, tag="move"):
    """Moves an object that the sender holds, or changes its data. Only the latest counts."""

    id: str
    position: Vector | None = None
    quat_xyzw: Quaternion | None = None
    velocity: Vector | None = None
    """m/s, common frame: what it goes on with until the next word."""
    data: Any = msgspec.UNSET


class Release(_Message, tag="release"):
    """Lets go of an object."""

    id: str


class Remove(_Message, tag="remove"):
    """Takes an object out of the room. Refused where somebody else holds it."""

    id: str


class Heartbeat(_Message, tag="heartbeat"):
    """The sender is still there, and keeps what it holds: every 2 s where nothing else is said."""


class Say(_Message, tag="say"):
    """A word of an application, handed on to one client or to all; the room does not look into it."""

    topic: str
    """A word of the application's, at most 64 characters."""
    data: Any = None
    to: str | None = None
    """A user's name; None: everybody else."""


class Signal(_Message, tag="signal"):
    """WebRTC signalling, handed on: an offer, an answer or a candidate."""

    to: str
    """A user's name, or `room` for the room itself."""
    data: dict[str, Any]
    """To the room `{"type": "offer", "sdp": text}` with all candidates in it; among devices as they agree."""


class Leave(_Message, tag="leave"):
    """The sender goes, and does not come back as the same devices."""


FromClient = (
    Hello
    | Ping
    | Ranges
    | Reset
    | Lost
    | Module
    | Clock
    | Finish
    | Again
    | Create
    | Grab
    | Move
    | Release
    | Remove
    | Heartbeat
    | Say
    | Signal
    | Leave
)
