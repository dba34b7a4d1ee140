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
from synchronizar.graph.rigid_graph import height_sigma_of, late_loss
from synchronizar.parameters import Model
from synchronizar.preprocessing.range_measurements import Samples, pairs


class Hypothesis(NamedTuple):
    """A joint placement that explains the ranges."""

    frames: Array
    """(k, 4) x, y, z, yaw: common_from_user of every user; NaN where it is not placed."""
    cost: float
    """Negative log likelihood, up to a constant that all hypotheses share."""


def connected(samples: Samples, users: int, reference: int) -> list[int]:
    """The users that a chain of ranges ties to the reference, itself included, sorted."""
    reached = np.zeros(users, dtype=bool)
    reached[reference] = True
    links = np.unique(np.stack([samples.i, samples.j]), axis=1)
    while True:
        touched = reached[links].any(axis=0)
        grown = reached.copy()
        grown[links[:, touched].ravel()] = True
        if (grown == reached).all():
            return np.flatnonzero(reached).tolist()
        reached = grown


def joint_placements(
    samples: Samples, users: tuple[User, ...], placed: list[int], reference: int, model: Model
) -> list[Hypothesis]:
    """Joint placements of the users in `placed` (the reference among them), best first; in the reference's frame."""
    if len(placed) == 1:
        frames = np.full((len(users), 4), np.nan)
        frames[reference] = 0.0
        return [Hypothesis(frames, 0.0)]
    sight, spread = _sights(samples, len(users))
    order = _order(sight, spread, np.array([user.static for user in users]), placed)
    frames = np.full((len(users), 4), np.nan)
    frames[order[0]] = 0.0
    alive = [Hypothesis(frames, 0.0)]
    for user in order[1:]:
        alive = extend(samples, alive, users, user, model)
    return [Hypothesis(relative_to(h.frames, reference), h.cost) for h in alive]


def _sights(samples: Samples, users: int) -> tuple[Array, Array]:
    """How well each two users (k, k) are likely to tell their placement, a rough measure for an order only.

    And how far each (k,) spreads (m): its places' smaller principal 1 sigma in the plane and a tenth of the larger.
    """
    begin = np.array([pair.samples.start for pair in pairs(samples)])
    count = np.diff([*begin, len(samples)])
    i, j = samples.i[begin], samples.j[begin]

    def mean(column: Array) -> Array:
        return np.add.reduceat(column, begin) / count

    def spread_of(p: Array) -> Array:
        x, y = p[:, 0], p[:, 1]
        mx, my = mean(x), mean(y)
        xx, yy, xy = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
        middle, radius = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
        small, large = np.maximum(middle - radius, 0.0), np.maximum(middle + radius, 0.0)
        return np.asarray(np.sqrt(small) + 0.1 * np.sqrt(large))

    spread_i, spread_j = spread_of(samples.p_i), spread_of(samples.p_j)
    reach = np.maximum(mean(samples.distance), 0.5)
    sight = np.full((users, users), -1.0)
    sight[i, j] = sight[j, i] = (spread_i + spread_j) / reach * np.sqrt(count)
    spread = np.zeros(users)
    np.maximum.at(spread, i, spread_i)
    np.maximum.at(spread, j, spread_j)
    return sight, spread


def _order(sight: Array, spread: Array, static: Mask, placed: list[int]) -> list[int]:
    """The users in the order in which they are placed: each next one has the best sight of one before it.

    The first has a heading, and is of the two that see each other best the one that moves more.
    """
    of_moving = np.where(static[:, None] & static[None, :], -1.0, sight)
    ends = np.array(np.unravel_index(np.argmax(of_moving), sight.shape))
    first = int(ends[np.argmax(np.where(static[ends], -1.0, spread[ends]))])
    order = [first]
    while len(order) < len(placed):
        best = sight[order].max(axis=0)
        best[order] = -2.0
        order.append(int(np.argmax(best)))
    return order


def _links(samples: Samples, user: int, placed: Mask) -> tuple[Indices, Indices]:
    """The samples between a user and placed ones, and which end (0 for i, 1 for j) the user is."""
    mine = ((samples.i == user) & placed[samples.j]) | ((samples.j == user) & placed[samples.i])
    rows = np.flatnonzero(mine).astype(np.int32)
    return rows, (samples.j[rows] == user).astype(np.int32)


def _known_positions(samples: Samples, frames: Array, rows: Indices, end: Indices, own: Array) -> Array:
    """The other ends' antennas (n, 3) in the common frame."""
    other = np.where(end == 0, samples.j[rows], samples.i[rows])
    return apply_frames(frames[other], own[1 - end, rows])


def extend(
    samples: Samples, alive: list[Hypothesis], users: tuple[User, ...], user: int, model: Model
) -> list[Hypothesis]:
    """Each hypothesis with one more user, wherever its ranges to those that are placed allow; best first."""
    own = np.stack([samples.p_i, samples.p_j])
    grown = []
    for hypothesis in alive:
        placed = ~np.isnan(hypothesis.frames[:, 0])
        rows, end = _links(samples, user, placed)
        found = search_placements(
            _known_positions(samples, hypothesis.frames, rows, end, own),
            own[end, rows],
            samples.distance[rows],
            samples.sigma[rows],
            samples.late_odds[rows],
            height_sigma_of(users[user], model),
            not users[user].static,
            late_loss(model),
            model.largest_error,
            model.most_candidates,
            model.most_searched,
            model.cost_alive,
        )
        for placement in found:
            frames = hypothesis.frames.copy()
            frames[user] = placement[:4]
            grown.append(Hypothesis(frames, hypothesis.cost + float(placement[4])))
    grown.sort(key=lambda h: h.cost)
    return [h for h in grown[: model.most_hypotheses] if h.cost <= grown[0].cost + model.cost_alive]
