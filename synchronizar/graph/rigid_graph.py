"""The pose graph with one keyframe per user, at SLAM's own: frames and heights are all that is free.

SLAM, clocks and radios are trusted, ranges independent and as good as the recording says: the paper's own model, all
users at once. It also stands for a pose graph at given states, where mirror images are looked for.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from synchronizar._core import RigidSolver
from synchronizar.arrays import Array
from synchronizar.graph.em_weights import EmWeights
from synchronizar.graph.pose_graph import SAME, LocalOptimum, PoseGraph
from synchronizar.graph.priors import bursts_with_foreign
from synchronizar.graph.problem import Problem
from synchronizar.graph.states import States
from synchronizar.preprocessing.centering import centered
from synchronizar.preprocessing.keyframes import RangeEnds, standing_at
from synchronizar.preprocessing.range_measurements import RangeMeasurements, pair_bounds

_GAIN = 0.005  # of log likelihood: what gains less changes nothing that could be measured
_ITERATIONS = 10


class RigidGraph(PoseGraph):
    """The graph of a problem; each user's frame is about its anchor."""

    def __init__(self, problem: Problem, anchors: Array):
        """`anchors` (k, 3) m in the users' own frames, at height 0."""
        self._about_anchors = centered(problem.measurements, anchors)
        super().__init__(problem, [standing_at(anchor) for anchor in anchors])
        self.calibrations = []
        self.sigma, self._gain = problem.measurements.sigma, _GAIN
        s = self._about_anchors
        bounds = pair_bounds(s)
        begin, active = bounds[:-1], np.zeros(len(self.users), dtype=bool)
        active[self.active_users] = True
        self._solver = RigidSolver(
            active,
            self.reference,
            bounds,
            s.i[begin],
            s.j[begin],
            s.t,
            s.p_i,
            s.p_j,
            s.distance,
            s.sigma,
            s.nlos_odds,
            self.height_sigma,
            self.parameters.priors.place_sigma,
            self.yaw_sigma,
            problem.survey,
            self.survey_sigma,
            self.parameters.priors.survey_dof,
            self.loss,
        )

    def _read_antennas(self, clock_offset: Array) -> None:
        """The measurements have them; clocks are right."""
        s = self._about_anchors
        here, zeros = np.zeros(len(s), dtype=np.int32), np.zeros((len(s), 3))
        self.assumed_clock = np.zeros_like(clock_offset)
        self.ends = RangeEnds(here, zeros, s.p_i, zeros), RangeEnds(here, zeros, s.p_j, zeros)

    def to_rigid_ranges(self, states: States) -> RangeMeasurements:  # noqa: ARG002 - the face of PoseGraph
        """The measurements about the anchors: there is no drift, scale, clock or bias."""
        return self._about_anchors

    def residuals(self, states: States) -> Array:
        """(n,) m, predicted minus measured."""
        return self._solver.residuals(states.anchor_poses)

    def initial_em_weights(self) -> EmWeights:
        """Nothing is known yet; each range counts as one."""
        return self._weights(self.measurements.nlos_odds)

    def _weights(self, nlos_odds: Array) -> EmWeights:
        k, ones = len(self.users), np.ones(len(nlos_odds))
        return EmWeights(nlos_odds, ones, ones, [np.ones(0)] * k, np.ones((k + 1, 3)), np.ones(k), np.ones(k))

    def with_range_weights(self, states: States, em_weights: EmWeights) -> EmWeights:  # noqa: ARG002 - the face of PoseGraph
        """The same: each range counts as one."""
        return em_weights

    def e_step(self, states: States, before: EmWeights) -> tuple[EmWeights, float]:  # noqa: ARG002 - the face of PoseGraph
        """EM weights re-estimated at these states, and the states' negative log likelihood."""
        nlos_odds, cost = self._solver.e_step(states.anchor_poses, bursts_with_foreign(self.parameters))
        return self._weights(nlos_odds), cost

    def run_em(
        self,
        states: States,
        em_weights: EmWeights,
        rounds: int,
        annealing: float = 1.0,
        known: Sequence[Array] = (),
        hopeless: float = np.inf,
    ) -> LocalOptimum:
        """The local optimum reached from states, as in PoseGraph."""
        frames, nlos_odds, cost = self._solver.run_em(
            states.anchor_poses,
            em_weights.nlos_odds,
            bursts_with_foreign(self.parameters),
            annealing,
            rounds,
            _ITERATIONS,
            self._gain,
            list(known),
            SAME,
            hopeless,
        )
        return LocalOptimum(self, states._replace(anchor_poses=frames), self._weights(nlos_odds), cost)

    def optimised(
        self, states: States, about: Array, em_weights: EmWeights, annealing: float, iterations: int, gain: float
    ) -> States:
        """The states after at most so many Gauss-Newton steps, as in PoseGraph."""
        frames = self._solver.optimize(states.anchor_poses, about, em_weights.nlos_odds, annealing, iterations, gain)
        return states._replace(anchor_poses=frames)

    def image(self, states: States, em_weights: EmWeights, known: Sequence[Array]) -> States | None:
        """The states at the optimum for these weights; None where it, or the way to it, is at `known` poses."""
        frames = states.anchor_poses
        frames = self._solver.optimize(
            frames, frames, em_weights.nlos_odds, 1.0, _ITERATIONS, 0.25 * self._gain, list(known), SAME
        )
        there = states._replace(anchor_poses=frames)
        return None if self.is_known(there, known) else there

    def last_poses(self, states: States) -> Array:
        """(k, 4) x, y, z (m), yaw (rad): where each anchor is."""
        return states.anchor_poses.copy()

    def cost(self, frames: Array, nlos_odds: Array | None = None, most: float = np.inf) -> float:
        """The sum of the losses of all ranges, each by itself, and of the heights' prior, at frames (k, 4).

        `nlos_odds` (n,) stand for the measurements' own. Where the cost is above `most`, any number above it.
        """
        return self._solver.cost(frames, self.measurements.nlos_odds if nlos_odds is None else nlos_odds, most)

    def covariances(self, frames: Array, nlos_odds: Array) -> Array:
        """(k, 4, 4) of x, y, z (m), yaw (rad) beside the reference, at a local optimum; NaN where nobody is."""
        out = self._solver.covariances(frames, nlos_odds).reshape(-1, 4, 4)
        if len(self.active_users) < len(out):
            out[np.isin(np.arange(len(out)), self.active_users, invert=True)] = np.nan
        return out

    def other_heights(self, frames: Array, nlos_odds: Array, excluded: float) -> list[Array]:
        """Joint placements (k, 4) that differ from `frames` in heights alone and explain the ranges.

        Their cost is at most `excluded` above the best one's; `nlos_odds` (n,) stand for the measurements' own.
        """
        found = self._solver.other_heights(frames, nlos_odds, excluded, self.parameters.search.most_hypotheses)
        return [np.column_stack([frames[:, :2], heights + 0.0 * frames[:, 2], frames[:, 3]]) for heights, _ in found]
