"""The process that solves one room: commands come on standard input, what is known goes out on standard output."""

from __future__ import annotations

import gc
import os
import sys
from pathlib import Path
from time import perf_counter
from typing import Any, BinaryIO

import msgspec
import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.registration import UserRegistration
from synchronizar.errors import InputError
from synchronizar.estimation.incremental.estimator import Estimator
from synchronizar.io.json_values import covariance_json, frame_json, number_json
from synchronizar.io.registration_folder import registration_json
from synchronizar.live.messages import UserFrame
from synchronizar.live.solver_wire import (
    LENGTH,
    AddUser,
    Advance,
    Begin,
    Command,
    Finish,
    Finished,
    Lost,
    NewestRange,
    NewFrame,
    Pose,
    Range,
    Reply,
    Save,
    Saved,
    Told,
    begin_decoder,
    block_decoder,
    framed,
)

_MOST_TOLD = 20
"""Refusals that are told with one answer."""
_NICE = 3
"""The server comes first where all cores are busy, and searches come after this process."""
_DECIMALS = 9
"""Nanometres, of matrices that go to everybody ten times a second: further digits are half of the bytes."""


class Solving:
    """An estimator that does what commands say; users come one after the other."""

    def __init__(self, begin: Begin) -> None:
        self._begin = begin
        self._waiting: list[AddUser] = []
        self._estimator: Estimator | None = None
        self._frames = dict(begin.frames)
        self._refused: list[str] = []
        if begin.state is not None:
            try:
                self._estimator = Estimator.load(begin.state, workers=begin.workers)
            except InputError as error:
                self._refused.append(f"everybody is looked for anew: {error}")

    def do(self, command: Command, serial: int) -> Reply | None:
        """Carry one out; the reply where it has one. A command that makes no sense is told with the next events."""
        try:
            return self._do(command, serial)
        except ValueError as error:
            if isinstance(command, Advance | Save | Finish):
                raise  # no fault of what was said: a question without an answer would be waited for without end
            if len(self._refused) < _MOST_TOLD:
                self._refused.append(str(error))
            return None

    def close(self) -> None:
        """End the process that searches."""
        if self._estimator is not None:
            self._estimator.close()

    def _do(self, command: Command, serial: int) -> Reply | None:
        estimator = self._estimator
        match command:
            case AddUser():
                self._add(command)
            case Advance():
                return self._advance(command.t, serial)
            case Save():
                return self._save(command.path, serial)
            case Finish():
                if estimator is None:
                    return Finished({})
                estimator.complete(command.t)
                return Finished(registration_json(estimator.registration()))
            case _ if estimator is None:
                return None  # static radios alone: there is nothing to solve
            case Pose():
                estimator.add_pose(command.user, command.t, command.position, command.quat_xyzw)
            case Range():
                estimator.add_range(command.t, command.a, command.b, command.distance, **command.optional)
            case Lost():
                estimator.lost_tracking(command.user)
            case NewFrame():
                self._frames[command.user] = command.frame
                estimator.new_session(command.user)
        return None

    def _add(self, command: AddUser) -> None:
        """An estimator needs somebody who moves; radios that stand still wait until somebody does."""
        name = command.user.name
        settings = msgspec.to_builtins(command.user)
        settings.pop("name")
        if self._estimator is None:
            self._waiting.append(command)
            if command.user.static:
                return
            users = {waiting.user.name: msgspec.to_builtins(waiting.user) for waiting in self._waiting}
            for own in users.values():
                own.pop("name")
            surveyed = any(waiting.user.position is not None for waiting in self._waiting)
            reference = None if surveyed else self._begin.reference
            self._estimator = Estimator(users, reference=reference, workers=self._begin.workers)
            self._waiting.clear()
        elif name not in (user.name for user in self._estimator.users):
            self._estimator.add_user(name, **settings)

    def _advance(self, t: float, serial: int) -> Told:
        began = perf_counter()
        refused, self._refused = self._refused, []
        if self._estimator is None:
            return Told(t, serial, None, {}, refused, [], 0.0)
        events = [*self._estimator.advance(t), *refused]
        now = self._estimator.registration()
        users = {name: _told(user, self._frames.get(name, 0)) for name, user in now.users.items()}
        ranges = [NewestRange(*newest) for newest in self._estimator.newest_ranges()]
        return Told(t, serial, now.reference, users, events, ranges, perf_counter() - began)

    def _save(self, path: str, serial: int) -> Saved:
        """Under another name first: whoever ends this process leaves the state before."""
        if self._estimator is None:
            return Saved(serial, path, False)
        half = Path(f"{path}.half")
        try:
            self._estimator.save(half)
            half.replace(path)
        except (InputError, OSError):
            return Saved(serial, path, False)
        return Saved(serial, path, True)


def _told(user: UserRegistration, frame: int) -> UserFrame:
    own = user.common_from_user
    place = frame_json(own, user.static)
    return UserFrame(
        state=str(user.state),  # type: ignore[arg-type]
        reason=user.reason,
        frame=frame,
        matrix=None if own is None else own.matrix.round(_DECIMALS).tolist(),
        x=place["x"],
        y=place["y"],
        z=place["z"],
        yaw=place["yaw"],
        scale=1.0 if own is None else own.scale,
        covariance=covariance_json(None if user.covariance is None else user.covariance.round(_DECIMALS)),
        sigma=_sigma(user.covariance),
        clock_offset=user.clock_offset,
        progress=user.progress,
        cue=user.cue,
    )


def _sigma(covariance: Array | None) -> float | None:
    """m: the longer half-axis of the ellipse in the plane."""
    if covariance is None or not np.isfinite(covariance[:2, :2]).all():
        return None
    return number_json(float(np.sqrt(max(0.0, np.linalg.eigvalsh(covariance[:2, :2])[-1]))))


def serve(commands: BinaryIO, replies: BinaryIO) -> None:
    """Solve until nothing more comes, or nobody hears what is known."""
    solving: Solving | None = None
    try:
        while (block := _read(commands)) is not None:
            if solving is None:
                solving = Solving(begin_decoder.decode(block))
                continue
            decoded = block_decoder.decode(block)
            for command in decoded.commands:
                if (reply := solving.do(command, decoded.serial)) is not None:
                    replies.write(framed(reply))
            replies.flush()
    except BrokenPipeError:
        # The server was killed; what is left in the buffer must not be tried again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), replies.fileno())
    if solving is not None:
        solving.close()


def _read(commands: BinaryIO) -> Any:
    """The next block; None at the end."""
    head = commands.read(LENGTH.size)
    if len(head) < LENGTH.size:
        return None
    (size,) = LENGTH.unpack(head)
    block = commands.read(size)
    return block if len(block) == size else None


if __name__ == "__main__":
    if hasattr(os, "nice"):  # Windows has none
        os.nice(_NICE)
    gc.freeze()  # what was imported is never garbage: looking through it takes 40 ms whenever the oldest are looked at
    answers = sys.stdout.buffer
    sys.stdout = sys.stderr  # whatever else is printed must not come among the answers
    serve(sys.stdin.buffer, answers)
