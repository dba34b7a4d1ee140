"""The minima gathered into joint placements that differ, each with its uncertainty."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.batch import SAME, Settled
from synchronizar.geometry import apply_frames, difference, wrap_angle
from synchronizar.misfit import Misfit, misfit
from synchronizar.model import Model
from synchronizar.samples import Samples


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


def fits(settled: Settled, samples: Samples) -> dict[int, Misfit]:
    """How the samples fit a minimum, user by user."""
    graph = settled.graph
    residual, honest = graph.residuals(settled.values), graph.honest(settled.values)
    weight = graph.weights(settled.values) / samples.sigma**2
    return {u: misfit(samples, settled.frames, residual, weight, honest, u) for u in graph.free}


def placements(settled: list[Settled], fit: dict[int, Misfit], corners: Array, model: Model) -> list[Placement]:
    """The minima (best first) gathered into placements that differ, their covariances as large as the residuals say.

    `corners` (k, c, 3) are points of each user's walk in its own frame; minima that move none of them by more than
    `model.largest_error` are the same placement.
    """
    groups: list[list[Settled]] = []
    for s in settled:
        for group in groups:
            if np.nanmax(moved(s.frames, group[0].frames, corners)) < model.largest_error:
                group.append(s)
                break
        else:
            groups.append([s])
    return [_merge(group, fit) for group in groups]


def _merge(group: list[Settled], fit: dict[int, Misfit]) -> Placement:
    """The mixture of Gaussians about the minima that do not repeat each other, and its first two moments."""
    best = group[0]
    distinct = [best]
    for s in group[1:]:
        if all(np.nanmax(np.abs(difference(s.frames, d.frames))) > SAME for d in distinct):
            distinct.append(s)
    within = np.array([_inflated(s, fit) for s in distinct])
    log_weight = np.array([-s.cost for s in distinct])
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    away = np.array([difference(s.frames, best.frames) for s in distinct])
    mean = np.einsum("m,mkc->kc", weight, away)
    spread = away - mean
    covariance = np.einsum("m,mkcd->kcd", weight, within) + np.einsum("m,mkc,mkd->kcd", weight, spread, spread)
    frames = best.frames + mean
    frames[:, 3] = wrap_angle(frames[:, 3])
    minima = [Minimum(float(w), s.frames, c) for w, s, c in zip(weight, distinct, within, strict=True)]
    return Placement(best.cost, frames, covariance, minima)


def _inflated(settled: Settled, fit: dict[int, Misfit]) -> Array:
    """The covariances (k, 4, 4) with what the ranges say worth 1 / inflation of what it seems; priors are worth theirs.

    With the information H = R + P of ranges and priors, and scores of covariance f R + P, the sandwich
    H^-1 (f R + P) H^-1 is f H^-1 - (f - 1) H^-1 P H^-1; no number is known worse than before any range.
    """
    out = settled.graph.covariances(settled.values)
    for u, of_user in fit.items():
        variances = settled.graph.prior_variances(u)
        out[u] = of_user.inflation * out[u] - (of_user.inflation - 1.0) * out[u] @ np.diag(1.0 / variances) @ out[u]
        no_worse = np.sqrt(np.minimum(1.0, variances / np.maximum(np.diag(out[u]), 1e-300)))
        out[u] *= np.outer(no_worse, no_worse)
    return out


def moved(frames: Array, others: Array, corners: Array) -> Array:
    """(k,) m: how far two joint placements (k, 4) lie apart for each user, at the corner (k, c, 3) where it is most."""
    return np.asarray(np.linalg.norm(places(frames, corners) - places(others, corners), axis=2).max(axis=1))


def places(frames: Array, corners: Array) -> Array:
    """(k, c, 3) m: where points (k, c, 3) of each user's own frame lie in the common one, by frames (k, 4)."""
    return apply_frames(frames[:, None], corners)
