"""What can be said of each user's placement, and how sure it is."""

from __future__ import annotations

from collections.abc import Collection
from statistics import NormalDist
from typing import NamedTuple, Protocol

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.registration import State
from synchronizar.data.user import User
from synchronizar.estimation.hypotheses import Hypothesis, moved, places
from synchronizar.estimation.residual_statistics import ResidualStatistics
from synchronizar.geometry import wrap_angle
from synchronizar.parameters import Parameters

_NAMES = ("x", "y", "z", "yaw")
_LEAST = 1e-9  # m and rad: a sigma that is none
_DIRECTIONS = 32  # of a quarter turn


class Placed(Protocol):
    """What a graph tells of its users: RigidGraph and AnchoredGraph both do."""

    users: tuple[User, ...]
    reference: int
    free: list[int]

    def prior_variances(self, user: int) -> Array:
        """(4,) of x, y, z (m^2) and yaw (rad^2), relative to the reference, before any range."""


class Verdict(NamedTuple):
    """One user's."""

    state: State
    reason: str
    unseen_direction: Array | None = None
    prior_dominated: tuple[str, ...] = ()


def verdicts(
    found: list[Hypothesis],
    fit: dict[int, ResidualStatistics],
    graph: Placed,
    extent: Array,
    parameters: Parameters,
    registered: Collection[int] = (),
) -> list[Verdict | None]:
    """The verdict on each user that is placed; of users that are `registered` already, whether they still are."""
    best = found[0]
    away = np.zeros(len(graph.users))
    for other in found[1:]:
        away = np.fmax(away, moved(best.frames, other.frames, extent))
    said: list[Verdict | None] = [None] * len(graph.users)
    said[graph.reference] = Verdict(State.REGISTERED, "the reference: its frame is the common one")
    for u in graph.free:
        prior = graph.prior_variances(u)
        dominated = tuple(
            name
            for name, own, of in zip(_NAMES, np.diag(best.covariances[u]), prior, strict=True)
            if own > 0.5 * of and not (name == "yaw" and graph.users[u].static)
        )
        wrong_share = parameters.integrity.wrong_share_kept if u in registered else parameters.integrity.wrong_share
        state, reason, direction = _state(best, u, graph.users[u].static, extent[u], wrong_share, parameters)
        doubted = fit[u].rejected > 0.5 and fit[u].inflation > parameters.integrity.systematic_inflation
        if doubted or fit[u].rejected > parameters.integrity.largest_rejected:
            reason = f"{fit[u].rejected:.0%} of its ranges do not fit: its track or a radio is not what it is taken for"
            state = State.UNOBSERVABLE
        if away[u] > parameters.integrity.largest_error and state is State.REGISTERED:
            state, reason, direction = State.AMBIGUOUS, f"{len(found)} joint placements explain the ranges", None
        said[u] = Verdict(state, reason, direction, dominated)
    return said


def nearness(best: Hypothesis, user: int, static: bool, extent: Array, parameters: Parameters) -> float:
    """How many times its sigmas could grow before a user were not registered; below 1 it is not."""
    normal = NormalDist()
    in_plane = parameters.integrity.largest_error / np.sqrt(-2.0 * np.log(parameters.integrity.wrong_share))
    in_line = normal.inv_cdf(1.0 - 0.5 * parameters.integrity.wrong_share)
    covariance, yaw = best.covariances[user], best.frames[user, 3]
    level, _ = _largest_spread(covariance, yaw, extent, [0, 1])
    height, _ = _largest_spread(covariance, yaw, extent, [2])
    ratios = [in_plane / max(level, _LEAST), parameters.integrity.largest_error / in_line / max(height, _LEAST)]
    if not static:
        ratios.append(parameters.integrity.largest_yaw_error / in_line / max(float(np.sqrt(covariance[3, 3])), _LEAST))
    return float(min(ratios))


def _state(
    best: Hypothesis, user: int, static: bool, extent: Array, wrong_share: float, parameters: Parameters
) -> tuple[State, str, Array | None]:
    """Registered if an error in place, anywhere on its walk, or heading beyond the limits is improbable.

    If not: what is seen least.
    """
    in_plane, in_height, in_heading = _wrong(best, user, extent, parameters)
    covariance, yaw = best.covariances[user], best.frames[user, 3]
    level, level_error = _largest_spread(covariance, yaw, extent, [0, 1])
    height, height_error = _largest_spread(covariance, yaw, extent, [2])
    if not static and in_heading > wrong_share:
        direction = covariance[3] / np.linalg.norm(covariance[3])
        heading = np.sqrt(covariance[3, 3])
        return State.UNOBSERVABLE, f"its heading is known to {heading:.2f} rad only (1 sigma)", direction
    if in_plane > wrong_share:
        where = np.degrees(np.arctan2(level_error[1], level_error[0])) % 180.0
        reason = f"its place along {where:.0f} deg is known to {level:.2f} m only (1 sigma)"
        return State.UNOBSERVABLE, reason, level_error
    if in_height > wrong_share:
        return State.UNOBSERVABLE, f"its height is known to {height:.2f} m only (1 sigma)", height_error
    return State.REGISTERED, f"its place is known to {max(level, height):.2f} m (1 sigma)", None


def _wrong(best: Hypothesis, user: int, extent: Array, parameters: Parameters) -> tuple[float, float, float]:
    """The probability, by the mixture of its minima, that a user is wrong in the plane, in height, in heading.

    Of a minimum at distance d from the placement, an error in the plane beyond the limit has at most the probability of
    one beyond limit - d.
    """
    limit = parameters.integrity.largest_error
    own = extent[None]
    here = places(best.frames[[user]], own)
    plane = height = heading = 0.0
    for minimum in best.components_of(user):
        frames, covariance = minimum.frames[[user]], minimum.covariances[user]
        off = (places(frames, own) - here)[0]
        away = max(limit - float(np.hypot(off[:, 0], off[:, 1]).max()), 0.0)
        plane += minimum.weight * _beyond_in_plane(away, *_axes(covariance, frames[0, 3], extent))
        sigma, _ = _largest_spread(covariance, frames[0, 3], extent, [2])
        height += minimum.weight * _beyond(limit, off[0, 2], sigma)
        turned = wrap_angle(float(frames[0, 3] - best.frames[user, 3]))
        heading += minimum.weight * _beyond(
            parameters.integrity.largest_yaw_error, turned, float(np.sqrt(covariance[3, 3]))
        )
    return plane, height, heading


def _beyond(limit: float, mean: float, sigma: float) -> float:
    """P(|x| > limit) of a normal x."""
    normal = NormalDist(mean, max(sigma, _LEAST))
    return 1.0 - normal.cdf(limit) + normal.cdf(-limit)


def _beyond_in_plane(limit: float, long: float, short: float) -> float:
    """P(|e| > limit) of a normal e in the plane with these 1 sigma along its axes.

    The mean over all directions of e of that of a normal in one direction, in polar coordinates of the whitened plane:
    exp(-limit^2 / (2 (long^2 cos^2 + short^2 sin^2))).
    """
    phi = (np.arange(_DIRECTIONS) + 0.5) * (0.5 * np.pi / _DIRECTIONS)
    variance = (long * np.cos(phi)) ** 2 + (short * np.sin(phi)) ** 2
    return float(np.exp(-0.5 * limit**2 / np.maximum(variance, _LEAST**2)).mean())


def _axes(covariance: Array, yaw: float, extent: Array) -> tuple[float, float]:
    """1 sigma (m) along both axes of the ellipse in the plane of the corner where the long one is longest."""
    jacobians = _by_frame(yaw, extent)[:, :2]
    variances = np.linalg.eigvalsh(jacobians @ covariance @ jacobians.transpose(0, 2, 1))
    short, long = np.sqrt(np.maximum(variances[np.argmax(variances[:, 1])], 0.0)).tolist()
    return long, short


def _by_frame(yaw: float, extent: Array) -> Array:
    """(c, 3, 4) derivatives of where corners (c, 3) lie by x, y, z, yaw of the frame."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = c * extent[:, 0] - s * extent[:, 1], s * extent[:, 0] + c * extent[:, 1]
    jacobians = np.zeros((len(extent), 3, 4))
    jacobians[:, :3, :3] = np.eye(3)
    jacobians[:, 0, 3], jacobians[:, 1, 3] = -y, x
    return jacobians


def _largest_spread(covariance: Array, yaw: float, extent: Array, axes: list[int]) -> tuple[float, Array]:
    """The largest 1 sigma (m) of the place of any corner (c, 3) in these axes of the common frame.

    And the unit error of (x, y, z, yaw) that goes with it.
    """
    jacobians = _by_frame(yaw, extent)[:, axes]
    variances, directions = np.linalg.eigh(jacobians @ covariance @ jacobians.transpose(0, 2, 1))
    worst = int(np.argmax(variances[:, -1]))
    error = covariance @ jacobians[worst].T @ directions[worst, :, -1]
    return float(np.sqrt(max(variances[worst, -1], 0.0))), error / max(float(np.linalg.norm(error)), 1e-300)
