"""SLAM that drifts many times as far as usual, told from ranges that are NLOS.

Where a device's odometry is bad, the model's drift cannot bend its track to its ranges, and all that do not fit are
taken for NLOS. So where many seem NLOS, the same is solved with drift that is wide for everybody, each device's own
drift is measured there, and what has more evidence is gone on with: wide drift and few NLOS ranges, or usual drift and
many. Among late ranges the measured drift is the usual one again, and nothing changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.estimation.local_optima import nlos_share
from synchronizar.estimation.segments import keyframes_of_all, search_and_grow
from synchronizar.graph.evidence import evidence_against
from synchronizar.graph.pose_graph import LocalOptimum, PoseGraph
from synchronizar.graph.problem import Problem
from synchronizar.graph.states import interpolated
from synchronizar.graph.step_noise import step_noise
from synchronizar.preprocessing.relocalizations import RepairedTrack

WIDE = 10.0
"""Factor on everybody's drift: beyond it Student's t reaches, and steps of good SLAM are measured all the same."""

FAR_WEIGHT = 2.0
"""Steps that usual drift counts as where it is wide for everybody."""

_ROUNDS = 6
_NOISE_ROUNDS = 40  # from wide drift, what steps hardly determine shrinks slowly


class Searched(NamedTuple):
    """What a search found, and the drift that it allowed."""

    found: list[LocalOptimum]
    """Best first."""
    interval: float
    """s between their keyframes."""
    noise: Array
    """(k, 2) factors on the drift of `parameters.slam` that these have."""
    weight: float
    """Steps that usual drift counts as where it is measured."""


def with_far_drift(
    usual: Searched,
    problem: Problem,
    repaired_tracks: dict[str, RepairedTrack],
    begun: Sequence[tuple[Array, Array]] = (),
) -> Searched:
    """What was found with `usual` drift, or with drift as far as the ranges make likely, by the evidence of both."""
    parameters = problem.parameters
    if not len(problem.measurements) or nlos_share(usual.found[0]) <= parameters.search.drifting_share:
        return usual
    interval = parameters.slam.keyframe_interval
    wide = np.where([[user.static] * 2 for user in problem.users], 1.0, WIDE)
    # SLAM that drifts so far is rigid for a shorter time.
    search = {"first_stretch": parameters.search.first_stretch / WIDE}
    sooner = replace(problem, parameters=parameters.changed(search=search))
    found = search_and_grow(sooner, keyframes_of_all(problem, repaired_tracks, interval, wide), begun=begun)
    before = _at_measured_drift(usual.found[0], usual.noise, parameters.slam.drift_weight, problem, repaired_tracks)
    after = _at_measured_drift(found[0], wide, FAR_WEIGHT, problem, repaired_tracks)
    weight = np.sqrt(before.optimum.graph.initial_em_weights().range_weight)
    against = [evidence_against(one.optimum, weight, one.noise) for one in (before, after)]
    if against[1] > against[0] - parameters.search.drift_cost:
        return usual
    # Errors of drift that is measured too small would be taken for those of ranges.
    graph, states, em_weights, _ = after.optimum
    clear = graph.with_reflections(there=False).run_em(states, em_weights, _ROUNDS)
    best, noise = _at_measured_drift(clear, after.noise, FAR_WEIGHT, problem, repaired_tracks)
    others = [s._replace(graph=s.graph.with_keyframes(best.graph.keyframes)) for s in found[1:]]
    return Searched([best, *others], interval, noise, FAR_WEIGHT)


class _Measured(NamedTuple):
    """An optimum at fine keyframes whose drift is that measured there."""

    optimum: LocalOptimum
    noise: Array
    """(k, 2)."""


def _at_measured_drift(
    optimum: LocalOptimum,
    before: Array,
    weight: float,
    problem: Problem,
    repaired_tracks: dict[str, RepairedTrack],
) -> _Measured:
    """An optimum whose keyframes have the factors `before` (k, 2), with those that are measured at it."""
    noise = step_noise(optimum.graph, optimum.states, optimum.em_weights, before, weight, _NOISE_ROUNDS)
    keyframes = keyframes_of_all(problem, repaired_tracks, problem.parameters.slam.keyframe_interval, noise)
    graph = PoseGraph(problem, keyframes).with_sigma_of(optimum.graph)
    states = interpolated(optimum.states, optimum.graph.keyframes, keyframes)
    em_weights = replace(graph.initial_em_weights(), range_weight=optimum.em_weights.range_weight)
    return _Measured(graph.run_em(states, em_weights, _ROUNDS), noise)
