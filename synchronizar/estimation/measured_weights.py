"""Optima whose ranges have weights and sigmas that are measured on their residuals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from synchronizar.arrays import Array
from synchronizar.estimation.comparing import BETTER, nlos_share
from synchronizar.graph.pose_graph import LocalOptimum, PoseGraph
from synchronizar.graph.rigid_graph import RigidGraph
from synchronizar.graph.states import interpolated

_FIRST_ROUNDS = 2
_ROUNDS = 8
_MEASURING_ROUNDS = (4, 2)
_REFINING_ROUNDS = 4
_NOISIER = 2.0  # in range weights: less is no difference
_TRUSTED_STEPS, _TRUSTED_GAIN = 2, 0.1  # from faultless devices: enough that those who are not begin to differ


def with_measured_weights(coarse: LocalOptimum) -> LocalOptimum:
    """The same optimum with ranges' weights, and how large their errors in line of sight are, measured on residuals.

    With the model's reflections most short detours pass for line-of-sight; where there are reflections, these may pass
    for NLOS without them. So where ranges seem NLOS without, both are tried, and what is likelier is taken.
    """
    clear = _measured(coarse._replace(graph=coarse.graph.with_reflections(there=False)))
    if nlos_share(clear) <= coarse.graph.parameters.search.doubtful_share:
        return clear
    reflected = _measured(coarse._replace(graph=coarse.graph.with_reflections(there=True)))
    weight = clear.em_weights.range_weight
    return min(clear, reflected, key=lambda optimum: _normalised_cost(optimum, weight))


def _measured(optimum: LocalOptimum) -> LocalOptimum:
    for rounds in _MEASURING_ROUNDS:
        optimum = _measured_again(optimum, rounds)
    return optimum


def _normalised_cost(optimum: LocalOptimum, range_weight: Array) -> float:
    """Negative log likelihood with these range weights (n,), up to a constant whatever the ranges' sigmas are."""
    graph = optimum.graph
    _, cost = graph.e_step(optimum.states, replace(optimum.em_weights, range_weight=range_weight))
    return cost + float(range_weight @ np.log(graph.sigma))


def with_noise_alone(optimum: LocalOptimum) -> LocalOptimum:
    """The optimum of measured weights, or another one that leaves less of the ranges unexplained.

    What is systematic passes for noise once weights are measured on it: with weights that small a prior holds a wrong
    height against all ranges. So ranges are taken for as good as they are said to be, and measured again where that
    leads. The other optimum is believed where it gains more by its weights than it loses by those of the first.
    """
    graph, states, em_weights, _ = optimum
    if not len(graph.measurements):
        return optimum
    said = (graph.sigma / graph.measurements.sigma) ** 2
    if _NOISIER * float(em_weights.range_weight.mean()) > float(said.mean()):
        return optimum
    other = with_measured_weights(graph.run_em(states, replace(em_weights, range_weight=said), _FIRST_ROUNDS))
    if float(other.em_weights.range_weight.mean()) < _NOISIER * float(em_weights.range_weight.mean()):
        return optimum
    return _more_credible(optimum, other)


def with_devices_trusted(optimum: LocalOptimum) -> LocalOptimum:
    """The optimum of measured weights, or the one that is near where devices and ranges are as they say.

    Among NLOS ranges a walk may have bent until late ones pass for others. So SLAM is taken as it is, devices for
    faultless and ranges for as good as they are said to be; then all is free again from there.
    """
    graph, states = optimum.graph, optimum.states
    if nlos_share(optimum) <= graph.parameters.search.doubtful_share:
        return optimum
    clear = graph.with_reflections(there=False)
    rigid = RigidGraph(clear.rigid_problem(clear.initial_states(states.anchor_poses)), np.zeros((len(graph.users), 3)))
    annealing = graph.parameters.search.annealing
    near = rigid.run_em(rigid.initial_states(states.anchor_poses), rigid.initial_em_weights(), _FIRST_ROUNDS, annealing)
    near = rigid.run_em(near.states, near.em_weights, _ROUNDS)
    first = replace(
        graph.initial_em_weights(),
        nlos_odds=near.em_weights.nlos_odds,
        range_weight=np.ones(len(graph.measurements)),
    )
    begin = clear.initial_states(near.states.anchor_poses)
    begin = clear.optimised(begin, begin.anchor_poses, first, 1.0, _TRUSTED_STEPS, _TRUSTED_GAIN)
    return _more_credible(optimum, with_measured_weights(clear.run_em(begin, first, _FIRST_ROUNDS)))


def _more_credible(optimum: LocalOptimum, other: LocalOptimum) -> LocalOptimum:
    """Of two optima with measured weights the other one if it gains more by its own than it loses by the first's."""
    ours, others = optimum.em_weights.range_weight, other.em_weights.range_weight
    gain = _normalised_cost(optimum, others) - _normalised_cost(other, others)
    loss = _normalised_cost(other, ours) - _normalised_cost(optimum, ours)
    return other if gain > loss + BETTER else optimum


def refine(coarse: LocalOptimum, graph: PoseGraph) -> LocalOptimum:
    """The same optimum at the finer keyframes of another graph."""
    coarse = coarse.graph.run_em(coarse.states, coarse.em_weights, _REFINING_ROUNDS)
    states = interpolated(coarse.states, coarse.graph.keyframes, graph.keyframes)
    first = replace(graph.initial_em_weights(), range_weight=coarse.em_weights.range_weight)
    near = graph.with_sigma_of(coarse.graph).run_em(states, first, _REFINING_ROUNDS)
    return _measured_again(near, _REFINING_ROUNDS)


def _measured_again(optimum: LocalOptimum, rounds: int) -> LocalOptimum:
    """The optimum after more EM rounds with ranges' sigmas and weights measured on its residuals.

    Where errors in line of sight are larger than noise and many ranges are NLOS, some of the others are NLOS after all,
    and ranges count for less.
    """
    states = optimum.states
    graph = optimum.graph.with_measured_sigma(states, optimum.em_weights.range_weight)
    em_weights, _ = graph.e_step(states, optimum.em_weights)
    em_weights = graph.with_range_weights(states, em_weights)
    beyond = 1.0 - (graph.measurements.sigma / graph.sigma) ** 2
    _, inlier_probability = graph.inlier_probability(states, em_weights)
    share = float(1.0 - inlier_probability.mean()) if len(inlier_probability) else 0.0
    worth = 1.0 / (1.0 + graph.parameters.ranges.reflection_confusion * 4.0 * share * (1.0 - share) * beyond)
    return graph.run_em(states, replace(em_weights, range_weight=worth * em_weights.range_weight), rounds)
