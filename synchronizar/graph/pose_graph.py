"""The anchored pose graph (Kim et al., ICRA 2010): relative frames, keyframe poses and calibrations of all users.

Variables: per user a Pose2 F and a height H, common_from_anchor; per keyframe a Pose2 X and a height Z in the axes of
the anchor, the first fixed at SLAM's own pose; per device a vector D of log scale, radio bias and clock offset. SLAM's
steps are the odometry factors between keyframes; range factors connect the users (factors/calibrated_range.h).
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from synchronizar._core import NlosMixture, WalkNoise, foreign_or_nlos_of_pairs, mixture_terms
from synchronizar.arrays import Array, Indices, Mask
from synchronizar.data.recording import Recording
from synchronizar.data.user import User
from synchronizar.geometry import apply_frames, difference, wrap_angle
from synchronizar.graph.em_weights import EmWeights, student
from synchronizar.graph.priors import (
    CalibrationPriors,
    bursts_with_foreign,
    calibration_dof,
    calibration_sigmas,
    height_sigma_of,
    known_bias_sigmas,
    nlos_mixture,
    survey_sigmas,
)
from synchronizar.graph.problem import Problem
from synchronizar.graph.states import BIAS, CLOCK, SCALE, States, slam_states, steps, to_rigid_ranges
from synchronizar.graph.walks import Walks
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.keyframes import Keyframes, RangeEnds, range_ends
from synchronizar.preprocessing.lasting_errors import LastingErrors, lasting_errors
from synchronizar.preprocessing.range_measurements import RangeMeasurements, mean_by_pair, pair_bounds
from synchronizar.preprocessing.range_weights import (
    Correlation,
    measured_correlation,
    measured_range_weights,
    measured_sizes,
    prior_range_weights,
)

SAME = 0.01  # m and rad: optima that are closer are one
_STALE_CLOCK = 0.005  # s: antennas are read again when a clock offset changes by more
_GAIN = 0.001  # log likelihood: optimisation stops at a smaller gain, which moves no estimate measurably
_GAIN_A_RANGE = 1e-6  # log likelihood per range, in addition
_ITERATIONS = 10
_PINNED = 1e-3  # m
_LEAST_OWN = 1e-9  # probability: a weight must not be 0


class LocalOptimum(NamedTuple):
    """A local minimum of a pose graph's cost, or where EM stopped on the way to it."""

    graph: PoseGraph
    """The graph with antenna positions read at the clock offsets of these states."""
    states: States
    em_weights: EmWeights
    cost: float
    """Negative log likelihood, up to a constant that optima with the same ranges and range weights share."""

    @property
    def frames(self) -> Array:
        """(k, 4) x, y, z (m), yaw (rad) of each user's last keyframe in the common frame; the yaw is of SLAM's axes."""
        return self.graph.last_poses(self.states)

    @property
    def held_as_usual(self) -> Mask:
        """(k,) whether each device starts at the usual height."""
        return self.graph.held_as_usual


class PoseGraph:
    """The anchored pose graph of a problem's n range measurements at given keyframes. No method changes it."""

    def __init__(self, problem: Problem, keyframes: list[Keyframes]):
        """`keyframes` of all k users."""
        self.problem, self.keyframes = problem, keyframes
        measurements, parameters = problem.measurements, problem.parameters
        self.calibrations = problem.active_users
        """Whose devices are variables: all of them, or none."""
        self.model_sigma = np.hypot(measurements.sigma, parameters.ranges.multipath_sigma)
        """(n,) m, 1 sigma of each range in line of sight, with reflections as the model has them."""
        self.sigma = self._largest_sigma = self.model_sigma
        """(n,) m: the same as it is taken to be, and the largest that it may be measured to be."""
        self.lasting: LastingErrors | None = None
        """Errors of ranges that last, where they are variables: what `sigma` tells is then noise alone."""
        self.lasting_sigma = np.zeros(0)
        """(v,) m, 1 sigma of each."""
        self.said_sigma = measurements.sigma
        """(n,) m: what noise alone is said to be."""
        self._gain = _GAIN + _GAIN_A_RANGE * len(measurements)
        self.loss: NlosMixture = nlos_mixture(parameters)
        self.height_sigma = np.array([height_sigma_of(user, parameters) for user in self.users]) / np.sqrt(2.0)
        """(k,) m: of each origin about the mean level."""
        self.other_height_sigma = np.maximum(parameters.priors.other_height_sigma / np.sqrt(2.0), self.height_sigma)
        """(k,) m: the same of a device that is not held as usual."""
        self.held_as_usual = np.ones(len(self.users), dtype=bool)
        """(k,) whether the device starts at the usual height."""
        self.pinned = np.full(len(self.users), np.nan)
        """(k,) m: the height that an origin has whatever ranges and prior say; NaN of those who are free."""
        self.survey_sigma = survey_sigmas(self.users, parameters)
        """(k,) m: of each surveyed radio's place, on each axis."""
        self.known_bias_sigma = known_bias_sigmas(self.users, parameters)
        """(k,) m: of each radio's bias beside the known one; infinite where none is known."""
        self.calibration_priors = CalibrationPriors(*calibration_sigmas(parameters))
        self._read_antennas(np.zeros(len(self.users)))

    @property
    def users(self) -> tuple[User, ...]:
        """All k users of the recording."""
        return self.problem.users

    @property
    def active_users(self) -> list[int]:
        """The users in the graph, the reference among them."""
        return self.problem.active_users

    @property
    def reference(self) -> int:
        """The user whose frame is the common one."""
        return self.problem.reference

    @property
    def free(self) -> list[int]:
        """The active users but the reference."""
        return self.problem.free

    @property
    def measurements(self) -> RangeMeasurements:
        """The n ranges."""
        return self.problem.measurements

    @property
    def parameters(self) -> Parameters:
        """The model's noise, priors and thresholds."""
        return self.problem.parameters

    def drifting(self) -> list[int]:
        """The users that have steps."""
        return [u for u in self.active_users if len(self.keyframes[u]) > 1]

    def with_antennas_at(self, clock_offset: Array) -> Self:
        """The same graph with antenna positions read from the tracks at clock offsets (k,) s.

        Its clock variables count from these.
        """
        out = copy(self)
        out._read_antennas(clock_offset)
        out.__dict__.pop("walks", None)
        return out

    def _read_antennas(self, clock_offset: Array) -> None:
        """Set what depends on the clock offsets (k,) s, in a graph that nobody else holds yet."""
        recording, s = self.problem.recording, self.measurements
        self.assumed_clock = clock_offset.copy()
        self.ends: tuple[RangeEnds, RangeEnds] = (
            range_ends(recording, s, s.i, self.keyframes, clock_offset),
            range_ends(recording, s, s.j, self.keyframes, clock_offset),
        )

    def with_reflections(self, there: bool) -> Self:
        """The same graph with line-of-sight errors as large as the model's reflections make them, or as noise alone."""
        sigma = self.model_sigma if there else self.measurements.sigma
        return self._with_sigma(sigma, sigma)

    def with_sigma_of(self, other: PoseGraph) -> Self:
        """The same graph with the sigmas of another one of the same ranges."""
        return self._with_sigma(other.sigma, other._largest_sigma)

    def with_lasting_errors(self, size: float, share: float) -> Self:
        """The same graph, that has none, with errors that last.

        Errors in line of sight are `size` times as large as this one's, and so large a share of their variance lasts.
        """
        lasting = lasting_errors(self.measurements, self.parameters)
        noise = size * np.sqrt(1.0 - share)
        out = self._with_sigma(noise * self.sigma, self._largest_sigma)
        out.lasting, out.lasting_sigma = lasting, size * np.sqrt(share) * self.sigma[lasting.first_range]
        out.said_sigma = noise * self.said_sigma
        return out

    def lasting_of(self, states: States) -> Array:
        """(v,) m: the lasting errors at these states; 0 where the states have none yet."""
        count = len(self.lasting_sigma)
        return states.lasting if len(states.lasting) == count else np.zeros(count)

    def with_measured_sigma(self, states: States, range_weight: Array) -> Self:
        """The same graph with sigmas as large as line-of-sight errors are at these states, noise at least.

        They are measured on what passes by the largest sigma that they may have, with reflections or without: on what
        passes by their own measure they would shrink without end.
        """
        m, s, sigma = self.parameters, self.measurements, self._largest_sigma
        whitened, bounds = self.residuals(states) / sigma, pair_bounds(s)
        odds, own, _ = self._chains(whitened, sigma, range_weight)
        _, weight, _ = mixture_terms(whitened, sigma, odds, self.loss)
        return self._with_sigma(sigma * measured_sizes(bounds, s.sigma / sigma, whitened, own * weight, m), sigma)

    def _chains(self, whitened: Array, sigma: Array, range_weight: Array) -> tuple[Array, Array, float]:
        """NLOS odds and own probabilities (n,) at residuals (n,) over `sigma` (n,), and the cost of all chains."""
        s, bursts, bounds = self.measurements, bursts_with_foreign(self.parameters), pair_bounds(self.measurements)
        worth = mean_by_pair(range_weight, bounds)
        odds, foreign, costs = foreign_or_nlos_of_pairs(
            bounds, s.t, s.distance, whitened, sigma, s.nlos_odds, worth, self.loss, bursts
        )
        return odds, np.maximum(1.0 - foreign, _LEAST_OWN), float(costs @ worth)

    def _with_sigma(self, sigma: Array, largest: Array) -> Self:
        out = copy(self)
        out.sigma, out._largest_sigma = sigma, largest
        out.__dict__.pop("walks", None)
        return out

    def with_keyframes(self, keyframes: list[Keyframes]) -> Self:
        """The same graph with other step sigmas; `keyframes` differ from its own in nothing else."""
        out = copy(self)
        out.keyframes = keyframes
        return out

    def with_other_keyframes(self, keyframes: list[Keyframes]) -> Self:
        """The same graph at other moments."""
        out = copy(self)
        out.keyframes = keyframes
        out._read_antennas(self.assumed_clock)
        out.__dict__.pop("walks", None)
        return out

    def with_held_as_usual(self, usual: Mask) -> Self:
        """The same graph with other devices (k,) that start at the usual height."""
        out = copy(self)
        out.held_as_usual = usual
        return out

    def with_pinned_heights(self, heights: Array, users: Sequence[int]) -> Self:
        """The same graph in which the origins of some users have given heights, (k,) m of all."""
        out = copy(self)
        out.pinned = np.where(np.isin(np.arange(len(heights)), users), heights, np.nan)
        return out

    def with_calibration_priors(self, priors: CalibrationPriors) -> Self:
        """The same graph with other priors of calibrations."""
        out = copy(self)
        out.calibration_priors = priors
        return out

    def initial_states(self, frames: Array, calibration: Array | None = None) -> States:
        """SLAM's own poses as states, with anchors at frames (k, 4) x, y, z (m), yaw (rad); `calibration` (k, 3)."""
        return slam_states(
            frames, self.keyframes, np.zeros((len(self.users), 3)) if calibration is None else calibration
        )

    # Residuals at given states

    def residuals(self, states: States) -> Array:
        """(n,) m, predicted minus measured."""
        walks = self.walks
        return walks.solver.residuals(
            walks.places(states),
            states.calibration[walks.users],
            self.lasting_of(states),
            self.assumed_clock[walks.users],
        )

    @cached_property
    def walks(self) -> Walks:
        """The walks as the core's solver has them."""
        s, users = self.measurements, self.active_users
        return Walks.of(
            users,
            self.reference,
            [self.keyframes[u].place - self.keyframes[u].anchor for u in users],
            [self.keyframes[u].t - self.assumed_clock[u] for u in users],
            (s.i, s.j, s.distance, self.sigma),
            self.ends,
            self.lasting,
        )

    def walk_noise(self, about: Array, em_weights: EmWeights) -> WalkNoise:
        """Weights and priors of the walks; the wide priors of position and yaw are centred on frames (k, 4)."""
        m, users, surveyed = self.parameters, self.active_users, self.problem.surveyed
        own, common = self.calibration_priors[:2]
        about = about.copy()
        about[surveyed, :3] = self.problem.survey[surveyed]
        height = np.where(surveyed, self.survey_sigma, self.height_sigma) / np.sqrt(em_weights.height_weight)
        place = np.where(surveyed, height, m.priors.place_sigma)
        pinned = ~np.isnan(self.pinned)
        about[pinned, 2], height[pinned] = self.pinned[pinned], _PINNED
        weight = np.sqrt(em_weights.calibration_weight)
        of_users = [
            np.vstack([np.ones((1, 3)), self.keyframes[u].step_sigma / np.sqrt(em_weights.step_weight[u])[:, None]])
            for u in users
        ]
        return WalkNoise(
            em_weights.nlos_odds,
            em_weights.range_weight * em_weights.own_probability,
            np.concatenate(of_users),
            about[users],
            place[users],
            self.yaw_sigma,
            height[users],
            (surveyed | pinned)[users],
            own / weight[users],
            self.known_bias_sigma[users],
            common / weight[-1],
            self.assumed_clock[users],
            self.lasting_sigma,
            np.concatenate([em_weights.level_weight[u] * self.keyframes[u].level_information for u in users]),
        )

    @property
    def yaw_sigma(self) -> float:
        """All users may turn about the reference together: their k priors on that turn must weigh as much as one."""
        return float(self.parameters.priors.yaw_sigma * np.sqrt(max(len(self.free), 1)))

    def to_rigid_ranges(self, states: States) -> RangeMeasurements:
        """The ranges for a rigid model: antennas corrected for drift, scale and clock, distances for bias."""
        out = to_rigid_ranges(self.measurements, states, self.ends, self.assumed_clock)
        if self.lasting is not None:
            out = replace(out, distance=out.distance - self.lasting_of(states)[self.lasting.of_range])
        return replace(out, sigma=self.sigma)

    def rigid_problem(self, states: States) -> Problem:
        """The problem of a rigid model at these states: the same users with `to_rigid_ranges`."""
        return self.problem.with_measurements(self.to_rigid_ranges(states))

    def inlier_probability(self, states: States, em_weights: EmWeights) -> tuple[Array, Array]:
        """(n,) each: the weight that the loss gives each range, and the probability that it is line-of-sight."""
        weight, inlier_probability = self._terms(self.residuals(states) / self.sigma, em_weights)
        return weight, inlier_probability

    def _terms(self, whitened: Array, em_weights: EmWeights) -> tuple[Array, Array]:
        _, weight, inlier_probability = mixture_terms(whitened, self.sigma, em_weights.nlos_odds, self.loss)
        return em_weights.own_probability * weight, em_weights.own_probability * inlier_probability

    def height_curvature(self, states: States, em_weights: EmWeights) -> Array:
        """(n,) 1/m^2: second derivative of the cost in the height difference by the curvature of each distance.

        w rho'(e) (1 - e_z^2) / (d sigma), with w the range weight and e_z the vertical part of the unit direction; the
        Gauss-Newton term rho''(e) (e_z / sigma)^2 is not in it.
        """
        flat = self.to_rigid_ranges(states)
        between = apply_frames(states.anchor_poses[flat.i], flat.p_i) - apply_frames(
            states.anchor_poses[flat.j], flat.p_j
        )
        distance = np.maximum(np.linalg.norm(between, axis=1), 1e-9)
        whitened = (distance - flat.distance) / self.sigma
        weight, _ = self._terms(whitened, em_weights)
        level = 1.0 - (between[:, 2] / distance) ** 2
        return np.asarray(em_weights.range_weight * weight * whitened / self.sigma * level / distance)

    # EM weights

    def initial_em_weights(self) -> EmWeights:
        """Initial weights, from the priors."""
        weights = [np.ones(len(k.step_sigma)) for k in self.keyframes]
        first = prior_range_weights(self.measurements, self.parameters)
        k = len(self.users)
        own = np.ones(len(self.measurements))
        return EmWeights(self.measurements.nlos_odds, own, first, weights, np.ones((k + 1, 3)), np.ones(k), np.ones(k))

    def e_step(self, states: States, before: EmWeights) -> tuple[EmWeights, float]:
        """EM weights re-estimated at these states, and the states' negative log likelihood.

        Range weights stay as they were before. Costs of graphs with the same ranges and range weights can be
        compared.
        """
        odds, own, cost = self._chains(self.residuals(states) / self.sigma, self.sigma, before.range_weight)
        weights = [np.ones(len(k.step_sigma)) for k in self.keyframes]
        for u in self.drifting():
            squares = (steps(states.keyframe_poses[u], self.keyframes[u]) ** 2).sum(axis=1)
            weights[u], tail = student(squares, self.parameters.slam.drift_dof, 4)
            cost += tail
        cost += self._cost_of_lasting(states)
        calibration_weight, tail = self._calibration_weights(states, before)
        height_weight, of_heights = self.height_weights(states.anchor_poses)
        level_weight, of_levels = self.level_weights(states)
        after = EmWeights(odds, own, before.range_weight, weights, calibration_weight, height_weight, level_weight)
        return after, cost + tail + of_heights + of_levels

    def _cost_of_lasting(self, states: States) -> float:
        if self.lasting is None:
            return 0.0
        errors, decay = self.lasting_of(states), self.lasting.decay
        before = np.where(self.lasting.follows >= 0, errors[self.lasting.follows], 0.0)
        return 0.5 * float((((errors - decay * before) / self.lasting_steps) ** 2).sum())

    @property
    def lasting_steps(self) -> Array:
        """(v,) m, 1 sigma of each lasting error beside the one that it follows."""
        return self.lasting_sigma if self.lasting is None else self.lasting_sigma * np.sqrt(1.0 - self.lasting.decay**2)

    def with_range_weights(self, states: States, em_weights: EmWeights) -> EmWeights:
        """The same EM weights, range weights measured on the residuals (`measured_range_weights`)."""
        whitened = self.residuals(states) / self.sigma
        weight, _ = self._terms(whitened, em_weights)
        measured = measured_range_weights(
            self.measurements,
            self.said_sigma / self.sigma,
            weight,
            self._correlation(whitened, weight),
            self.parameters,
        )
        return replace(em_weights, range_weight=measured)

    def correlation(self, states: States, em_weights: EmWeights) -> Correlation:
        """Of the errors of neighbouring ranges at these states."""
        whitened = self.residuals(states) / self.sigma
        return self._correlation(whitened, self._terms(whitened, em_weights)[0])

    def _correlation(self, whitened: Array, weight: Array) -> Correlation:
        r = self.parameters.ranges
        links = _links(self.problem.recording, self.measurements)
        reach = r.multipath_duration if self.lasting is None else r.multipath_slot
        return measured_correlation(self.measurements, whitened, weight, links, reach, self.parameters)

    def _calibration_weights(self, states: States, before: EmWeights) -> tuple[Array, float]:
        """Weights (k + 1, 3) of the device calibrations, the last row of the shared one, and their cost."""
        own, common = self.calibration_priors[:2]
        shared = self.shared_calibration(states, before.calibration_weight)
        squares = np.zeros((len(self.users) + 1, 3))
        squares[self.active_users] = ((states.calibration[self.active_users] - shared) / own) ** 2
        squares[-1] = (shared / common) ** 2
        weight, cost = student(squares, calibration_dof(self.parameters), 1)
        known = states.calibration[self.active_users, BIAS] / self.known_bias_sigma[self.active_users]
        return weight, cost + 0.5 * float(known @ known)

    def shared_calibration(self, states: States, calibration_weight: Array) -> Array:
        """(3,) the most likely shared calibration, given weights (k + 1, 3)."""
        own, common = self.calibration_priors[:2]
        weight = calibration_weight[self.active_users] / own**2
        total = weight.sum(axis=0) + calibration_weight[-1] / common**2
        return np.asarray((weight * states.calibration[self.active_users]).sum(axis=0) / total)

    def height_weights(self, frames: Array) -> tuple[Array, float]:
        """Weights (k,) of the origins' heights about their most likely mean, of surveyed places, and their cost.

        The cost is that of the heights beside the mean level, whatever that is.
        """
        users, share = self._on_level, self.parameters.priors.usual_height_share
        weight = np.where(self.held_as_usual, 1.0, (self.height_sigma / self.other_height_sigma) ** 2)
        information = self.height_sigma[users] ** -2.0
        squares = weight[users] * information * (frames[users, 2] - self.mean_height(frames, weight)) ** 2
        cost = 0.5 * float(squares.sum() - np.log(weight[users]).sum())
        cost += 0.5 * float(np.log(weight[users] @ information / information.sum()))
        cost += float((~self.held_as_usual[users]).sum() * np.log(share / (1.0 - share)))
        surveyed = np.flatnonzero(self.problem.surveyed)
        off_places = frames[surveyed, :3] - self.problem.survey[surveyed]
        of_places = (off_places**2).sum(axis=1) / self.survey_sigma[surveyed] ** 2
        weight[surveyed], of_survey = student(of_places, self.parameters.priors.survey_dof, 3)
        return weight, cost + of_survey

    def level_weights(self, states: States) -> tuple[Array, float]:
        """Weights (k,) of how far devices stray from the heights at which they are carried, and their cost."""
        squares, independent = np.zeros(len(self.users)), np.zeros(len(self.users))
        scale, priors = np.exp(states.calibration[:, SCALE]), self.parameters.priors
        for u in self.active_users:
            keyframes = self.keyframes[u]
            if len(keyframes) > 1:
                information, height = keyframes.level_information, scale[u] * states.keyframe_poses[u][:, 2]
                squares[u] = information @ (height - information @ height / information.sum()) ** 2
                independent[u] = min((keyframes.t[-1] - keyframes.t[0]) / priors.level_duration, len(keyframes))
        return student(squares, priors.level_dof, independent)

    @property
    def _on_level(self) -> list[int]:
        """The active users whose heights the mean level is of: all but surveyed radios."""
        surveyed = self.problem.surveyed
        return [u for u in self.active_users if not surveyed[u]]

    def mean_height(self, frames: Array, height_weight: Array) -> float:
        """The most likely mean height (m) of the origins, at anchor poses (k, 4) and weights (k,)."""
        users = self._on_level
        weight = height_weight[users] / self.height_sigma[users] ** 2
        return float(weight @ frames[users, 2] / weight.sum())

    # Optimisation

    def run_em(
        self,
        states: States,
        em_weights: EmWeights,
        rounds: int,
        annealing: float = 1.0,
        known: Sequence[Array] = (),
        hopeless: float = np.inf,
    ) -> LocalOptimum:
        """The local optimum reached from states: optimises the states and re-estimates the weights in turn.

        Expectation maximisation; antenna positions are read again where clock offsets have changed. Stops when a round
        lowers the cost by less than the graph's gain, or after `rounds`; or when, after a round, the last poses are
        `known` ones (the cost returned is then that before it) or the states cost more than `hopeless`.
        """
        graph, about, before, gain = self, states.anchor_poses, np.inf, self._gain
        for _ in range(rounds):
            if np.abs(states.calibration[:, CLOCK] - graph.assumed_clock).max() > _STALE_CLOCK:
                graph = graph.with_antennas_at(states.calibration[:, CLOCK])
            if before < np.inf and self.is_known(states, known):
                return LocalOptimum(graph, states, em_weights, before)
            em_weights, cost = graph.e_step(states, em_weights)
            if before - cost < gain or hopeless < cost < before < np.inf:
                return LocalOptimum(graph, states, em_weights, cost)
            before = cost
            states = graph.optimised(states, about, em_weights, annealing, _ITERATIONS, 0.25 * gain)
        em_weights, cost = graph.e_step(states, em_weights)
        return LocalOptimum(graph, states, em_weights, cost)

    def is_known(self, states: States, known: Sequence[Array]) -> bool:
        """Whether the last poses are within `SAME` of some known ones, (k, 4) each."""
        here = self.last_poses(states)
        return any(np.nanmax(np.abs(difference(here, there))) < SAME for there in known)

    def optimised(
        self, states: States, about: Array, em_weights: EmWeights, annealing: float, iterations: int, gain: float
    ) -> States:
        """The states after at most so many Gauss-Newton steps, until one gains less than `gain`.

        `annealing` >= 1 widens the loss; the wide priors of position and yaw are centred on frames `about` (k, 4).
        """
        walks = self.walks
        places, calibration, lasting = walks.solver.optimize(
            walks.places(states),
            states.calibration[walks.users],
            self.lasting_of(states),
            self.walk_noise(about, em_weights),
            self.loss,
            annealing,
            iterations,
            gain,
        )
        return walks.states(places, calibration, lasting, states)

    def last_poses(self, states: States) -> Array:
        """(k, 4) x, y, z (m), yaw (rad) of each user's last keyframe in the common frame; the yaw is of SLAM's axes."""
        out = states.anchor_poses.copy()
        for u, keyframe_poses in enumerate(states.keyframe_poses):
            out[u, :3] = apply_frames(
                states.anchor_poses[u], np.exp(states.calibration[u, SCALE]) * keyframe_poses[-1, :3]
            )
            out[u, 3] = wrap_angle(out[u, 3] + keyframe_poses[-1, 3])
        return out

    def prior_variances(self, user: int) -> Array:
        """(4,) prior variances of x, y, z (m^2) and yaw (rad^2) relative to the reference."""
        m = self.parameters
        if self.problem.surveyed[user]:
            place = float(self.survey_sigma[user]) ** 2
            return np.array([place, place, place, m.priors.yaw_sigma**2])
        height = self.height_sigma[user] ** 2 + self.height_sigma[self.reference] ** 2
        return np.array([m.priors.place_sigma**2, m.priors.place_sigma**2, height, m.priors.yaw_sigma**2])


def _links(recording: Recording, measurements: RangeMeasurements) -> Indices:
    """(n,) a number for the two antennas of each range."""
    a, b = recording.ranges.antenna_a[measurements.row], recording.ranges.antenna_b[measurements.row]
    swapped = recording.ranges.a[measurements.row] != measurements.i
    many = int(max(a.max(initial=0), b.max(initial=0))) + 2
    return np.where(swapped, (b + 1) * many + a + 1, (a + 1) * many + b + 1).astype(np.int32)
