"""What can be said of each user's placement, and how sure it is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.batch import Settled
from synchronizar.model import Model
from synchronizar.registration import State
from synchronizar.samples import Samples
from synchronizar.user import User


class Placement(NamedTuple):
    """A joint placement and its uncertainty; minima that are all but the same count as one."""

    cost: float
    """Negative log likelihood of its best minimum."""
    frames: Array
    """(k, 4) x, y, z, yaw: the mean over its minima, each weighing what its likelihood says."""
    covariances: Array
    """(k, 4, 4) of additive errors in x, y, z (m, common axes) and yaw (rad): within the minima, and between them."""


class Verdict(NamedTuple):
    """One user's."""

    state: State
    reason: str
    unseen_direction: Array | None = None
    prior_dominated: tuple[str, ...] = ()


def placements(settled: list[Settled], corners: Array, model: Model) -> list[Placement]:
    """The minima (best first) gathered into placements that differ.

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
    return [_merge(group) for group in groups]


def _merge(group: list[Settled]) -> Placement:
    """Moment matching of a mixture of Gaussians, one at each minimum that is not a repetition (Laplace's method)."""
    best = group[0]
    distinct = [best]
    for s in group[1:]:
        if all(np.nanmax(np.abs(_difference(s.frames, d.frames))) > 1e-2 for d in distinct):
            distinct.append(s)
    within = np.array([s.graph.covariances(s.values) for s in distinct])
    log_weight = np.array([-s.cost for s in distinct])
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    away = np.array([_difference(s.frames, best.frames) for s in distinct])
    mean = np.einsum("m,mkc->kc", weight, away)
    spread = away - mean
    covariance = np.einsum("m,mkcd->kcd", weight, within) + np.einsum("m,mkc,mkd->kcd", weight, spread, spread)
    frames = best.frames + mean
    frames[:, 3] = np.remainder(frames[:, 3] + np.pi, 2.0 * np.pi) - np.pi
    return Placement(best.cost, frames, covariance)


def _difference(frames: Array, others: Array) -> Array:
    out = frames - others
    out[:, 3] = np.remainder(out[:, 3] + np.pi, 2.0 * np.pi) - np.pi
    return out


def verdicts(
    found: list[Placement], settled: Settled, samples: Samples, users: tuple[User, ...], corners: Array, model: Model
) -> list[Verdict | None]:
    """The verdict on each user that is placed."""
    best = found[0]
    away = np.zeros(len(users))
    for other in found[1:]:
        away = np.fmax(away, moved(best.frames, other.frames, corners))
    out: list[Verdict | None] = []
    for u, user in enumerate(users):
        if np.isnan(best.frames[u, 0]):
            out.append(None)
            continue
        if u == settled.graph.reference:
            out.append(Verdict(State.REGISTERED, "the reference: its frame is the common one"))
            continue
        covariance = best.covariances[u]
        if away[u] > model.largest_error:
            out.append(Verdict(State.AMBIGUOUS, f"{len(found)} placements explain the ranges"))
            continue
        spread, direction = _largest_spread(covariance, best.frames[u, 3], corners[u])
        yaw_sigma = float(np.sqrt(covariance[3, 3]))
        quantile = 3.2905
        if spread * quantile > model.largest_error:
            out.append(Verdict(State.UNOBSERVABLE, f"placed to {spread:.2f} m only (1 sigma)", direction))
        elif not user.static and yaw_sigma * quantile > model.largest_yaw_error:
            out.append(Verdict(State.UNOBSERVABLE, f"heading known to {yaw_sigma:.2f} rad only (1 sigma)", direction))
        else:
            out.append(Verdict(State.REGISTERED, f"placed to {spread:.2f} m (1 sigma)"))
    return out


def moved(frames: Array, others: Array, corners: Array) -> Array:
    """(k,) m: how far two joint placements (k, 4) lie apart for each user, at the corner (k, c, 3) where it is most."""
    return np.asarray(np.linalg.norm(_places(frames, corners) - _places(others, corners), axis=2).max(axis=1))


def _places(frames: Array, corners: Array) -> Array:
    x, y, z, yaw = (column[:, None] for column in frames.T)
    c, s = np.cos(yaw), np.sin(yaw)
    px, py, pz = np.moveaxis(corners, 2, 0)
    return np.stack([x + c * px - s * py, y + s * px + c * py, z + pz], axis=2)


def _largest_spread(covariance: Array, yaw: float, corners: Array) -> tuple[float, Array]:
    """The largest 1 sigma (m) of the place of any of the user's corners (c, 3), and the frame's error that makes it."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = c * corners[:, 0] - s * corners[:, 1], s * corners[:, 0] + c * corners[:, 1]
    jacobians = np.zeros((len(corners), 3, 4))
    jacobians[:, :3, :3] = np.eye(3)
    jacobians[:, 0, 3], jacobians[:, 1, 3] = -y, x
    variances, directions = np.linalg.eigh(jacobians @ covariance @ jacobians.transpose(0, 2, 1))
    worst = int(np.argmax(variances[:, -1]))
    error = covariance @ jacobians[worst].T @ directions[worst, :, -1]
    return float(np.sqrt(max(variances[worst, -1], 0.0))), error / max(float(np.linalg.norm(error)), 1e-12)
