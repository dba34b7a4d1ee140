"""One device's poses as they come, its relocalisation jumps found and removed on the way.

What `repair_relocalizations` does to a whole track is done here pose by pose, with the same physics and thresholds. An
impossible step makes the stream suspect at its very pose; a few poses later the search of the batch, on the stretch
about it, decides whether it was a jump.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from synchronizar.arrays import Array, Indices, Mask
from synchronizar.data.jump import Jump
from synchronizar.data.track import Track
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.relocalizations import (
    JumpSearch,
    NoiseLevels,
    RepairedTrack,
    attitude_follows,
    predict_steps,
    rebuild_jumps,
    search_jumps,
    steps_of,
)
from synchronizar.preprocessing.repaired_poses import (
    ATTITUDE,
    POSITION,
    RAW_ATTITUDE,
    RAW_POSITION,
    REBUILT,
    SAME_STAMP,
    SEGMENT,
    STAMP,
    Pose,
    RepairedPoses,
    Tail,
    raw_track,
    tail_of,
)
from synchronizar.preprocessing.running_quantile import RunningQuantile
from synchronizar.preprocessing.stamp_guard import Admitted, StampGuard
from synchronizar.preprocessing.stream_events import (
    Dismissed,
    Event,
    SetAside,
    Suspicion,
    event_numbers,
    event_of,
    jump_of,
    suspicion_numbers,
    suspicion_of,
)
from synchronizar.quaternions import (
    inverse_quaternions,
    multiply_quaternions,
    tilt_of_quaternions,
    yaw_of_quaternions,
)

_FARTHEST, _LATEST = 1e9, 1e20  # m, s: beyond, numbers are no place and no time
_SHORTEST, _LONGEST = 1e-12, 1e12  # square of a length that quaternions may have
_ROUNDING = 1e-14  # of the square of a unit quaternion's length
_USUAL = 0.95  # quantile of prediction errors that is their noise level, as in the batch
_CHECK_INTERVAL = 0.5  # s: where some step is not smooth, the two-sided search follows after so much
_SMOOTH = 0.15  # of the least jump: where no step changes by more, three of them do not add up to half of it
_TURNS = 0.4  # of the least turn that may be a jump: the same
_SEARCH_INTERVAL = 2.0  # s: and in any case after so much, since it also measures the noise
_FEWEST_STEPS = 20  # for a noise level
_MANY_STEPS = 100  # from so many on a few jumps do not raise it
_NEARLY = 0.9  # of a turn from which on axes may have stayed: then what follows decides
_MOST = 0.9  # quantile of steps that is usual
_SOME = 8  # latest jumps that a suspicion may have been about
_FEW_MEDIANS = 4.0  # of errors: more than the 95 % quantile where nothing is wrong
_CONTEXT_ROWS = 8  # before what is searched: neighbours of the first step


class PoseStream(RepairedPoses):
    """The repaired track of one device, from SLAM's poses as they come."""

    def __init__(self, parameters: Parameters) -> None:
        super().__init__(parameters)
        self._frozen_after = parameters.diagnosis.frozen_duration
        self._gap = parameters.diagnosis.stray_gap
        self._longest_gap = parameters.slam.longest_pose_gap
        self._guard: StampGuard[Pose] = StampGuard(parameters)
        self.faults = 0
        """How many poses were no numbers."""
        self.set_aside = 0
        """How many were set aside, stray or frozen."""
        self.suspicions = 0
        """How many times the stream became suspect."""
        self.suspect: Suspicion | None = None
        """Since when poses may not be where they seem; None as a rule."""
        self._events: list[Event] = []
        self.jumps: list[Jump] = []
        """All that were found, as in `RepairedTrack`; `pose` counts from the first pose of the stream."""
        self._clear()

    def _clear(self) -> None:
        """No pose, and nothing known of the steps."""
        self._clear_poses()
        self._count = 0  # of rows, those pending among them
        self._decided = 1  # rows whose steps are known to be jumps or none; the first has no step
        self.resumed_at = -math.inf
        """s: stamp of the first pose after it told nothing, or the same, for longer than `slam.longest_pose_gap`."""
        self._t, self._same_since = -math.inf, -math.inf
        self._x = self._y = self._z = math.nan
        self._qx = self._qy = self._qz = 0.0
        self._qw = 1.0
        self._vx = self._vy = self._vz = 0.0
        self._worst = 0.0  # m^2: square of the largest change of a step since the last search
        self._least_dot = 1.0
        self._gate = self._parameters.slam.jump_least**2
        self._dot_gate = math.cos(0.5 * _TURNS * self._parameters.slam.jump_turn)
        self._check_at, self._search_at, self._check_count = -math.inf, -math.inf, 0
        self._stands = self._froze = self._stops = False
        self._attitude_measured, self._attitude_follows = True, False
        self._intervals, self._position_errors, self._attitude_errors, self._lengths, self._turns = (
            RunningQuantile() for _ in range(5)
        )

    @property
    def newest(self) -> float:
        """s: stamp of the last pose; -inf before the first."""
        return self._t

    def __len__(self) -> int:
        return self._count

    def add(self, t: float, position: Sequence[float], quat_xyzw: Sequence[float]) -> None:
        """SLAM's next pose (s by its own clock, m); the attitude need not be of unit length."""
        x, y, z = position
        qx, qy, qz, qw = quat_xyzw
        guard = self._guard
        square = qx * qx + qy * qy + qz * qz + qw * qw
        if not abs(square - 1.0) < _ROUNDING:
            if not _SHORTEST < square < _LONGEST:
                self.faults += 1
                return
            length = math.sqrt(square)
            qx, qy, qz, qw = qx / length, qy / length, qz / length, qw / length
        if not (abs(x) + abs(y) + abs(z) < _FARTHEST and abs(t) < _LATEST):
            self.faults += 1
            return
        if SAME_STAMP < t - guard.last <= self._gap and not guard.held:
            guard.last = t
            guard.count += 1
            self._take(t, x, y, z, qx, qy, qz, qw)
        else:
            self._take_admitted(guard.admit(t, (x, y, z, qx, qy, qz, qw)))

    def _take_admitted(self, admitted: Admitted[Pose]) -> None:
        aside = list(admitted.aside)
        if admitted.anew:
            aside += self._table_now()[:, STAMP].tolist()
            self._clear()
            self.suspect = None
        if aside:
            self.set_aside += len(aside)
            self._events.append(SetAside(min(aside), max(aside), len(aside), "stray"))
        for t, pose in admitted.items:
            if t - self._t > SAME_STAMP:
                self._take(t, *pose)
            else:
                self._insert(t, pose)

    def _take(self, t: float, x: float, y: float, z: float, qx: float, qy: float, qz: float, qw: float) -> None:
        """A sound pose after all others."""
        dt = t - self._t
        dx, dy, dz = x - self._x, y - self._y, z - self._z
        if dx == dy == dz == 0.0 and qx == self._qx and qy == self._qy and qz == self._qz and qw == self._qw:
            if not self._stands and t - self._same_since >= self._frozen_after:
                self._stands = True
                self._freeze()
        else:
            self._stands = False
            if self._t - self._same_since >= self._frozen_after and self._thaw(x, y, z, qx, qy, qz, qw):
                dt = t - self._t
            self._same_since = t
        if self._longest_gap < dt < math.inf:
            self.resumed_at = t
        ex, ey, ez = dx - self._vx * dt, dy - self._vy * dt, dz - self._vz * dt
        square = ex * ex + ey * ey + ez * ez
        dot = abs(qx * self._qx + qy * self._qy + qz * self._qz + qw * self._qw)
        self._pending.append((t, x, y, z, qx, qy, qz, qw))
        self._count += 1
        self._t, self._x, self._y, self._z = t, x, y, z
        self._qx, self._qy, self._qz, self._qw = qx, qy, qz, qw
        self._vx, self._vy, self._vz = dx / dt, dy / dt, dz / dt
        if square > self._worst:
            self._worst = square
        if dot < self._least_dot:
            self._least_dot = dot
        if (square > self._gate or dot < self._dot_gate) and self.suspect is None:
            self._look()
        if t >= self._check_at or (self._check_count and self._count >= self._check_count):
            self._check()

    def settle(self) -> None:
        """Decide all that is open: nothing more comes."""
        self._take_admitted(self._guard.settle())
        self._check(settle=True)

    def take_events(self) -> list[Event]:
        """What was found since the last call."""
        events, self._events = self._events, []
        return events

    # Reading

    def believed(self, since: float) -> Tail:
        """The poses since then (s) but those that may not be where they seem: a jump is not mended at once."""
        table = self._table_now()
        end = len(table) if self.suspect is None else int(np.searchsorted(table[:, STAMP], self.suspect.t))
        return tail_of(table[np.searchsorted(table[:, STAMP], since) : end])

    def repaired(self, since: float) -> RepairedTrack:
        """The track since then (s), as the batch repairs a whole one, in the axes of the stream's beginning; copies.

        A segment may also begin where SLAM's vertical changed (`Levelled`). ValueError where there is no such pose.
        """
        table = self._table_now()
        first = int(np.searchsorted(table[:, STAMP], since))
        table = table[first:].copy()
        segment = table[:, SEGMENT].astype(np.int32)
        axes = self._axes[int(segment[0]) if len(segment) else len(self._axes) :]
        jumps = [j for j in self.jumps if j.t > table[:1, STAMP].max(initial=-np.inf)]
        return RepairedTrack(
            Track(table[:, STAMP], table[:, POSITION], table[:, ATTITUDE]),
            tuple(replace(jump, pose=int(np.searchsorted(table[:, STAMP], jump.t))) for jump in jumps),
            segment - segment[:1],
            np.array([each.quat_xyzw for each in axes]),
            np.array([each.level for each in axes]),
            self.rebuilt_sigma,
        )

    @property
    def rebuilt_sigma(self) -> tuple[float, float]:
        """1 sigma of a rebuilt step as the stream is known so far, as in `RepairedTrack`."""
        noise, spread = self._noise(), self._parameters.slam.jump_spread
        return (math.inf, math.inf) if noise is None else (spread * noise.position, spread * noise.attitude)

    def forget(self, before: float) -> None:
        """Poses stamped earlier than `before` (s) are needed no more; those that checks need stay."""
        table = self._table_now()
        open_since = table[min(self._decided, len(table)) - 1, STAMP] if len(table) else 0.0
        context = open_since - 1.5 * self._parameters.slam.glitch_duration
        first = int(np.searchsorted(table[:, STAMP], min(before, context)))
        first = min(first, self._decided - 1 - _CONTEXT_ROWS)
        if first > len(table) // 4:
            self._forget_rows(first)
            self._count -= first
            self._decided -= first
            if self._check_count:
                self._check_count -= first

    def _insert(self, t: float, pose: Pose) -> None:
        """A pose that comes late."""
        row = self._insert_row(t, pose)
        if row is None:
            return
        self._count += 1
        if row < self._decided:
            self._decided += 1
        if self._check_count:
            self._check_count += 1
        self._worst = math.inf  # the search will tell
        if row == self._rows - 2:
            self._same_since = max(self._same_since, t)

    # Jumps

    def _noise(self) -> NoiseLevels | None:
        """Of the stream so far; None while there is too little."""
        if self._position_errors.count < _FEWEST_STEPS:
            return None
        levels = [errors.quantile(_USUAL) for errors in (self._position_errors, self._attitude_errors)]
        return NoiseLevels(self._intervals.quantile(0.5), levels[0], levels[1])

    def _look(self) -> None:
        """Doubt the newest pose where the steps before allow no such step."""
        slam = self._parameters.slam
        rows = self._table_now()[-_CONTEXT_ROWS:]
        if len(rows) <= slam.jump_neighbours + 1:
            return
        steps = steps_of(raw_track(rows))
        prediction = predict_steps(steps, rows[1:, REBUILT] == 0.0, slam.jump_neighbours, self._parameters)
        noise = self._noise() or _noise_of_few(
            steps.dt[:-1], prediction.position_error[:-1], prediction.attitude_error[:-1]
        )
        dt, distance, turn = float(steps.dt[-1]), prediction.position_error[-1], prediction.attitude_error[-1]
        spread = slam.jump_spread * max(dt / noise.interval, 1.0)
        # The step begins with the velocity before; how it ends is not known yet.
        farthest = max(slam.jump_least, 0.5 * slam.jump_acceleration * dt**2, spread * noise.position)
        fastest = max(slam.jump_turn, slam.jump_rate * dt, spread * noise.attitude)
        if not self._attitude_measured:
            fastest = math.inf
        if distance > farthest or turn > fastest:
            self._doubt(Suspicion(self._t, "jump", float(distance), float(turn)))
            self._check_count = self._count + slam.jump_neighbours + 1

    def _doubt(self, suspicion: Suspicion) -> None:
        self.suspect = suspicion
        self.suspicions += 1

    def _check(self, settle: bool = False) -> None:
        """Search the steps that are not decided, where there may be something or it is time."""
        self._check_at, self._check_count = self._t + _CHECK_INTERVAL, 0
        slam = self._parameters.slam
        smooth = self._worst < (_SMOOTH * slam.jump_least) ** 2 and self._least_dot > self._dot_gate
        if not settle and self.suspect is None and smooth and self._t < self._search_at:
            return
        table = self._table_now()
        if len(table) < 2:
            return
        if not settle and self._position_errors.count == 0 and len(table) <= _FEWEST_STEPS:
            self._check_count = _FEWEST_STEPS + 1  # too few to tell noise from jumps
            return
        self._search_at = self._t + _SEARCH_INTERVAL
        begin = max(self._decided - 1 - _CONTEXT_ROWS, 0)
        search = self._search(table, begin)
        if begin and (search.jumped | search.turned).any():
            since = float(table[self._decided - 1, STAMP]) - 1.5 * slam.glitch_duration
            begin = min(begin, int(np.searchsorted(table[:, STAMP], since)))
            search = self._search(table, begin)
        first = self._decided - 1 - begin  # of the open steps
        ready, due = self._ready(table[begin + 1 :, STAMP], search, first)
        if settle:
            ready[:] = True
        end = first + (len(ready) if ready.all() else int(np.argmin(ready)))
        jumped = search.jumped.copy()
        jumped[end:] = False
        self._learn(search, slice(first, end))
        self._decided = begin + 1 + end
        if jumped[first:end].any():
            self._apply(begin, search, first, end)
        change = np.diff(search.steps.twist[max(end - 1, 0) :, 3:6], axis=0) * search.steps.dt[max(end, 1) :, None]
        self._worst, self._least_dot = float(np.max(np.sum(change**2, axis=1), initial=0.0)), 1.0
        if search.turned[end:].any():
            self._least_dot = 0.0
        if (levelled := self._level(self._decided - 1)) is not None:
            self._events.append(levelled)
        self._conclude(begin, search, end, due)

    def _search(self, table: Array, begin: int) -> JumpSearch:
        rows = table[begin:]
        decided = rows[1 : self._decided - begin, REBUILT] > 0.0
        noise, track = self._noise(), raw_track(rows)
        follows = attitude_follows(track, self._parameters)
        self._attitude_follows = self._attitude_follows if follows is None else follows
        self._attitude_measured |= not self._attitude_follows
        if noise is None or self._position_errors.count < _MANY_STEPS:
            own = search_jumps(track, self._parameters, NoiseLevels(float(np.median(np.diff(track.t))), 0.0, 0.0))
            young = _noise_of_few(own.steps.dt, own.position_error, own.attitude_error)
            noise = young if noise is None else NoiseLevels(*map(min, noise, young))
        known = self._attitude_follows, self._attitude_measured
        search = search_jumps(track, self._parameters, noise, decided, *known)
        self._attitude_measured = search.measured
        return search

    def _ready(self, t: Array, search: JumpSearch, first: int) -> tuple[Mask, Array]:
        """Which steps from `first` on can be decided; and when (n,) s each can, inf where more poses are needed.

        t (n,) are the stamps of the poses after the steps.
        """
        slam = self._parameters.slam
        turned = search.jumped & (search.attitude_error > _NEARLY * slam.jump_turn)
        due = np.where(turned, t + 0.5 * slam.glitch_duration, -np.inf)
        group = -np.inf  # glitches that follow one another are one
        for step in np.flatnonzero(search.turned)[::-1]:
            own = t[step] + slam.glitch_duration
            group = group if own + slam.glitch_duration >= group > -np.inf else own
            due[step] = group
        good = ~search.jumped
        after: Indices = np.cumsum(good[::-1], dtype=np.int32)[::-1] - good
        few = (after <= slam.jump_neighbours) & (t + slam.longest_pose_gap > self._t)
        due[few] = np.inf
        return due[first:] <= self._t, due

    def _learn(self, search: JumpSearch, which: slice) -> None:
        """Noise levels, from steps that are decided."""
        good = ~search.jumped[which]
        steps = search.steps
        dt = steps.dt[which][good]
        twist = steps.twist[which][good]
        self._intervals.add(dt)
        self._position_errors.add(search.position_error[which][good])
        self._attitude_errors.add(search.attitude_error[which][good])
        moved = twist.any(axis=1)
        self._lengths.add((np.linalg.norm(twist[:, 3:6], axis=1) * dt)[moved])
        self._turns.add((np.linalg.norm(twist[:, 6:], axis=1) * dt)[moved])
        noise, slam = self._noise(), self._parameters.slam
        if noise is not None:
            self._gate = max(slam.jump_least, slam.jump_spread * noise.position) ** 2

    def _apply(self, begin: int, search: JumpSearch, first: int, end: int) -> None:
        """Remove jumps among steps first ... end of what was searched from row `begin` on."""
        table = self._table_now()
        least_tilt = search.least_tilt(self._parameters)
        axes, displacement = rebuild_jumps(raw_track(table[begin:]), search, least_tilt, self._parameters)
        for segment, step in enumerate(np.flatnonzero(search.jumped).tolist()):
            if not first <= step < end:
                continue
            row = begin + 1 + step
            turned = multiply_quaternions(inverse_quaternions(axes[segment]), axes[segment + 1])
            change = inverse_quaternions(turned)
            beyond = search.steps.displacement[step] - displacement[step]
            self._begin_segment(row, turned, displacement[step], least_tilt)
            jump = Jump(
                float(table[row, STAMP]),
                self._forgotten + row,
                float(np.linalg.norm(beyond)),
                float(yaw_of_quaternions(change)),
                float(tilt_of_quaternions(change)),
            )
            self.jumps.append(jump)
            self._events.append(jump)

    def _conclude(self, begin: int, search: JumpSearch, end: int, due: Array) -> None:
        """End a suspicion that is decided, begin one where the search saw what is not; say when to look again."""
        table, slam = self._table_now(), self._parameters.slam
        if self.suspect is not None and self.suspect.kind == "frozen":
            return
        if self.suspect is not None and self.suspect.t <= table[self._decided - 1, STAMP]:
            if not any(jump.t >= self.suspect.t for jump in self.jumps[-_SOME:]):
                self._events.append(Dismissed(self.suspect.t))
            self.suspect = None
        if self.suspect is None:
            trouble = search.jumped | search.turned
            trouble[:end] = False
            trouble[max(len(trouble) - slam.jump_neighbours, 0) :] = False  # too few poses after
            if not trouble.any():
                return
            step = int(np.argmax(trouble))
            errors = float(search.position_error[step]), float(search.attitude_error[step])
            self._doubt(Suspicion(float(table[begin + 1 + step, STAMP]), "jump", *errors))
        if np.isinf(due[end]):
            self._check_count = self._count + 1
        else:
            self._check_at = float(due[end])

    # Frozen poses

    def _freeze(self) -> None:
        """Doubt a pose that is repeated where the device moved right before, and never was seen to stop like that."""
        table, slam = self._table_now(), self._parameters.slam
        row = int(np.searchsorted(table[:, STAMP], self._same_since))
        if not row or self.suspect is not None:
            return
        moved = float(np.linalg.norm(table[row, RAW_POSITION] - table[row - 1, RAW_POSITION]))
        at_once = moved > slam.jump_speed * (table[row, STAMP] - table[row - 1, STAMP])
        if self._froze or (at_once and not self._stops):
            self._doubt(Suspicion(self._same_since, "frozen", 0.0, 0.0))

    def _thaw(self, *pose: float) -> bool:
        """Whether the pose that was repeated, until this other one came, was frozen; its repetitions are removed."""
        table, limits = self._table_now(), self._parameters.diagnosis
        row = int(np.searchsorted(table[:, STAMP], self._same_since))
        step = math.dist(table[row, RAW_POSITION], pose[:3])
        turn = 2.0 * math.acos(min(abs(float(table[row, RAW_ATTITUDE] @ pose[3:])), 1.0))
        frozen = self._froze
        if min(self._lengths.count, self._turns.count) >= _FEWEST_STEPS:
            frozen |= step > max(limits.frozen_jump, limits.frozen_steps * self._lengths.quantile(_MOST))
            frozen |= turn > max(limits.frozen_turn, limits.frozen_steps * self._turns.quantile(_MOST))
        if self.suspect is not None and self.suspect.kind == "frozen":
            if not frozen:
                self._stops = True
                self._events.append(Dismissed(self.suspect.t))
            self.suspect = None
        if not frozen or row + 1 >= len(table):
            return False
        self._froze = True
        removed = table[row + 1 :, STAMP]
        self._events.append(SetAside(float(removed[0]), float(removed[-1]), len(removed), "frozen"))
        self.set_aside += len(removed)
        if self.suspect is not None and self.suspect.t > self._same_since:
            self.suspect = None
        self._rows = self._count = row + 1
        self._decided = min(self._decided, row + 1)
        self._t, self._check_count = self._same_since, 0
        return True

    # To and from plain arrays

    def state(self) -> dict[str, Array]:
        """All of it, as `from_state` takes it: it goes on to the last bit as this one would."""
        empty = np.zeros((0, 8))
        return {
            **self._state_of_poses(),
            "numbers": np.array([float(getattr(self, name)) for name in _NUMBERS]),
            "guard": np.array([self._guard.last, float(self._guard.count)]),
            "held": np.array([(t, *pose) for t, pose in self._guard.held]).reshape(-1, 8),
            "suspect": empty if self.suspect is None else np.array([suspicion_numbers(self.suspect)]),
            "events": np.array([event_numbers(event) for event in self._events]).reshape(-1, 6),
            "jumps": np.array([event_numbers(jump)[1:] for jump in self.jumps]).reshape(-1, 5),
            "quantiles": np.array([getattr(self, name).counts for name in _QUANTILES], dtype=np.float64),
        }

    @classmethod
    def from_state(cls, parameters: Parameters, state: Mapping[str, Array]) -> PoseStream:
        """The stream that `state` was taken of. ValueError or KeyError where it is of another shape."""
        stream = cls(parameters)
        stream._take_state_of_poses(state)
        for name, value in zip(_NUMBERS, state["numbers"].tolist(), strict=True):
            setattr(stream, name, type(getattr(stream, name))(value))
        stream._guard.last, stream._guard.count = float(state["guard"][0]), int(state["guard"][1])
        for t, x, y, z, qx, qy, qz, qw in state["held"].tolist():
            stream._guard.held.append((t, (x, y, z, qx, qy, qz, qw)))
        for numbers in state["suspect"].tolist():
            stream.suspect = suspicion_of(numbers)
        stream._events = [event_of(numbers) for numbers in state["events"].tolist()]
        stream.jumps = [jump_of(fields) for fields in state["jumps"].tolist()]
        for name, counts in zip(_QUANTILES, state["quantiles"], strict=True):
            quantiles = getattr(stream, name)
            quantiles.counts[:] = counts
            quantiles.count = int(counts.sum())
        return stream


_QUANTILES = ("_intervals", "_position_errors", "_attitude_errors", "_lengths", "_turns")
_NUMBERS = (
    *("faults", "repeated", "set_aside", "suspicions", "_forgotten", "_count", "_decided", "_t", "_same_since"),
    "resumed_at",
    *("_x", "_y", "_z", "_qx", "_qy", "_qz", "_qw", "_vx", "_vy", "_vz", "_worst", "_least_dot", "_gate"),
    *("_check_at", "_search_at", "_check_count", "_stands", "_froze", "_stops"),
    *("_attitude_measured", "_attitude_follows"),
    *("_level_vertical", "_own_vertical", "_segment_since"),
)


def _noise_of_few(dt: Array, position_error: Array, attitude_error: Array) -> NoiseLevels:
    """Noise levels of few steps: one jump, and the steps beside it, are more than one in twenty of them."""
    errors = (position_error, attitude_error)
    levels = [min(float(np.quantile(e, _USUAL)), _FEW_MEDIANS * float(np.median(e))) for e in errors]
    return NoiseLevels(float(np.median(dt)), levels[0], levels[1])
