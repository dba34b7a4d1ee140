"""Local optima grouped into hypotheses: joint frames that differ by more than the largest error, with covariances."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.geometry import apply_frames, difference, wrap_angle
from synchronizar.graph.pose_graph import SAME
from synchronizar.parameters import Parameters


class GaussianComponent(NamedTuple):
    """One component of a hypothesis's Gaussian mixture: a local optimum and its covariance (Laplace's method)."""

    weight: float
    """Its share of the hypothesis's probability."""
    frames: Array
    """(k, 4) x, y, z (m), yaw (rad)."""
    covariances: Array
    """(k, 4, 4) of additive errors in x, y, z (m, common axes) and yaw (rad)."""


class Hypothesis(NamedTuple):
    """Frames of all users and their uncertainty: a Gaussian mixture over local optima that are nearly the same.

    A user whose frame is nearly the same in all hypotheses has the mean and covariance over the optima of all of them.
    """

    cost: float
    """Negative log likelihood of its best optimum."""
    frames: Array
    """(k, 4) x, y, z (m), yaw (rad): the mean of the mixture."""
    covariances: Array
    """(k, 4, 4) of the mixture, of additive errors in x, y, z (m, common axes) and yaw (rad)."""
    minima: list[GaussianComponent]
    """The mixture's components, best first."""
    all_components: list[GaussianComponent] | None = None
    """The components of all hypotheses, where there is more than one."""
    agreed: Mask | None = None
    """(k,) whether the user's frame is nearly the same in all hypotheses; None where there is one only."""

    def components_of(self, user: int) -> list[GaussianComponent]:
        """The mixture of a user's frame: over all hypotheses where these agree on it, else over this one."""
        if self.all_components is None or self.agreed is None or not self.agreed[user]:
            return self.minima
        return self.all_components


class _Optimum(Protocol):
    """A local optimum of the rigid or the full model."""

    @property
    def held_as_usual(self) -> Mask:
        """(k,) whether each device starts at the usual height."""

    @property
    def frames(self) -> Array:
        """(k, 4) x, y, z (m), yaw (rad)."""

    @property
    def cost(self) -> float:
        """Negative log likelihood."""


M = TypeVar("M", bound=_Optimum)


def hypotheses(
    minima: Sequence[M], spread: Callable[[M], tuple[Array, float]], extent: Array, parameters: Parameters
) -> list[Hypothesis]:
    """Local optima (best first) grouped into hypotheses.

    `spread` returns the covariances (k, 4, 4) of an optimum, and the logarithm of how much room it has beside others.
    `extent` (k, c, 3) m are the extent points of each user's track in its own frame. Optima that move none of them by
    `parameters.integrity.largest_error` or more are one hypothesis.
    """
    groups: list[list[M]] = []
    for s in _distinct(minima):
        for group in groups:
            if np.nanmax(moved(s.frames, group[0].frames, extent)) < parameters.integrity.largest_error:
                group.append(s)
                break
        else:
            groups.append([s])
    distinct = [_merge([_laplace(s, spread) for s in group]) for group in groups]
    return distinct if len(distinct) == 1 else _pool(distinct, extent, parameters)


def _distinct(optima: Sequence[M]) -> list[M]:
    """The optima without those within `SAME` of a better one whose devices are held alike."""
    out: list[M] = []
    for s in optima:
        if not any(
            np.array_equal(s.held_as_usual, d.held_as_usual)
            and np.nanmax(np.abs(difference(s.frames, d.frames))) < SAME
            for d in out
        ):
            out.append(s)
    return out


def _laplace(s: M, spread: Callable[[M], tuple[Array, float]]) -> tuple[float, GaussianComponent]:
    """The cost of an optimum beside its volume, and the Gaussian about it."""
    covariances, log_volume = spread(s)
    return s.cost - log_volume, GaussianComponent(1.0, s.frames, covariances)


def _merge(gaussians: list[tuple[float, GaussianComponent]]) -> Hypothesis:
    """The hypothesis of some Gaussians, best first: their mixture with weights exp(-cost), its mean and covariance."""
    best = gaussians[0][1]
    log_weight = -np.array([cost for cost, _ in gaussians])
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    offset = np.array([difference(m.frames, best.frames) for _, m in gaussians])
    within = np.array([m.covariances for _, m in gaussians])
    mean = np.einsum("m,mkc->kc", weight, offset)
    spread = offset - mean
    covariance = np.einsum("m,mkcd->kcd", weight, within) + np.einsum("m,mkc,mkd->kcd", weight, spread, spread)
    frames = best.frames + mean
    frames[:, 3] = wrap_angle(frames[:, 3])
    minima = [m._replace(weight=float(w)) for w, (_, m) in zip(weight, gaussians, strict=True)]
    return Hypothesis(gaussians[0][0], frames, covariance, minima)


def _pool(distinct: list[Hypothesis], extent: Array, parameters: Parameters) -> list[Hypothesis]:
    """The same hypotheses; users on which all agree get the mean and covariance of the mixture over all."""
    merged = _merge([(p.cost - np.log(m.weight / p.minima[0].weight), m) for p in distinct for m in p.minima])
    best = merged.minima[0]
    apart = np.fmax.reduce([moved(m.frames, best.frames, extent) for m in merged.minima])
    near = np.asarray(apart < parameters.integrity.largest_error)
    return [
        p._replace(
            frames=np.where(near[:, None], merged.frames, p.frames),
            covariances=np.where(near[:, None, None], merged.covariances, p.covariances),
            all_components=merged.minima,
            agreed=near,
        )
        for p in distinct
    ]


def moved(frames: Array, others: Array, extent: Array) -> Array:
    """(k,) m: largest distance between two frames (k, 4) of each user, over its extent points (k, c, 3)."""
    return np.asarray(np.linalg.norm(places(frames, extent) - places(others, extent), axis=2).max(axis=1))


def places(frames: Array, extent: Array) -> Array:
    """(k, c, 3) m: points (k, c, 3) m of each user's own frame, transformed to the common one by frames (k, 4)."""
    return apply_frames(frames[:, None], extent)
