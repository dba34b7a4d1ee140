"""What a room says to its clients, and answers who joins."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from synchronizar.live.messages.basics import Quaternion, Vector


class _FromRoom(msgspec.Struct, omit_defaults=True):
    """What a room says: a client takes what it knows, and leaves fields of later versions of a room alone."""


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
