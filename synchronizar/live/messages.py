"""What a room and its clients say to each other: the one table of messages. `docs/protocol.md` is made from it.

Control messages are JSON objects, a `type` each, in text frames. Poses are many and small: they go as bytes
(`pose_wire`). Lengths m, angles rad, times s. Positions of a device are in the axes of its own SLAM, y up where it said
so; the common frame is z up.
"""

from __future__ import annotations

import math
from typing import Any, Literal, TypeVar

import msgspec

PROTOCOL = 1
"""Version of all of this; a client that speaks another is refused with both numbers."""
ROOM = "room"
"""In whose name the room itself takes part in WebRTC; no device can have it."""
APP = "app"
"""In whose name the room's application speaks and holds objects; no device can have it."""
LONGEST_NAME = 64
MOST_USERS = 64
"""Users that one connection may host."""
MOST_RANGES = 512
"""Ranges in one message."""
LARGEST_MESSAGE = 64 * 1024
"""Bytes of one message of a client, text or binary; what a room says is as large as the room."""
LARGEST_DATA = 8 * 1024
"""Bytes of an object's or a said message's `data`, as JSON."""

_T = TypeVar("_T")
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class MessageError(ValueError):
    """A message that is refused. `reason` is a word that is counted, the text one sentence."""

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason


class _Message(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    pass


class _FromRoom(msgspec.Struct, omit_defaults=True):
    """What a room says: a client takes what it knows, and leaves fields of later versions of a room alone."""


class _Tagged(msgspec.Struct):
    type: str


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


class Joined(_FromRoom):
    """Answer to `POST /api/join`."""

    token: str
    """To be said in `hello` within `expires` seconds, once. Never in an address."""
    expires: float
    """s."""
    resume: str
    """To join again as the same devices: keep it, and show it to nobody."""
    room: str
    """The room's code, as the room writes it."""
    users: list[str]
    """The devices that the connection will speak for."""
    webtransport_port: int | None = None
    """UDP port for WebTransport at `/live`; null where the server has none, and a WebSocket is the way."""
    webtransport_sha256: str | None = None
    """Hash of the certificate there, in hex: what a browser takes as `serverCertificateHashes`."""


# From a client to the room.


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

# From the room to a client.


class Member(_FromRoom):
    """A device in the room."""

    name: str
    index: int
    """Its number in poses sent by the room; kept for as long as the room stands."""
    here: bool = True
    """Whether its connection is up."""
    static: bool = False
    """Whether it is a radio that stands still."""
    up: Literal["y", "z"] = "z"
    """Which of its own axes points up."""
    frame: int = 0
    """Number of its SLAM frame."""


class UserFrame(_FromRoom, omit_defaults=False):
    """Where a device's frame lies in the common one, as in registration.json, with what it should do."""

    state: Literal["registered", "ambiguous", "unobservable", "disconnected"]
    """Only where it is registered is its place to be relied on."""
    reason: str
    """Why, in one sentence for people."""
    frame: int
    """Number of the SLAM frame that all this is about."""
    matrix: list[list[float]] | None
    """4x4, row by row: the axes of the device's own SLAM, scale included, to the common frame, z up; null: none yet."""
    x: float | None
    """m: x, y, z and yaw say the same as `matrix`, between z-up axes of both (of a y-up frame -z, -x and y)."""
    y: float | None
    z: float | None
    yaw: float | None
    """rad, about the common z."""
    scale: float
    """Length in the common frame over length by its SLAM."""
    covariance: list[list[float | None]] | None
    """4x4 over x, y, z, yaw."""
    sigma: float | None
    """m, 1 sigma in the plane: the longer half-axis of the ellipse."""
    clock_offset: float | None
    """s: its stamps, put to the room's clock, minus those of ranges: what comparing clocks has left over."""
    progress: float | None
    """0 to 1: how near it is to being registered."""
    cue: str | None
    """Which way its bearer should walk, in words: "walk 2 m to your left"."""


class Frames(_FromRoom, tag="frames"):
    """Everybody's frame: when something changed, and twice a second."""

    version: int
    """Rises with each change."""
    t: float
    """By the room's clock."""
    reference: str | None
    """The device beside which the others are judged; its first pose fixed the common frame. Null until there is one."""
    users: dict[str, UserFrame]
    """Empty until the solver has said something: it may be missing whoever has just come."""


class Object(_FromRoom):
    """An object as it stands; the common frame never moves under it."""

    id: str
    kind: str
    position: Vector
    quat_xyzw: Quaternion
    by: str
    """Who created it."""
    holder: str | None = None
    """Who holds it, and alone may move it."""
    velocity: Vector | None = None
    """m/s, common frame: what its holder moves it with."""
    t: float = 0.0
    """By the room's clock: when it was there."""
    data: Any = None
    waits_for: str | None = None
    """The device whose frame its place is in, until that is registered."""


class Objects(_FromRoom, tag="objects"):
    """Objects that were changed, in the order in which the room took it, and those that are gone: none is both."""

    version: int
    """Rises with each change."""
    changed: list[Object] = []
    """As they are now."""
    removed: list[str] = []
    """Their ids."""


class Members(_FromRoom, tag="members"):
    """All devices of the room, whenever one comes, goes or begins a new frame."""

    members: list[Member]


class Welcome(_FromRoom, tag="welcome"):
    """The answer to `hello`: everything as it is now."""

    room: str
    you: list[str]
    """Names of the devices that this connection speaks for; the poses that it sends name them by their index here."""
    protocol: int
    t: float
    """The room's clock."""
    members: list[Member]
    frames: Frames
    objects: Objects
    """All that there are."""
    udp_port: int | None = None
    """Where modules send their ranges."""
    app: str | None = None
    """The application that the room was started with."""
    webrtc: bool = False
    """Whether the room takes poses by a WebRTC data channel: `signal` to `room`."""


class Pong(_FromRoom, tag="pong"):
    """The answer to `ping`."""

    t: float
    """What the ping said."""
    room_t: float
    """The room's clock when it came in."""
    recorded: bool = False
    """Whether a recording is played: what the room tells is of that one's time, which poses say, not of this clock."""


class ModuleKey(_FromRoom, tag="module_key"):
    """What a module is provisioned with: it can speak for this address in this room and for nobody else."""

    user: str
    address: int
    session: int
    """The room's number among modules."""
    key: str
    """32 bytes in hex."""
    udp_port: int | None
    """Of the server: where the module sends its datagrams."""


class Events(_FromRoom, tag="events"):
    """What happened, a sentence each."""

    t: float
    """The room's clock."""
    events: list[str]
    """Sentences for people; programs go by `frames`."""


class PairRange(_FromRoom, omit_defaults=False):
    """The newest range of a pair."""

    a: str
    b: str
    distance: float
    residual: float | None
    """m, measured minus predicted; None where the solver has not used it."""
    used: bool
    age: float
    """s."""


class Health(_FromRoom, omit_defaults=False):
    """How a device and its links are."""

    poses_hz: float
    ranges_hz: float
    latency_ms: float | None
    """Half a round trip of its pings."""
    asleep: bool
    """Whether its module was told to sleep."""
    refused: dict[str, int]
    """How many of its words were refused, by reason."""


class Lag(_FromRoom, omit_defaults=False):
    """How late the server's loop comes to what is due, ms, over the last minute."""

    median: float
    p99: float
    """More than 20 ms: the server has more to do than its machine has time."""


class Status(_FromRoom, tag="status"):
    """How the room is, once a second."""

    t: float
    users: dict[str, Health]
    pairs: list[PairRange]
    refused: dict[str, int]
    """Of datagrams and connections that could not be told to be anybody's, by reason."""
    behind: float
    """s: how far the solver is behind the room's clock."""
    lag: Lag | None = None
    """Of the server; null where nobody watches it."""
    solver: str | None = None
    """What is wrong with the solver: until it works again frames stay as they are. Null where it works."""


class Said(_FromRoom, tag="said"):
    """What somebody said."""

    topic: str
    data: Any
    by: str


class Signalled(_FromRoom, tag="signalled"):
    """WebRTC signalling from somebody."""

    by: str
    data: dict[str, Any]


class Refused(_FromRoom, tag="refused"):
    """Something that this client sent was refused; told once for each reason, and again when it goes on."""

    reason: str
    """A word to count by: `user`, `value`, `future`, `old`, `frame`, `rate`, `message` and others."""
    what: str
    """One sentence with a way on."""
    count: int = 1
    """How many were refused for that reason so far."""


class Answer(_FromRoom, tag="answer"):
    """The answer to `finish`: registration.json."""

    registration: dict[str, Any]


class Bye(_FromRoom, tag="bye"):
    """The last message: why the room ends the connection."""

    reason: str
    """`elsewhere`, `left`, `token`, `hello`, `protocol` and others."""
    what: str
    """One sentence with a way on."""


FromRoom = (
    Welcome
    | Pong
    | Members
    | Frames
    | Objects
    | Events
    | Status
    | ModuleKey
    | Said
    | Signalled
    | Refused
    | Answer
    | Bye
)

_encoder = msgspec.json.Encoder()
_from_client: msgspec.json.Decoder[FromClient] = msgspec.json.Decoder(FromClient)
_from_room: msgspec.json.Decoder[FromRoom] = msgspec.json.Decoder(FromRoom)
_join = msgspec.json.Decoder(Join)
_open_room = msgspec.json.Decoder(OpenRoom)
_joined = msgspec.json.Decoder(Joined)
_tagged = msgspec.json.Decoder(_Tagged)


def encode(message: msgspec.Struct) -> bytes:
    """JSON of a message. Numbers have to be finite: JSON has no others."""
    return _encoder.encode(message)


def decode_from_client(data: bytes | str) -> FromClient:
    """What a client says. Raises MessageError for anything else."""
    return _short(_from_client, data)


def decode_from_room(data: bytes | str) -> FromRoom:
    """What a room says. Raises MessageError for anything else."""
    return _checked(_from_room, data)


def type_of(data: bytes | str) -> str | None:
    """What a message that cannot be decoded calls itself; None where it is no message at all."""
    try:
        return _tagged.decode(data).type
    except (msgspec.ValidationError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None


def decode_join(data: bytes) -> Join:
    """What somebody who joins asks for. Raises MessageError for anything else."""
    return _short(_join, data)


def decode_open_room(data: bytes) -> OpenRoom:
    """What somebody who opens a room asks for. Raises MessageError for anything else."""
    return _short(_open_room, data)


def decode_joined(data: bytes) -> Joined:
    """What a room answers who joins. Raises MessageError for anything else."""
    return _checked(_joined, data)


def _short(decoder: msgspec.json.Decoder[_T], data: bytes | str) -> _T:
    if len(data) > LARGEST_MESSAGE:
        raise MessageError("size", f"a message has at most {LARGEST_MESSAGE} bytes")
    return _checked(decoder, data)


def _checked(decoder: msgspec.json.Decoder[_T], data: bytes | str) -> _T:
    """JSON refuses NaN and infinities by itself; numbers beyond a double's are infinite and refused as well."""
    try:
        return decoder.decode(data)
    except msgspec.ValidationError as error:
        raise MessageError("message", str(error)) from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise MessageError("malformed", f"not a JSON object of the protocol: {error}") from None


def data_size(data: Any) -> int:
    """Bytes of an application's data as JSON."""
    return len(_encoder.encode(data))


def data_too_large(data: Any) -> bool:
    """Whether an application's data has more than LARGEST_DATA bytes as JSON."""
    return data_size(data) > LARGEST_DATA


def all_finite(*numbers: float) -> bool:
    """Whether all are finite."""
    return all(map(math.isfinite, numbers))
