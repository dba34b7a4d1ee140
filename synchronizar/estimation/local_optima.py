"""Local optima of a pose graph: from the candidates of the search, from their mirror images and from SLAM slips."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain

import numpy as np

from synchronizar.estimation.comparing import BETTER, by_cost, held_surveyed, nlos_share
from synchronizar.estimation.initialisation import placements_in_parts, without_an_entry
from synchronizar.estimation.optimum_images import mirror_states
from synchronizar.estimation.slips import relaid
from synchronizar.graph.em_weights import EmWeights
from synchronizar.graph.pose_graph import LocalOptimum, PoseGraph
from synchronizar.graph.rigid_graph import RigidGraph
from synchronizar.graph.states import States
from synchronizar.progress import Progress, unheard

_FIRST_ROUNDS = 2
_ANNEALED_ROUNDS = 3
_ROUNDS = 8


def find_optima(graph: PoseGraph, starts: list[States], progress: Progress = unheard) -> list[LocalOptimum]:
    """The local optima reached from `starts`, and from slips and mirror images of the best one, best first.

    A rigid graph is not annealed unless ranges are NLOS, and is then started from parts of the walk as well.
    """
    found: list[LocalOptimum] = []
    rigid, search = isinstance(graph, RigidGraph), graph.parameters.search
    annealing = () if rigid else search.annealing_of_rigid
    for n, states in enumerate(starts, start=1):
        _add_optimum(graph, states, found, annealing)
        progress(0.5 * n / len(starts))
    if rigid and graph.free and nlos_share(min(found, key=by_cost)) > search.doubtful_share:
        for states in starts:
            _add_optimum(graph, states, found, (search.annealing,))
        for start in placements_in_parts(graph.rigid_problem(starts[0])):
            _add_optimum(graph, graph.initial_states(start.frames), found, ())
    nearest = min(found, key=by_cost)
    if graph.problem.surveyed.any() and (
        nlos_share(nearest) > search.doubtful_share
        or not np.array_equal(held_surveyed(nearest), graph.problem.surveyed)
    ):
        for candidate in without_an_entry(graph.rigid_problem(starts[0]).widened(0.0 if rigid else search.sigma)):
            _add_optimum(graph, graph.initial_states(candidate.frames), found, annealing)
    best = min(found, key=by_cost)
    while graph.free and len(graph.measurements):
        for states in chain(relaid(best.graph, best.states), mirror_states(best, found)):
            if isinstance(best.graph, RigidGraph):  # most lead to an optimum that is known
                image = best.graph.image(states, best.em_weights, [optimum.frames for optimum in found])
                if image is None:
                    continue
                states = image
            _add_optimum(best.graph, states, found, ())
        better = min(found, key=by_cost)
        progress(0.8)
        if better.cost > best.cost - BETTER:
            break
        best = better  # which may have mirror images of its own
    return sorted(found, key=by_cost)


def approach(graph: PoseGraph, states: States, annealing: float) -> LocalOptimum:
    """States near a local optimum after a few EM rounds, the first ones annealed."""
    em_weights = _with_search_weights(graph.initial_em_weights())
    near = graph.run_em(states, em_weights, _FIRST_ROUNDS, annealing)
    return near.graph.run_em(near.states, near.em_weights, _FIRST_ROUNDS)


def _add_optimum(graph: PoseGraph, states: States, found: list[LocalOptimum], annealing: tuple[float, ...]) -> None:
    """Optimise from `states` and add the optimum to `found`, unless it is hopeless or within `SAME` of a known one."""
    known = [optimum.frames for optimum in found]
    hopeless = min(found, key=by_cost).cost + graph.parameters.search.hopeless_cost if found else np.inf
    em_weights = _with_search_weights(graph.initial_em_weights())
    for factor in annealing:
        graph, states, em_weights, _ = graph.run_em(states, em_weights, _ANNEALED_ROUNDS, factor)
    if isinstance(graph, RigidGraph):  # many parts of a walk lead to few optima
        rounds = graph.parameters.search.most_rounds
        optimum = graph.run_em(states, em_weights, rounds, known=known, hopeless=hopeless)
    else:
        optimum = graph.run_em(states, em_weights, _FIRST_ROUNDS)
        if optimum.cost > hopeless or graph.is_known(optimum.states, known):
            return
        optimum = optimum.graph.run_em(optimum.states, optimum.em_weights, _ROUNDS, known=known)
    if not graph.is_known(optimum.states, known):
        found.append(optimum)


def _with_search_weights(em_weights: EmWeights) -> EmWeights:
    """EM weights with the square root of the range weights: between those of independent and of correlated ranges.

    Which of both holds is measured later. With the weights of correlated ranges, half a walk of ranges taken for NLOS
    would cost less than one SLAM slip.
    """
    return replace(em_weights, range_weight=np.sqrt(em_weights.range_weight))
