"""The noise of SLAM's steps, asked beside errors of ranges that last.

What a pair's ranges are wrong by for seconds looks like SLAM that does not drift, or like one that does. Ranges that
count for less, as where walks are solved, say next to nothing of either. So where errors of neighbouring ranges are
alike, those that last become variables for this question (`preprocessing.lasting_errors`), and the rest is noise. How
large errors are, and which share of their variance lasts, is asked of the evidence (marginal likelihood) in turn, and
the mean is taken. Where neighbours are no more alike than by chance, errors are noise, and nothing is asked.

The walks themselves are solved with ranges that count for less: what is systematic in ranges follows places rather than
time, and as noise it would tell biases and scales that are none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from synchronizar.arrays import Array
from synchronizar.graph.evidence import evidence_against
from synchronizar.graph.pose_graph import LocalOptimum, PoseGraph
from synchronizar.graph.states import interpolated
from synchronizar.graph.step_noise import StepNoise, step_noise, with_drift
from synchronizar.preprocessing.keyframes import Keyframes

_SHARES = np.array([0.05, 0.2, 0.4, 0.6, 0.8, 0.95])
_SIZES = 2.0 ** np.array([-0.75, -0.25, 0.25, 0.75])
_STEPS, _GAIN = 2, 0.5
_FIRST_SHARE = 0.5
_SWEEPS = 2
_ROUNDS = 2
_PASSES, _SETTLED = 5, 0.03


def measured_noise(optimum: LocalOptimum, fine: list[Keyframes] | None) -> StepNoise:
    """The noise of all users' steps at an optimum of measured weights, whose keyframes have usual drift.

    `fine` are such keyframes at which lasting errors are asked for; None where they are not.
    """
    graph, usual = optimum.graph, np.ones((len(optimum.graph.users), 2))
    if not len(graph.measurements):
        return StepNoise(usual, usual, usual)
    noise, drift, there = _settled(optimum, usual)
    if fine is None or there.graph.correlation(there.states, there.em_weights).neighbours == 0.0:
        return noise
    keyframes = with_drift(fine, drift)
    near = interpolated(there.states, graph.keyframes, keyframes)
    at_fine = there.graph.with_other_keyframes(keyframes)
    begin = replace(at_fine.initial_em_weights(), range_weight=there.em_weights.range_weight)
    lasting = with_lasting_errors(LocalOptimum(at_fine, near, at_fine.e_step(near, begin)[0], np.inf))
    return _settled(lasting, drift)[0]


def _settled(optimum: LocalOptimum, drift: Array) -> tuple[StepNoise, Array, LocalOptimum]:
    """The noise, the drift (k, 2) under which it was measured at last, and the optimum there.

    `drift` is what the optimum's keyframes have. SLAM that drifts farther is asked about again where it may: else its
    farthest steps pass for slips, and what it leaves of the ranges' errors for their noise.
    """
    for _ in range(_PASSES):
        noise = step_noise(optimum.graph, optimum.states, optimum.em_weights, drift)
        farther = np.maximum(noise.used, 1.0)
        if np.allclose(farther, drift, rtol=_SETTLED):
            break
        graph = optimum.graph.with_keyframes(with_drift(optimum.graph.keyframes, farther / drift))
        em_weights = graph.with_range_weights(optimum.states, optimum.em_weights)
        optimum, drift = graph.run_em(optimum.states, em_weights, _ROUNDS), farther
    return noise, drift, optimum


def with_lasting_errors(optimum: LocalOptimum) -> LocalOptimum:
    """The optimum in the graph whose lasting errors are variables, as large as the ranges make likely."""
    graph, states, em_weights, _ = optimum
    squares, weights = graph.correlation(states, em_weights)[2:]
    size, share = float(np.sqrt(squares.sum() / weights.sum())), _FIRST_SHARE
    one_by_one = replace(em_weights, range_weight=np.ones(len(graph.measurements)))
    near = graph.with_lasting_errors(size, share).run_em(states, one_by_one, _ROUNDS)
    for _ in range(_SWEEPS):
        near = near._replace(em_weights=near.graph.with_range_weights(near.states, near.em_weights))
        of_shares = [_against(near, graph.with_lasting_errors(size, tried)) for tried in _SHARES]
        share = _mean(_SHARES, of_shares)
        of_sizes = [_against(near, graph.with_lasting_errors(size * by, share)) for by in _SIZES]
        size *= float(np.exp(_mean(np.log(_SIZES), of_sizes)))
        near = graph.with_lasting_errors(size, share).run_em(near.states, near.em_weights, _ROUNDS)
    measured = near.graph.with_range_weights(near.states, near.em_weights)
    return near.graph.run_em(near.states, measured, _ROUNDS)


def _against(near: LocalOptimum, graph: PoseGraph) -> float:
    states, em_weights = near.states, near.em_weights
    there = graph.optimised(states, states.anchor_poses, em_weights, 1.0, _STEPS, _GAIN)
    optimum = LocalOptimum(graph, there, em_weights, np.inf)
    return evidence_against(optimum, em_weights.range_weight, np.ones((len(graph.users), 2)))


def _mean(tried: Array, against: list[float]) -> float:
    weight = np.exp(min(against) - np.array(against))
    return float(weight @ tried / weight.sum())
