"""Initialisation: candidates for all users' frames from ranges alone, by a global search that needs no start.

Users are added one at a time, each by its ranges to all added before, beginning with the pair that observes each other
best. Every candidate that explains the ranges is kept (a user that walks a line has a mirror image, for one) until
ranges to others exclude it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import repeat
from typing import NamedTuple

import numpy as np

from synchronizar._core import search_placements
from synchronizar.arrays import Array, Indices, Mask
from synchronizar.geometry import apply_frames, relative_to
from synchronizar.graph.priors import height_sigma_of, nlos_mixture
from synchronizar.graph.problem import Problem
from synchronizar.preprocessing.range_measurements import RangeMeasurements, pair_bounds


class Candidate(NamedTuple):
    """Frames of several users that explain the ranges between them."""

    frames: Array
    """(k, 4) x, y, z (m), yaw (rad): common_from_user; NaN for users not added yet."""
    cost: float
    """Negative log likelihood, up to a constant that all candidates share."""


def joint_placements(problem: Problem) -> list[Candidate]:
    """Candidates for the frames of the active users in the reference's frame, best first; SLAM is rigid."""
    users = problem.users
    frames = np.full((len(users), 4), np.nan)
    if not problem.free:
        frames[problem.reference] = 0.0
        return [Candidate(frames, 0.0)]
    if problem.surveyed.any():
        return _beside_survey(problem, [])
    observability, spread = _observability(problem.measurements, len(users))
    order = _order(observability, spread, np.array([user.static for user in users]), problem.active_users)
    frames[order[0]] = 0.0
    alive = [Candidate(frames, 0.0)]
    for user in order[1:]:
        alive = extend(problem, alive, user)
    return [Candidate(relative_to(h.frames, problem.reference), h.cost) for h in alive]


def without_an_entry(problem: Problem) -> list[Candidate]:
    """Joint placements in each of which one surveyed radio is not where it was surveyed to be."""
    ranging = np.bincount(
        np.concatenate([problem.measurements.i, problem.measurements.j]), minlength=len(problem.users)
    )
    doubted = np.flatnonzero(problem.surveyed & (ranging > 0)).tolist()
    return [found[0] for u in doubted if (found := _beside_survey(problem, [u]))] if len(doubted) > 1 else []


def _beside_survey(problem: Problem, doubted: list[int]) -> list[Candidate]:
    """Candidates with surveyed radios at their places, but for those `doubted`, which are added last."""
    users, surveyed = problem.users, np.flatnonzero(problem.surveyed)
    frames = np.full((len(users), 4), np.nan)
    frames[problem.reference] = 0.0
    frames[surveyed] = np.column_stack([problem.survey[surveyed], np.zeros(len(surveyed))])
    frames[doubted] = np.nan
    alive = [Candidate(frames, 0.0)]
    placed = {problem.reference, *surveyed.tolist()} - set(doubted)
    observability, _ = _observability(problem.measurements, len(users))
    left = set(problem.active_users) - placed - set(doubted)
    for group in (left, set(doubted)):
        while group:
            best = observability[sorted(placed)].max(axis=0)
            user = max(group, key=lambda u: float(best[u]))
            if best[user] < 0.0:  # ties to the doubted alone
                return []
            alive = extend(problem, alive, user)
            placed.add(user)
            group.remove(user)
    return alive


def placements_in_parts(problem: Problem) -> Iterator[Candidate]:
    """Joint placements found in random parts of the walk (the same ones each time) that connect all active users.

    A part may be free of the burst of NLOS ranges that misleads the whole.
    """
    measurements, search = problem.measurements, problem.parameters.search
    random = np.random.default_rng(0)
    begin, end = measurements.t.min(), measurements.t.max()
    along = (measurements.t - begin) / max(end - begin, 1e-9)
    piece = np.minimum(along * search.part_pieces, search.part_pieces - 1).astype(int)
    for _ in range(search.parts):
        share = random.permutation(search.part_pieces) / search.part_pieces
        taken = share < random.uniform(search.least_part, search.largest_part)
        part = problem.part(taken[piece])
        if part.active_users == problem.active_users:
            yield from joint_placements(part)[: search.most_followed]


def _observability(measurements: RangeMeasurements, users: int) -> tuple[Array, Array]:
    """How well each two users (k, k) are likely to observe their relative frame, a rough measure for an order only.

    (spread of i + spread of j) / mean distance * sqrt(number of ranges); -1 without ranges. And the spread (k,) m of
    each user: the smaller principal 1 sigma of its antenna positions in the plane plus a tenth of the larger.
    """
    bounds = pair_bounds(measurements)
    begin, count = bounds[:-1], np.diff(bounds)
    i, j = measurements.i[begin], measurements.j[begin]

    def mean(column: Array) -> Array:
        return np.add.reduceat(column, begin) / count

    def spread_of(p: Array) -> Array:
        x, y = p[:, 0], p[:, 1]
        mx, my = mean(x), mean(y)
        xx, yy, xy = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
        middle, radius = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
        small, large = np.maximum(middle - radius, 0.0), np.maximum(middle + radius, 0.0)
        return np.asarray(np.sqrt(small) + 0.1 * np.sqrt(large))

    spread_i, spread_j = spread_of(measurements.p_i), spread_of(measurements.p_j)
    reach = np.maximum(mean(measurements.distance), 0.5)
    observability = np.full((users, users), -1.0)
    observability[i, j] = observability[j, i] = (spread_i + spread_j) / reach * np.sqrt(count)
    spread = np.zeros(users)
    np.maximum.at(spread, i, spread_i)
    np.maximum.at(spread, j, spread_j)
    return observability, spread


def _order(observability: Array, spread: Array, static: Mask, active_users: list[int]) -> list[int]:
    """The users in the order in which they are added: each next one is best observed by one before it.

    The first is not static; of the pair that observes each other best it is the one that moves more.
    """
    of_moving = np.where(static[:, None] & static[None, :], -1.0, observability)
    ends = np.array(np.unravel_index(np.argmax(of_moving), observability.shape))
    first = int(ends[np.argmax(np.where(static[ends], -1.0, spread[ends]))])
    order = [first]
    while len(order) < len(active_users):
        best = observability[order].max(axis=0)
        best[order] = -2.0
        order.append(int(np.argmax(best)))
    return order


class _Links(NamedTuple):
    """The n ranges between a user and those that are placed, pair after pair."""

    other: Indices
    """(n,)"""
    own: Array
    """(n, 3) m: the user's antennas, in its own frame."""
    others: Array
    """(n, 3) m: the others', each in its own frame."""
    distance: Array
    sigma: Array
    nlos_odds: Array


def _links(measurements: RangeMeasurements, user: int, placed: Mask) -> _Links:
    bounds = pair_bounds(measurements)
    i, j = measurements.i[bounds[:-1]], measurements.j[bounds[:-1]]
    mine = np.flatnonzero(((i == user) & placed[j]) | ((j == user) & placed[i]))
    other, begin, end = np.where(i == user, j, i)[mine], bounds[mine], bounds[mine + 1]
    slices = [slice(*ends) for ends in zip(begin.tolist(), end.tolist(), strict=True)]
    ends = (measurements.p_i, measurements.p_j)
    is_j = (j == user)[mine].tolist()

    def joined(columns: Iterable[Array]) -> Array:
        return np.concatenate([column[rows] for column, rows in zip(columns, slices, strict=True)])

    return _Links(
        np.repeat(other, end - begin),
        joined(ends[k] for k in is_j),
        joined(ends[not k] for k in is_j),
        joined(repeat(measurements.distance, len(mine))),
        joined(repeat(measurements.sigma, len(mine))),
        joined(repeat(measurements.nlos_odds, len(mine))),
    )


def extend(problem: Problem, candidates: list[Candidate], user: int) -> list[Candidate]:
    """Each candidate with one more user, at every frame that its ranges to the users in it allow; best first.

    All candidates are of the same users.
    """
    parameters, known = problem.parameters, problem.users[user]
    surveyed = problem.surveyed.any()
    links = _links(problem.measurements, user, ~np.isnan(candidates[0].frames[:, 0]))
    grown = []
    for candidate in candidates:
        found = search_placements(
            apply_frames(candidate.frames[links.other], links.others),
            links.own,
            links.distance,
            links.sigma,
            links.nlos_odds,
            # A survey's zero says nothing of how high devices are.
            parameters.priors.static_height_sigma if surveyed else height_sigma_of(known, parameters),
            not known.static,
            nlos_mixture(parameters),
            parameters.integrity.largest_error,
            parameters.search.most_candidates,
            parameters.search.most_ranges,
            parameters.search.cost_alive,
        )
        for placement in found:
            frames = candidate.frames.copy()
            frames[user] = placement[:4]
            grown.append(Candidate(frames, candidate.cost + float(placement[4])))
    grown.sort(key=lambda h: h.cost)
    return [
        h for h in grown[: parameters.search.most_hypotheses] if h.cost <= grown[0].cost + parameters.search.cost_alive
    ]
