"""Anchored pose graphs (Kim et al., ICRA 2010): everybody's SLAM bends where the ranges say so.

Per user a frame F and a height H of its anchor in the common frame; per keyframe a pose X and a height Z about the
anchor, the first held at SLAM's own; per device a vector of log scale, radio bias and clock offset. SLAM's steps tie
the keyframes, ranges tie the users (factors/device_range.h).
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise

import gtsam
import numpy as np

from synchronizar._core import CalibratedRangeBlock, NlosMixture, burst_nlos_odds, mixture_terms
from synchronizar.arrays import Array, Indices
from synchronizar.cooperative import Cooperative, finish
from synchronizar.data.recording import Recording
from synchronizar.geometry import apply_frames, wrap_angle
from synchronizar.graph import keys
from synchronizar.graph.marginal_prior import MarginalPrior
from synchronizar.graph.optimization import optimizing
from synchronizar.graph.range_factors import CalibratedRangeBlockFactor, CalibratedUserKeys, PoseCache
from synchronizar.graph.rigid_graph import bursts_of, height_sigma_of, nlos_mixture
from synchronizar.graph.states import BIAS, CLOCK, SCALE, States, antennas, slam_states, steps, to_rigid_ranges
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.keyframes import Keyframes, RangeEnds, range_ends
from synchronizar.preprocessing.range_measurements import RangeMeasurements, pairs
from synchronizar.preprocessing.range_weights import measured_range_weights, prior_range_weights

_STALE_CLOCK = 0.005  # s: antennas that were read for a clock further off are read anew
_GAIN = 0.05  # of log likelihood: what gains less changes nothing that could be measured
_GAIN_A_RANGE = 3e-5  # nor does what gains less a range
_ITERATIONS = 10


@dataclass(frozen=True)
class EmWeights:
    """What is held while the variables are sought, and sought anew when they were found."""

    nlos_odds: Array
    """(n,) of each range, its neighbours in time considered."""
    range_weight: Array
    """(n,) as how many independent ranges each counts."""
    step_weight: list[Array]
    """Of each user (m - 1,): how far each of SLAM's steps is believed; Student's t."""
    calibration_weight: Array
    """(k + 1, 3): the same of each device's scale, bias and clock being as usual, and of what is usual being none."""


class PoseGraph:
    """The graph of some samples; keyframes as they are given."""

    def __init__(
        self,
        recording: Recording,
        measurements: RangeMeasurements,
        keyframes: list[Keyframes],
        active_users: list[int],
        reference: int,
        parameters: Parameters,
        marginal_prior: MarginalPrior | None = None,
    ):
        """`recording` has mended tracks; `active_users` are the users that take part, the reference among them.

        `marginal_prior` is what earlier ranges told of some of them, at their first keyframes.
        """
        self.recording, self.measurements, self.keyframes = recording, measurements, keyframes
        self.users = recording.users
        self.active_users, self.reference = active_users, reference
        self.free = [u for u in active_users if u != reference]
        self.parameters, self.marginal_prior = parameters, marginal_prior
        known = [] if marginal_prior is None else marginal_prior.users
        # Of whom nothing is known but priors; and whose heights are about a level that all share.
        self._new = [u for u in active_users if u not in known]
        self._level_users = active_users if marginal_prior is None else [reference, *self._new]
        self.sigma = np.hypot(measurements.sigma, parameters.ranges.multipath_sigma)
        self._loss: NlosMixture = nlos_mixture(parameters)
        self._from_level = np.array([height_sigma_of(user, parameters) for user in self.users]) / np.sqrt(2.0)
        self._links = _links(recording, measurements)
        self._reading = PoseCache()
        self.read_antennas(np.zeros(len(self.users)))

    def read_antennas(self, clock_offset: Array) -> None:
        """Read antennas off the tracks anew, for clock offsets (k,) s; keep those that the walks are solved for."""
        s = self.measurements
        self._clock = clock_offset.copy()
        self._ends: tuple[RangeEnds, RangeEnds] = (
            range_ends(self.recording, s, s.i, self.keyframes, clock_offset),
            range_ends(self.recording, s, s.j, self.keyframes, clock_offset),
        )
        i, j = self._ends
        changes = np.diff(s.i) | np.diff(s.j) | np.diff(i.keyframe) | np.diff(j.keyframe)
        self._bounds = np.unique(np.concatenate([[0], np.flatnonzero(changes) + 1, [len(s)]]))

    def with_keyframes(self, keyframes: list[Keyframes]) -> PoseGraph:
        """The same graph; keyframes are the same but for how far SLAM's steps can be trusted."""
        out = copy(self)
        out.keyframes = keyframes
        return out

    def initial_states(self, frames: Array, calibration: Array | None = None) -> States:
        """SLAM as it is, laid at frames (k, 4) of the anchors."""
        return slam_states(
            frames, self.keyframes, np.zeros((len(self.users), 3)) if calibration is None else calibration
        )

    # What the samples say of some walks

    def residuals(self, states: States) -> Array:
        """(n,) m, predicted minus measured."""
        s = self.measurements
        i = antennas(states, s.i, self._ends[0], self._clock)
        j = antennas(states, s.j, self._ends[1], self._clock)
        q_i, q_j = (apply_frames(states.anchor_poses[who], p) for who, p in ((s.i, i), (s.j, j)))
        bias = states.calibration[s.i, BIAS] + states.calibration[s.j, BIAS]
        return np.asarray(np.linalg.norm(q_i - q_j, axis=1) + bias - s.distance)

    def to_rigid_ranges(self, states: States) -> RangeMeasurements:
        """The samples as a rigid model would have them: drift, scale, clocks and biases taken out."""
        return replace(to_rigid_ranges(self.measurements, states, self._ends, self._clock), sigma=self.sigma)

    def inlier_probability(self, states: States, em_weights: EmWeights) -> tuple[Array, Array]:
        """(n,) each: the weight that the loss gives each range, and the probability that it is honest."""
        whitened = self.residuals(states) / self.sigma
        _, weight, inlier_probability = mixture_terms(whitened, self.sigma, em_weights.nlos_odds, self._loss)
        return weight, inlier_probability

    def height_curvature(self, states: States, em_weights: EmWeights) -> Array:
        """(n,) 1/m^2: what each range's bending adds to the cost's second derivative in the difference in height."""
        flat = self.to_rigid_ranges(states)
        between = apply_frames(states.anchor_poses[flat.i], flat.p_i) - apply_frames(
            states.anchor_poses[flat.j], flat.p_j
        )
        distance = np.maximum(np.linalg.norm(between, axis=1), 1e-9)
        whitened = (distance - flat.distance) / self.sigma
        _, weight, _ = mixture_terms(whitened, self.sigma, em_weights.nlos_odds, self._loss)
        level = 1.0 - (between[:, 2] / distance) ** 2
        return np.asarray(em_weights.range_weight * weight * whitened / self.sigma * level / distance)

    # What is judged between two searches

    def initial_em_weights(self) -> EmWeights:
        """Nothing is known yet."""
        weights = [np.ones(len(k.step_sigma)) for k in self.keyframes]
        first = prior_range_weights(self.measurements, self.parameters)
        return EmWeights(self.measurements.nlos_odds, first, weights, np.ones((len(self.users) + 1, 3)))

    def e_step(self, states: States, before: EmWeights) -> tuple[EmWeights, float]:
        """How late, how believable everything is at these walks; and their negative log likelihood.

        Costs of graphs with the same samples and worth can be compared.
        """
        m, s = self.parameters, self.measurements
        whitened = self.residuals(states) / self.sigma
        odds, cost = np.empty(len(s)), 0.0
        for pair in pairs(s):
            k = pair.measurements
            odds[k], chain = burst_nlos_odds(
                s.t[k],
                whitened[k],
                self.sigma[k],
                s.nlos_odds[k],
                self._loss,
                bursts_of(m),
            )
            cost += chain * float(before.range_weight[k].mean())
        weights = [np.ones(len(k.step_sigma)) for k in self.keyframes]
        for u in self.active_users:
            squares = (steps(states.keyframe_poses[u], self.keyframes[u]) ** 2).sum(axis=1)
            weights[u], tail = _student(squares, m.slam.drift_dof, 4)
            cost += tail
        calibration_weight, tail = self._calibration_weights(states, before)
        return EmWeights(odds, before.range_weight, weights, calibration_weight), cost + tail + self._height_cost(
            states
        ) + self._carried_cost(states)

    def with_range_weights(self, states: States, em_weights: EmWeights) -> EmWeights:
        """The same, what ranges are worth measured on their residuals."""
        whitened = self.residuals(states) / self.sigma
        _, weight, _ = mixture_terms(whitened, self.sigma, em_weights.nlos_odds, self._loss)
        return replace(
            em_weights,
            range_weight=measured_range_weights(
                self.measurements, self.sigma, whitened, weight, self._links, self.parameters
            ),
        )

    def _calibration_weights(self, states: States, before: EmWeights) -> tuple[Array, float]:
        """The weights (k + 1, 3) of the devices, the last row that of what they have in common; and the cost."""
        own, common = calibration_sigmas(self.parameters)
        kind = self._kind(states, before.calibration_weight)
        squares = np.zeros((len(self.users) + 1, 3))
        squares[self._new] = ((states.calibration[self._new] - kind) / own) ** 2
        squares[-1] = (kind / common) ** 2
        return _student(squares, calibration_dof(self.parameters), 1)

    def _kind(self, states: States, calibration_weight: Array) -> Array:
        """(3,) the most likely common part of the devices, by weights (k + 1, 3)."""
        own, common = calibration_sigmas(self.parameters)
        weight = calibration_weight[self._new] / own**2
        total = weight.sum(axis=0) + calibration_weight[-1] / common**2
        return np.asarray((weight * states.calibration[self._new]).sum(axis=0) / total)

    def _height_cost(self, states: States) -> float:
        heights, weight = states.anchor_poses[self._level_users, 2], self._from_level[self._level_users] ** -2
        level = self._level(states)
        return 0.5 * float((weight * (heights - level) ** 2).sum())

    def _level(self, states: States) -> float:
        """The most likely height (m) that origins lie about."""
        weight = self._from_level[self._level_users] ** -2
        return float(weight @ states.anchor_poses[self._level_users, 2] / weight.sum())

    def _carried_cost(self, states: States) -> float:
        if self.marginal_prior is None:
            return 0.0
        return float(self.marginal_prior.factor(self._clock).error(self._shared_values(states)))

    # The graph

    def run_em(
        self, states: States, em_weights: EmWeights, rounds: int, annealing: float = 1.0
    ) -> tuple[States, EmWeights, float]:
        """Find the walks and judge what is late in turn (expectation maximisation), until neither changes."""
        return finish(self.running_em(states, em_weights, rounds, annealing))

    def running_em(
        self,
        states: States,
        em_weights: EmWeights,
        rounds: int,
        annealing: float = 1.0,
        steps_a_round: int = _ITERATIONS,
    ) -> Cooperative[tuple[States, EmWeights, float]]:
        """`run_em` in portions; fewer steps a round are enough near a minimum."""
        about, before = states.anchor_poses, np.inf
        gain = _GAIN + _GAIN_A_RANGE * len(self.measurements)
        for _ in range(rounds):
            if np.abs(states.calibration[:, CLOCK] - self._clock).max() > _STALE_CLOCK:
                self.read_antennas(states.calibration[:, CLOCK])
                yield
            em_weights, cost = self.e_step(states, em_weights)
            if before - cost < gain:
                return states, em_weights, cost
            before = cost
            factors = self.factors(about, em_weights, annealing)
            yield
            values, ordering = self.values(states), self.ordering()
            values = yield from optimizing(factors, values, ordering, steps_a_round, 0.25 * gain, self._reading)
            states = self.states(values, states)
            yield
        em_weights, cost = self.e_step(states, em_weights)
        return states, em_weights, cost

    def factors(
        self, about: Array, em_weights: EmWeights, annealing: float = 1.0, height_curvature: Array | None = None
    ) -> gtsam.NonlinearFactorGraph:
        """Priors, with those of places and headings, which say nothing, about frames (k, 4); SLAM's steps; ranges.

        `height_curvature` (n,) stands for that of the ranges themselves.
        """
        graph = gtsam.NonlinearFactorGraph()
        self._add_priors(graph, about, em_weights)
        for u in self.active_users:
            self.add_steps(graph, u, em_weights.step_weight[u])
        s, (i, j) = self.measurements, self._ends
        for first, end in pairwise(self._bounds.tolist()):
            k = slice(first, end)
            block = CalibratedRangeBlock(
                (i.offset[k], i.lever[k], i.velocity[k]),
                (j.offset[k], j.lever[k], j.velocity[k]),
                s.distance[k],
                self.sigma[k],
                em_weights.nlos_odds[k],
                em_weights.range_weight[k],
            )
            keys_i = self.keys(int(s.i[first]), int(i.keyframe[first]))
            keys_j = self.keys(int(s.j[first]), int(j.keyframe[first]))
            bends = None if height_curvature is None else float(height_curvature[k].sum())
            graph.add(CalibratedRangeBlockFactor(keys_i, keys_j, block, self._loss, annealing, self._reading, bends))
        return graph

    def linearizing(
        self, states: States, em_weights: EmWeights, height_curvature: Array | None = None
    ) -> Cooperative[gtsam.GaussianFactorGraph]:
        """All factors at some walks, in portions."""
        factors = self.factors(states.anchor_poses, em_weights, height_curvature=height_curvature)
        yield
        values = self.values(states)
        yield
        self._reading.hold(values)
        linear = factors.linearize(values)
        self._reading.hold(None)
        return linear

    def _add_priors(self, graph: gtsam.NonlinearFactorGraph, about: Array, em_weights: EmWeights) -> None:
        m, noise = self.parameters, gtsam.noiseModel
        # All may turn about the reference together: what their k priors say of that must be what one says.
        yaw_sigma = m.priors.yaw_sigma * np.sqrt(max(len(self.free), 1))
        wide = noise.Diagonal.Sigmas(np.array([m.priors.place_sigma, m.priors.place_sigma, yaw_sigma]))
        if self.marginal_prior is not None:
            graph.add(self.marginal_prior.factor(self._clock))
        for u in self.free:
            if u not in self._new:
                continue
            x, y, _, yaw = about[u].tolist()
            graph.addPriorPose2(keys.frame(u), gtsam.Pose2(x, y, yaw), wide)
            graph.add(
                gtsam.BetweenFactorDouble(
                    keys.MEAN_HEIGHT, keys.height(u), 0.0, noise.Isotropic.Sigma(1, self._from_level[u])
                )
            )
        own, common = calibration_sigmas(m)
        weight = np.sqrt(em_weights.calibration_weight)
        for u in self._new:
            usual = np.array([0.0, 0.0, -self._clock[u]])
            graph.add(
                gtsam.BetweenFactorVector(
                    keys.SHARED_CALIBRATION, keys.calibration(u), usual, noise.Diagonal.Sigmas(own / weight[u])
                )
            )
        graph.addPriorVector(keys.SHARED_CALIBRATION, np.zeros(3), noise.Diagonal.Sigmas(common / weight[-1]))
        graph.addPriorDouble(keys.MEAN_HEIGHT, 0.0, noise.Isotropic.Sigma(1, self._from_level[self.reference]))

    def add_steps(self, graph: gtsam.NonlinearFactorGraph, user: int, weight: Array) -> None:
        """SLAM's steps, the first from a keyframe that is held."""
        noise, frames = gtsam.noiseModel, self.keyframes[user]
        sigmas = frames.step_sigma / np.sqrt(weight)[:, None]
        ways = np.diff(frames.place - frames.anchor, axis=0).tolist()
        for n, ((x, y, z), (plane, up, turn)) in enumerate(zip(ways, sigmas.tolist(), strict=True)):
            level, height = noise.Diagonal.Sigmas(np.array([plane, plane, turn])), noise.Isotropic.Sigma(1, up)
            if n == 0:
                graph.addPriorPose2(keys.pose(user, 1), gtsam.Pose2(x, y, 0.0), level)
                graph.addPriorDouble(keys.local_height(user, 1), float(frames.place[0, 2]) + z, height)
            else:
                here, there = keys.pose(user, n), keys.pose(user, n + 1)
                graph.add(gtsam.BetweenFactorPose2(here, there, gtsam.Pose2(x, y, 0.0), level))
                here, there = keys.local_height(user, n), keys.local_height(user, n + 1)
                graph.add(gtsam.BetweenFactorDouble(here, there, z, height))

    def keys(self, user: int, keyframe: int) -> CalibratedUserKeys:
        """Those of a user at a keyframe: the reference's frame and everybody's first keyframe are held."""
        free, first = user != self.reference, keyframe == 0
        return CalibratedUserKeys(
            keys.frame(user) if free else None,
            keys.height(user) if free else None,
            None if first else keys.pose(user, keyframe),
            None if first else keys.local_height(user, keyframe),
            keys.calibration(user),
            held_local=(0.0, 0.0, 0.0, float(self.keyframes[user].place[0, 2])),
        )

    def ordering(self) -> gtsam.Ordering:
        """Keyframes in the order of time, then what all of them share: a band with a narrow border."""
        return keys.ordering([*self.keyframe_keys(set()), *self.shared_keys()])

    def keyframe_keys(self, without: set[int]) -> Iterator[int]:
        """Those of all keyframes that are not held, but for some, in the order of time."""
        stamps = [
            (t - self._clock[u], u, n + 1)
            for u in self.active_users
            for n, t in enumerate(self.keyframes[u].t[1:].tolist())
        ]
        for _, u, n in sorted(stamps):
            for key in (keys.pose(u, n), keys.local_height(u, n)):
                if key not in without:
                    yield key

    def shared_keys(self) -> list[int]:
        """Those of frames, devices and what all have in common."""
        frames = [key for u in self.free for key in (keys.frame(u), keys.height(u))]
        return [*frames, *(keys.calibration(u) for u in self.active_users), keys.SHARED_CALIBRATION, keys.MEAN_HEIGHT]

    def values(self, states: States) -> gtsam.Values:
        """Gtsam's values at these walks."""
        values = self._shared_values(states)
        for u in self.active_users:
            for n, (x, y, z, yaw) in enumerate(states.keyframe_poses[u].tolist()):
                if n > 0:
                    values.insert(keys.pose(u, n), gtsam.Pose2(x, y, yaw))
                    values.insert(keys.local_height(u, n), z)
        return values

    def _shared_values(self, states: States) -> gtsam.Values:
        """Those of `shared_keys`."""
        values = gtsam.Values()
        for u in self.active_users:
            if u != self.reference:
                x, y, z, yaw = states.anchor_poses[u].tolist()
                values.insert(keys.frame(u), gtsam.Pose2(x, y, yaw))
                values.insert(keys.height(u), z)
            values.insert(keys.calibration(u), states.calibration[u] - np.array([0.0, 0.0, self._clock[u]]))
        values.insert(keys.SHARED_CALIBRATION, self._kind(states, np.ones((len(self.users) + 1, 3))))
        values.insert(keys.MEAN_HEIGHT, self._level(states))
        return values

    def states(self, values: gtsam.Values, before: States) -> States:
        """The walks at these values; what is not among them stays as it was before."""
        frames, calibration = before.anchor_poses.copy(), before.calibration.copy()
        keyframe_poses = [of_user.copy() for of_user in before.keyframe_poses]
        for u in self.active_users:
            if u != self.reference:
                at = values.atPose2(keys.frame(u))
                frames[u] = at.x(), at.y(), values.atDouble(keys.height(u)), at.theta()
            calibration[u] = values.atVector(keys.calibration(u))
            calibration[u, CLOCK] += self._clock[u]
            for n in range(1, len(keyframe_poses[u])):
                at = values.atPose2(keys.pose(u, n))
                keyframe_poses[u][n] = at.x(), at.y(), values.atDouble(keys.local_height(u, n)), at.theta()
        return States(frames, keyframe_poses, calibration)

    def last_poses(self, states: States) -> Array:
        """(k, 4) x, y, z (m), yaw (rad): where each last keyframe is, and how SLAM's axes lie there."""
        out = states.anchor_poses.copy()
        for u, keyframe_poses in enumerate(states.keyframe_poses):
            out[u, :3] = apply_frames(
                states.anchor_poses[u], np.exp(states.calibration[u, SCALE]) * keyframe_poses[-1, :3]
            )
            out[u, 3] = wrap_angle(out[u, 3] + keyframe_poses[-1, 3])
        return out

    def prior_variances(self, user: int) -> Array:
        """(4,) of x, y, z (m^2) and yaw (rad^2), relative to the reference, before any range."""
        m = self.parameters
        height = self._from_level[user] ** 2 + self._from_level[self.reference] ** 2
        return np.array([m.priors.place_sigma**2, m.priors.place_sigma**2, height, m.priors.yaw_sigma**2])


def calibration_sigmas(parameters: Parameters) -> tuple[Array, Array]:
    """1 sigma (3,) of log scale, bias (m) and clock (s): of each device's own, and of what all have in common."""
    m = parameters
    own = np.array([m.devices.scale_sigma, m.devices.bias_sigma, m.devices.clock_sigma])
    return own, np.array([m.devices.scale_common_sigma, m.devices.bias_common_sigma, m.devices.clock_common_sigma])


def calibration_dof(parameters: Parameters) -> Array:
    """Degrees of freedom (3,) of Student's t, as which they are distributed."""
    return np.array([parameters.devices.scale_dof, parameters.devices.bias_dof, parameters.devices.clock_dof])


def _student(squares: Array, freedom: Array | float, dimension: int) -> tuple[Array, float]:
    """Of Student's t, given squared distances in units of sigma: the weights of its scale mixture, and its cost.

    Scaled so that it bends at 0 like the normal with that sigma: what is smooth because it was solved for, with smaller
    squares than noise has, must not pass for less noise than there is.
    """
    f = freedom + dimension
    return f / (f + squares), float((0.5 * f * np.log1p(squares / f)).sum())


def _links(recording: Recording, measurements: RangeMeasurements) -> Indices:
    """(n,) a number for each two antennas that measure."""
    a, b = recording.ranges.antenna_a[measurements.row], recording.ranges.antenna_b[measurements.row]
    swapped = recording.ranges.a[measurements.row] != measurements.i
    many = int(max(a.max(initial=0), b.max(initial=0))) + 2
    return np.where(swapped, (b + 1) * many + a + 1, (a + 1) * many + b + 1).astype(np.int32)
