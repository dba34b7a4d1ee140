"""Devices of a room, the connections that speak for them, and tickets of those who have not come yet."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Any, Protocol

from synchronizar.live import messages as m
from synchronizar.live.budget import Allowance, Budget
from synchronizar.live.device_clock import DeviceClock
from synchronizar.live.outbox import Outbox
from synchronizar.live.placing import OwnPose
from synchronizar.live.pose_wire import PoseUp


class Peer(Protocol):
    """A client's second way for poses, besides its connection; where it takes none, they go by the connection."""

    def signalled(self, data: dict[str, Any]) -> None:
        """What the client says to set it up."""

    def send_poses(self, data: bytes) -> bool:
        """Whether it took everybody's poses."""

    def close(self) -> None:
        """End it."""


@dataclass
class Device:
    """A device of the room, here or away."""

    settings: m.UserSettings
    index: int
    owner: str
    """Hash of the secret by which its connection is known when it comes again."""
    frame: int = 0
    session: int = 0
    """How often its SLAM began anew."""
    client: Client | None = None
    clock: DeviceClock = field(default_factory=DeviceClock)
    held: list[PoseUp] = field(default_factory=list)
    """Poses that wait until its clock is known."""
    pose: OwnPose | None = None
    """Its newest pose by the room's clock, in its own axes."""
    poses: deque[float] = field(default_factory=lambda: deque(maxlen=128))
    ranges: deque[float] = field(default_factory=lambda: deque(maxlen=1024))
    round_trip: float | None = None
    refused: Counter[str] = field(default_factory=Counter)
    left_at: float | None = None
    resets: Budget | None = None

    @property
    def name(self) -> str:
        """Its name."""
        return self.settings.name

    def member(self) -> m.Member:
        """As others are told of it."""
        here = self.client is not None
        return m.Member(self.name, self.index, here, self.settings.static, self.settings.up, self.frame)


@dataclass(eq=False)
class Client:
    """A connection and the devices that it speaks for."""

    devices: list[Device]
    recorded: bool
    allowance: Allowance
    outbox: Outbox = field(default_factory=Outbox)
    told: Counter[str] = field(default_factory=Counter)
    peer: Peer | None = None
    app: bool = False
    """Whether it is the room's application."""

    @property
    def name(self) -> str:
        """In whose name it holds objects and speaks; empty for who only looks."""
        if self.app:
            return m.APP
        return self.devices[0].name if self.devices else ""


@dataclass(eq=False)
class Ticket:
    """What a join has bought."""

    settings: list[m.UserSettings]
    owner: str
    """Hash of the secret by which they come again."""
    recorded: bool
    until: float
    app: bool = False
    """Whether it is for the room's application."""

    @property
    def users(self) -> list[str]:
        """Names of the devices."""
        return [user.name for user in self.settings]
