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
from synchronizar.graph import height_sigma_of, late_loss
from synchronizar.model import Model
from synchronizar.samples import Samples
from synchronizar.user import User


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
    own = _own_positions(samples)
    first = _begin(samples, users, placed, own)
    frames = np.full((len(users), 4), np.nan)
    frames[first] = 0.0
    alive = [Hypothesis(frames, 0.0)]
    todo = set(placed) - {first}
    while todo:
        user = _best_seen(samples, alive[0], todo, own)
        todo.remove(user)
        alive = _extend(samples, alive, users, user, model)
    return [Hypothesis(_relative_to(h.frames, reference), h.cost) for h in alive]


def _own_positions(samples: Samples) -> Array:
    return np.stack([samples.p_i, samples.p_j])


def _spread(xy: Array) -> float:
    """How far points (n, 2) lie from their best line, and a little for how far along it (m): 0 for one point."""
    values = np.linalg.eigvalsh(np.cov(xy.T)) if len(xy) > 1 else np.zeros(2)
    small, large = np.sqrt(np.maximum(values, 0.0))
    return float(small + 0.1 * large)


def _sight(known: Array, own: Array, distance: Array) -> float:
    """How well ranges between these points are likely to tell a placement: a rough measure, for an order only."""
    reach = max(float(distance.mean()), 0.5)
    return (_spread(known[:, :2]) + _spread(own[:, :2])) / reach * float(np.sqrt(len(distance)))


def _begin(samples: Samples, users: tuple[User, ...], placed: list[int], own: Array) -> int:
    """The user whose frame the search begins with: of the two that see each other best the one that moves more."""
    from synchronizar.samples import pairs

    best, first = -1.0, placed[0]
    for pair in pairs(samples):
        p_i, p_j = own[0, pair.samples], own[1, pair.samples]
        sight = _sight(p_i, p_j, samples.distance[pair.samples])
        ends = [(u, _spread(p[:, :2])) for u, p in ((pair.i, p_i), (pair.j, p_j)) if not users[u].static]
        if ends and sight > best:
            best, first = sight, max(ends, key=lambda end: end[1])[0]
    return first


def _links(samples: Samples, user: int, placed: Mask) -> tuple[Indices, Indices]:
    """The samples between a user and placed ones, and which end (0 for i, 1 for j) the user is."""
    mine = ((samples.i == user) & placed[samples.j]) | ((samples.j == user) & placed[samples.i])
    rows = np.flatnonzero(mine).astype(np.int32)
    return rows, (samples.j[rows] == user).astype(np.int32)


def _known_positions(samples: Samples, frames: Array, rows: Indices, end: Indices, own: Array) -> Array:
    """The other ends' antennas (n, 3) in the common frame."""
    other = np.where(end == 0, samples.j[rows], samples.i[rows])
    x, y, z, yaw = frames[other].T
    p = own[1 - end, rows]
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([x + c * p[:, 0] - s * p[:, 1], y + s * p[:, 0] + c * p[:, 1], z + p[:, 2]], axis=1)


def _best_seen(samples: Samples, hypothesis: Hypothesis, todo: set[int], own: Array) -> int:
    placed = ~np.isnan(hypothesis.frames[:, 0])
    best, user = -1.0, -1
    for candidate in sorted(todo):
        rows, end = _links(samples, candidate, placed)
        if not len(rows):
            continue
        known = _known_positions(samples, hypothesis.frames, rows, end, own)
        sight = _sight(known, own[end, rows], samples.distance[rows])
        if sight > best:
            best, user = sight, candidate
    return user


def _extend(
    samples: Samples, alive: list[Hypothesis], users: tuple[User, ...], user: int, model: Model
) -> list[Hypothesis]:
    own = _own_positions(samples)
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


def _relative_to(frames: Array, reference: int) -> Array:
    """The same placements (k, 4) in the frame of the user `reference`."""
    x, y, z, yaw = frames[reference]
    c, s = np.cos(yaw), np.sin(yaw)
    dx, dy = frames[:, 0] - x, frames[:, 1] - y
    out = np.stack([c * dx + s * dy, -s * dx + c * dy, frames[:, 2] - z, frames[:, 3] - yaw], axis=1)
    out[:, 3] = np.remainder(out[:, 3] + np.pi, 2.0 * np.pi) - np.pi
    return out
