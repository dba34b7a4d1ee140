"""A room that is told rubbish: whether anything fails, and whether it goes on.

`python -m experiments.live.fuzz [--count 1000000] [--seed 1]`: datagrams, words, poses and joins that make sense are
spoilt (bits, lengths, numbers, texts, pieces of one in another; half of the spoilt datagrams have a right tag all the
same) and given to a lobby, its UDP port and a room with a recorder, as they would come from the network. One in ten is
left as it was. Nothing may raise; what reaches the solver has to be finite, of devices that are there, and of a moment
that can be; what clients are told has to be what the protocol says; memory has to stay what it was after the first
tenth. In the end somebody joins, walks and ranges as if nothing had been. Told are how many were refused, by reason.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import random
import struct
import tempfile
from collections import Counter
from hashlib import blake2s
from math import isfinite
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from experiments.common.cpu import resident_mb
from synchronizar.io.datagrams import MEASURED, RANGE, TAG_SIZE, RangesDatagram, encode_ranges
from synchronizar.live import messages as m
from synchronizar.live.connection import hear_word
from synchronizar.live.lobby import Lobby
from synchronizar.live.member import Client
from synchronizar.live.messages import MessageError
from synchronizar.live.pose_wire import PoseUp, decode_poses_down, encode_poses_up
from synchronizar.live.recorder import FolderRecorder
from synchronizar.live.room import Room
from synchronizar.live.room_time import FROM_THE_FUTURE, TOO_OLD
from synchronizar.live.solver_wire import Command, Pose, Range
from synchronizar.live.udp import UdpPort

STEP_S = 0.002
"""s of the room's clock between two things that come."""
TICK_EVERY, FLUSH_EVERY = 20, 5000
NAMES = ("alice", "bob", "carol", "dave")
MORE_MB = 60.0
"""Memory after the first tenth may grow by so much; what one address may have filled is less."""
NUMBERS = ("NaN", "-1", "0", "1e400", "-1e308", "1e12", "9007199254740993", "18446744073709551616", "9" * 400, "null")
TEXTS = ("", "alice", "bob~2", "../../etc/passwd", "\x00", "\ud800", '"', "a,b\n1,2", "~", "." * 70, "\U0001f600" * 64)
NESTED = 3000
_SEQUENCE = slice(16, 24)
"""Where it stands in a datagram."""
A_ROOM = 100_000
"""Things that one room is told; then another is."""


class FuzzError(AssertionError):
    """What the room must not do."""


class Told(NamedTuple):
    """What became of it."""

    count: int
    seconds: float
    megabytes_more: float
    refused: Counter[str]
    solver: Counter[str]
    """What reached the solver, by kind."""


class Clock:
    """The room's."""

    def __init__(self) -> None:
        self.t = 1.8e9

    def __call__(self) -> float:
        """Now, in s."""
        return self.t


class Watching:
    """In the solver's place: looks at what reaches it."""

    trouble: str | None = None

    def __init__(self, clock: Clock, names: Any) -> None:
        self.counted: Counter[str] = Counter()
        self._clock, self._names = clock, names

    def feed(self, command: Command) -> None:
        """Something that a device said."""
        self.counted[type(command).__name__] += 1
        match command:
            case Pose():
                numbers = (command.t, *command.position, *command.quat_xyzw)
                fine = all(map(isfinite, numbers)) and command.user in self._names()
            case Range():
                numbers = (command.t, command.distance, command.optional.get("sigma", 1.0))
                fine = all(map(isfinite, numbers)) and {command.a, command.b} <= set(self._names())
            case _:
                return
        if not fine or not self._clock.t - TOO_OLD <= command.t <= self._clock.t + FROM_THE_FUTURE:
            raise FuzzError(f"the solver was told {command!r}")

    def advance(self, t: float) -> None:
        """It is `t`."""

    def finish(self, t: float) -> None:
        """Nothing more comes after `t`."""

    async def drained(self) -> None:
        """It is never behind."""


class Fuzz:
    """A room, and who spoils what it is told."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.random, self.clock = random.Random(seed), Clock()
        self.lobby = Lobby(self.clock)
        self.recorder = FolderRecorder(folder)
        self.room = Room("CODE", self.clock, bytes(range(32)), self.recorder)
        self.solver = Watching(self.clock, lambda: self.room.devices.keys())
        self.room.solver = self.solver
        self.lobby.add(self.room)
        self.port = UdpPort(self.lobby, self.clock, "127.0.0.1", 0)
        self.clients: list[Client] = []
        self.secrets: dict[str, str] = {}
        self.refused: Counter[str] = Counter()
        self.sequence = 0
        for name in NAMES:
            self._enter(name)
        self._looking = self.room.connect(self.room.admit(m.Join("CODE"))[0])

    def step(self) -> None:
        """One thing comes."""
        self.clock.t += STEP_S
        kind = self.random.random()
        if kind < 0.45:
            self.port.hear(self._datagram(), ("127.0.0.1", 9))
        elif kind < 0.97:
            client = self.random.choice([*self.clients, self._looking])
            hear_word(self.room, client, self._poses(client) if kind < 0.65 else self._word(client))
        else:
            self._join()

    def tick(self) -> None:
        """What the room does by itself, and whether clients understand what they are told."""
        self.room.tick()
        for name in NAMES:
            if (device := self.room.devices[name]).client is None or device.client.outbox.closed:
                self._enter(name)
        self.clients = [client for client in self.room.clients if client.devices]
        if self._looking.outbox.closed:
            self._looking = self.room.connect(self.room.admit(m.Join("CODE"))[0])
        for client in self.room.clients:
            for word in client.outbox.take():
                decode_poses_down(word) if word[:1] != b"{" else m.decode_from_room(word)
        if self.random.random() < 0.002:
            self.room.disconnect(self.random.choice(self.clients))

    def goes_on(self) -> None:
        """Somebody joins, walks and ranges."""
        self.clock.t += 700.0  # whoever flooded is forgiven by then, and clocks of modules are forgotten
        before = self.solver.counted.copy()
        joined = self.lobby.join(m.Join("code", [m.UserSettings("afterwards")]), "10.0.0.99")
        room, ticket = self.lobby.redeem(joined.token)
        client = room.connect(ticket)
        hear_word(room, client, m.encode(m.Module("afterwards", 99)).decode())
        self._enter("alice")
        own = self.room.modules.users
        alice = next(address for address, name in own.items() if name == "alice") if "alice" in own.values() else 1
        hear_word(room, room.devices["alice"].client, m.encode(m.Module("alice", alice)).decode())  # type: ignore[arg-type]
        for n in range(60):
            self.clock.t += 0.05
            hear_word(room, client, encode_poses_up([PoseUp(0, 0, n, self.clock.t, (0.1 * n, 0.0, 0.0), (0, 0, 0, 1))]))
            told = self._ranges(99, alice, n, 4000, 77)
            self.port.hear(encode_ranges(told, self.room.modules.keys.of(99)), ("127.0.0.1", 9))
        counted = self.solver.counted - before
        if counted["Pose"] < 60 or counted["Range"] < 60:
            raise FuzzError(f"afterwards the room did not go on: {counted}, {self.room.status().refused}")

    def close(self) -> None:
        """Nothing stays open."""
        self.port.close()
        self.recorder.close()

    def counted(self) -> Counter[str]:
        """Everything that was refused, by reason."""
        told = Counter(self.room.status().refused)
        for device in self.room.devices.values():
            told += device.refused
        return told + self.refused

    def _enter(self, name: str) -> None:
        """A device that comes, or comes again."""
        settings = m.UserSettings(name, antennas={"left": (0.1, 0.0, 0.0)} if name == "bob" else {})
        ticket, self.secrets[name] = self.room.admit(m.Join("CODE", [settings], resume=self.secrets.get(name)))
        client = self.room.connect(ticket)
        hear_word(self.room, client, m.encode(m.Module(name, NAMES.index(name) + 1)).decode())
        self.clients = [other for other in self.clients if not other.outbox.closed] + [client]

    def _datagram(self) -> bytes:
        reporter = self.random.randrange(1, 5)
        self.sequence += self.random.choice((1, 1, 1, 0, -3, 1000))
        mm = self.random.choice((4000, 4000, 25000, -50, -5000, 9_999_999))
        told = self._ranges(reporter, self.random.randrange(1, 5) % 4 + 1, max(self.sequence, 0), mm, 9)
        key = self.room.modules.keys.of(reporter)
        if self._sane():
            return _signed(told, key)
        whole = _signed(told, key)
        spoilt = self._spoil(whole)
        if len(spoilt) > TAG_SIZE and self.random.random() < 0.5:
            body = spoilt[:-TAG_SIZE]
            if self.random.random() < 0.9:  # after a sequence that is far ahead nothing else of it is taken
                body = body[: _SEQUENCE.start] + whole[_SEQUENCE] + body[_SEQUENCE.stop :]
            spoilt = body + blake2s(body, digest_size=TAG_SIZE, key=key).digest()
        return spoilt

    def _ranges(self, reporter: int, peer: int, sequence: int, mm: int, epoch: int) -> RangesDatagram:
        row = (peer, 0, MEASURED, mm, 0, 0, 50, -8000, -8100, 0, 0)
        rows = np.array([row] * self.random.choice((1, 1, 3, 32)), RANGE)
        return RangesDatagram(self.room.modules.session, reporter, sequence, epoch, round(1e9 * self.clock.t), 0, rows)

    def _poses(self, client: Client) -> bytes:
        stamp = self.clock.t + self.random.choice((0.0, 0.0, 0.0, -0.2, 5.0, -50.0, 1e9, float("nan"), float("inf")))
        own = client.devices[0].frame if client.devices else 0
        frame = self.random.choice((own, own, own, 0, 255))
        x = self.random.choice((0.0, 1.0, -3.0, 5.0, 1e9, float("nan"), -float("inf")))
        user = self.random.choice((0, 0, 0, 0, 1, 65535))
        count = self.random.choice((1, 1, 1, 1, 1, 1, 1, 1, 5, 5, 256, 300))
        poses = encode_poses_up([PoseUp(user, frame, 1, stamp, (x, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))] * count)
        return poses if self._sane() else self._spoil(poses)

    def _word(self, client: Client) -> str:
        someone = self.random.choice((client.name or "alice", client.name or "alice", *NAMES))
        word = self.random.choice(self._words(someone))
        if self._sane():
            return m.encode(word).decode()
        if self.random.random() < 0.3:
            return self._spoil(m.encode(word)).decode("utf-8", "replace")
        return self._spoil_json(json.loads(m.encode(word)))

    def _words(self, someone: str) -> list[Any]:
        t, place = self.clock.t, (1.0, 2.0, 0.5)
        return [
            m.Hello("guessed"),
            m.Ping(t, 0.01, 0.02),
            m.Ranges([m.MeasuredRange(t, someone, "bob", 3.0, 0.1, None, "left", -80.0, -81.0, False, "phone")] * 3),
            m.Reset(someone, self.random.randrange(-3, 300)),
            m.Lost(someone),
            m.Module(someone, self.random.randrange(-2, 0x10001)),
            m.Clock(t + 1e6),
            m.Finish(t),
            m.Create(
                f"o{self.random.randrange(5000)}", "coin", place, user=self.random.choice((None, someone)), data={}
            ),
            m.Grab(f"o{self.random.randrange(50)}"),
            m.Move(f"o{self.random.randrange(50)}", place, velocity=place, data="x" * self.random.randrange(9000)),
            m.Release(f"o{self.random.randrange(50)}"),
            m.Remove(f"o{self.random.randrange(50)}"),
            m.Heartbeat(),
            m.Say("wave", [1, 2, {"hand": "left"}], self.random.choice((None, someone))),
            m.Signal(someone, {"sdp": "..."}),
            m.Leave(),
        ]

    def _join(self) -> None:
        """Somebody asks for a token, and uses it, or not."""
        name = self.random.choice((*TEXTS, "eve", "bob~3", f"guest{self.random.randrange(100)}"))
        settings = {"name": name, "up": "y", "height_sigma": 0.1, "antennas": {"tip": [0.0, 0.1, 0.0]}}
        code = self.random.choice(("CODE", "CODE", "CODE", "WRONG"))
        asked = {"room": code, "users": [settings], "time": self.random.choice(("live", "recorded")), "resume": "abc"}
        body = json.dumps(asked) if self._sane() else self._spoil_json(asked)
        address = f"10.0.{self.random.randrange(3)}.{self.random.randrange(250)}"
        try:
            token = self.lobby.join(m.decode_join(body.encode("utf-8", "replace")), address).token
            if self.random.random() < 0.3:
                room, ticket = self.lobby.redeem(token)
                room.disconnect(room.connect(ticket))
            self.lobby.redeem("guessed")
        except MessageError as error:
            self.refused[f"join {error.reason}"] += 1

    def _sane(self) -> bool:
        return self.random.random() < 0.1

    def _spoil(self, data: bytes) -> bytes:
        out, r = bytearray(data), self.random
        for _ in range(r.choice((1, 1, 2, 5))):
            at = r.randrange(len(out) + 1)
            match r.randrange(7):
                case 0:
                    out[at : at + 1] = bytes([r.randrange(256)])
                case 1 if at < len(out):
                    out[at] ^= 1 << r.randrange(8)
                case 2:
                    del out[at:]
                case 3:
                    out[at:at] = r.randbytes(r.choice((1, 8, 56, 3000)))
                case 4:
                    out[at : at + 8] = struct.pack("<d", r.choice((float("nan"), float("inf"), -1e300, 5e-324)))
                case 5:
                    out[at : at + 8] = struct.pack("<Q", r.choice((0, 2**64 - 1, 2**63, 2**62 + 1)))
                case _:
                    out[at:at] = out[: r.randrange(len(out) + 1)]
        return bytes(out)

    def _spoil_json(self, word: dict[str, Any]) -> str:
        r = self.random
        mark, mark_in_text = "\x01", json.dumps("\x01")
        holder: Any = word
        while True:
            keys = list(holder) if isinstance(holder, dict) else range(len(holder))
            if not keys:
                break
            key = r.choice(keys)
            if isinstance(holder[key], dict | list) and r.random() < 0.8:
                holder = holder[key]
                continue
            if r.random() < 0.1 and isinstance(holder, dict):
                del holder[key]
            else:
                holder[key] = mark
            break
        nested = "[" * NESTED + "]" * NESTED
        instead = r.choice((*NUMBERS, *map(json.dumps, TEXTS), nested, '"' + "x" * 70_000 + '"', "{}", "[[]]", "true"))
        return json.dumps(word).replace(mark_in_text, instead)


def _signed(told: RangesDatagram, key: bytes) -> bytes:
    """Whatever is told, with the right tag; a reporter that ranges with itself is told by the bytes alone."""
    peers = told.ranges["peer"]
    peers[peers == told.reporter] = told.reporter % 4 + 1
    return encode_ranges(told, key)


async def fuzz(count: int, seed: int) -> Told:
    """Raises whatever a room should not have raised."""
    began, first_mb, said = perf_counter(), 0.0, 0
    refused: Counter[str] = Counter()
    solver: Counter[str] = Counter()
    while said < count:
        with tempfile.TemporaryDirectory() as folder:
            fuzzing = Fuzz(Path(folder), seed + said)
            try:
                for n in range(min(A_ROOM, count - said)):
                    fuzzing.step()
                    if n % TICK_EVERY == 0:
                        fuzzing.tick()
                    if n % FLUSH_EVERY == 0:
                        fuzzing.recorder.flush()
                    said += 1
                    if said == count // 10:
                        first_mb = resident_mb()
                fuzzing.goes_on()
            finally:
                fuzzing.close()
            refused += fuzzing.counted()
            solver += fuzzing.solver.counted
    more = resident_mb() - first_mb
    if more > MORE_MB:
        raise FuzzError(f"memory grew by {more:.0f} MB")
    return Told(count, perf_counter() - began, more, refused, solver)


def main() -> None:
    """Print what became of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    told = asyncio.run(fuzz(arguments.count, arguments.seed))
    print(f"{told.count} said, nothing raised; {told.count / told.seconds:.0f} a second; {told.megabytes_more:+.1f} MB")
    print("refused:", ", ".join(f"{reason} {n}" for reason, n in sorted(told.refused.items())))
    print("taken:", ", ".join(f"{kind} {n}" for kind, n in sorted(told.solver.items())))


if __name__ == "__main__":
    main()
