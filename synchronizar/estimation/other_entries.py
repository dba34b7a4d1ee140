"""Optima in which one surveyed radio is not where its entry says, on either side of the survey's level."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from synchronizar.arrays import Array
from synchronizar.estimation.comparing import held_surveyed
from synchronizar.estimation.initialisation import Candidate, extend
from synchronizar.graph.pose_graph import LocalOptimum
from synchronizar.preprocessing.range_measurements import RangeMeasurements

_MOST_PLACES = 2  # of one radio: above and below those who walk on one level
_FIRST_ROUNDS = 2
_ROUNDS = 4


def other_entries(optimum: LocalOptimum) -> list[LocalOptimum]:
    """Optima beside one with measured weights in which one entry that it holds is wrong.

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
    """Each radio whose entry is held, and frames (k, 4) without it: as they are, and mirrored at the others' level."""
    graph, frames = optimum.graph, optimum.states.anchor_poses
    surveyed, survey = graph.problem.surveyed, graph.problem.survey
    moved = [u for u in graph.free if not surveyed[u]]
    k, (i, j) = len(frames), (ranges.i, ranges.j)
    count = np.bincount(i, minlength=k) + np.bincount(j, minlength=k)
    own = (np.bincount(i, ranges.p_i[:, 2], k) + np.bincount(j, ranges.p_j[:, 2], k)) / np.maximum(count, 1)
    held = [u for u in np.flatnonzero(held_surveyed(optimum)).tolist() if u in graph.active_users]
    for user in held if len(held) > 1 and moved else ():
        here = frames.copy()
        here[user] = np.nan
        mirrored = here.copy()
        level = survey[[u for u in held if u != user], 2].mean()
        mirrored[moved, 2] = 2.0 * (level - own[moved]) - here[moved, 2]
        yield user, here
        yield user, mirrored
