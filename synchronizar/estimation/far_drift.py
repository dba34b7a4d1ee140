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
from synchronizar.estimation.local_optima import nlos_share, with_measured_weights, with_noise_alone
from synchronizar.estimation.segments import coarse_interval, keyframes_of_all, search_and_grow
from synchronizar.graph.evidence import evidence_against
from synchronizar.graph.pose_graph import LocalOptimum, PoseGraph
from synchronizar.graph.problem import Problem
from synchronizar.graph.states import interpolated
from synchronizar.graph.step_noise import step_noise
from synchronizar.preprocessing.relocalizations import RepairedTrack
from synchronizar.progress import Progress, stage, unheard

WIDE = 10.0
"""Factor on everybody's drift: beyond it Student's t reaches, and steps of good SLAM are measured all the same."""

FAR_WEIGHT = 2.0
"""Steps that usual drift counts as where it is wide for everybody."""

_ROUNDS = 6
_BENT_ROUNDS = 3
_BENT = 0.9  # of the ranges that seem NLOS: among late ranges wide drift explains less than a tenth of them
_MOST = 0.6  # of the ranges
_NOISE_ROUNDS = 40  # from wide drift, what steps hardly determine shrinks slowly


class Searched(NamedTuple):
    """What a search found, and the drift that it allowed."""

    best: LocalOptimum
    """The first of those found, ranges' weights measured at it."""
    found: list[LocalOptimum]
    """Best first."""
    interval: float
    """s between their keyframes."""
    noise: Array
    """(k, 2) factors on the drift of `parameters.slam` that these have."""
    drift_weight: float
    """Steps that usual drift counts as where it is measured."""


def searched(
    problem: Problem,
    repaired_tracks: dict[str, RepairedTrack],
    progress: Progress = unheard,
    begun: Sequence[tuple[Array, Array]] = (),
) -> Searched:
    """What is found with usual drift, or with drift as far as the ranges make likely, by the evidence of both."""
    parameters, none = problem.parameters, np.ones((len(problem.users), 2))
    interval, weight = coarse_interval(problem), parameters.slam.drift_weight
    coarse = keyframes_of_all(problem, repaired_tracks, interval, none)
    found = search_and_grow(problem, coarse, stage(progress, 0.0, 0.7), begun)
    usual = Searched(with_noise_alone(with_measured_weights(found[0])), found, interval, none, weight)
    seeming = max(nlos_share(found[0]), nlos_share(usual.best))
    if seeming <= parameters.search.drifting_share or not _bends(usual, problem, repaired_tracks):
        return usual
    far = _searched_far(problem, repaired_tracks, begun)
    progress(1.0)
    before = _at_measured_drift(usual.best, none, weight, problem, repaired_tracks)
    after = _at_measured_drift(far.best, far.noise, FAR_WEIGHT, problem, repaired_tracks)
    by_before, by_after = (
        [evidence_against(one.optimum, weighed.em_weights.range_weight, one.noise) for one in (before, after)]
        for weighed in (before.optimum, after.optimum)
    )
    # Weights measured at either one favour it.
    gain, loss = by_after[0] - by_after[1], by_before[1] - by_before[0]
    return far if gain > loss + parameters.search.drift_cost else usual


def _bends(usual: Searched, problem: Problem, repaired_tracks: dict[str, RepairedTrack]) -> bool:
    """Whether wide drift alone, from where usual drift has led, explains many of the ranges that seem NLOS.

    Where most do, everything may be elsewhere, and that says nothing.
    """
    interval, before = problem.parameters.slam.keyframe_interval, usual.best
    if nlos_share(before) > _MOST:
        return True
    keyframes = keyframes_of_all(problem, repaired_tracks, interval, np.full((len(problem.users), 2), WIDE))
    graph = PoseGraph(problem, keyframes).with_sigma_of(before.graph)
    states = interpolated(before.states, before.graph.keyframes, keyframes)
    first = graph.initial_em_weights()
    bent = graph.run_em(states, replace(first, range_weight=np.sqrt(first.range_weight)), _BENT_ROUNDS)
    return nlos_share(bent) < _BENT * nlos_share(before)


def _searched_far(
    problem: Problem, repaired_tracks: dict[str, RepairedTrack], begun: Sequence[tuple[Array, Array]]
) -> Searched:
    """What is found where drift is wide for everybody, and then as far as it is measured to be."""
    parameters = problem.parameters
    interval = parameters.slam.keyframe_interval
    noise = np.where([[user.static] * 2 for user in problem.users], 1.0, WIDE)
    # SLAM that drifts so far is rigid for a shorter time.
    search = {"first_stretch": parameters.search.first_stretch / WIDE}
    sooner = replace(problem, parameters=parameters.changed(search=search))
    found = search_and_grow(sooner, keyframes_of_all(problem, repaired_tracks, interval, noise), begun=begun)
    best, noise = _at_measured_drift(found[0], noise, FAR_WEIGHT, problem, repaired_tracks)
    # Once more with noise alone: what drift leaves would be taken for reflections.
    clear = best.graph.with_reflections(there=False).run_em(best.states, best.em_weights, _ROUNDS)
    best, noise = _at_measured_drift(clear, noise, FAR_WEIGHT, problem, repaired_tracks)
    found = [best, *(s._replace(graph=s.graph.with_keyframes(best.graph.keyframes)) for s in found[1:])]
    return Searched(with_noise_alone(with_measured_weights(best)), found, interval, noise, FAR_WEIGHT)


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
