"""The placements that explain the ranges of a window, begun from whatever is known of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from synchronizar.arrays import Array
from synchronizar.cooperative import Cooperative
from synchronizar.estimation.full import keyframes_of_all, solve
from synchronizar.estimation.initialisation import Candidate, extend
from synchronizar.estimation.local_optima import compare, find_optima
from synchronizar.estimation.segments import coarse_interval, ties
from synchronizar.graph.marginal_prior import MarginalPrior
from synchronizar.graph.pose_graph import LocalOptimum, PoseGraph
from synchronizar.graph.problem import Problem
from synchronizar.graph.states import States, interpolated
from synchronizar.preprocessing.relocalizations import RepairedTrack

_STEPS = 3  # of a solution that is followed: it is near already


@dataclass(frozen=True)
class Window:
    """What is known of a stretch of time before it is solved."""

    problem: Problem
    """The reference is the user beside whom the others are placed in this window."""
    repaired_tracks: dict[str, RepairedTrack]
    marginal_prior: MarginalPrior | None
    """What earlier ranges told of some of them."""
    noise: Array
    """(k, 2) of each SLAM, as it was found before."""
    range_weight: float
    """Of a range, as it was found before."""

    def minima(self, last: LocalOptimum | None, others: bool) -> Cooperative[tuple[list[LocalOptimum], Array]]:
        """Best first, and how noisy each SLAM is taken to be.

        `last` is the solution of a window that began where this one does, of all that are in this one. From it, or from
        what is carried, all are followed; `others` says to look also for other minima near, and for mirror images.
        """
        if self.marginal_prior is None and last is None:
            solved = solve(self.problem, self.repaired_tracks)
            return solved.minima, solved.noise
        parameters = self.problem.parameters
        long = float(np.ptp(self.problem.measurements.t)) > 2.0 * parameters.incremental.window
        interval = coarse_interval(self.problem) if long else parameters.slam.keyframe_interval
        keyframes = keyframes_of_all(self.problem, self.repaired_tracks, interval, self.noise)
        yield
        graph = PoseGraph(self.problem, keyframes, self.marginal_prior)
        yield
        if last is not None:
            starts = [interpolated(last.states, last.graph.keyframes, keyframes)]
        else:
            marginal_prior = self.marginal_prior
            assert marginal_prior is not None
            begun = graph.initial_states(marginal_prior.frames, marginal_prior.calibration)
            known = set(graph.active_users) <= set(marginal_prior.users)
            starts = [begun] if known else _joined(graph, begun, marginal_prior)
            others = others or not known
        if not others:
            return (yield from _followed(graph, starts[0], self.range_weight)), self.noise
        found = find_optima(graph, starts)
        (best,) = yield from _followed(found[0].graph, found[0].states, self.range_weight)
        return compare(found, best), self.noise


def _followed(graph: PoseGraph, states: States, range_weight: float) -> Cooperative[list[LocalOptimum]]:
    """The minimum that walks lead to; ranges were worth so much before."""
    before = replace(graph.initial_em_weights(), range_weight=np.full(len(graph.measurements), range_weight))
    graph, states, em_weights, _ = yield from graph.running_em(states, before, 1, steps_a_round=_STEPS)
    yield
    em_weights = graph.with_range_weights(states, em_weights)
    return [(yield from graph.running_em(states, em_weights, 1, steps_a_round=_STEPS))]


def _joined(graph: PoseGraph, begun: States, marginal_prior: MarginalPrior) -> list[States]:
    """Walks with those who are new wherever their ranges to all others allow."""
    frames = np.full_like(begun.anchor_poses, np.nan)
    frames[marginal_prior.users] = begun.anchor_poses[marginal_prior.users]
    begun_somewhere = begun._replace(anchor_poses=np.nan_to_num(begun.anchor_poses))
    wide = graph.rigid_problem(begun_somewhere).widened(graph.parameters.search.sigma)
    alive = [Candidate(frames, 0.0)]
    coming = [u for u in graph.active_users if u not in marginal_prior.users]
    while coming:
        there = ~np.isnan(alive[0].frames[:, 0])
        user = max(coming, key=lambda u: ties(wide.measurements, u, np.flatnonzero(there).tolist()))
        coming.remove(user)
        alive = extend(wide, alive, user)
    return [begun._replace(anchor_poses=h.frames) for h in alive]
