"""The states of a pose graph as places, which is what the core's solver moves (factors/walk_solver.h)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from synchronizar._core import WalkSolver
from synchronizar.arrays import Array, Indices
from synchronizar.geometry import apply_frames, wrap_angle
from synchronizar.graph.states import SCALE, States
from synchronizar.preprocessing.keyframes import RangeEnds
from synchronizar.preprocessing.lasting_errors import LastingErrors


class Walks(NamedTuple):
    """The keyframes of some of k users, one after the other, and the solver that knows them and their ranges."""

    solver: WalkSolver
    users: list[int]
    """Users of the graph that have keyframes here, in the solver's order."""
    reference: int
    """Index among `users`."""
    first: Indices
    """(len(users) + 1,) the first of the m keyframes of each user, and the end."""
    slam: Array
    """(m, 3) SLAM units: where SLAM has each keyframe, x and y from the user's first."""

    @classmethod
    def of(
        cls,
        users: list[int],
        reference: int,
        slam: list[Array],
        t: list[Array],
        ranges: tuple[Indices, Indices, Array, Array],
        ends: tuple[RangeEnds, RangeEnds],
        lasting: LastingErrors | None = None,
    ) -> Walks:
        """Of `users`, whose keyframes are at `slam` (m, 3) and `t` (m,) each.

        `ranges` are both users, the distances and sigmas of n ranges, `ends` their antennas at keyframes that are
        counted by user. They may have `lasting` errors.
        """
        first = np.concatenate([[0], np.cumsum([len(of_user) for of_user in slam])]).astype(np.int32)
        begin = np.full(max(users) + 1, -1, dtype=np.int32)
        begin[users] = first[:-1]
        i, j, distance, sigma = ranges
        places = np.concatenate(slam)
        solver = WalkSolver(
            users.index(reference),
            first,
            np.concatenate(t),
            places,
            begin[i] + ends[0].keyframe,
            begin[j] + ends[1].keyframe,
            (ends[0].offset, ends[0].lever, ends[0].velocity),
            (ends[1].offset, ends[1].lever, ends[1].velocity),
            distance,
            sigma,
            *(() if lasting is None else (lasting.of_range, lasting.follows, lasting.decay)),
        )
        return cls(solver, users, users.index(reference), first, places)

    def places(self, states: States) -> Array:
        """(m, 4) x, y, z (m), yaw (rad) of all keyframes in the common frame."""
        who = np.repeat(self.users, np.diff(self.first))
        at = np.concatenate([states.keyframe_poses[u] for u in self.users])
        frames = states.anchor_poses[who]
        out = np.empty_like(at)
        out[:, :3] = apply_frames(frames, np.exp(states.calibration[who, SCALE])[:, None] * at[:, :3])
        out[:, 3] = at[:, 3] + frames[:, 3]
        return out

    def states(self, places: Array, calibration: Array, lasting: Array, before: States) -> States:
        """The states at these places (m, 4), users' calibrations and errors; other users are as they were `before`.

        Each user's first keyframe is at SLAM's own pose in the axes of its anchor.
        """
        count = np.diff(self.first)
        scale, start = np.exp(calibration[:, SCALE]), self.first[:-1]
        frames = places[start].copy()
        frames[:, 2] -= scale * self.slam[start, 2]
        frames[self.reference] = 0.0
        of_keyframe = np.repeat(frames, count, axis=0)
        c, s = np.cos(of_keyframe[:, 3]), np.sin(of_keyframe[:, 3])
        dx, dy, dz = (places[:, :3] - of_keyframe[:, :3]).T / np.repeat(scale, count)
        own = np.column_stack([c * dx + s * dy, -s * dx + c * dy, dz, wrap_angle(places[:, 3] - of_keyframe[:, 3])])
        own[start] = np.column_stack([self.slam[start], np.zeros(len(start))])
        anchor_poses, all_calibrations = before.anchor_poses.copy(), before.calibration.copy()
        anchor_poses[self.users], all_calibrations[self.users] = frames, calibration
        anchor_poses[self.users, 3] = wrap_angle(frames[:, 3])
        keyframe_poses = list(before.keyframe_poses)
        for n, u in enumerate(self.users):
            keyframe_poses[u] = own[self.first[n] : self.first[n + 1]]
        return States(anchor_poses, keyframe_poses, all_calibrations, lasting)
