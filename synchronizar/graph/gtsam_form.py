"""A pose graph as a gtsam factor graph, for whoever wants it in gtsam; the core's solver needs none of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np

from synchronizar._core import RangeSlot
from synchronizar.arrays import Array
from synchronizar.graph import keys
from synchronizar.graph.em_weights import EmWeights
from synchronizar.graph.pose_graph import PoseGraph
from synchronizar.graph.range_factors import CalibratedUserKeys, RangeSlotFactor
from synchronizar.graph.states import CLOCK, SCALE, States


@dataclass(frozen=True)
class GtsamForm:
    """The factors of a pose graph, and its states as gtsam's values."""

    graph: PoseGraph

    def factors(
        self, about: Array, em_weights: EmWeights, annealing: float = 1.0, height_curvature: Array | None = None
    ) -> gtsam.NonlinearFactorGraph:
        """Priors, SLAM's steps and ranges; the wide priors of position and yaw are centred on frames (k, 4).

        `annealing` >= 1 widens the loss; `height_curvature` (n,) 1/m^2 replaces the ranges' own.
        """
        out = gtsam.NonlinearFactorGraph()
        self._add_priors(out, about, em_weights)
        for u in self.graph.drifting():
            self.add_steps(out, u, em_weights.step_weight[u])
            self._add_level(out, u, em_weights.level_weight[u])
        self._add_ranges(out, em_weights, annealing, height_curvature)
        return out

    def _add_ranges(
        self, out: gtsam.NonlinearFactorGraph, em_weights: EmWeights, annealing: float, height_curvature: Array | None
    ) -> None:
        graph = self.graph
        s, (i, j) = graph.measurements, graph.ends
        # A slot is the time between two neighbouring boundaries of anybody's: within it each user is at one keyframe.
        boundaries = np.unique(np.concatenate([graph.keyframes[u].until for u in graph.active_users]))
        slot = np.searchsorted(boundaries, s.t)
        order = np.argsort(slot, kind="stable")
        number = np.zeros(len(graph.users), dtype=np.int32)
        for k in np.split(order, np.flatnonzero(np.diff(slot[order])) + 1) if len(s) else []:
            users = np.union1d(s.i[k], s.j[k])
            number[users] = np.arange(len(users))
            keyframe = np.zeros(len(graph.users), dtype=np.int32)
            keyframe[s.i[k]], keyframe[s.j[k]] = i.keyframe[k], j.keyframe[k]
            of_slot = RangeSlot(
                len(users),
                number[s.i[k]],
                number[s.j[k]],
                (i.offset[k], i.lever[k], i.velocity[k]),
                (j.offset[k], j.lever[k], j.velocity[k]),
                s.distance[k],
                graph.sigma[k],
                em_weights.nlos_odds[k],
                em_weights.range_weight[k] * em_weights.own_probability[k],
            )
            curvature = None
            if height_curvature is not None:
                pair = {of_pair: n for n, of_pair in enumerate(of_slot.pairs)}
                which = [pair[a, b] for a, b in zip(number[s.i[k]].tolist(), number[s.j[k]].tolist(), strict=True)]
                curvature = np.bincount(which, height_curvature[k], len(pair)).astype(float)
            keys_of = [self.keys(u, int(keyframe[u])) for u in users.tolist()]
            out.add(RangeSlotFactor(keys_of, of_slot, graph.loss, annealing, curvature))

    def _add_priors(self, out: gtsam.NonlinearFactorGraph, about: Array, em_weights: EmWeights) -> None:
        graph, noise = self.graph, gtsam.noiseModel
        sigma = graph.height_sigma / np.sqrt(em_weights.height_weight)
        place = graph.parameters.priors.place_sigma
        wide = noise.Diagonal.Sigmas(np.array([place, place, graph.yaw_sigma]))
        for u in graph.free:
            x, y, _, yaw = about[u].tolist()
            if graph.problem.surveyed[u]:
                x, y, z = graph.problem.survey[u].tolist()
                place = float(graph.survey_sigma[u] / np.sqrt(em_weights.height_weight[u]))
                near = noise.Diagonal.Sigmas(np.array([place, place, graph.yaw_sigma]))
                out.addPriorPose2(keys.frame(u), gtsam.Pose2(x, y, yaw), near)
                out.addPriorDouble(keys.height(u), z, noise.Isotropic.Sigma(1, place))
                continue
            out.addPriorPose2(keys.frame(u), gtsam.Pose2(x, y, yaw), wide)
            level = noise.Isotropic.Sigma(1, sigma[u])
            out.add(gtsam.BetweenFactorDouble(keys.MEAN_HEIGHT, keys.height(u), 0.0, level))
        if graph.calibrations:
            self._add_calibration_priors(out, em_weights)
        level = noise.Isotropic.Sigma(1, sigma[graph.reference])
        out.addPriorDouble(keys.MEAN_HEIGHT, 0.0, level)

    def _add_calibration_priors(self, out: gtsam.NonlinearFactorGraph, em_weights: EmWeights) -> None:
        noise = gtsam.noiseModel
        own, common = self.graph.calibration_priors[:2]
        weight = np.sqrt(em_weights.calibration_weight)
        for u in self.graph.calibrations:
            difference = np.array([0.0, 0.0, -self.graph.assumed_clock[u]])
            sigmas = noise.Diagonal.Sigmas(own / weight[u])
            out.add(gtsam.BetweenFactorVector(keys.SHARED_CALIBRATION, keys.calibration(u), difference, sigmas))
            if np.isfinite(known := float(self.graph.known_bias_sigma[u])):
                only = noise.Diagonal.Precisions(np.array([0.0, known**-2, 0.0]))
                out.addPriorVector(keys.calibration(u), np.zeros(3), only)
        out.addPriorVector(keys.SHARED_CALIBRATION, np.zeros(3), noise.Diagonal.Sigmas(common / weight[-1]))

    def add_steps(self, out: gtsam.NonlinearFactorGraph, user: int, weight: Array) -> None:
        """Add the odometry factors of a user's SLAM steps; the first step starts at a fixed keyframe."""
        noise, frames = gtsam.noiseModel, self.graph.keyframes[user]
        sigmas = frames.step_sigma / np.sqrt(weight)[:, None]
        slam_steps = np.diff(frames.place - frames.anchor, axis=0).tolist()
        for n, ((x, y, z), (plane, up, turn)) in enumerate(zip(slam_steps, sigmas.tolist(), strict=True)):
            planar, vertical = noise.Diagonal.Sigmas(np.array([plane, plane, turn])), noise.Isotropic.Sigma(1, up)
            if n == 0:
                out.addPriorPose2(keys.pose(user, 1), gtsam.Pose2(x, y, 0.0), planar)
                out.addPriorDouble(keys.local_height(user, 1), float(frames.place[0, 2]) + z, vertical)
            else:
                here, there = keys.pose(user, n), keys.pose(user, n + 1)
                out.add(gtsam.BetweenFactorPose2(here, there, gtsam.Pose2(x, y, 0.0), planar))
                here, there = keys.local_height(user, n), keys.local_height(user, n + 1)
                out.add(gtsam.BetweenFactorDouble(here, there, z, vertical))

    def _add_level(self, out: gtsam.NonlinearFactorGraph, user: int, weight: float) -> None:
        """Hold a user's keyframes to one height: sqrt(information) (exp(log scale) z - own height)."""
        frames = self.graph.keyframes[user]
        first, root = float(frames.place[0, 2]), np.sqrt(weight * frames.level_information)
        local = [keys.local_height(user, n) for n in range(1, len(frames))]
        device = [keys.calibration(user)] if self.graph.calibrations else []

        def error(_: Any, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
            scale = float(np.exp(values.atVector(device[0])[SCALE])) if device else 1.0
            heights = scale * np.array([first, *[values.atDouble(key) for key in local]])
            if jacobians is not None:
                jacobians[0] = -root[:, None]
                for n in range(1, len(root)):
                    jacobians[n] = scale * root[:, None] * (np.arange(len(root)) == n)[:, None]
                if device:
                    jacobians[len(root)] = (root * heights)[:, None] * (np.arange(3) == SCALE)
            return np.asarray(root * (heights - values.atDouble(keys.own_height(user))))

        unit = gtsam.noiseModel.Unit.Create(len(root))
        out.add(gtsam.CustomFactor(unit, [keys.own_height(user), *local, *device], error))

    def keys(self, user: int, keyframe: int) -> CalibratedUserKeys:
        """Keys of a user at a keyframe; the reference's frame and every user's first keyframe are fixed."""
        graph = self.graph
        free, first, frames = user != graph.reference, keyframe == 0, graph.keyframes[user]
        return CalibratedUserKeys(
            keys.frame(user) if free else None,
            keys.height(user) if free else None,
            None if first else keys.pose(user, keyframe),
            None if first else keys.local_height(user, keyframe),
            keys.calibration(user) if graph.calibrations else None,
            held_local=(0.0, 0.0, 0.0, float(frames.place[0, 2])),
        )

    def ordering(self) -> gtsam.Ordering:
        """Elimination ordering: keyframes by time, then what they share, which makes a banded matrix with a border."""
        graph = self.graph
        stamps = sorted(
            (t - graph.assumed_clock[u], u, n + 1)
            for u in graph.active_users
            for n, t in enumerate(graph.keyframes[u].t[1:].tolist())
        )
        keyframes = [key for _, u, n in stamps for key in (keys.pose(u, n), keys.local_height(u, n))]
        frames = [key for u in graph.free for key in (keys.frame(u), keys.height(u))]
        calibrations = [keys.calibration(u) for u in graph.calibrations]
        shared = [keys.SHARED_CALIBRATION] if calibrations else []
        own = [keys.own_height(u) for u in graph.drifting()]
        return keys.ordering([*keyframes, *frames, *calibrations, *shared, keys.MEAN_HEIGHT, *own])

    def values(self, states: States) -> gtsam.Values:
        """The states as gtsam values."""
        graph, values = self.graph, gtsam.Values()
        for u in graph.free:
            x, y, z, yaw = states.anchor_poses[u].tolist()
            values.insert(keys.frame(u), gtsam.Pose2(x, y, yaw))
            values.insert(keys.height(u), z)
        for u in graph.calibrations:
            values.insert(keys.calibration(u), states.calibration[u] - np.array([0.0, 0.0, graph.assumed_clock[u]]))
        if graph.calibrations:
            alike = np.ones((len(graph.users) + 1, 3))
            values.insert(keys.SHARED_CALIBRATION, graph.shared_calibration(states, alike))
        values.insert(keys.MEAN_HEIGHT, graph.mean_height(states.anchor_poses, np.ones(len(graph.users))))
        for u in graph.drifting():
            heights = np.exp(states.calibration[u, SCALE]) * states.keyframe_poses[u][:, 2]
            values.insert(keys.own_height(u), float(np.average(heights, weights=graph.keyframes[u].level_information)))
        for u in graph.active_users:
            for n, (x, y, z, yaw) in enumerate(states.keyframe_poses[u].tolist()):
                if n > 0:
                    values.insert(keys.pose(u, n), gtsam.Pose2(x, y, yaw))
                    values.insert(keys.local_height(u, n), z)
        return values

    def states(self, values: gtsam.Values, before: States) -> States:
        """The states at these gtsam values; variables that are not in them keep their value in `before`."""
        graph = self.graph
        frames, calibration = before.anchor_poses.copy(), before.calibration.copy()
        keyframe_poses = [of_user.copy() for of_user in before.keyframe_poses]
        for u in graph.free:
            at = values.atPose2(keys.frame(u))
            frames[u] = at.x(), at.y(), values.atDouble(keys.height(u)), at.theta()
        for u in graph.active_users:
            for n in range(1, len(keyframe_poses[u])):
                at = values.atPose2(keys.pose(u, n))
                keyframe_poses[u][n] = at.x(), at.y(), values.atDouble(keys.local_height(u, n)), at.theta()
        for u in graph.calibrations:
            calibration[u] = values.atVector(keys.calibration(u))
            calibration[u, CLOCK] += graph.assumed_clock[u]
        return States(frames, keyframe_poses, calibration)
