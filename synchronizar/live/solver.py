"""A room's solver: a process of its own that is fed and asked, and begun again where it dies."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import time
from asyncio.subprocess import PIPE, Process
from collections import deque
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from synchronizar.live.pacing import Pacing
from synchronizar.live.restarts import TOLD_FROM_S, Restarts
from synchronizar.live.solver_wire import (
    LENGTH,
    Advance,
    Begin,
    Block,
    Command,
    Finish,
    Finished,
    NewFrame,
    Pose,
    Range,
    Save,
    Saved,
    Told,
    framed,
    reply_decoder,
)
from synchronizar.live.sparing import RANGES_S, Sparing

SAVED_EVERY = 5.0
"""s between states that are written; what came since is kept and said again to a process that is begun anew."""
_MOST_UNANSWERED = 2
"""Questions on their way at most: what comes meanwhile goes in one block, so that a slow solver skips moments."""
_MOST_KEPT = 200_000
"""Commands that are kept while there is no state yet."""
_ENDS_WITHIN_S = 0.5


class Solver(Protocol):
    """What a room needs of whoever solves it."""

    trouble: str | None
    """Why nothing is solved just now, in one sentence; None where it works."""

    def feed(self, command: Command) -> None:
        """Something that a device said."""

    def advance(self, t: float) -> None:
        """It is `t`: tell what is known."""

    def finish(self, t: float) -> None:
        """Nothing more comes after `t`: tell the answer."""

    async def drained(self) -> None:
        """Until nearly everything that was asked is answered."""


class SolverProcess:
    """Feeds the process `estimating` and hears it; the caller never waits."""

    def __init__(
        self,
        told: Callable[[Told], None],
        finished: Callable[[dict[str, Any]], None],
        event: Callable[[str], None],
        state: Path,
        begin: Begin,
        saved: Callable[[int, dict[str, int]], None] | None = None,
        saving: Callable[[int], None] | None = None,
        clock: Callable[[], float] = time.monotonic,
        rest: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        """`told`, `finished` and `event` hear what comes.

        `state` is the file for its state: `saving` hears the block that asks for it, `saved` the block and all devices'
        frames then, once it is written. `clock` (s) and `rest` say how long the process lives, and is left alone.
        """
        self.trouble: str | None = None
        self.closed = False
        self._restarts, self._rest = Restarts(clock), rest
        self._news_from = 0
        self._told, self._finished, self._event = told, finished, event
        self._saving_hook, self._saved_hook = saving, saved
        self._state, self._begin = state, begin
        self._spared = None if begin.workers == 0 else Sparing()
        """Nothing is left out where the answer must not hang on how fast things come."""
        self._heard_of: float | None = None
        self._pacing = Pacing()
        self._serial = 0
        self._pending: list[Command] = []
        self._kept: deque[Block] = deque()
        self._kept_commands = 0
        self._unanswered: deque[int] = deque()
        self._frames: dict[str, int] = dict(begin.frames)
        self._saving: tuple[int, dict[str, int]] | None = None
        self._save_at: float | None = None
        self._process: Process | None = None
        self._drained = asyncio.Event()
        self._drained.set()

    @property
    def restarts(self) -> int:
        """How often its process ended by itself."""
        return self._restarts.all

    @property
    def serial(self) -> int:
        """Of the latest block."""
        return self._serial

    @property
    def process_id(self) -> int | None:
        """Of its process, while there is one."""
        return None if self._process is None else self._process.pid

    def feed(self, command: Command) -> None:
        """Something that a device said; it goes with the next question."""
        if isinstance(command, NewFrame):
            self._frames[command.user] = command.frame
        if self._spared is None or self._spared.takes(command):
            self._pending.append(command)
        if len(self._pending) > _MOST_KEPT and self._spared is not None:
            self._pending = _without_measured(self._pending)  # it has said nothing for a minute or so

    def advance(self, t: float) -> None:
        """Ask what is known at `t`. One that is behind, or busy, is asked less often, unless time is recorded."""
        if self._spared is not None:
            if self._spared.update(t, 0.0 if self._heard_of is None else t - self._heard_of):
                self._event(_sparing(self._spared.step))
            if len(self._unanswered) >= _MOST_UNANSWERED or not self._pacing.is_due(t):
                return
        self._pending.append(Advance(t))
        self._unanswered.append(self._serial + 1)
        if self._save_at is None:
            self._save_at = t + SAVED_EVERY
        elif t >= self._save_at and self._saving is None:
            self._save_at = t + SAVED_EVERY
            self._pending.append(Save(str(self._state)))
            self._saving = self._serial + 1, dict(self._frames)
            if self._saving_hook is not None:
                self._saving_hook(self._serial + 1)
        self._send()

    def finish(self, t: float) -> None:
        """Ask for the answer."""
        self._pending.append(Finish(t))
        self._send()

    async def drained(self) -> None:
        """Wait until the solver has answered nearly all: for who feeds faster than anybody walks."""
        await self._drained.wait()

    async def run(self) -> None:
        """Keep the process going until `close`."""
        while not self.closed:
            self._restarts.began()
            self._news_from = self._serial + 1
            with suppress(OSError, asyncio.IncompleteReadError):  # a machine without memory begins no process either
                await self._run_once()
            if self.closed:
                return
            wait = self._restarts.ended()
            self._tell_of_end(wait)
            await self._rest(wait)

    async def close(self) -> None:
        """End the process."""
        self.closed = True
        if self._process is not None:
            _signal(self._process, signal.SIGTERM)
            await self._process.wait()

    def _tell_of_end(self, wait: float) -> None:
        """It ended by itself, and is left alone for `wait` s."""
        if self._restarts.blames_what_came:
            # What it is told makes it die: go on from the state before, without what came since.
            self._forget_measured()
            lost = "what was measured since its last state is left out"
        else:
            lost = "nothing that was measured is lost"
        if wait < TOLD_FROM_S:
            self._event(f"the solver ended by itself and is begun again; {lost}")
            return
        n = self._restarts.in_a_row
        self.trouble = f"the solver has ended {n} times in a row: it is begun again {wait:.0f} s after its last end"
        self._event(f"{self.trouble}; {lost}")

    async def _run_once(self) -> None:
        command = (sys.executable, "-m", "synchronizar.live.estimating")
        self._process = process = await asyncio.create_subprocess_exec(
            *command, stdin=PIPE, stdout=PIPE, limit=2**20, start_new_session=True
        )
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdin.write(framed(self._begin))
            self._unanswered.clear()
            self._saving = None
            for block in self._kept:
                process.stdin.write(framed(block))
                self._unanswered.extend(block.serial for command in block.commands if isinstance(command, Advance))
            while True:
                (size,) = LENGTH.unpack(await process.stdout.readexactly(LENGTH.size))
                self._hear(reply_decoder.decode(await process.stdout.readexactly(size)))
        finally:
            # It has ended, or is about to: to kill it at once would reap it before the loop does, which warns.
            try:
                await asyncio.wait_for(process.wait(), _ENDS_WITHIN_S)
            except TimeoutError:
                _signal(process, signal.SIGKILL)
                await process.wait()
            self._process = None

    def _send(self) -> None:
        self._serial += 1
        block = Block(self._serial, self._pending)
        self._pending = []
        self._kept.append(block)
        self._kept_commands += len(block.commands)
        if self._kept_commands > _MOST_KEPT:
            self._forget_measured()
        if len(self._unanswered) > _MOST_UNANSWERED:
            self._drained.clear()
        process = self._process
        if process is not None and process.stdin is not None and process.returncode is None:
            process.stdin.write(framed(block))

    def _hear(self, reply: Told | Saved | Finished) -> None:
        match reply:
            case Told():
                self._heard_of = reply.t
                self._pacing.answered(reply.seconds)
                if reply.serial >= self._news_from and self._restarts.works() and self.trouble is not None:
                    self.trouble = None
                    self._event("the solver works again")
                while self._unanswered and self._unanswered[0] <= reply.serial:
                    self._unanswered.popleft()
                if len(self._unanswered) <= _MOST_UNANSWERED:
                    self._drained.set()
                self._told(reply)
            case Saved():
                saving, self._saving = self._saving, None
                if reply.done:
                    frames = self._frames if saving is None or saving[0] != reply.serial else saving[1]
                    self._begin = Begin(self._begin.workers, self._begin.reference, reply.path, frames)
                    while self._kept and self._kept[0].serial <= reply.serial:
                        self._kept_commands -= len(self._kept.popleft().commands)
                    if self._saved_hook is not None:
                        self._saved_hook(reply.serial, frames)
            case Finished():
                self._finished(reply.registration)

    def _forget_measured(self) -> None:
        """Leave poses and ranges out of what is kept; who is there and what frames they have stays."""
        for block in self._kept:
            block.commands = _without_measured(block.commands)
        self._kept_commands = sum(len(block.commands) for block in self._kept)
        self._unanswered.clear()
        self._drained.set()


def _without_measured(commands: list[Command]) -> list[Command]:
    """Who is there, and what frames they have."""
    return [c for c in commands if not isinstance(c, Pose | Range | Advance | Save)]


def _sparing(step: int) -> str:
    if step == 0:
        return "the solver keeps up again: all ranges go to it"
    return f"the solver does not keep up: of each pair of devices a range in {RANGES_S[step]:g} s goes to it"


def _signal(process: Process, number: signal.Signals) -> None:
    """Not by its own methods: they look first whether it has ended, and take its status away from who waits for it."""
    if process.returncode is None:
        with suppress(ProcessLookupError):
            os.kill(process.pid, number)
