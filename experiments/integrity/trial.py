"""A simulated walk, what went wrong with it, and where everybody's frame really lay."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from experiments.common.faults import in_frames, with_truth_moved
from synchronizar.arrays import Array, Mask
from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.survey import SURVEY, with_survey_origin
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.geometry import YawFrame, apply_frames
from synchronizar.quaternions import inverse_quaternions, multiply_quaternions, yaw_of_quaternions
from synchronizar.simulation.simulate import Simulation


class TrueWalk(NamedTuple):
    """One device's truth."""

    t: Array
    """(n,) s, its own clock."""
    position: Array
    """(n, 3) m, in the room."""
    frames: Array
    """(n, 5) x, y, z (m), yaw (rad), scale: `room_from_own` at each pose."""


@dataclass(frozen=True)
class Trial:
    """A walk as it comes, its truth, and what maximum likelihood is told of it."""

    simulation: Simulation
    """Its recording is what is solved."""
    honest: Mapping[str, Track]
    """Each device's own track before poses were garbled: what its frame is read from."""
    scale: Mapping[str, float]
    """A metre in the room over one in each device's own track."""
    best: Simulation | None
    """What maximum likelihood has: the same walk with all that can be mended mended, its `late` ranges left out. It has
    the ranges of the recording, row by row. None where that would not be the same task."""
    room_from_survey: YawFrame | None = None
    """Where radios were surveyed."""

    @classmethod
    def of(cls, simulation: Simulation) -> Trial:
        """A walk as it was simulated."""
        scale = {name: simulation.world_from_user[name].scale for name in simulation.recording.tracks}
        return cls(simulation, simulation.recording.tracks, scale, simulation)

    @property
    def recording(self) -> Recording:
        """What is solved."""
        return self.simulation.recording

    @property
    def moving(self) -> list[str]:
        """Who has a track."""
        return [user.name for user in self.recording.users if not user.static]

    def moments(self, share: float) -> float:
        """s, range clock: when so much of the walk is over."""
        return share * self.simulation.scene.seconds

    def of_device(self, name: str) -> Mask:
        """(n,) which ranges are this device's."""
        u, r = self.recording.index(name), self.recording.ranges
        return np.asarray((r.a == u) | (r.b == u))

    def with_recording(self, **changes: object) -> Trial:
        """Another recording."""
        recording = replace(self.recording, **changes)  # type: ignore[arg-type]
        return replace(self, simulation=replace(self.simulation, recording=recording))

    def with_garbled(self, name: str, track: Track) -> Trial:
        """A device's poses as they come, where its frame stays what it was."""
        return self.with_recording(tracks={**self.recording.tracks, name: track})

    def with_own_frames(self, name: str, frames: Array) -> Trial:
        """A device's own frame moved by `frames` (n, 4), new_from_old at each of its poses."""
        moved = in_frames(self.honest[name], frames)
        return replace(self.with_garbled(name, moved), honest={**self.honest, name: moved})

    def with_lengths(self, name: str, factor: float) -> Trial:
        """A device's own track in another unit."""
        longer = replace(self.honest[name], position=factor * self.honest[name].position)
        scale = {**self.scale, name: self.scale[name] / factor}
        return replace(self.with_garbled(name, longer), honest={**self.honest, name: longer}, scale=scale)

    def with_carried(self, frames: Mapping[str, Array]) -> Trial:
        """Devices carried off by `frames` (n, 4) in the room, unseen by SLAM."""
        best = None if self.best is None else with_truth_moved(self.best, frames)
        return replace(self, simulation=with_truth_moved(self.simulation, frames), best=best)

    def with_climb(self, name: str, higher: Array) -> Trial:
        """A device's own track where it also goes up and down by `higher` (n, 4), which SLAM sees."""
        track = in_frames(self.honest[name], higher)
        out = replace(self.with_garbled(name, track), honest={**self.honest, name: track})
        if self.best is None:
            return out
        recording = self.best.recording
        tracks = {**recording.tracks, name: in_frames(recording.tracks[name], higher)}
        return replace(out, best=replace(self.best, recording=replace(recording, tracks=tracks)))

    def later(self, seconds: float) -> Trial:
        """All clocks put forward."""

        def put(tracks: Mapping[str, Track]) -> dict[str, Track]:
            return {name: replace(track, t=track.t + seconds) for name, track in tracks.items()}

        ranges = self.recording.ranges
        out = self.with_recording(tracks=put(self.recording.tracks), ranges=replace(ranges, t=ranges.t + seconds))
        simulation = replace(out.simulation, truth=put(self.simulation.truth))
        return replace(out, simulation=simulation, honest=put(self.honest))

    def with_ranges(self, ranges: Ranges, spoiled: Mask) -> Trial:
        """Other ranges, row by row, of which maximum likelihood knows which are `spoiled` (n,)."""
        return replace(self.with_recording(ranges=ranges), best=self._without(spoiled))

    def with_added(self, extra: Array) -> Trial:
        """Ranges that are longer by `extra` (n,) m, which maximum likelihood knows where it is not 0."""
        ranges = self.recording.ranges
        return self.with_ranges(replace(ranges, distance=ranges.distance + extra), extra != 0.0)

    def without_best(self) -> Trial:
        """The same where nobody knows what could be had."""
        return replace(self, best=None)

    def spoiled(self, rows: Mask) -> Trial:
        """The same where maximum likelihood does without these ranges (n,) too."""
        return replace(self, best=self._without(rows))

    def _without(self, rows: Mask) -> Simulation | None:
        return None if self.best is None else replace(self.best, late=self.best.late | rows)

    def surveyed(self, users: Mapping[str, User], room_from_survey: YawFrame) -> Trial:
        """The same with these radios surveyed; maximum likelihood has the right entries."""
        told = tuple(users.get(user.name, user) for user in self.recording.users)
        out = replace(self.with_recording(users=told), room_from_survey=room_from_survey)
        if self.best is None:
            return out
        survey_from_room = room_from_survey.inverse()
        right = {
            name: replace(user, position=tuple((survey_from_room @ self.best.truth[name].position[0]).tolist()))
            for name, user in users.items()
        }
        recording = replace(self.best.recording, users=tuple(right.get(u.name, u) for u in self.best.recording.users))
        whole = with_survey_origin(recording)
        origin = whole.users[-1]
        x, y, z = (room_from_survey @ np.array(origin.position)).tolist()
        frames = {**self.best.world_from_user, origin.name: replace(room_from_survey, x=x, y=y, z=z)}
        return replace(out, best=replace(self.best, recording=whole, world_from_user=frames))

    def truth(self) -> dict[str, TrueWalk]:
        """Of every device; of a survey too, which stands still."""
        out = {}
        for name, true in self.simulation.truth.items():
            if name in self.honest:
                out[name] = TrueWalk(true.t, true.position, _frames(true, self.honest[name], self.scale[name]))
            else:
                out[name] = TrueWalk(true.t, true.position, np.append(true.position[0], [0.0, 1.0])[None])
        if self.room_from_survey is not None:
            f = self.room_from_survey
            frame = np.array([[f.x, f.y, f.z, f.yaw, 1.0]])
            out[SURVEY] = TrueWalk(np.zeros(1), frame[:, :3], frame)
        return out


def _frames(true: Track, own: Track, scale: float) -> Array:
    """(n, 5): `room_from_own` at each pose."""
    yaw = yaw_of_quaternions(multiply_quaternions(true.quat_xyzw, inverse_quaternions(own.quat_xyzw)))
    turn = np.column_stack([np.zeros((len(own), 3)), yaw])
    origin = true.position - apply_frames(turn, scale * own.position)
    return np.column_stack([origin, yaw, np.full(len(own), scale)])
