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
from synchronizar.estimation.comparing import nlos_share
from synchronizar.estimation.measured_weights import with_measured_weights, with_noise_alone
from synchronizar.estimation.segments import coarse_interval, keyframes_of_all, search_and_grow
from synchronizar.graph.evidence import evidence_against
from synchronizar.graph.pose_graph import LocalOptimum, PoseGraph
from synchronizar.graph.problem import Problem
from synchronizar.graph.states import interpolated
from synchronizar.graph.step_noise import far_step_noise, step_noise
from synchronizar.preprocessing.keyframes import Keyframes
from synchronizar.preprocessing.relocalizations import RepairedTrack
from synchronizar.progress import Progress, stage, unheard

_ROUNDS = 6
_BENT_ROUNDS = 3


class Searched(NamedTuple):
    """What a search found, and the drift that it allowed."""

    best: LocalOptimum
    """The first of those found, ranges' weights measured at it."""
    found: list[LocalOptimum]
    """Best first."""
    interval: float
    """s between their keyframes."""
    far: Array | None
    """(k, 2) factors on the drift of `parameters.slam` that these have; None where it is as usual."""


def searched(
    problem: Problem,
    repaired_tracks: dict[str, RepairedTrack],
    progress: Progress = unheard,
    begun: Sequence[tuple[Array, Array]] = (),
    far: bool = True,
) -> Searched:
    """What is found with usual drift, or if `far` with drift as far as the ranges make likely, by the evidence of both.

    In the 20 s that a search sees while people walk, wide drift also explains ranges between the wrong people.
    """
    parameters = problem.parameters
    interval = coarse_interval(problem)
    found = search_and_grow(
        problem, keyframes_of_all(problem, repaired_tracks, interval), stage(progress, 0.0, 0.7), begun
    )
    usual = Searched(with_noise_alone(with_measured_weights(found[0])), found, interval, None)
    seeming = max(nlos_share(found[0]), nlos_share(usual.best))
    if not far or seeming <= parameters.search.drifting_share or not _bends(usual, problem, repaired_tracks):
        return usual
    wide = _searched_far(problem, repaired_tracks, begun)
    progress(1.0)
    noise = step_noise(usual.best.graph, usual.best.states, usual.best.em_weights).sought
    before = _with_drift(usual.best, noise, problem, repaired_tracks)
    noises = noise, far_noise(wide.best, problem, repaired_tracks)
    after = _with_drift(wide.best, noises[1], problem, repaired_tracks)
    by_before, by_after = (
        [
            evidence_against(one, weighed.em_weights.range_weight, of_one)
            for one, of_one in zip((before, after), noises, strict=True)
        ]
        for weighed in (before, after)
    )
    # Weights measured at either one favour it.
    gain, loss = by_after[0] - by_after[1], by_before[1] - by_before[0]
    return wide if gain > loss + parameters.search.drift_cost else usual


def far_noise(optimum: LocalOptimum, problem: Problem, repaired_tracks: dict[str, RepairedTrack]) -> Array:
    """(k, 2) the factors that are measured at an optimum whose steps fit wide drift."""
    wide = _wide_keyframes(problem, repaired_tracks)
    states = interpolated(optimum.states, optimum.graph.keyframes, wide)
    graph = PoseGraph(problem, wide).with_sigma_of(optimum.graph).with_antennas_at(optimum.graph.assumed_clock)
    first = replace(graph.initial_em_weights(), range_weight=optimum.em_weights.range_weight)
    em_weights, _ = graph.e_step(states, first)
    return far_step_noise(graph, states, em_weights, problem.parameters.search.drift_wide)


def _wide_keyframes(problem: Problem, repaired_tracks: dict[str, RepairedTrack]) -> list[Keyframes]:
    wide = np.full((len(problem.users), 2), problem.parameters.search.drift_wide)
    return keyframes_of_all(problem, repaired_tracks, problem.parameters.slam.keyframe_interval, wide)


def _bends(usual: Searched, problem: Problem, repaired_tracks: dict[str, RepairedTrack]) -> bool:
    """Whether wide drift alone, from where usual drift has led, explains many of the ranges that seem NLOS.

    Where most do, everything may be elsewhere, and that says nothing.
    """
    before = usual.best
    if nlos_share(before) > problem.parameters.search.drift_lost:
        return True
    keyframes = _wide_keyframes(problem, repaired_tracks)
    graph = PoseGraph(problem, keyframes).with_sigma_of(before.graph)
    states = interpolated(before.states, before.graph.keyframes, keyframes)
    first = graph.initial_em_weights()
    bent = graph.run_em(states, replace(first, range_weight=np.sqrt(first.range_weight)), _BENT_ROUNDS)
    return nlos_share(bent) < problem.parameters.search.drift_bent * nlos_share(before)


def _searched_far(
    problem: Problem, repaired_tracks: dict[str, RepairedTrack], begun: Sequence[tuple[Array, Array]]
) -> Searched:
    """What is found where drift is wide for everybody, and then as far as it is measured to be."""
    parameters = problem.parameters
    # SLAM that drifts so far is rigid for a shorter time.
    search = {"first_stretch": parameters.search.first_stretch / parameters.search.drift_wide}
    sooner = replace(problem, parameters=parameters.changed(search=search))
    found = search_and_grow(sooner, _wide_keyframes(problem, repaired_tracks), begun=begun)
    best = _with_drift(found[0], far_noise(found[0], problem, repaired_tracks), problem, repaired_tracks)
    # Once more with noise alone: what drift leaves would be taken for reflections.
    clear = best.graph.with_reflections(there=False).run_em(best.states, best.em_weights, _ROUNDS)
    noise = far_noise(clear, problem, repaired_tracks)
    best = _with_drift(clear, noise, problem, repaired_tracks)
    found = [best, *(s._replace(graph=s.graph.with_keyframes(best.graph.keyframes)) for s in found[1:])]
    interval = parameters.slam.keyframe_interval
    return Searched(with_noise_alone(with_measured_weights(best)), found, interval, noise)


def _with_drift(
    optimum: LocalOptimum, noise: Array, problem: Problem, repaired_tracks: dict[str, RepairedTrack]
) -> LocalOptimum:
    """An optimum at fine keyframes whose drift has these factors (k, 2)."""
    keyframes = keyframes_of_all(problem, repaired_tracks, problem.parameters.slam.keyframe_interval, noise)
    graph = PoseGraph(problem, keyframes).with_sigma_of(optimum.graph)
    states = interpolated(optimum.states, optimum.graph.keyframes, keyframes)
    em_weights = replace(graph.initial_em_weights(), range_weight=optimum.em_weights.range_weight)
    return graph.run_em(states, em_weights, _ROUNDS)
