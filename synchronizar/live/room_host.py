"""What runs a room: its clock, its solver's process, its recorder, and the two beats of its time."""

from __future__ import annotations

import asyncio
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from synchronizar.errors import InputError
from synchronizar.live.recorder import RESUME_FILE, STATE_FILE, FolderRecorder
from synchronizar.live.room import Room
from synchronizar.live.solver import SolverProcess
from synchronizar.live.solver_wire import Begin

TICK_S = 1.0 / 30.0
FLUSH_S = 1.0


class RoomClock:
    """s since 1970 when the server began, and from then on a clock that only goes forwards."""

    def __init__(self) -> None:
        self._since = time.time() - time.monotonic()

    def __call__(self) -> float:
        """Now, in s."""
        return self._since + time.monotonic()


class RoomHost:
    """Keeps one room going until it is closed."""

    def __init__(self, room: Room, recorder: FolderRecorder | None) -> None:
        self.room = room
        self._recorder = recorder
        self._temporary = None if recorder is not None else tempfile.TemporaryDirectory(prefix="synchronizar-")
        self._state = Path(self._temporary.name if self._temporary else recorder.folder) / STATE_FILE  # type: ignore[union-attr]
        self._offsets: dict[int, dict[str, int]] = {}
        self._tasks: list[asyncio.Task[None]] = []
        self.solver: SolverProcess | None = None

    def start(self, workers: int, begin: Begin | None = None) -> None:
        """Begin its tasks; there must be a running loop."""
        room = self.room
        self.solver = SolverProcess(
            room.told, room.finished, room.event, self._state, begin or Begin(workers), self._saved, self._saving
        )
        room.solver = self.solver
        beats = [self.solver.run(), self._ticks()]
        if self._recorder is not None:
            beats.append(self._flushes(self._recorder))
        self._tasks = [asyncio.create_task(beat) for beat in beats]

    async def close(self) -> None:
        """Everything on disk, and nothing left running."""
        if self.solver is not None:
            await self.solver.close()
        for task in self._tasks:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task
        if self._recorder is not None:
            await asyncio.to_thread(self._recorder.close)
        if self._temporary is not None:
            self._temporary.cleanup()

    async def _ticks(self) -> None:
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            self.room.tick()
            due = max(due + TICK_S, loop.time())
            await asyncio.sleep(due - loop.time())

    async def _flushes(self, recorder: FolderRecorder) -> None:
        """A disk that is full or gone is told, and the room goes on."""
        told = False
        while True:
            await asyncio.sleep(FLUSH_S)
            try:
                await asyncio.to_thread(recorder.flush)
                told = False
            except InputError as error:
                if not told:
                    self.room.event(f"the room is not recorded: {error}")
                told = True

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
