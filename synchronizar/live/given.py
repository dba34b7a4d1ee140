"""What a room's solver is given, and its recorder writes: the same of both."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Protocol

from synchronizar.live import messages as m
from synchronizar.live.member import Device
from synchronizar.live.solver import Solver
from synchronizar.live.solver_wire import AddUser, Command, Lost, NewFrame, Pose, Range
from synchronizar.live.words_file import Word


class Recorder(Protocol):
    """What writes a room down as it goes."""

    def user(self, settings: m.UserSettings, session: int) -> None:
        """Somebody comes, or has a new frame."""

    def pose(self, user: str, frame: int, t: float, position: m.Vector, quat_xyzw: m.Quaternion) -> None:
        """A pose that the solver is given."""

    def range(
        self, t: float, a: str, b: str, frames: tuple[int, int], distance: float, optional: dict[str, Any]
    ) -> None:
        """A range that the solver is given."""

    def word(self, word: Word) -> bool:
        """What was said or moved; False where it cannot be written any more."""


class Given:
    """Hands on to whoever solves, and whoever records, one room. Times are the room's (s)."""

    def __init__(self, recorder: Recorder | None) -> None:
        self.solver: Solver | None = None
        self._recorder = recorder
        self._head: tuple[str | None, str | None] | None = None

    def user(self, device: Device) -> None:
        """Somebody comes."""
        self._feed(AddUser(device.settings))
        self.recorded_user(device, device.session)

    def recorded_user(self, device: Device, session: int) -> None:
        """The solver knows already that somebody comes, or has come: for the recording alone."""
        if self._recorder is not None:
            self._recorder.user(device.settings, session)

    def new_frame(self, device: Device) -> None:
        """A device's SLAM began anew."""
        self._feed(NewFrame(device.name, device.frame))
        self.recorded_user(device, device.session)

    def lost(self, device: Device) -> None:
        """A device's SLAM lost track."""
        self._feed(Lost(device.name))

    def pose(self, device: Device, t: float, position: m.Vector, quat_xyzw: m.Quaternion) -> None:
        """A pose, in the device's own axes."""
        self._feed(Pose(device.name, t, position, quat_xyzw))
        if self._recorder is not None:
            self._recorder.pose(device.name, device.session, t, position, quat_xyzw)

    def range(self, t: float, a: Device, b: Device, distance: float, optional: dict[str, Any]) -> None:
        """A distance."""
        self._feed(Range(t, a.name, b.name, distance, optional))
        if self._recorder is not None:
            self._recorder.range(t, a.name, b.name, (a.session, b.session), distance, optional)

    def words(self, app: str | None, reference: str | None, words: Iterable[Word]) -> bool:
        """What was said or moved, while this is done and the common frame is this device's; no solver hears it.

        False where it cannot be written any more.
        """
        recorder, kept = self._recorder, True
        if recorder is None:
            return True
        for word in words:
            if self._head != (app, reference):
                self._head = app, reference
                recorder.word(Word(word.t, app=app, reference=reference))
            kept = recorder.word(word)
        return kept

    def _feed(self, command: Command) -> None:
        if self.solver is not None:
            self.solver.feed(command)
