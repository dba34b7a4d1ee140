"""The simulated air while people walk: modules are added, carried about and switched off as it runs.

The program `synchronizar-air --live` runs beside this one; its modules' datagrams go to a collector's UDP port on this
machine, and what the collector sends back reaches the modules (firmware/targets/host/SCENARIO.md). Nothing here waits
for it: what it is told is written as far as it takes it, what it says is read by a thread.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from select import select
from threading import Thread
from types import TracebackType
from typing import IO, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from synchronizar.errors import InputError
from synchronizar.simulation.air import PROGRAM, program
from synchronizar.simulation.scenario import CHANNEL, PRF_MHZ, ROOM_C

MOST_BEHIND = 1 << 20
"""Bytes that the program has not taken: an hour of a walker's places. More, and it does not keep up."""
MOST_FAULTS = 100
"""Faults that are kept, the newest."""
END_S = 5.0
"""s: how long the program is waited for at the end."""


class Carried(NamedTuple):
    """A module: its key, its crystals, its antenna delay."""

    key: bytes
    """Its own, as the room gave it."""
    ppm: float = 0.0
    """Relative rate error of its radio's crystal; positive is fast."""
    board_ppm: float = 0.0
    """The same of its board's crystal."""
    range_bias: float = 0.0
    """m: bias of its ranges from a wrong antenna delay."""


class Sent(NamedTuple):
    """A datagram that a module has sent to the collector."""

    t: float
    """s: when it came there."""
    module: int
    measured: float
    """s: when its newest range was measured; NaN where it has none, or its module is in another network by now."""


class LiveAir:
    """The air of one session.

    Time is the caller's own (s, at least 0): the air runs to the newest place of the module that has told the least,
    and no further; who has no place yet does not range. Raises InputError where the program is missing, has ended or
    does not keep up. `on_sent` is called, by another thread, with each datagram.
    """

    def __init__(
        self,
        session: int,
        port: int,
        seed: int = 0,
        *,
        scheme: str = "one-to-n",
        stamp_sigma: float = 0.03,
        frame_loss: float = 0.0,
        on_sent: Callable[[Sent], None] | None = None,
    ) -> None:
        self.t = 0.0
        """s: how far it has run, by what it said last."""
        self.datagrams = 0
        """Number of datagrams that it has sent to the collector."""
        self.states: dict[int, str] = {}
        """What each module does now, in the program's words, by address."""
        self.faults: deque[str] = deque(maxlen=MOST_FAULTS)
        """Lines that it did not understand, each with what is wrong with it."""
        self._on_sent = on_sent
        self._behind = b""
        settings = [
            "air 1",
            f"session {session}",
            f"seed {seed}",
            f"scheme {scheme}",
            f"channel {CHANNEL}",
            f"prf {PRF_MHZ}",
            f"stamp_sigma {stamp_sigma}",
            f"frame_loss {frame_loss}",
        ]
        self._process = _start("".join(f"{line}\n" for line in settings), port)
        assert self._process.stdin is not None
        os.set_blocking(self._process.stdin.fileno(), False)
        self._threads = [Thread(target=read, daemon=True) for read in (self._read_events, self._read_faults)]
        for thread in self._threads:
            thread.start()

    def add(self, address: int, module: Carried) -> None:
        """A module, that has power from its first place on."""
        self._tell(
            f"module {address} {module.key.hex()} ppm {module.ppm} board_ppm {module.board_ppm} "
            f"antenna_delay_error {module.range_bias} temperature {ROOM_C}"
        )

    def place(self, address: int, t: float, xyz: ArrayLike) -> None:
        """Where a module's antenna is at t (s), xyz (3,) m; straight lines between one place and the next."""
        x, y, z = np.asarray(xyz, dtype=float).tolist()
        self._tell(f"at {address} {t!r} {x!r} {y!r} {z!r}")

    def places(self, t: float, xyz: Mapping[int, ArrayLike]) -> None:
        """The same of several modules, by address."""
        for address, place in xyz.items():
            self.place(address, t, place)

    def stay(self, address: int) -> None:
        """A module does not move from its newest place on, until its next; so long nobody waits for it."""
        self._tell(f"stay {address}")

    def off(self, address: int) -> None:
        """A module has no power any more; it may be added again."""
        self._tell(f"off {address}")

    def block(self, a: int, b: int, begin: float, end: float, extra: float) -> None:
        """Signals between two modules come `extra` m longer from begin to before end (s)."""
        self._tell(f"blocked {a} {b} {begin!r} {end!r} {extra!r}")

    def close(self) -> None:
        """End the program, once it has run as far as it was told."""
        assert self._process.stdin is not None
        way = self._process.stdin.fileno()
        with suppress(OSError):
            while self._behind and select([], [way], [], END_S)[1]:
                self._behind = self._behind[os.write(way, self._behind) :]
        self._process.stdin.close()
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for thread in self._threads:
            thread.join()
        for stream in (self._process.stdout, self._process.stderr):
            assert stream is not None
            stream.close()

    def __enter__(self) -> LiveAir:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _tell(self, line: str) -> None:
        """Write a line as far as the program takes it; the rest goes with the next."""
        if self._process.poll() is not None:
            raise InputError(PROGRAM, self.faults[-1] if self.faults else "has ended")
        assert self._process.stdin is not None
        self._behind += line.encode("ascii") + b"\n"
        with suppress(BlockingIOError, BrokenPipeError):
            self._behind = self._behind[os.write(self._process.stdin.fileno(), self._behind) :]
        if len(self._behind) > MOST_BEHIND:
            raise InputError(PROGRAM, "does not keep up with what it is told")

    def _read_events(self) -> None:
        for line in _lines(self._process.stdout):
            match line.split():
                case ["sent", t, module, _, measured]:
                    self.t = float(t)
                    self.datagrams += 1
                    if self._on_sent is not None:
                        told = float("nan") if measured == "-" else float(measured)
                        self._on_sent(Sent(self.t, int(module), told))
                case ["said", t, "node", address, *words]:
                    self.t = float(t)
                    self.states[int(address)] = " ".join(words)
                case _:
                    pass

    def _read_faults(self) -> None:
        for line in _lines(self._process.stderr):
            self.faults.append(line.strip().removeprefix(f"{PROGRAM}: "))


def _start(settings: str, port: int) -> subprocess.Popen[bytes]:
    """The program, started; the file of settings has no name."""
    with tempfile.TemporaryFile() as file:
        file.write(settings.encode("ascii"))
        file.seek(0)
        pipe = subprocess.PIPE
        try:
            return subprocess.Popen(
                [program(), f"/dev/fd/{file.fileno()}", "--port", str(port), "--live"],
                stdin=pipe,
                stdout=pipe,
                stderr=pipe,
                bufsize=0,
                pass_fds=[file.fileno()],
            )
        except OSError as fault:
            raise InputError(PROGRAM, str(fault)) from fault


def _lines(stream: IO[bytes] | None) -> Iterator[str]:
    """Lines as they come; buffered here, since the pipe is not."""
    assert stream is not None
    rest = b""
    while some := stream.read(1 << 16):
        *whole, rest = (rest + some).split(b"\n")
        yield from (line.decode("ascii", "backslashreplace") for line in whole)
