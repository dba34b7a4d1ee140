"""What runs a room: its clock, its solver's process, its recorder, and the two beats of its time."""

from __future__ import annotations

import asyncio
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from synchronizar.errors import InputError
from synchronizar.live.app_process import AppProcess
from synchronizar.live.object_file import ObjectFile
from synchronizar.live.recorder import RESUME_FILE, STATE_FILE, FolderRecorder, Gathered
from synchronizar.live.resuming import begin_again, tail
from synchronizar.live.room import Room
from synchronizar.live.roster import Roster, write_roster
from synchronizar.live.solver import SolverProcess
from synchronizar.live.solver_wire import Advance, Begin

TICK_S = 1.0 / 30.0
WRITTEN_EVERY = 0.5
"""s: so that with the time that writing takes no more than a second is lost."""


class RoomClock:
    """s since 1970 when the server began, and from then on a clock that only goes forwards."""

    def __init__(self) -> None:
        self._since = time.time() - time.monotonic()

    def __call__(self) -> float:
        """Now, in s."""
        return self._since + time.monotonic()


class RoomHost:
    """Keeps one room going until it is closed."""

    def __init__(self, room: Room, workers: int, recorder: FolderRecorder | None, objects: ObjectFile | None) -> None:
        """`workers` search beside the solver, where time is live."""
        self.room = room
        self.solver: SolverProcess | None = None
        self._workers, self._recorder, self._objects = workers, recorder, objects
        self._temporary = tempfile.TemporaryDirectory(prefix="synchronizar-") if recorder is None else None
        self._state = (Path(self._temporary.name) if recorder is None else recorder.folder) / STATE_FILE  # type: ignore[union-attr]
        self._offsets: dict[int, dict[str, int]] = {}
        self._roster_version = -1, 0
        self._tasks: list[asyncio.Task[None]] = []
        self._writing: asyncio.Task[None] | None = None
        self._ended = asyncio.Event()
        self._app: AppProcess | None = None

    def start(self) -> None:
        """Begin its tasks; there must be a running loop."""
        self._tasks = [asyncio.create_task(self._ticks())]
        if self._recorder is not None:
            self._writing = asyncio.create_task(self._writes(self._recorder))
        self.room.time.begun = lambda recorded: self._solve(Begin(0 if recorded else self._workers))

    def begin_app(self, app: AppProcess) -> None:
        """What people do there runs from now on."""
        self._app = app
        app.start()
        # A recording has its own.
        self.room.again.begun = lambda: self._tasks.append(asyncio.create_task(app.close()))

    def resume(self, roster: Roster) -> None:
        """Go on where the room's folder ends. Raises InputError where it cannot be read."""
        assert self._recorder is not None
        folder, room = self._recorder.folder, self.room
        room.restore(roster)
        if not roster.devices:
            return
        begin, offsets = begin_again(folder, self._workers, self._recorder.offsets())
        if begin.state is not None:
            self._recorder.note(RESUME_FILE, {"offsets": offsets, "frames": begin.frames})
        room.time.recorded, room.time.begun = False, None
        self._solve(begin)
        assert self.solver is not None
        for command in tail(folder, roster.devices, begin, offsets):
            if isinstance(command, Advance):
                self.solver.advance(command.t)
            else:
                self.solver.feed(command)
        if self._objects is not None:
            room.objects.restore(self._objects.load(), room.app is not None)

    def _solve(self, begin: Begin) -> None:
        """Begin the solver."""
        room = self.room
        self.solver = SolverProcess(room.told, room.finished, room.event, self._state, begin, self._saved, self._saving)
        room.solver = self.solver
        self._tasks.append(asyncio.create_task(self.solver.run()))

    async def close(self) -> None:
        """Everything on disk, and nothing left running."""
        if self._app is not None:
            await self._app.close()
        if self.solver is not None:
            await self.solver.close()
        for task in self._tasks:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task
        if self._writing is not None:
            self._ended.set()
            await self._writing
        if self._recorder is not None:
            self._recorder.close()
        if self._objects is not None:
            self._objects.close()
        if self._temporary is not None:
            self._temporary.cleanup()

    async def _ticks(self) -> None:
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            self.room.tick()
            due = max(due + TICK_S, loop.time())
            await asyncio.sleep(due - loop.time())

    async def _writes(self, recorder: FolderRecorder) -> None:
        """A disk that is full or gone is told, and the room goes on."""
        told = False
        while not self._ended.is_set():
            with suppress(TimeoutError):
                await asyncio.wait_for(self._ended.wait(), WRITTEN_EVERY)
            try:
                await self._write(recorder)
                told = False
            except InputError as error:
                if not told:
                    self.room.event(f"the room is not recorded: {error}")
                told = True

    async def _write(self, recorder: FolderRecorder) -> None:
        """All that came, on disk. It is gathered here and written by a thread."""
        version = self.room.people.version, self.room.modules.receiver.datagrams
        roster = self.room.roster() if version != self._roster_version else None
        await asyncio.to_thread(self._written, recorder, recorder.gather(), roster)
        self._roster_version = version

    def _written(self, recorder: FolderRecorder, gathered: Gathered, roster: Roster | None) -> None:
        if roster is not None:
            write_roster(recorder.folder, roster)
        recorder.write(gathered)
        if self._objects is not None:
            self._objects.flush()

    def _saving(self, serial: int) -> None:
        """A state with all blocks up to `serial` is being written: what is recorded until now is in it."""
        if self._recorder is not None:
            self._offsets[serial] = self._recorder.offsets()

    def _saved(self, serial: int, frames: dict[str, int]) -> None:
        if self._recorder is None:
            return
        offsets = self._offsets.pop(serial, None)
        self._offsets = {later: of for later, of in self._offsets.items() if later > serial}
        if offsets is not None:
            with suppress(InputError):
                self._recorder.note(RESUME_FILE, {"offsets": offsets, "frames": frames})
