"""What can be said of each user's placement, and how sure it is."""

from __future__ import annotations

from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.batch import Settled
from synchronizar.graph import RigidGraph
from synchronizar.misfit import Misfit, misfit
from synchronizar.model import Model
from synchronizar.registration import State
from synchronizar.samples import Samples

_NAMES = ("x", "y", "z", "yaw")
_SYSTEMATIC = 2.0  # inflation of a covariance: with most ranges rejected, more than late signals explain


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
    """Moment matching of a mixture of Gaussians, one at each minimum that is not a repetition (Laplace's method)."""
    best = group[0]
    distinct = [best]
    for s in group[1:]:
        if all(np.nanmax(np.abs(_difference(s.frames, d.frames))) > 1e-2 for d in distinct):
            distinct.append(s)
    within = np.array([_inflated(s, fit) for s in distinct])
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


def _difference(frames: Array, others: Array) -> Array:
    out = frames - others
    out[:, 3] = np.remainder(out[:, 3] + np.pi, 2.0 * np.pi) - np.pi
    return out


def verdicts(
    found: list[Placement], fit: dict[int, Misfit], graph: RigidGraph, corners: Array, model: Model
) -> list[Verdict | None]:
    """The verdict on each user that is placed."""
    best = found[0]
    away = np.zeros(len(graph.users))
    for other in found[1:]:
        away = np.fmax(away, moved(best.frames, other.frames, corners))
    said: list[Verdict | None] = [None] * len(graph.users)
    said[graph.reference] = Verdict(State.REGISTERED, "the reference: its frame is the common one")
    for u in graph.free:
        prior = graph.prior_variances(u)
        dominated = tuple(
            name
            for name, own, of in zip(_NAMES, np.diag(best.covariances[u]), prior, strict=True)
            if own > 0.5 * of and not (name == "yaw" and graph.users[u].static)
        )
        state, reason, direction = _state(best, u, graph.users[u].static, corners[u], model)
        doubted = fit[u].rejected > 0.5 and fit[u].inflation > _SYSTEMATIC
        if doubted or fit[u].rejected > model.largest_rejected:
            reason = f"{fit[u].rejected:.0%} of its ranges do not fit: its track or a radio is not what it is taken for"
            state = State.UNOBSERVABLE
        if away[u] > model.largest_error and state is State.REGISTERED:
            state, reason, direction = State.AMBIGUOUS, f"{len(found)} placements explain the ranges", None
        said[u] = Verdict(state, reason, direction, dominated)
    return said


def _state(best: Placement, user: int, static: bool, corners: Array, model: Model) -> tuple[State, str, Array | None]:
    """Registered if its place, anywhere on its walk, and its heading are known well enough; else what is seen least.

    An error beyond the limit has the probability `wrong_share`: in the plane at most exp(-limit^2 / (2 sigma^2)), sigma
    the longer axis of the ellipse; in height and heading by the normal distribution's quantile.
    """
    covariance, yaw = best.covariances[user], best.frames[user, 3]
    level, level_error = _largest_spread(covariance, yaw, corners, [0, 1])
    height, height_error = _largest_spread(covariance, yaw, corners, [2])
    heading = 0.0 if static else float(np.sqrt(covariance[3, 3]))
    in_plane = np.sqrt(-2.0 * np.log(model.wrong_share))
    in_line = NormalDist().inv_cdf(1.0 - model.wrong_share / 2.0)
    if in_line * heading > model.largest_yaw_error:
        direction = covariance[3] / np.linalg.norm(covariance[3])
        return State.UNOBSERVABLE, f"its heading is known to {heading:.2f} rad only (1 sigma)", direction
    if in_plane * level > model.largest_error:
        where = np.degrees(np.arctan2(level_error[1], level_error[0])) % 180.0
        reason = f"its place along {where:.0f} deg is known to {level:.2f} m only (1 sigma)"
        return State.UNOBSERVABLE, reason, level_error
    if in_line * height > model.largest_error:
        return State.UNOBSERVABLE, f"its height is known to {height:.2f} m only (1 sigma)", height_error
    return State.REGISTERED, f"its place is known to {max(level, height):.2f} m (1 sigma)", None


def moved(frames: Array, others: Array, corners: Array) -> Array:
    """(k,) m: how far two joint placements (k, 4) lie apart for each user, at the corner (k, c, 3) where it is most."""
    return np.asarray(np.linalg.norm(_places(frames, corners) - _places(others, corners), axis=2).max(axis=1))


def _places(frames: Array, corners: Array) -> Array:
    x, y, z, yaw = (column[:, None] for column in frames.T)
    c, s = np.cos(yaw), np.sin(yaw)
    px, py, pz = np.moveaxis(corners, 2, 0)
    return np.stack([x + c * px - s * py, y + s * px + c * py, z + pz], axis=2)


def _largest_spread(covariance: Array, yaw: float, corners: Array, axes: list[int]) -> tuple[float, Array]:
    """The largest 1 sigma (m) of the place of any corner (c, 3) in these axes of the common frame.

    And the unit error of (x, y, z, yaw) that goes with it.
    """
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = c * corners[:, 0] - s * corners[:, 1], s * corners[:, 0] + c * corners[:, 1]
    jacobians = np.zeros((len(corners), 3, 4))
    jacobians[:, :3, :3] = np.eye(3)
    jacobians[:, 0, 3], jacobians[:, 1, 3] = -y, x
    jacobians = jacobians[:, axes]
    variances, directions = np.linalg.eigh(jacobians @ covariance @ jacobians.transpose(0, 2, 1))
    worst = int(np.argmax(variances[:, -1]))
    error = covariance @ jacobians[worst].T @ directions[worst, :, -1]
    return float(np.sqrt(max(variances[worst, -1], 0.0))), error / max(float(np.linalg.norm(error)), 1e-300)
