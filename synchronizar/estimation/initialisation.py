"""Ranges -> where each frame could be: joint placements of all users, found without a start that has to be lucky.

Users are added one at a time, each against all that are placed already, beginning with the two that see each other
best. Every placement that explains the ranges is followed (a user that walks a line has a mirror image, for one) until
ranges to others exclude it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from synchronizar._core import search_placements
from synchronizar.arrays import Array, Indices, Mask
from synchronizar.data.user import User
from synchronizar.geometry import apply_frames, relative_to
from synchronizar.graph.rigid_graph import height_sigma_of, nlos_mixture
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import RangeMeasurements, pairs


class Candidate(NamedTuple):
    """A joint placement that explains the ranges."""

    frames: Array
    """(k, 4) x, y, z, yaw: common_from_user of every user; NaN where it is not placed."""
    cost: float
    """Negative log likelihood, up to a constant that all hypotheses share."""


def connected(measurements: RangeMeasurements, users: int, reference: int) -> list[int]:
    """The users that a chain of ranges ties to the reference, itself included, sorted."""
    reached = np.zeros(users, dtype=bool)
    reached[reference] = True
    links = np.unique(np.stack([measurements.i, measurements.j]), axis=1)
    while True:
        touched = reached[links].any(axis=0)
        grown = reached.copy()
        grown[links[:, touched].ravel()] = True
        if (grown == reached).all():
            return np.flatnonzero(reached).tolist()
        reached = grown


def joint_placements(
    measurements: RangeMeasurements,
    users: tuple[User, ...],
    active_users: list[int],
    reference: int,
    parameters: Parameters,
) -> list[Candidate]:
    """Joint placements of the active users (the reference among them) in its frame, best first."""
    if len(active_users) == 1:
        frames = np.full((len(users), 4), np.nan)
        frames[reference] = 0.0
        return [Candidate(frames, 0.0)]
    sight, spread = _sights(measurements, len(users))
    order = _order(sight, spread, np.array([user.static for user in users]), active_users)
    frames = np.full((len(users), 4), np.nan)
    frames[order[0]] = 0.0
    alive = [Candidate(frames, 0.0)]
    for user in order[1:]:
        alive = extend(measurements, alive, users, user, parameters)
    return [Candidate(relative_to(h.frames, reference), h.cost) for h in alive]


def _sights(measurements: RangeMeasurements, users: int) -> tuple[Array, Array]:
    """How well each two users (k, k) are likely to tell their placement, a rough measure for an order only.

    And how far each (k,) spreads (m): its places' smaller principal 1 sigma in the plane and a tenth of the larger.
    """
    begin = np.array([pair.measurements.start for pair in pairs(measurements)])
    count = np.diff([*begin, len(measurements)])
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
    sight = np.full((users, users), -1.0)
    sight[i, j] = sight[j, i] = (spread_i + spread_j) / reach * np.sqrt(count)
    spread = np.zeros(users)
    np.maximum.at(spread, i, spread_i)
    np.maximum.at(spread, j, spread_j)
    return sight, spread


def _order(sight: Array, spread: Array, static: Mask, active_users: list[int]) -> list[int]:
    """The users in the order in which they are placed: each next one has the best sight of one before it.

    The first has a heading, and is of the two that see each other best the one that moves more.
    """
    of_moving = np.where(static[:, None] & static[None, :], -1.0, sight)
    ends = np.array(np.unravel_index(np.argmax(of_moving), sight.shape))
    first = int(ends[np.argmax(np.where(static[ends], -1.0, spread[ends]))])
    order = [first]
    while len(order) < len(active_users):
        best = sight[order].max(axis=0)
        best[order] = -2.0
        order.append(int(np.argmax(best)))
    return order


def _links(measurements: RangeMeasurements, user: int, active_users: Mask) -> tuple[Indices, Indices]:
    """The samples between a user and placed ones, and which end (0 for i, 1 for j) the user is."""
    mine = ((measurements.i == user) & active_users[measurements.j]) | (
        (measurements.j == user) & active_users[measurements.i]
    )
    rows = np.flatnonzero(mine).astype(np.int32)
    return rows, (measurements.j[rows] == user).astype(np.int32)


def _known_positions(measurements: RangeMeasurements, frames: Array, rows: Indices, end: Indices, own: Array) -> Array:
    """The other ends' antennas (n, 3) in the common frame."""
    other = np.where(end == 0, measurements.j[rows], measurements.i[rows])
    return apply_frames(frames[other], own[1 - end, rows])


def extend(
    measurements: RangeMeasurements, alive: list[Candidate], users: tuple[User, ...], user: int, parameters: Parameters
) -> list[Candidate]:
    """Each hypothesis with one more user, wherever its ranges to those that are placed allow; best first."""
    own = np.stack([measurements.p_i, measurements.p_j])
    grown = []
    for hypothesis in alive:
        active_users = ~np.isnan(hypothesis.frames[:, 0])
        rows, end = _links(measurements, user, active_users)
        found = search_placements(
            _known_positions(measurements, hypothesis.frames, rows, end, own),
            own[end, rows],
            measurements.distance[rows],
            measurements.sigma[rows],
            measurements.nlos_odds[rows],
            height_sigma_of(users[user], parameters),
            not users[user].static,
            nlos_mixture(parameters),
            parameters.integrity.largest_error,
            parameters.search.most_candidates,
            parameters.search.most_ranges,
            parameters.search.cost_alive,
        )
        for placement in found:
            frames = hypothesis.frames.copy()
            frames[user] = placement[:4]
            grown.append(Candidate(frames, hypothesis.cost + float(placement[4])))
    grown.sort(key=lambda h: h.cost)
    return [
        h for h in grown[: parameters.search.most_hypotheses] if h.cost <= grown[0].cost + parameters.search.cost_alive
    ]
