"""Optima in which one surveyed radio is not where its entry says, on either side of the survey's level."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from synchronizar.arrays import Array
from synchronizar.estimation.initialisation import Candidate, extend
from synchronizar.graph.pose_graph import LocalOptimum
from synchronizar.preprocessing.range_measurements import RangeMeasurements

_MOST_PLACES = 2  # of one radio: above and below those who walk on one level
_FIRST_ROUNDS = 2
_ROUNDS = 4


def other_entries(optimum: LocalOptimum) -> list[LocalOptimum]:
    """Optima beside one with measured weights in which one entry alone is wrong.

    Ranges tell on which side of the radios people walk by how unequal in height these are. A wrong height among few
    radios may fit the wrong side, and then biases take up what is left: nothing seems wrong. Only with the entry left
    out does the right side explain the ranges.
    """
    graph, states = optimum.graph, optimum.states
    rigid, limits = graph.rigid_problem(states), graph.parameters
    near_entry = limits.integrity.survey_contradicted
    known, found = [optimum.frames], list[LocalOptimum]()
    for user, frames in _without_an_entry(optimum, rigid.measurements):
        for candidate in extend(rigid, [Candidate(frames, 0.0)], user)[:_MOST_PLACES]:
            if np.linalg.norm(candidate.frames[user, :3] - graph.problem.survey[user]) < near_entry:
                continue
            begin = states._replace(anchor_poses=candidate.frames)
            near = graph.run_em(begin, optimum.em_weights, _FIRST_ROUNDS)
            if near.cost > optimum.cost + limits.search.hopeless_cost or near.graph.is_known(near.states, known):
                continue
            other = near.graph.run_em(near.states, near.em_weights, _ROUNDS, known=known)
            known.append(other.frames)
            found.append(other)
    return found


def _without_an_entry(optimum: LocalOptimum, ranges: RangeMeasurements) -> Iterator[tuple[int, Array]]:
    """Each surveyed radio that ranges, and frames (k, 4) without it, all others of the survey at their entries.

    Everybody else is where it is, and then mirrored at these others' level.
    """
    graph, k = optimum.graph, len(optimum.graph.users)
    surveyed, survey = graph.problem.surveyed, graph.problem.survey
    count = np.bincount(ranges.i, minlength=k) + np.bincount(ranges.j, minlength=k)
    sums = np.bincount(ranges.i, ranges.p_i[:, 2], k) + np.bincount(ranges.j, ranges.p_j[:, 2], k)
    own = sums / np.maximum(count, 1)
    moved = [u for u in graph.free if not surveyed[u]]
    radios = np.flatnonzero(surveyed & (count > 0)).tolist()
    for user in radios if len(radios) > 1 and moved else ():
        here = optimum.states.anchor_poses.copy()
        here[surveyed, :3] = survey[surveyed]
        here[user] = np.nan
        mirrored = here.copy()
        level = survey[[u for u in radios if u != user], 2].mean()
        mirrored[moved, 2] = 2.0 * (level - own[moved]) - here[moved, 2]
        yield user, here
        yield user, mirrored
