"""A recording played back as it would have come: each pose and each range at its own time, nothing ahead of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from time import perf_counter

import numpy as np

from synchronizar.arrays import Array, Indices
from synchronizar.data.in_time import A_SECOND, in_time
from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.registration import RangeVerdicts, Registration, State
from synchronizar.data.survey import with_survey_origin
from synchronizar.data.track import Track
from synchronizar.data.updates import Replay, Update, UserUpdate
from synchronizar.diagnosis import findings_of
from synchronizar.diagnosis.reasons import with_reasons
from synchronizar.diagnosis.survey import survey_findings
from synchronizar.estimation.incremental.engine import Engine
from synchronizar.estimation.incremental.told import registration_now, user_now
from synchronizar.estimation.register import reference_of, register
from synchronizar.parameters import Parameters

_OPTIONAL = tuple(f.name for f in fields(Ranges) if f.name not in ("t", "a", "b", "distance"))


def replay(
    recording: Recording,
    reference: str | None = None,
    parameters: Parameters | None = None,
    told: Callable[[Update], None] | None = None,
) -> Replay:
    """Play a recording; `told` hears each update as it is known. Raises InputError as `register` does."""
    parameters = parameters or Parameters()
    began = perf_counter()
    measured = with_survey_origin(recording)
    engine = Engine(measured.users, reference_of(measured, reference, parameters), parameters)
    rows: list[list[Array]] = [[] for _ in recording.users]
    updates: list[Update] = []
    known = _Known(engine, recording)
    columns = {f.name: getattr(recording.ranges, f.name).tolist() for f in fields(Ranges)}
    tick: int | None = None

    def tell(advance: Callable[[float], list[str]]) -> None:
        if tick is not None:
            updates.append(known.update((tick + 1) / A_SECOND, advance))
            if told is not None:
                told(updates[-1])

    for t, user, row in in_time(recording):
        if tick is not None and t >= (tick + 1) / A_SECOND:
            tell(engine.advance)
            tick = None
        if user < 0:
            optional = {name: columns[name][row] for name in _OPTIONAL if columns[name][row] == columns[name][row]}
            engine.add_range(t, columns["a"][row], columns["b"][row], columns["distance"][row], **optional)
            tick = int(np.floor(t * A_SECOND))
            continue
        track = recording.tracks[recording.users[user].name]
        position, quat = track.position[row], track.quat_xyzw[row]
        engine.add_pose(user, t, position.tolist(), quat.tolist())
        if engine.state(user) is State.REGISTERED and (placed := engine.pose(user, position, quat)) is not None:
            rows[user].append(np.concatenate([[t], *placed]))
    tell(engine.complete)
    tracks = {user.name: _track(np.array(of)) for user, of in zip(recording.users, rows, strict=True) if of}
    seconds = {"load": 0.0, "initialise": 0.0, "solve": perf_counter() - began}
    registration = known.registration(tracks, seconds)
    found = [*findings_of(recording, parameters), *survey_findings(recording, registration, parameters)]
    return Replay(updates, tracks, with_reasons(registration, found))


class _Known:
    """What an engine has told so far."""

    def __init__(self, engine: Engine, recording: Recording) -> None:
        self.engine, self.recording = engine, recording
        n = len(recording.ranges)
        self._usable, self._used = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
        self._weight, self._residual = np.zeros(n), np.full(n, np.nan)
        self._slot = -1
        self._order = np.argsort(recording.ranges.t, kind="stable")

    def update(self, t: float, advance: Callable[[float], list[str]]) -> Update:
        """Go on to a moment, and tell."""
        engine, began = self.engine, perf_counter()
        events = advance(t)
        now = [user_now(engine, u) for u in range(len(self.recording.users))]
        seconds = perf_counter() - began
        self._read(t)
        users = {
            user.name: UserUpdate(
                engine.state(u),
                user.common_from_user,
                user.covariance,
                1.0 if engine.state(u) is State.REGISTERED else user.progress or 0.0,
                user.static,
                user.cue,
            )
            for u, user in enumerate(now)
        }
        return Update(t, seconds, users, events)

    def _read(self, t: float) -> None:
        """The verdicts on the ranges of the recent past, once a second."""
        if np.floor(t) == self._slot:
            return
        self._slot = int(np.floor(t))
        self.read()

    def read(self) -> None:
        """The verdicts on the ranges of the recent past."""
        serial = self.engine.log.rows[:, -1].astype(np.int32)
        usable, inlier, weight, residual = self.engine.range_verdicts(serial)
        at = self.rows_of(serial[usable])
        self._usable[at], self._used[at] = True, inlier[usable] > 0.5
        self._weight[at], self._residual[at] = weight[usable], residual[usable]

    def rows_of(self, serial: Indices) -> Indices:
        """Rows of the recording, by running index: ranges are told in the order of time."""
        return np.asarray(self._order[serial], dtype=np.int32)

    def registration(self, tracks: dict[str, Track], seconds: dict[str, float]) -> Registration:
        """At the end, about each user's last pose."""
        self.read()
        ranges = RangeVerdicts(self._usable, self._used, self._weight, self._residual)
        if not self.engine.solved:
            measured = self.recording.ranges
            nothing = replace(self.recording, ranges=replace(measured, distance=np.full(len(measured), np.nan)))
            reference = self.engine.users[self.engine.reference]
            whose = None if reference.is_survey_origin else reference.name
            return replace(register(nothing, whose), ranges=ranges)
        told = registration_now(self.engine)
        users = {name: replace(user, common_track=tracks.get(name)) for name, user in told.users.items()}
        return replace(told, users=users, ranges=ranges, seconds=seconds)


def _track(rows: Array) -> Track:
    quat = rows[:, 4:] / np.linalg.norm(rows[:, 4:], axis=1, keepdims=True)
    return Track(rows[:, 0], rows[:, 1:4], quat)
