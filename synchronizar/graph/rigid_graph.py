"""The pose graph with one keyframe per user, at SLAM's own: frames and heights are all that is free.

SLAM, clocks and radios are trusted, ranges independent and as good as the recording says: the paper's own model, all
users at once. It also stands for a pose graph at given states, where mirror images are looked for.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np

from synchronizar._core import RangeBlock, UserPose, search_heights
from synchronizar.arrays import Array
from synchronizar.graph.pose_graph import EmWeights, PoseGraph
from synchronizar.graph.problem import Problem
from synchronizar.graph.states import States
from synchronizar.preprocessing.centering import centered
from synchronizar.preprocessing.keyframes import RangeEnds, standing_at
from synchronizar.preprocessing.range_measurements import Pair, RangeMeasurements, pairs

_GAIN = 0.005  # of log likelihood: what gains less changes nothing that could be measured


class RigidGraph(PoseGraph):
    """The graph of a problem; each user's frame is about its anchor."""

    def __init__(self, problem: Problem, anchors: Array):
        """`anchors` (k, 3) m in the users' own frames, at height 0."""
        self._about_anchors = centered(problem.measurements, anchors)
        super().__init__(problem, [standing_at(anchor) for anchor in anchors])
        self.calibrations = []
        self.sigma, self._gain = problem.measurements.sigma, _GAIN
        s = self._about_anchors
        self._blocks: list[tuple[Pair, RangeBlock]] = []
        for pair in pairs(s):
            k = pair.measurements
            block = RangeBlock(s.p_i[k], s.p_j[k], s.distance[k], s.sigma[k], s.nlos_odds[k])
            self._blocks.append((pair, block))

    def with_nlos_odds(self, nlos_odds: Array) -> RigidGraph:
        """The same graph, each range's prior NLOS odds (n,) being these."""
        out = copy(self)
        out.problem = self.problem.with_measurements(replace(self.measurements, nlos_odds=nlos_odds))
        out._about_anchors = replace(self._about_anchors, nlos_odds=nlos_odds)
        out._blocks = [(pair, block.with_nlos_odds(nlos_odds[pair.measurements])) for pair, block in self._blocks]
        return out

    def _read_antennas(self, clock_offset: Array) -> None:
        """The measurements have them; clocks are right."""
        s = self._about_anchors
        here, zeros = np.zeros(len(s), dtype=np.int32), np.zeros((len(s), 3))
        self.assumed_clock = np.zeros_like(clock_offset)
        self.ends = RangeEnds(here, zeros, s.p_i, zeros), RangeEnds(here, zeros, s.p_j, zeros)

    def to_rigid_ranges(self, states: States) -> RangeMeasurements:  # noqa: ARG002 - the face of PoseGraph
        """The measurements about the anchors: there is no drift, scale, clock or bias."""
        return self._about_anchors

    def initial_em_weights(self) -> EmWeights:
        """Nothing is known yet; each range counts as one."""
        k, one = len(self.users), np.ones(len(self.measurements))
        return EmWeights(self.measurements.nlos_odds, one, [np.ones(0)] * k, np.ones((k + 1, 3)), np.ones(k))

    def with_range_weights(self, states: States, em_weights: EmWeights) -> EmWeights:  # noqa: ARG002 - the face of PoseGraph
        """The same: each range counts as one."""
        return em_weights

    def height_weights(self, frames: Array) -> tuple[Array, float]:
        """All 1: a normal prior. With longer tails the mirror images of a level walk stay possible."""
        off = (frames[:, 2] - self.mean_height(frames, np.ones(len(frames)))) / self.height_sigma
        return np.ones(len(frames)), 0.5 * float(np.square(off[self.active_users]).sum())

    def last_poses(self, states: States) -> Array:
        """(k, 4) x, y, z (m), yaw (rad): where each anchor is."""
        return states.anchor_poses.copy()

    def cost(self, frames: Array) -> float:
        """The sum of the losses of all ranges, each by itself, and of the heights' normal prior, at frames (k, 4)."""
        poses = _poses(frames)
        ranges = sum(block.cost(poses[pair.i], poses[pair.j], self.loss) for pair, block in self._blocks)
        return ranges + self.height_weights(frames)[1]

    def other_heights(self, frames: Array, excluded: float) -> list[Array]:
        """Joint placements (k, 4) that differ from `frames` in heights alone and explain the ranges.

        Their cost is at most `excluded` above the best one's.
        """
        found = search_heights(
            np.nan_to_num(frames),
            self.height_sigma,
            np.isin(np.arange(len(frames)), self.free),
            [(pair.i, pair.j, block) for pair, block in self._blocks],
            self.loss,
            excluded,
            self.parameters.search.most_hypotheses,
        )
        return [np.column_stack([frames[:, :2], heights + 0.0 * frames[:, 2], frames[:, 3]]) for heights, _ in found]


def _poses(frames: Array) -> list[UserPose]:
    """Of every user, by frames (k, 4) x, y, z, yaw."""
    return [UserPose(x, y, yaw, z) for x, y, z, yaw in frames.tolist()]
