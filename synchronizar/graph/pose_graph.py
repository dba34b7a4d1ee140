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

from synchronizar._core import DeviceBlock, Late, judge, judge_bursts
from synchronizar.arrays import Array, Indices
from synchronizar.cooperative import Portions, finish
from synchronizar.data.recording import Recording
from synchronizar.geometry import apply_frames, wrap_angle
from synchronizar.graph import keys
from synchronizar.graph.marginal_prior import Carried
from synchronizar.graph.optimization import optimizing
from synchronizar.graph.range_factors import DeviceBlockFactor, DeviceKeys, Reading
from synchronizar.graph.rigid_graph import height_sigma_of, late_loss
from synchronizar.graph.states import BIAS, CLOCK, SCALE, Walks, antennas, begin, flattened, steps
from synchronizar.parameters import Model
from synchronizar.preprocessing.keyframes import Ends, Keyframes, ends_of
from synchronizar.preprocessing.range_measurements import Samples, pairs
from synchronizar.preprocessing.range_weights import worth, worth_before

_STALE_CLOCK = 0.005  # s: antennas that were read for a clock further off are read anew
_GAIN = 0.05  # of log likelihood: what gains less changes nothing that could be measured
_GAIN_A_RANGE = 3e-5  # nor does what gains less a range
_ITERATIONS = 10


@dataclass(frozen=True)
class Judgement:
    """What is held while the variables are sought, and sought anew when they were found."""

    late_odds: Array
    """(n,) of each range, its neighbours in time considered."""
    worth: Array
    """(n,) as how many independent ranges each counts."""
    step_weight: list[Array]
    """Of each user (m - 1,): how far each of SLAM's steps is believed; Student's t."""
    device_weight: Array
    """(k + 1, 3): the same of each device's scale, bias and clock being as usual, and of what is usual being none."""


class AnchoredGraph:
    """The graph of some samples; keyframes as they are given."""

    def __init__(
        self,
        recording: Recording,
        samples: Samples,
        keyframes: list[Keyframes],
        placed: list[int],
        reference: int,
        model: Model,
        carried: Carried | None = None,
    ):
        """`recording` has mended tracks; `placed` are the users that take part, the reference among them.

        `carried` is what earlier ranges told of some of them, at their first keyframes.
        """
        self.recording, self.samples, self.keyframes = recording, samples, keyframes
        self.users = recording.users
        self.placed, self.reference = placed, reference
        self.free = [u for u in placed if u != reference]
        self.model, self.carried = model, carried
        known = [] if carried is None else carried.users
        # Of whom nothing is known but priors; and whose heights are about a level that all share.
        self._new = [u for u in placed if u not in known]
        self._level_users = placed if carried is None else [reference, *self._new]
        self.sigma = np.hypot(samples.sigma, model.multipath_sigma)
        self._loss: Late = late_loss(model)
        self._from_level = np.array([height_sigma_of(user, model) for user in self.users]) / np.sqrt(2.0)
        self._links = _links(recording, samples)
        self._reading = Reading()
        self.read_antennas(np.zeros(len(self.users)))

    def read_antennas(self, clock_offset: Array) -> None:
        """Read antennas off the tracks anew, for clock offsets (k,) s; keep those that the walks are solved for."""
        s = self.samples
        self._clock = clock_offset.copy()
        self._ends: tuple[Ends, Ends] = (
            ends_of(self.recording, s, s.i, self.keyframes, clock_offset),
            ends_of(self.recording, s, s.j, self.keyframes, clock_offset),
        )
        i, j = self._ends
        changes = np.diff(s.i) | np.diff(s.j) | np.diff(i.keyframe) | np.diff(j.keyframe)
        self._bounds = np.unique(np.concatenate([[0], np.flatnonzero(changes) + 1, [len(s)]]))

    def with_keyframes(self, keyframes: list[Keyframes]) -> AnchoredGraph:
        """The same graph; keyframes are the same but for how far SLAM's steps can be trusted."""
        out = copy(self)
        out.keyframes = keyframes
        return out

    def begin(self, frames: Array, device: Array | None = None) -> Walks:
        """SLAM as it is, laid at frames (k, 4) of the anchors."""
        return begin(frames, self.keyframes, np.zeros((len(self.users), 3)) if device is None else device)

    # What the samples say of some walks

    def residuals(self, walks: Walks) -> Array:
        """(n,) m, predicted minus measured."""
        s = self.samples
        i = antennas(walks, s.i, self._ends[0], self._clock)
        j = antennas(walks, s.j, self._ends[1], self._clock)
        q_i, q_j = (apply_frames(walks.frames[who], p) for who, p in ((s.i, i), (s.j, j)))
        bias = walks.device[s.i, BIAS] + walks.device[s.j, BIAS]
        return np.asarray(np.linalg.norm(q_i - q_j, axis=1) + bias - s.distance)

    def flattened(self, walks: Walks) -> Samples:
        """The samples as a rigid model would have them: drift, scale, clocks and biases taken out."""
        return replace(flattened(self.samples, walks, self._ends, self._clock), sigma=self.sigma)

    def honest(self, walks: Walks, judgement: Judgement) -> tuple[Array, Array]:
        """(n,) each: the weight that the loss gives each range, and the probability that it is honest."""
        whitened = self.residuals(walks) / self.sigma
        _, weight, honest = judge(whitened, self.sigma, judgement.late_odds, self._loss)
        return weight, honest

    def bending(self, walks: Walks, judgement: Judgement) -> Array:
        """(n,) 1/m^2: what each range's bending adds to the cost's second derivative in the difference in height."""
        flat = self.flattened(walks)
        between = apply_frames(walks.frames[flat.i], flat.p_i) - apply_frames(walks.frames[flat.j], flat.p_j)
        distance = np.maximum(np.linalg.norm(between, axis=1), 1e-9)
        whitened = (distance - flat.distance) / self.sigma
        _, weight, _ = judge(whitened, self.sigma, judgement.late_odds, self._loss)
        level = 1.0 - (between[:, 2] / distance) ** 2
        return np.asarray(judgement.worth * weight * whitened / self.sigma * level / distance)

    # What is judged between two searches

    def first_judgement(self) -> Judgement:
        """Nothing is known yet."""
        weights = [np.ones(len(k.step_sigma)) for k in self.keyframes]
        first = worth_before(self.samples, self.model)
        return Judgement(self.samples.late_odds, first, weights, np.ones((len(self.users) + 1, 3)))

    def judged(self, walks: Walks, before: Judgement) -> tuple[Judgement, float]:
        """How late, how believable everything is at these walks; and their negative log likelihood.

        Costs of graphs with the same samples and worth can be compared.
        """
        m, s = self.model, self.samples
        whitened = self.residuals(walks) / self.sigma
        odds, cost = np.empty(len(s)), 0.0
        for pair in pairs(s):
            k = pair.samples
            odds[k], chain = judge_bursts(
                s.t[k], whitened[k], self.sigma[k], s.late_odds[k], self._loss, m.late_share, m.late_duration
            )
            cost += chain * float(before.worth[k].mean())
        weights = [np.ones(len(k.step_sigma)) for k in self.keyframes]
        for u in self.placed:
            squares = (steps(walks.local[u], self.keyframes[u]) ** 2).sum(axis=1)
            weights[u], tail = _student(squares, m.drift_tail, 4)
            cost += tail
        device_weight, tail = self._judged_devices(walks, before)
        return Judgement(odds, before.worth, weights, device_weight), cost + tail + self._height_cost(
            walks
        ) + self._carried_cost(walks)

    def measured(self, walks: Walks, judgement: Judgement) -> Judgement:
        """The same, what ranges are worth measured on their residuals."""
        whitened = self.residuals(walks) / self.sigma
        _, weight, _ = judge(whitened, self.sigma, judgement.late_odds, self._loss)
        return replace(judgement, worth=worth(self.samples, self.sigma, whitened, weight, self._links, self.model))

    def _judged_devices(self, walks: Walks, before: Judgement) -> tuple[Array, float]:
        """The weights (k + 1, 3) of the devices, the last row that of what they have in common; and the cost."""
        own, common = device_sigmas(self.model)
        kind = self._kind(walks, before.device_weight)
        squares = np.zeros((len(self.users) + 1, 3))
        squares[self._new] = ((walks.device[self._new] - kind) / own) ** 2
        squares[-1] = (kind / common) ** 2
        return _student(squares, device_tails(self.model), 1)

    def _kind(self, walks: Walks, device_weight: Array) -> Array:
        """(3,) the most likely common part of the devices, by weights (k + 1, 3)."""
        own, common = device_sigmas(self.model)
        weight = device_weight[self._new] / own**2
        total = weight.sum(axis=0) + device_weight[-1] / common**2
        return np.asarray((weight * walks.device[self._new]).sum(axis=0) / total)

    def _height_cost(self, walks: Walks) -> float:
        heights, weight = walks.frames[self._level_users, 2], self._from_level[self._level_users] ** -2
        level = self._level(walks)
        return 0.5 * float((weight * (heights - level) ** 2).sum())

    def _level(self, walks: Walks) -> float:
        """The most likely height (m) that origins lie about."""
        weight = self._from_level[self._level_users] ** -2
        return float(weight @ walks.frames[self._level_users, 2] / weight.sum())

    def _carried_cost(self, walks: Walks) -> float:
        if self.carried is None:
            return 0.0
        return float(self.carried.factor(self._clock).error(self._shared_values(walks)))

    # The graph

    def settle(
        self, walks: Walks, judgement: Judgement, rounds: int, annealing: float = 1.0
    ) -> tuple[Walks, Judgement, float]:
        """Find the walks and judge what is late in turn (expectation maximisation), until neither changes."""
        return finish(self.settling(walks, judgement, rounds, annealing))

    def settling(
        self, walks: Walks, judgement: Judgement, rounds: int, annealing: float = 1.0, steps_a_round: int = _ITERATIONS
    ) -> Portions[tuple[Walks, Judgement, float]]:
        """`settle` in portions; fewer steps a round are enough near a minimum."""
        about, before = walks.frames, np.inf
        gain = _GAIN + _GAIN_A_RANGE * len(self.samples)
        for _ in range(rounds):
            if np.abs(walks.device[:, CLOCK] - self._clock).max() > _STALE_CLOCK:
                self.read_antennas(walks.device[:, CLOCK])
                yield
            judgement, cost = self.judged(walks, judgement)
            if before - cost < gain:
                return walks, judgement, cost
            before = cost
            factors = self.factors(about, judgement, annealing)
            yield
            values, ordering = self.values(walks), self.ordering()
            values = yield from optimizing(factors, values, ordering, steps_a_round, 0.25 * gain, self._reading)
            walks = self.walks(values, walks)
            yield
        judgement, cost = self.judged(walks, judgement)
        return walks, judgement, cost

    def factors(
        self, about: Array, judgement: Judgement, annealing: float = 1.0, bending: Array | None = None
    ) -> gtsam.NonlinearFactorGraph:
        """Priors, with those of places and headings, which say nothing, about frames (k, 4); SLAM's steps; ranges.

        `bending` (n,) stands for that of the ranges themselves.
        """
        graph = gtsam.NonlinearFactorGraph()
        self._add_priors(graph, about, judgement)
        for u in self.placed:
            self.add_steps(graph, u, judgement.step_weight[u])
        s, (i, j) = self.samples, self._ends
        for first, end in pairwise(self._bounds.tolist()):
            k = slice(first, end)
            block = DeviceBlock(
                (i.offset[k], i.lever[k], i.velocity[k]),
                (j.offset[k], j.lever[k], j.velocity[k]),
                s.distance[k],
                self.sigma[k],
                judgement.late_odds[k],
                judgement.worth[k],
            )
            keys_i = self.keys(int(s.i[first]), int(i.keyframe[first]))
            keys_j = self.keys(int(s.j[first]), int(j.keyframe[first]))
            bends = None if bending is None else float(bending[k].sum())
            graph.add(DeviceBlockFactor(keys_i, keys_j, block, self._loss, annealing, self._reading, bends))
        return graph

    def linearizing(
        self, walks: Walks, judgement: Judgement, bending: Array | None = None
    ) -> Portions[gtsam.GaussianFactorGraph]:
        """All factors at some walks, in portions."""
        factors = self.factors(walks.frames, judgement, bending=bending)
        yield
        values = self.values(walks)
        yield
        self._reading.hold(values)
        linear = factors.linearize(values)
        self._reading.hold(None)
        return linear

    def _add_priors(self, graph: gtsam.NonlinearFactorGraph, about: Array, judgement: Judgement) -> None:
        m, noise = self.model, gtsam.noiseModel
        # All may turn about the reference together: what their k priors say of that must be what one says.
        yaw_sigma = m.yaw_sigma * np.sqrt(max(len(self.free), 1))
        wide = noise.Diagonal.Sigmas(np.array([m.place_sigma, m.place_sigma, yaw_sigma]))
        if self.carried is not None:
            graph.add(self.carried.factor(self._clock))
        for u in self.free:
            if u not in self._new:
                continue
            x, y, _, yaw = about[u].tolist()
            graph.addPriorPose2(keys.frame(u), gtsam.Pose2(x, y, yaw), wide)
            graph.add(
                gtsam.BetweenFactorDouble(
                    keys.LEVEL, keys.height(u), 0.0, noise.Isotropic.Sigma(1, self._from_level[u])
                )
            )
        own, common = device_sigmas(m)
        weight = np.sqrt(judgement.device_weight)
        for u in self._new:
            usual = np.array([0.0, 0.0, -self._clock[u]])
            graph.add(
                gtsam.BetweenFactorVector(keys.KIND, keys.device(u), usual, noise.Diagonal.Sigmas(own / weight[u]))
            )
        graph.addPriorVector(keys.KIND, np.zeros(3), noise.Diagonal.Sigmas(common / weight[-1]))
        graph.addPriorDouble(keys.LEVEL, 0.0, noise.Isotropic.Sigma(1, self._from_level[self.reference]))

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

    def keys(self, user: int, keyframe: int) -> DeviceKeys:
        """Those of a user at a keyframe: the reference's frame and everybody's first keyframe are held."""
        free, first = user != self.reference, keyframe == 0
        return DeviceKeys(
            keys.frame(user) if free else None,
            keys.height(user) if free else None,
            None if first else keys.pose(user, keyframe),
            None if first else keys.local_height(user, keyframe),
            keys.device(user),
            held_local=(0.0, 0.0, 0.0, float(self.keyframes[user].place[0, 2])),
        )

    def ordering(self) -> gtsam.Ordering:
        """Keyframes in the order of time, then what all of them share: a band with a narrow border."""
        return keys.ordering([*self.keyframe_keys(set()), *self.shared_keys()])

    def keyframe_keys(self, without: set[int]) -> Iterator[int]:
        """Those of all keyframes that are not held, but for some, in the order of time."""
        stamps = [
            (t - self._clock[u], u, n + 1) for u in self.placed for n, t in enumerate(self.keyframes[u].t[1:].tolist())
        ]
        for _, u, n in sorted(stamps):
            for key in (keys.pose(u, n), keys.local_height(u, n)):
                if key not in without:
                    yield key

    def shared_keys(self) -> list[int]:
        """Those of frames, devices and what all have in common."""
        frames = [key for u in self.free for key in (keys.frame(u), keys.height(u))]
        return [*frames, *(keys.device(u) for u in self.placed), keys.KIND, keys.LEVEL]

    def values(self, walks: Walks) -> gtsam.Values:
        """Gtsam's values at these walks."""
        values = self._shared_values(walks)
        for u in self.placed:
            for n, (x, y, z, yaw) in enumerate(walks.local[u].tolist()):
                if n > 0:
                    values.insert(keys.pose(u, n), gtsam.Pose2(x, y, yaw))
                    values.insert(keys.local_height(u, n), z)
        return values

    def _shared_values(self, walks: Walks) -> gtsam.Values:
        """Those of `shared_keys`."""
        values = gtsam.Values()
        for u in self.placed:
            if u != self.reference:
                x, y, z, yaw = walks.frames[u].tolist()
                values.insert(keys.frame(u), gtsam.Pose2(x, y, yaw))
                values.insert(keys.height(u), z)
            values.insert(keys.device(u), walks.device[u] - np.array([0.0, 0.0, self._clock[u]]))
        values.insert(keys.KIND, self._kind(walks, np.ones((len(self.users) + 1, 3))))
        values.insert(keys.LEVEL, self._level(walks))
        return values

    def walks(self, values: gtsam.Values, before: Walks) -> Walks:
        """The walks at these values; what is not among them stays as it was before."""
        frames, device = before.frames.copy(), before.device.copy()
        local = [of_user.copy() for of_user in before.local]
        for u in self.placed:
            if u != self.reference:
                at = values.atPose2(keys.frame(u))
                frames[u] = at.x(), at.y(), values.atDouble(keys.height(u)), at.theta()
            device[u] = values.atVector(keys.device(u))
            device[u, CLOCK] += self._clock[u]
            for n in range(1, len(local[u])):
                at = values.atPose2(keys.pose(u, n))
                local[u][n] = at.x(), at.y(), values.atDouble(keys.local_height(u, n)), at.theta()
        return Walks(frames, local, device)

    def last_poses(self, walks: Walks) -> Array:
        """(k, 4) x, y, z (m), yaw (rad): where each last keyframe is, and how SLAM's axes lie there."""
        out = walks.frames.copy()
        for u, local in enumerate(walks.local):
            out[u, :3] = apply_frames(walks.frames[u], np.exp(walks.device[u, SCALE]) * local[-1, :3])
            out[u, 3] = wrap_angle(out[u, 3] + local[-1, 3])
        return out

    def prior_variances(self, user: int) -> Array:
        """(4,) of x, y, z (m^2) and yaw (rad^2), relative to the reference, before any range."""
        m = self.model
        height = self._from_level[user] ** 2 + self._from_level[self.reference] ** 2
        return np.array([m.place_sigma**2, m.place_sigma**2, height, m.yaw_sigma**2])


def device_sigmas(model: Model) -> tuple[Array, Array]:
    """1 sigma (3,) of log scale, bias (m) and clock (s): of each device's own, and of what all have in common."""
    m = model
    own = np.array([m.scale_sigma, m.bias_sigma, m.clock_sigma])
    return own, np.array([m.scale_common_sigma, m.bias_common_sigma, m.clock_common_sigma])


def device_tails(model: Model) -> Array:
    """Degrees of freedom (3,) of Student's t, as which they are distributed."""
    return np.array([model.scale_tail, model.bias_tail, model.clock_tail])


def _student(squares: Array, freedom: Array | float, dimension: int) -> tuple[Array, float]:
    """Of Student's t, given squared distances in units of sigma: the weights of its scale mixture, and its cost.

    Scaled so that it bends at 0 like the normal with that sigma: what is smooth because it was solved for, with smaller
    squares than noise has, must not pass for less noise than there is.
    """
    f = freedom + dimension
    return f / (f + squares), float((0.5 * f * np.log1p(squares / f)).sum())


def _links(recording: Recording, samples: Samples) -> Indices:
    """(n,) a number for each two antennas that measure."""
    a, b = recording.ranges.antenna_a[samples.row], recording.ranges.antenna_b[samples.row]
    swapped = recording.ranges.a[samples.row] != samples.i
    many = int(max(a.max(initial=0), b.max(initial=0))) + 2
    return np.where(swapped, (b + 1) * many + a + 1, (a + 1) * many + b + 1).astype(np.int32)
