"""What a solved window says of everybody, in the common frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.estimation.assessment import Assessment
from synchronizar.estimation.incremental.stream import Stretch
from synchronizar.estimation.incremental.window_state import Checkpoint
from synchronizar.geometry import apply_frames, moved_frames, rotation_2d, wrap_angle
from synchronizar.graph.pose_graph import LocalOptimum, PoseGraph
from synchronizar.graph.states import SCALE, States, corrected
from synchronizar.quaternions import multiply_quaternions, rotate_by_quaternions


@dataclass(frozen=True)
class Solution:
    """What is known since the last solve, in the common frame."""

    checkpoint: Checkpoint
    stretch: Stretch
    minima: list[LocalOptimum]
    told: Assessment
    common: Array
    """(4,) where the graph's own frame lies in the common one."""
    axes: Array
    """(k, 4) quaternions: what SLAM's axes are turned by at the end."""
    lift: Array
    """(k,) SLAM's lengths: what is added to its heights at the end."""
    noise: Array
    """(k, 2)"""
    repaired: Recording
    """The stretch with mended tracks."""

    @property
    def graph(self) -> PoseGraph:
        """The best minimum's."""
        return self.minima[0].graph

    @property
    def states(self) -> States:
        """The best minimum's."""
        return self.minima[0].states

    def scale(self, user: int) -> float:
        """Metres in a user's own unit of length."""
        return 1.0 if self.graph.users[user].static else float(np.exp(self.states.calibration[user, SCALE]))

    @cached_property
    def last_poses(self) -> Array:
        """(k, 4) x, y, z, yaw of each last keyframe in the common frame."""
        return moved_frames(self.common, self.told.hypotheses[0].frames)

    @cached_property
    def covariances(self) -> Array:
        """(k, 6, 6) as `Assessment.covariances`, in the common frame as it was laid at the reference's first pose."""
        turn = np.eye(6)
        turn[:2, :2] = rotation_2d(float(self.common[3]))
        out = turn @ self.told.covariances @ turn.T
        out[:, :4, :4] += self.checkpoint.spread_at(self.last_poses)
        return np.asarray(out)

    @cached_property
    def _turn(self) -> Array:
        """(k, 4) quaternions: SLAM's axes into the common frame's."""
        yaw = 0.5 * self.last_poses[:, 3]
        zero = np.zeros(len(yaw))
        return multiply_quaternions(np.column_stack([zero, zero, np.sin(yaw), np.cos(yaw)]), self.axes)

    def anchor_at(self, user: int, stamp: float) -> Array:
        """(4,) x, y, z, yaw in the common frame: what a device that was solved for is anchored at, at its own stamp.

        Its place then, its own origin in height, and how its mended axes lay.
        """
        keyframes, scale, t = self.graph.keyframes[user], self.scale(user), np.array([stamp])
        position = self.repaired.tracks[self.graph.users[user].name].at(t, np.inf).position
        place, turned = corrected(self.states.keyframe_poses[user], keyframes, t, position)
        frame = self.states.anchor_poses[user]
        here = np.append(apply_frames(frame[None], scale * place)[0], wrap_angle(frame[3] + turned[0]))
        anchor = moved_frames(self.common, here[None])[0]
        anchor[2] -= scale * position[0, 2]
        return np.asarray(anchor)

    def pose(self, user: int, position: Array, quat_xyzw: Array) -> tuple[Array, Array]:
        """A pose of SLAM's own (3,), (4,) in the common frame: as the last solution has it, SLAM followed since."""
        turn = self._turn[user]
        away = rotate_by_quaternions(turn, self.scale(user) * (position - self.stretch.last[user]))
        return self.last_poses[user, :3] + away, multiply_quaternions(turn, quat_xyzw)
