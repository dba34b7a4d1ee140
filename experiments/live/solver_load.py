"""A room's solver by itself, by the CPU's clock: how far it falls behind, what it costs and what it holds.

`python -m experiments.live.solver_load [--devices 32] [--minutes 4] [--seed 0] [--slow 1.0]`: what
`experiments.live.load` has its devices say (poses 60 times a second, ranges to ten neighbours 10 times a second) goes
through a room's own feeding of its solver into that solver, without server, sockets and pace. Time is simulated: the
solver and its search have a core each, and what they do takes as long as the CPU time that it took here, however busy
this machine is (`--slow`: times that). So it says what a room of so many devices would see, except for what its own
loop costs.

Told are, minute by minute of the room's time: how far behind the solver was (s, median and most), CPU (s a second) of
the solver and of the search, updates a second and the time of one (ms, median, 99 % and most), searches and the time of
one (s, median and most), resident memory (MB) of both, of the room's feeding what it keeps (commands), how many are
registered, and how much was spared.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

import synchronizar.estimation.incremental.engine as engine
from experiments.common.cpu import Usage, usage_of
from experiments.common.markdown import markdown
from experiments.common.results import write_table
from experiments.live.load import EACH_SIDE, POSES_HZ, RANGES_HZ, SIGMA_M, place
from synchronizar.estimation.incremental.searcher import Searcher
from synchronizar.estimation.incremental.snapshot import Found, Snapshot
from synchronizar.live import messages as m
from synchronizar.live.estimating import Solving
from synchronizar.live.room import UPDATES_A_SECOND
from synchronizar.live.solver import SolverProcess
from synchronizar.live.solver_wire import AddUser, Begin, Block, Pose, Range, Saved, Told
from synchronizar.quaternions import yaw_quaternion

_now = 0.0
"""s: the solver's moment."""
_slow = 1.0


@dataclass
class Minute:
    """What happened in one minute of the room's time."""

    behind: list[float] = field(default_factory=list)
    updates: list[float] = field(default_factory=list)
    searches: list[float] = field(default_factory=list)
    saves: list[float] = field(default_factory=list)


class SearchBeside(Searcher):
    """Waits for its process, and says what was found when the CPU time that it took has gone by."""

    latest: ClassVar[SearchBeside | None] = None
    took: ClassVar[deque[float]] = deque()

    def __init__(self, workers: int) -> None:
        super().__init__(workers)
        SearchBeside.latest = self
        self._due = 0.0

    def begin(self, snapshot: Snapshot) -> None:
        """Search now."""
        before = self.usage().cpu
        super().begin(snapshot)
        running = self._running
        assert running is not None
        while not running.done():
            time.sleep(0.001)
        took = _slow * (self.usage().cpu - before)
        self._due = _now + took
        self.took.append(took)

    def poll(self) -> tuple[bool, Found | None]:
        """It has not ended before then."""
        return (False, None) if self._running is not None and _now < self._due else super().poll()

    def abandon(self) -> None:
        """One that is going on is ended, with its process."""
        if self._running is not None and _now < self._due:
            self._running = Future()
        super().abandon()

    def usage(self) -> Usage:
        """Of its process."""
        return Usage(0.0, 0.0) if self._process is None else usage_of(self._process.pid)[0]


class Feeding(SolverProcess):
    """A room's own feeding, with a solver in this process that has a time of its own."""

    def __init__(self, state: Path) -> None:
        self.told: Told | None = None
        self.events: list[str] = []
        self.minute = Minute()
        begin = Begin(1)
        super().__init__(self._take, lambda _: None, self.events.append, state, begin)
        self._solving = Solving(begin)
        self._under_way: deque[Block] = deque()
        self._answers: deque[tuple[float, Told | Saved]] = deque()
        self._free = 0.0

    def _take(self, told: Told) -> None:
        self.told = told

    @property
    def kept(self) -> int:
        """Commands that would be said again to a solver that is begun anew."""
        return self._kept_commands

    def _send(self) -> None:
        super()._send()
        self._under_way.append(self._kept[-1])

    def go_on(self, t: float) -> None:
        """It is `t` (s): the solver has done what it could until now."""
        global _now
        while self._under_way and self._free <= t:
            block = self._under_way.popleft()
            _now = max(self._free, t)
            began, replies = time.process_time(), []
            for command in block.commands:
                if (reply := self._solving.do(command, block.serial)) is not None:
                    replies.append(reply)
            took = _slow * (time.process_time() - began)
            self._free = _now + took
            self.minute.updates.append(took)
            self._answers.extend((self._free, reply) for reply in replies if isinstance(reply, Told | Saved))
        while self._answers and self._answers[0][0] <= t:
            self._hear(self._answers.popleft()[1])
        self.minute.behind.append(t - (0.0 if self.told is None else self.told.t))


def feed(feeding: Feeding, devices: int, seconds: float, seed: int, every: float, note: Any) -> None:
    """Everybody walks; `note` is called each `every` s."""
    random = np.random.default_rng(seed)
    names = [f"room{seed}-{device:02d}" for device in range(devices)]
    for name in names:
        feeding.feed(AddUser(m.UserSettings(name)))
    starts = [place(seed, device, 0.0) for device in range(devices)]
    noted = every
    step = 1.0 / POSES_HZ
    for n in range(int(seconds * POSES_HZ)):
        t = n * step
        for device in range(devices):
            at = t + step * (0.618 * device % 1.0)
            turn = 0.7 * device
            c, s = np.cos(turn), np.sin(turn)
            x, y, z = (place(seed, device, at) - starts[device]).tolist()
            quat = yaw_quaternion(0.1 * at - turn).tolist()
            feeding.feed(Pose(names[device], at, (float(c * x + s * y), float(c * y - s * x), z), quat))
        if n % round(POSES_HZ / RANGES_HZ) == 0:
            for device in range(devices):
                at = t - 0.5 * step
                mine = place(seed, device, at)
                for k in range(1, EACH_SIDE + 1):
                    peer = (device + k) % devices
                    d = float(np.linalg.norm(mine - place(seed, peer, at))) + SIGMA_M * random.standard_normal()
                    optional = {"source": "module", "sigma": SIGMA_M, "rx_power": -80.0, "fp_power": -81.0}
                    feeding.feed(Range(at, names[device], names[peer], max(0.0, d), optional))
        if n % round(POSES_HZ / UPDATES_A_SECOND) == 0:
            feeding.advance(t)
        feeding.go_on(t)
        if t >= noted:
            noted += every
            note(t)


def main() -> None:
    """The table."""
    global _slow
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--devices", type=int, default=32)
    parser.add_argument("--minutes", type=float, default=4.0)
    parser.add_argument("--every", type=float, default=60.0, help="s")
    parser.add_argument("--slow", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    _slow = options.slow
    engine.Searcher = SearchBeside  # type: ignore[attr-defined, misc]
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        feeding = Feeding(Path(folder) / "state.npz")

        def note(t: float) -> None:
            minute, feeding.minute = feeding.minute, Minute()
            searches = list(SearchBeside.took)
            SearchBeside.took.clear()
            search = Usage(0.0, 0.0) if SearchBeside.latest is None else SearchBeside.latest.usage()
            users = {} if feeding.told is None else feeding.told.users
            updates = 1000.0 * np.array(minute.updates)
            rows.append(
                {
                    "s": round(t),
                    "behind s, median": float(np.median(minute.behind)),
                    "behind, most": max(minute.behind),
                    "solver cores": sum(minute.updates) / options.every,
                    "search cores": sum(searches) / options.every,
                    "updates/s": len(updates) / options.every,
                    "update ms p50": float(np.median(updates)),
                    "p99": float(np.quantile(updates, 0.99)),
                    "update, most": updates.max(),
                    "searches": len(searches),
                    "search s p50": float(np.median(searches or [0.0])),
                    "search, most": max(searches, default=0.0),
                    "solver MB": usage_of(os.getpid())[0].megabytes,
                    "search MB": search.megabytes,
                    "kept": feeding.kept,
                    "registered": sum(user.state == "registered" for user in users.values()),
                    "spared": 0 if feeding._spared is None else feeding._spared.step,
                }
            )
            print(rows[-1], feeding.events[-3:], flush=True)

        feed(feeding, options.devices, 60.0 * options.minutes, options.seed, options.every, note)
    write_table("solver_load", rows, {**vars(options), "cores": os.cpu_count(), "load": os.getloadavg()})
    print(markdown(rows, digits=2))


if __name__ == "__main__":
    main()
