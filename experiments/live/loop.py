"""A server's loop by the CPU's clock: how late it would be on a core of its own, however busy the machine is.

`python -m experiments.live.loop [--devices 32 48 64] [--seconds 20] [--profile]`: the server and the clients of
`experiments.live.load` in one process and one loop, over real sockets, so that the clients' work delays the server
besides. Time is this process's CPU time, and what it would have slept is skipped. In the solver's place stands one that
answers at once, with every frame changed each time (what it is told and says is encoded and decoded as for a process);
ranges come as modules' datagrams, each device's ten neighbours ten times a second. The room is recorded.

Told are, as in `load`, how late the loop is, the time from a pose's stamp to its arrival, words lost, and CPU seconds a
second, the clients' among them.
"""

from __future__ import annotations

import argparse
import asyncio
import cProfile
import os
import pstats
import selectors
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from experiments.common.markdown import markdown
from experiments.common.results import write_table
from experiments.live.load import EACH_SIDE, Heard, Task, _generate, lost_words, quantile_ms
from synchronizar.geometry import YawFrame
from synchronizar.live import Client
from synchronizar.live import messages as m
from synchronizar.live.room import Room
from synchronizar.live.room_host import RoomHost
from synchronizar.live.server import Server, ServerOptions
from synchronizar.live.solver_wire import (
    LENGTH,
    AddUser,
    Begin,
    Block,
    Command,
    NewestRange,
    Told,
    framed,
    reply_decoder,
)

_SINCE = time.time()
_skipped = 0.0


def cpu_clock() -> float:
    """CPU time, and sleep that was skipped (s)."""
    return time.process_time() + _skipped


class _Skips(selectors.DefaultSelector):
    """Sleeps in no time at all."""

    def select(self, timeout: float | None = None) -> Any:
        global _skipped
        ready = super().select(None if timeout is None else 0.0)
        if not ready and timeout is not None:
            _skipped += max(0.0, timeout)
        return ready


class _Loop(asyncio.SelectorEventLoop):
    def __init__(self) -> None:
        super().__init__(_Skips())

    def time(self) -> float:
        return cpu_clock()


class Told10Hz:
    """Says at once that everybody is registered, and a little elsewhere than before."""

    trouble: str | None = None

    def __init__(self, room: Room) -> None:
        self._room = room
        self._pending: list[Command] = []
        self._users: list[m.UserSettings] = []
        self._random = np.random.default_rng(0)
        self._serial = 0

    def feed(self, command: Command) -> None:
        """Kept until the next question."""
        self._pending.append(command)
        if isinstance(command, AddUser):
            self._users.append(command.user)

    def advance(self, t: float) -> None:
        """Encode what came, decode what is told."""
        self._serial += 1
        framed(Block(self._serial, self._pending))
        self._pending = []
        names = [user.name for user in self._users]
        pairs = [(names[i], names[(i + k) % len(names)]) for i in range(len(names)) for k in range(1, EACH_SIDE + 1)]
        ranges = [NewestRange(t, a, b, 3.123456789, 0.0123456789, True) for a, b in pairs]
        told = Told(t, self._serial, names[0], {name: self._frame() for name in names}, [], ranges, 0.01)
        decoded = reply_decoder.decode(framed(told)[LENGTH.size :])
        assert isinstance(decoded, Told)
        self._room.told(decoded)

    def finish(self, t: float) -> None:
        """Nobody asks."""

    async def drained(self) -> None:
        """It always is."""

    def _frame(self) -> m.UserFrame:
        x, y, yaw, *rest = self._random.normal(size=19).tolist()
        frame = YawFrame(x, y, 0.1, yaw, 1.001)
        covariance: Any = [rest[4 * row : 4 * row + 4] for row in range(4)]
        return m.UserFrame(
            *("registered", "", 0, frame.matrix.tolist(), x, y, 0.1, yaw, 1.001, covariance), 0.05, 0.001, 1.0, None
        )


async def _run(devices: int, seconds: float) -> tuple[list[m.Lag], Heard, float]:
    with tempfile.TemporaryDirectory() as folder:
        options = ServerOptions(
            host="127.0.0.1", port=0, udp_port=0, tls=False, keep_awake=True, record=Path(folder) / "rooms"
        )
        server = Server(options, None)
        where: Any = await server.start()
        try:
            begin = time.time() + 2.0 + 0.1 * devices
            task = Task(where["join"], where["udp_port"], tuple(range(devices)), devices, 0, 0, begin, seconds)
            lag: list[m.Lag] = []
            async with await Client.join(where["join"]) as watching:
                running = asyncio.create_task(_generate(task))
                used = [time.process_time()]
                async for message in watching.messages():
                    if isinstance(message, m.Status) and message.lag is not None:
                        if time.time() > begin + 5.0:
                            lag.append(message.lag)
                        else:
                            used = [time.process_time(), time.time()]
                    if running.done() or time.time() > begin + seconds - 3.0:
                        break
                cores = (time.process_time() - used[0]) / (time.time() - used[1])
                return lag, await running, cores
        finally:
            await server.close()


def run(devices: int, seconds: float) -> dict[str, Any]:
    """A line of the table."""
    with asyncio.Runner(loop_factory=_Loop) as runner:
        lag, heard, cores = runner.run(_run(devices, seconds))
    return {
        "devices": devices,
        "s": seconds,
        "loop p50 ms": lag[-1].median,
        "loop p99 ms": lag[-1].p99,
        "poses p50 ms": quantile_ms(heard.delays, 0.5),
        "poses p99 ms": quantile_ms(heard.delays, 0.99),
        "words": sum(map(len, heard.words.values())),
        "words lost": lost_words([heard]),
        "cores, with the clients'": cores,
        "load": os.getloadavg()[0],
    }


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--devices", type=int, nargs="+", default=[32, 48, 64])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--profile", action="store_true")
    options = parser.parse_args()
    _take_clock()
    rows = []
    for devices in options.devices:
        with cProfile.Profile(time.process_time) as profile:
            if not options.profile:
                profile.disable()
            rows.append(run(devices, options.seconds))
        print(rows[-1], flush=True)
        if options.profile:
            pstats.Stats(profile).sort_stats("tottime").print_stats(30)
    write_table("loop", rows, {**vars(options), "cores": os.cpu_count(), "load": os.getloadavg()})
    print(markdown(rows, digits=2))


def _take_clock() -> None:
    """Everybody in this process goes by it, and a room's solver is the one that answers at once."""

    def solve(self: RoomHost, begin: Begin) -> None:  # noqa: ARG001
        self.room.solver = Told10Hz(self.room)

    time.monotonic = cpu_clock
    time.time = lambda: _SINCE + cpu_clock()
    RoomHost._solve = solve  # type: ignore[method-assign]


if __name__ == "__main__":
    main()
