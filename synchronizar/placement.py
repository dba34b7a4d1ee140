"""The minima gathered into joint placements that differ, each with its uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from synchronizar.arrays import Array
from synchronizar.geometry import apply_frames, difference, wrap_angle
from synchronizar.model import Model

SAME = 0.01  # m and rad: minima that are closer are one


class Minimum(NamedTuple):
    """One of the minima that make a placement: a Gaussian about it (Laplace's method)."""

    weight: float
    """The share of the placement's probability."""
    frames: Array
    """(k, 4) x, y, z, yaw."""
    covariances: Array
    """(k, 4, 4) of additive errors in x, y, z (m, common axes) and yaw (rad)."""


class Placement(NamedTuple):
    """A joint placement and its uncertainty: minima that are all but the same are one."""

    cost: float
    """Negative log likelihood of its best minimum."""
    frames: Array
    """(k, 4) x, y, z, yaw: the mean over its minima."""
    covariances: Array
    """(k, 4, 4) about that mean, of additive errors in x, y, z (m, common axes) and yaw (rad)."""
    minima: list[Minimum]


class _Candidate(Protocol):
    @property
    def frames(self) -> Array:
        """(k, 4) x, y, z, yaw."""

    @property
    def cost(self) -> float:
        """Negative log likelihood."""


M = TypeVar("M", bound=_Candidate)


def placements(minima: Sequence[M], covariances: Callable[[M], Array], corners: Array, model: Model) -> list[Placement]:
    """Minima (best first) gathered into placements that differ; `covariances` gives the (k, 4, 4) of one.

    `corners` (k, c, 3) are points of each user's walk in its own frame; minima that move none of them by more than
    `model.largest_error` are the same placement.
    """
    groups: list[list[M]] = []
    for s in minima:
        for group in groups:
            if np.nanmax(moved(s.frames, group[0].frames, corners)) < model.largest_error:
                group.append(s)
                break
        else:
            groups.append([s])
    return [_merge(group, covariances) for group in groups]


def _merge(group: list[M], covariances: Callable[[M], Array]) -> Placement:
    """The mixture of Gaussians about the minima that do not repeat each other, and its first two moments."""
    best = group[0]
    distinct = [best]
    for s in group[1:]:
        if all(np.nanmax(np.abs(difference(s.frames, d.frames))) > SAME for d in distinct):
            distinct.append(s)
    within = np.array([covariances(s) for s in distinct])
    log_weight = np.array([-s.cost for s in distinct])
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    away = np.array([difference(s.frames, best.frames) for s in distinct])
    mean = np.einsum("m,mkc->kc", weight, away)
    spread = away - mean
    covariance = np.einsum("m,mkcd->kcd", weight, within) + np.einsum("m,mkc,mkd->kcd", weight, spread, spread)
    frames = best.frames + mean
    frames[:, 3] = wrap_angle(frames[:, 3])
    found = [Minimum(float(w), s.frames, c) for w, s, c in zip(weight, distinct, within, strict=True)]
    return Placement(best.cost, frames, covariance, found)


def moved(frames: Array, others: Array, corners: Array) -> Array:
    """(k,) m: how far two joint placements (k, 4) lie apart for each user, at the corner (k, c, 3) where it is most."""
    return np.asarray(np.linalg.norm(places(frames, corners) - places(others, corners), axis=2).max(axis=1))


def places(frames: Array, corners: Array) -> Array:
    """(k, c, 3) m: where points (k, c, 3) of each user's own frame lie in the common one, by frames (k, 4)."""
    return apply_frames(frames[:, None], corners)
