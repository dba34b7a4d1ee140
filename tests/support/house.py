"""A room without network, processes or wall time: the test sets the clock, and says what the solver knows."""

from __future__ import annotations

from typing import Any

import numpy as np

from synchronizar.geometry import YawFrame
from synchronizar.io.datagrams import MEASURED, RANGE, RangesDatagram, encode_ranges
from synchronizar.live import messages as m
from synchronizar.live.member import Client
from synchronizar.live.pose_wire import PosesDown, PoseUp, decode_poses_down, encode_poses_up
from synchronizar.live.recorder import FolderRecorder
from synchronizar.live.room import Room
from synchronizar.live.solver_wire import Command, NewestRange, Told

NO_TURN = (0.0, 0.0, 0.0, 1.0)


class Clock:
    def __init__(self) -> None:
        self.t = 1000.0

    def __call__(self) -> float:
        return self.t


class FakeSolver:
    """Remembers what it is told."""

    trouble: str | None = None

    def __init__(self) -> None:
        self.commands: list[Command] = []
        self.asked: list[float] = []
        self.finished_at: list[float] = []

    def feed(self, command: Command) -> None:
        self.commands.append(command)

    def advance(self, t: float) -> None:
        self.asked.append(t)

    def finish(self, t: float) -> None:
        self.finished_at.append(t)

    async def drained(self) -> None:
        pass

    def of(self, kind: type) -> list[Any]:
        return [command for command in self.commands if isinstance(command, kind)]


class House:
    """A room with its clock and solver."""

    def __init__(self, recorder: FolderRecorder | None = None, app: str | None = None) -> None:
        self.clock, self.recorder = Clock(), recorder
        self.room = Room("CODE", self.clock, key=bytes(32), recorder=recorder, app=app)
        self.solver = FakeSolver()
        self.room.solver = self.solver

    def enter(self, *names: str, up: str = "z", time: str = "live", resume: str | None = None) -> tuple[Client, str]:
        users = [m.UserSettings(name, up=up) for name in names]  # type: ignore[arg-type]
        ticket, secret = self.room.admit(m.Join("CODE", users, time, resume))  # type: ignore[arg-type]
        return self.room.connect(ticket), secret

    def enter_app(self) -> Client:
        ticket, _ = self.room.admit(m.Join("CODE", app=self.room.app_secret))
        return self.room.connect(ticket)

    def told(self, **frames: YawFrame) -> None:
        """The solver has registered these users."""
        users = {name: user_frame(frame) for name, frame in frames.items()}
        t = self.clock.t
        self.room.told(Told(t, 1, min(frames), users, [], [NewestRange(t, "alice", "bob", 3.0, 0.1, True)], 0.01))

    def said_to(self, client: Client) -> list[m.FromRoom | PosesDown]:
        return [
            m.decode_from_room(word) if word[:1] == b"{" else decode_poses_down(word) for word in client.outbox.take()
        ]

    def pose(self, client: Client, x: float, t: float | None = None, frame: int = 0, user: int = 0) -> None:
        stamp = self.clock.t if t is None else t
        self.room.hear_poses(client, encode_poses_up([PoseUp(user, frame, 1, stamp, (x, 0.0, 0.0), NO_TURN)]))


def user_frame(frame: YawFrame, state: str = "registered", number: int = 0) -> m.UserFrame:
    return m.UserFrame(
        state=state,  # type: ignore[arg-type]
        reason="",
        frame=number,
        matrix=frame.matrix.tolist(),
        x=frame.x,
        y=frame.y,
        z=frame.z,
        yaw=frame.yaw,
        scale=frame.scale,
        covariance=None,
        sigma=0.05,
        clock_offset=0.0,
        progress=1.0,
        cue=None,
    )


def only(kind: type, words: list[Any]) -> Any:
    found = [word for word in words if isinstance(word, kind)]
    assert len(found) == 1, found
    return found[0]


def refused(words: list[Any]) -> dict[str, str]:
    return {word.reason: word.what for word in words if isinstance(word, m.Refused)}


def datagram(house: House, address: int, peer: int, sequence: int, t: float, mm: int, key: bytes) -> bytes:
    row = (peer, 0, MEASURED, mm, 0, 0, 50, -8000, -8100, 0, 0)
    told = RangesDatagram(house.room.modules.session, address, sequence, 9, round(1e9 * t), 0, np.array([row], RANGE))
    return encode_ranges(told, key)
