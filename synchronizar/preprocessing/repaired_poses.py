"""A device's poses with their repaired track: the table of both, and the axes that lead from one to the other."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from synchronizar._core import poses_at, read_ranges
from synchronizar.arrays import Array, Indices, Mask
from synchronizar.data.track import Poses, Track
from synchronizar.geometry import wrap_angle
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.keyframes import VELOCITY_REACH
from synchronizar.preprocessing.stream_events import Levelled
from synchronizar.quaternions import (
    IDENTITY,
    inverse_quaternions,
    multiply_quaternions,
    normalized_quaternions,
    rotate_by_quaternions,
    tilt_of_quaternions,
    yaw_of_quaternions,
    yaw_quaternion,
)

Pose = tuple[float, float, float, float, float, float, float]
"""Position (m) and attitude x y z w, as SLAM has them."""
SAME_STAMP = 1e-9
"""s: stamps that are closer are one."""
STAMP, RAW_POSITION, RAW_ATTITUDE = 0, slice(1, 4), slice(4, 8)
"""Columns of the table: SLAM's own pose, ..."""
POSITION, ATTITUDE = slice(8, 11), slice(11, 15)
"""... the repaired one, ..."""
TRAVELLED, SEGMENT, REBUILT = 15, 16, 17
"""... the way up to it, how many times axes changed before it, whether the step to it was rebuilt."""
COLUMNS = 18
_POSE = STAMP, POSITION.start, ATTITUDE.start
_UP = np.array([0.0, 0.0, 1.0])
_FIRST_ROWS = 256


class Tail(NamedTuple):
    """n consecutive poses of the repaired track; copies."""

    t: Array
    """(n,) s, strictly rising."""
    position: Array
    """(n, 3) m."""
    quat_xyzw: Array
    """(n, 4)."""
    segment: Indices
    """(n,) how many times axes changed before each pose, since the stream began."""
    rebuilt: Mask
    """(n,) whether the step that leads to the pose was rebuilt from its neighbours."""
    travelled: Array
    """(n,) m: way since the stream began."""


class Axes(NamedTuple):
    """Repaired track from SLAM's own frame, for poses of the newest segment."""

    quat_xyzw: Array
    """(4,) repaired from SLAM."""
    offset: Array
    """(3,) m: a repaired position is this plus SLAM's, turned."""
    level: bool
    """Whether SLAM's vertical is trusted; else its steps are taken for horizontal, and `offset` has the height."""

    @property
    def yaw(self) -> float:
        """rad: by how much SLAM's frame is turned, as `yaw_of_quaternions`."""
        return wrap_angle(2.0 * math.atan2(self.quat_xyzw[2], self.quat_xyzw[3]))

    def repaired(self, position: Array, quat_xyzw: Array) -> tuple[Array, Array]:
        """SLAM's positions (..., 3) and attitudes (..., 4) in the repaired track's frame."""
        place = rotate_by_quaternions(self.quat_xyzw, position)
        if not self.level:
            place[..., 2] = 0.0
        return place + self.offset, multiply_quaternions(self.quat_xyzw, quat_xyzw)


class _Vertical:
    """A direction in the continued axes that some segments agree on as up."""

    def __init__(self, up: Array, seconds: float = 0.0) -> None:
        self.up, self.seconds = up, seconds


class RepairedPoses:
    """The poses of one device, from SLAM and repaired, in the order of time."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self.repeated = 0
        """How many had the stamp of another one; the first counts."""

    def _clear_poses(self) -> None:
        self._table = np.empty((_FIRST_ROWS, COLUMNS))
        self._rows = 0
        self._pending: list[tuple[float, ...]] = []
        self._forgotten = 0
        # Segments: repaired from SLAM, offset, level. Continued: in the axes of the first, as they are, tilt and all.
        self._axes: list[Axes] = [Axes(IDENTITY.copy(), np.zeros(3), True)]
        self._continued = IDENTITY.copy()
        self._untilt = IDENTITY.copy()
        self._verticals = [_Vertical(_UP.copy())]
        self._level_vertical = self._own_vertical = 0
        self._segment_since = -math.inf

    # Reading

    def last(self) -> Tail | None:
        """The newest pose, n = 1; None before the first."""
        table = self._table_now()
        return tail_of(table[-1:]) if len(table) else None

    def tail(self, since: float) -> Tail:
        """All poses stamped `since` (s) or later."""
        table = self._table_now()
        return tail_of(table[np.searchsorted(table[:, STAMP], since) :])

    def slam_track(self, most: int) -> Track:
        """SLAM's own poses, at most so many, evenly chosen; copies."""
        table = self._table_now()
        return raw_track(table[:: max(1, -(-len(table) // most))].copy())

    def at(self, t: Array) -> Poses:
        """The repaired poses at times (n,) s, as `Track.at` has them with the longest gap between poses."""
        table = self._table_now()
        if not len(table) or not len(t):
            n = len(t)
            return Poses(np.zeros((n, 3)), np.tile(IDENTITY, (n, 1)), np.zeros(n, dtype=bool))
        return Poses(*poses_at(table, _POSE, t, self._parameters.slam.longest_pose_gap))

    def way(self, begin: float, end: float) -> tuple[float, bool]:
        """How far SLAM came (m) from `begin` to `end` (s), and whether any step there was rebuilt."""
        table = self._table_now()
        first, last = np.searchsorted(table[:, STAMP], begin), np.searchsorted(table[:, STAMP], end, side="right")
        if last <= first:
            return 0.0, False
        travelled = float(table[last - 1, TRAVELLED] - table[first, TRAVELLED])
        return travelled, bool(table[first:last, REBUILT].any())

    def current_axes(self) -> Axes:
        """Repaired track from SLAM's frame, for poses after the last one."""
        return self._axes[-1]

    # Storage

    def _table_now(self) -> Array:
        """(n, columns) all rows; a view."""
        if self._pending:
            new = len(self._pending)
            while self._rows + new > len(self._table):
                self._table = np.concatenate([self._table, np.empty_like(self._table)])
            rows = self._table[self._rows : self._rows + new]
            rows[:, : RAW_ATTITUDE.stop] = self._pending
            self._pending.clear()
            rows[:, REBUILT] = 0.0
            self._rows += new
            if self._rows == new:
                self._segment_since = float(rows[0, STAMP])
            self._repair(self._rows - new, len(self._axes) - 1)
        return self._table[: self._rows]

    def _repair(self, first: int, segment: int) -> None:
        """Rows from `first` on belong to a segment."""
        rows = self._table[first : self._rows]
        _repair_rows(rows, self._axes[segment])
        rows[:, SEGMENT] = segment
        self._measure(first)

    def _measure(self, first: int) -> None:
        """The way travelled, of rows from `first` on."""
        if first == 0 and self._rows:
            self._table[0, TRAVELLED] = self._table[0, TRAVELLED] if self._forgotten else 0.0
            first = 1
        place = self._table[first - 1 : self._rows, POSITION]
        dx, dy, dz = (place[1:, i] - place[:-1, i] for i in range(3))
        steps = np.sqrt(dx * dx + dy * dy + dz * dz)
        travelled = self._table[first - 1 : self._rows, TRAVELLED]
        travelled[1:] = np.cumsum(np.concatenate([travelled[:1], steps]))[1:]

    def _insert_row(self, t: float, pose: Pose) -> int | None:
        """Add a pose that comes late, and return its row; None where there is one, or where poses are forgotten."""
        table = self._table_now()
        row = int(np.searchsorted(table[:, STAMP], t))
        if np.abs(t - table[max(row - 1, 0) : row + 1, STAMP]).min() <= SAME_STAMP:
            self.repeated += 1
            return None
        if row == 0 and self._forgotten:
            return None
        new = np.zeros(COLUMNS)
        new[: RAW_ATTITUDE.stop] = (t, *pose)
        before, after = table[max(row - 1, 0)], table[row]
        beside = before
        if before[SEGMENT] != after[SEGMENT]:
            near = [float(np.linalg.norm(new[RAW_POSITION] - other[RAW_POSITION])) for other in (before, after)]
            if near[1] < near[0]:
                beside, new[REBUILT] = after, after[REBUILT]
                after[REBUILT] = 0.0
        new[SEGMENT] = beside[SEGMENT]
        if row == 0:
            self._segment_since = t if new[SEGMENT] == 0.0 else self._segment_since
        _repair_rows(new[None, :], self._axes[int(new[SEGMENT])])
        if self._rows == len(self._table):
            self._table = np.concatenate([self._table, np.empty_like(self._table)])
        self._table[row + 1 : self._rows + 1] = self._table[row : self._rows].copy()
        self._table[row] = new
        self._rows += 1
        self._measure(row)
        return row

    def _forget_rows(self, first: int) -> None:
        """Drop the rows before one."""
        left = self._table[first : self._rows].copy()
        self._table[: len(left)] = left
        self._rows = len(left)
        self._forgotten += first

    # Axes

    def _begin_segment(self, row: int, turned: Array, displacement: Array, least_tilt: float) -> None:
        """From a row on SLAM's axes are `turned` (4,), and the step to it is `displacement` (3,) in those before."""
        t, old = float(self._table[row, STAMP]), self._axes[-1]
        self._verticals[self._own_vertical].seconds += float(self._table[row - 1, STAMP]) - self._segment_since
        self._segment_since = t
        self._continued = normalized_quaternions(multiply_quaternions(self._continued, turned))
        up = rotate_by_quaternions(self._continued, _UP)
        likeness = [float(up @ vertical.up) for vertical in self._verticals]
        self._own_vertical = int(np.argmax(likeness))
        if likeness[self._own_vertical] < math.cos(least_tilt):
            self._own_vertical = len(self._verticals)
            self._verticals.append(_Vertical(up))
        step = rotate_by_quaternions(old.quat_xyzw, displacement)
        step[2] *= old.level
        self._set_axes(row, self._table[row - 1, POSITION] + step)
        self._table[row, REBUILT] = 1.0

    def _set_axes(self, row: int, place: Array) -> None:
        """From a row on, which stands at `place` (3,), axes are as the verticals have it."""
        levelled = multiply_quaternions(self._untilt, self._continued)
        level = self._own_vertical == self._level_vertical
        quat = yaw_quaternion(float(yaw_of_quaternions(levelled))) if level else levelled
        turned = rotate_by_quaternions(quat, self._table[row, RAW_POSITION])
        turned[2] *= level
        self._axes.append(Axes(quat, place - turned, level))
        self._repair(row, len(self._axes) - 1)

    def _level(self, row: int) -> Levelled | None:
        """Level by the vertical that has held longest up to a row, if that is another one than before."""
        if self._own_vertical == self._level_vertical:
            return None
        t = float(self._table[row, STAMP])
        own = self._verticals[self._own_vertical].seconds + t - self._segment_since
        if own <= self._verticals[self._level_vertical].seconds:
            return None
        tilt = float(tilt_of_quaternions(multiply_quaternions(self._untilt, self._continued)))
        yaw = yaw_quaternion(float(yaw_of_quaternions(self._continued)))
        self._untilt = multiply_quaternions(yaw, inverse_quaternions(self._continued))
        self._level_vertical = self._own_vertical
        place = self._table[row, POSITION].copy()
        self._set_axes(row, place)
        return Levelled(t, tilt, float(self._table[row, RAW_POSITION][2] - place[2]))

    # To and from plain arrays

    def _state_of_poses(self) -> dict[str, Array]:
        return {
            "table": self._table_now().copy(),
            "axes": np.array([[*axes.quat_xyzw, *axes.offset, float(axes.level)] for axes in self._axes]),
            "continued": np.array([self._continued, self._untilt]),
            "verticals": np.array([[*vertical.up, vertical.seconds] for vertical in self._verticals]),
        }

    def _take_state_of_poses(self, state: Mapping[str, Array]) -> None:
        table = np.asarray(state["table"], dtype=float)
        if table.ndim != 2 or table.shape[1] != COLUMNS:
            raise ValueError(f"table: {COLUMNS} columns are needed")
        self._rows = len(table)
        self._table = np.concatenate([table, np.empty((_FIRST_ROWS, COLUMNS))])
        self._axes = [Axes(row[:4].copy(), row[4:7].copy(), bool(row[7])) for row in state["axes"]]
        self._continued, self._untilt = state["continued"][0].copy(), state["continued"][1].copy()
        self._verticals = [_Vertical(row[:3].copy(), float(row[3])) for row in state["verticals"]]


def ends_of_ranges(
    streams: Sequence[RepairedPoses | None],
    clocks: Array,
    t: Array,
    users: Indices,
    levers: Array,
    wanted: Mask,
    longest: float,
) -> tuple[Array, Mask]:
    """(n, 2, 3, 3) ends of ranges: repaired position (m), lever (m) and velocity (m/s); (n,) whether poses are there.

    `t` (n,) s by the ranges' clock, `clocks` (k,) s: a device's stamps minus these; `users` (n, 2), of whom those
    without a stream stand at their origins; `levers` (n, 2, 3) m in body axes. Velocities are means from
    `VELOCITY_REACH` before to as long after, as far as poses are known; `longest` s is the longest gap between poses.
    Only those `wanted`.
    """
    tables = [None if stream is None else stream._table_now() for stream in streams]
    ends, known = read_ranges(tables, _POSE, clocks, t, users, levers.reshape(-1, 3), wanted, VELOCITY_REACH, longest)
    return ends.reshape(-1, 2, 3, 3), known


def tail_of(table: Array) -> Tail:
    """Rows of the table (n, columns) as they are told; copies."""
    return Tail(
        table[:, STAMP].copy(),
        table[:, POSITION].copy(),
        table[:, ATTITUDE].copy(),
        table[:, SEGMENT].astype(np.int32),
        table[:, REBUILT] > 0.0,
        table[:, TRAVELLED].copy(),
    )


def raw_track(table: Array) -> Track:
    """SLAM's own poses of rows of the table (n, columns); views."""
    return Track(table[:, STAMP], table[:, RAW_POSITION], table[:, RAW_ATTITUDE])


def _repair_rows(rows: Array, axes: Axes) -> None:
    """Repaired columns of rows of one segment, each to the last bit the same whatever other rows there are."""
    if axes.level and not axes.quat_xyzw[:3].any() and not axes.offset.any():
        rows[:, POSITION.start : ATTITUDE.stop] = rows[:, RAW_POSITION.start : RAW_ATTITUDE.stop]
        return
    place, attitude = axes.repaired(rows[:, RAW_POSITION], rows[:, RAW_ATTITUDE])
    rows[:, POSITION] = place
    rows[:, ATTITUDE] = normalized_quaternions(attitude)
