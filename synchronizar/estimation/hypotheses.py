"""The minima gathered into joint placements that differ, each with its uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.geometry import apply_frames, difference, wrap_angle
from synchronizar.parameters import Parameters

SAME = 0.01  # m and rad: minima that are closer are one


class GaussianComponent(NamedTuple):
    """One of the minima that make a placement: a Gaussian about it (Laplace's method)."""

    weight: float
    """The share of the placement's probability."""
    frames: Array
    """(k, 4) x, y, z, yaw."""
    covariances: Array
    """(k, 4, 4) of additive errors in x, y, z (m, common axes) and yaw (rad)."""


class Hypothesis(NamedTuple):
    """A joint placement and its uncertainty: minima that are all but the same are one.

    Who is all but the same in all joint placements has the mean and covariance over the minima of all of them.
    """

    cost: float
    """Negative log likelihood of its best minimum."""
    frames: Array
    """(k, 4) x, y, z, yaw: the mean over its minima."""
    covariances: Array
    """(k, 4, 4) about that mean, of additive errors in x, y, z (m, common axes) and yaw (rad)."""
    minima: list[GaussianComponent]
    of_all: list[GaussianComponent] | None = None
    """The minima of all joint placements, where there are others."""
    optimum: Mask | None = None
    """(k,) who is all but the same in all of them."""

    def components_of(self, user: int) -> list[GaussianComponent]:
        """Those that matter for a user."""
        if self.of_all is None or self.optimum is None or not self.optimum[user]:
            return self.minima
        return self.of_all


class _Optimum(Protocol):
    @property
    def frames(self) -> Array:
        """(k, 4) x, y, z, yaw."""

    @property
    def cost(self) -> float:
        """Negative log likelihood."""


M = TypeVar("M", bound=_Optimum)


def hypotheses(
    minima: Sequence[M], covariances: Callable[[M], Array], extent: Array, parameters: Parameters
) -> list[Hypothesis]:
    """Minima (best first) gathered into placements that differ; `covariances` gives the (k, 4, 4) of one.

    `extent` (k, c, 3) are points of each user's walk in its own frame; minima that move none of them by more than
    `parameters.integrity.largest_error` are the same placement.
    """
    groups: list[list[M]] = []
    for s in minima:
        for group in groups:
            if np.nanmax(moved(s.frames, group[0].frames, extent)) < parameters.integrity.largest_error:
                group.append(s)
                break
        else:
            groups.append([s])
    apart = [_merge([_laplace(s, covariances) for s in _distinct(group)]) for group in groups]
    return apart if len(apart) == 1 else _pooled(apart, extent, parameters)


def _distinct(group: list[M]) -> list[M]:
    """Those that do not repeat each other."""
    out = group[:1]
    for s in group[1:]:
        if all(np.nanmax(np.abs(difference(s.frames, d.frames))) > SAME for d in out):
            out.append(s)
    return out


def _laplace(s: M, covariances: Callable[[M], Array]) -> tuple[float, GaussianComponent]:
    """Its cost, and the Gaussian about it."""
    return s.cost, GaussianComponent(1.0, s.frames, covariances(s))


def _merge(gaussians: list[tuple[float, GaussianComponent]]) -> Hypothesis:
    """Their mixture, weighed by what they cost, the best one first; its first two moments."""
    best = gaussians[0][1]
    log_weight = -np.array([cost for cost, _ in gaussians])
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    away = np.array([difference(m.frames, best.frames) for _, m in gaussians])
    within = np.array([m.covariances for _, m in gaussians])
    mean = np.einsum("m,mkc->kc", weight, away)
    spread = away - mean
    covariance = np.einsum("m,mkcd->kcd", weight, within) + np.einsum("m,mkc,mkd->kcd", weight, spread, spread)
    frames = best.frames + mean
    frames[:, 3] = wrap_angle(frames[:, 3])
    minima = [m._replace(weight=float(w)) for w, (_, m) in zip(weight, gaussians, strict=True)]
    return Hypothesis(gaussians[0][0], frames, covariance, minima)


def _pooled(apart: list[Hypothesis], extent: Array, parameters: Parameters) -> list[Hypothesis]:
    """The same; those who are near in all of them as all of them have it."""
    of_all = _merge([(p.cost - np.log(m.weight / p.minima[0].weight), m) for p in apart for m in p.minima])
    best = of_all.minima[0]
    away = np.fmax.reduce([moved(m.frames, best.frames, extent) for m in of_all.minima])
    near = np.asarray(away < parameters.integrity.largest_error)
    return [
        p._replace(
            frames=np.where(near[:, None], of_all.frames, p.frames),
            covariances=np.where(near[:, None, None], of_all.covariances, p.covariances),
            of_all=of_all.minima,
            optimum=near,
        )
        for p in apart
    ]


def moved(frames: Array, others: Array, extent: Array) -> Array:
    """(k,) m: how far two joint placements (k, 4) lie apart for each user, at the corner (k, c, 3) where it is most."""
    return np.asarray(np.linalg.norm(places(frames, extent) - places(others, extent), axis=2).max(axis=1))


def places(frames: Array, extent: Array) -> Array:
    """(k, c, 3) m: where points (k, c, 3) of each user's own frame lie in the common one, by frames (k, 4)."""
    return apply_frames(frames[:, None], extent)
