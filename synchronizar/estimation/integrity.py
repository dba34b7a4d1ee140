"""Integrity: whether each user is registered, ambiguous or unobservable, by the probability of a wrong frame."""

from __future__ import annotations

from collections.abc import Collection
from statistics import NormalDist
from typing import NamedTuple, Protocol

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.registration import State
from synchronizar.data.user import User
from synchronizar.estimation.hypotheses import Hypothesis, moved, places
from synchronizar.geometry import wrap_angle
from synchronizar.parameters import Parameters

_NAMES = ("x", "y", "z", "yaw")
_Z = 2
_LEAST = 1e-9  # m and rad: lower bound of a sigma that is divided by
_DIRECTIONS = 32  # in a quarter turn


class GraphUsers(Protocol):
    """The users of a graph and their priors."""

    @property
    def users(self) -> tuple[User, ...]:
        """All k users."""

    @property
    def reference(self) -> int:
        """The user whose frame is the common one."""

    @property
    def free(self) -> list[int]:
        """The users whose frames are unknown."""

    def prior_variances(self, user: int) -> Array:
        """(4,) prior variances of x, y, z (m^2) and yaw (rad^2) relative to the reference."""


class Verdict(NamedTuple):
    """State of one user's registration, with the reason."""

    state: State
    reason: str
    unseen_direction: Array | None = None
    """(4,) unit vector in x, y, z (m, common axes), yaw (rad) of the largest uncertainty, where that is the reason."""
    prior_dominated: tuple[str, ...] = ()
    """Which of x, y, z, yaw have a posterior variance above half the prior's."""


def verdicts(
    found: list[Hypothesis],
    rejected: Array,
    systematic: Collection[int],
    graph: GraphUsers,
    extent: Array,
    parameters: Parameters,
    registered: Collection[int] = (),
) -> list[Verdict | None]:
    """The verdict on each active user, None for the others.

    `found` are the hypotheses, best first, `rejected` (k,) the share of each user's ranges that do not fit,
    `systematic` users whose residuals are no noise, `extent` (k, c, 3) m the extent points of each user's track in its
    own frame. Users that are `registered` already stay so up to a higher probability of being wrong.
    """
    best = found[0]
    apart, in_plane = np.zeros(len(graph.users)), np.zeros(len(graph.users))
    for other in found[1:]:
        apart = np.fmax(apart, moved(best.frames, other.frames, extent))
        level = np.where(np.arange(4) == _Z, best.frames, other.frames)
        in_plane = np.fmax(in_plane, moved(best.frames, level, extent))
    out: list[Verdict | None] = [None] * len(graph.users)
    out[graph.reference] = Verdict(State.REGISTERED, "the reference: its frame is the common one")
    for u in graph.free:
        prior = graph.prior_variances(u)
        dominated = tuple(
            name
            for name, own, of in zip(_NAMES, np.diag(best.covariances[u]), prior, strict=True)
            if own > 0.5 * of and not (name == "yaw" and graph.users[u].static)
        )
        wrong_share = parameters.integrity.wrong_share_kept if u in registered else parameters.integrity.wrong_share
        state, reason, direction = _state(best, u, graph.users[u].static, extent[u], wrong_share, parameters)
        if rejected[u] > (0.5 if u in systematic else parameters.integrity.largest_rejected):
            reason = f"{rejected[u]:.0%} of its ranges do not fit: its track or a radio is not what it is taken for"
            state = State.UNOBSERVABLE
        if apart[u] > parameters.integrity.largest_error and state is State.REGISTERED:
            state, reason, direction = State.AMBIGUOUS, f"{len(found)} joint placements explain the ranges", None
            if in_plane[u] <= parameters.integrity.largest_error:
                reason += ", apart in height: set height_sigma, if its height is known better"
        out[u] = Verdict(state, reason, direction, dominated)
    return out


def nearness(best: Hypothesis, user: int, static: bool, extent: Array, parameters: Parameters) -> float:
    """The factor by which a user's sigmas may grow until it is no longer registered; below 1 it is not registered."""
    normal = NormalDist()
    in_plane = parameters.integrity.largest_error / np.sqrt(-2.0 * np.log(parameters.integrity.wrong_share))
    in_line = normal.inv_cdf(1.0 - 0.5 * parameters.integrity.wrong_share)
    covariance, yaw = best.covariances[user], best.frames[user, 3]
    plane, _ = _spread_in_plane(covariance, yaw, extent)
    height = float(np.sqrt(max(covariance[2, 2], 0.0)))
    ratios = [in_plane / max(plane, _LEAST), parameters.integrity.largest_error / in_line / max(height, _LEAST)]
    if not static:
        ratios.append(parameters.integrity.largest_yaw_error / in_line / max(float(np.sqrt(covariance[3, 3])), _LEAST))
    return float(min(ratios))


def _state(
    best: Hypothesis, user: int, static: bool, extent: Array, wrong_share: float, parameters: Parameters
) -> tuple[State, str, Array | None]:
    """State, reason and least observable direction (4,) of a user.

    Registered where errors beyond the limits, in position anywhere on the user's track or in yaw, are improbable.
    """
    in_plane, in_height, in_heading = _wrong_probabilities(best, user, extent, parameters)
    covariance, yaw = best.covariances[user], best.frames[user, 3]
    plane, plane_error = _spread_in_plane(covariance, yaw, extent)
    height = float(np.sqrt(max(covariance[2, 2], 0.0)))
    if not static and in_heading > wrong_share:
        direction = covariance[3] / np.linalg.norm(covariance[3])
        heading = np.sqrt(covariance[3, 3])
        return State.UNOBSERVABLE, f"its heading is known to {np.degrees(heading):.0f} deg only (1 sigma)", direction
    if in_plane > wrong_share:
        where = np.degrees(np.arctan2(plane_error[1], plane_error[0])) % 180.0
        reason = f"its place along {where:.0f} deg is known to {plane:.2f} m only (1 sigma)"
        return State.UNOBSERVABLE, reason, plane_error
    if in_height > wrong_share:
        direction = covariance[2] / np.linalg.norm(covariance[2])
        return State.UNOBSERVABLE, f"its height is known to {height:.2f} m only (1 sigma)", direction
    return State.REGISTERED, f"its place is known to {max(plane, height):.2f} m (1 sigma)", None


def _wrong_probabilities(
    best: Hypothesis, user: int, extent: Array, parameters: Parameters
) -> tuple[float, float, float]:
    """Probabilities that a user's error is beyond the limit in the plane, in height, in yaw, over the mixture.

    For a component at distance d from the mean, the probability of an error in the plane beyond the limit is bounded by
    that of an error beyond limit - d about the component.
    """
    limit = parameters.integrity.largest_error
    own = extent[None]
    mean_points = places(best.frames[[user]], own)
    plane = height = heading = 0.0
    for component in best.components_of(user):
        frames, covariance = component.frames[[user]], component.covariances[user]
        off = (places(frames, own) - mean_points)[0]
        margin = max(limit - float(np.hypot(off[:, 0], off[:, 1]).max()), 0.0)
        plane += component.weight * _beyond_in_plane(margin, *_axes(covariance, frames[0, 3], extent))
        sigma = float(np.sqrt(max(covariance[2, 2], 0.0)))
        height += component.weight * _beyond(limit, off[0, 2], sigma)
        yaw_error = wrap_angle(float(frames[0, 3] - best.frames[user, 3]))
        heading += component.weight * _beyond(
            parameters.integrity.largest_yaw_error, yaw_error, float(np.sqrt(covariance[3, 3]))
        )
    return plane, height, heading


def _beyond(limit: float, mean: float, sigma: float) -> float:
    """P(|x| > limit) of a normal x with this mean and 1 sigma."""
    normal = NormalDist(mean, max(sigma, _LEAST))
    return 1.0 - normal.cdf(limit) + normal.cdf(-limit)


def _beyond_in_plane(limit: float, long: float, short: float) -> float:
    """P(|e| > limit) of a zero-mean normal e in the plane with 1 sigma `long` and `short` along its axes.

    In polar coordinates of the whitened plane it is the mean over the angle of
    exp(-limit^2 / (2 (long^2 cos^2 + short^2 sin^2))).
    """
    phi = (np.arange(_DIRECTIONS) + 0.5) * (0.5 * np.pi / _DIRECTIONS)
    variance = (long * np.cos(phi)) ** 2 + (short * np.sin(phi)) ** 2
    return float(np.exp(-0.5 * limit**2 / np.maximum(variance, _LEAST**2)).mean())


def _axes(covariance: Array, yaw: float, extent: Array) -> tuple[float, float]:
    """1 sigma (m), long and short axis, of the horizontal error ellipse of the extent point with the longest axis."""
    jacobians = _extent_jacobians(yaw, extent)
    variances = np.linalg.eigvalsh(jacobians @ covariance @ jacobians.transpose(0, 2, 1))
    short, long = np.sqrt(np.maximum(variances[np.argmax(variances[:, 1])], 0.0)).tolist()
    return long, short


def _extent_jacobians(yaw: float, extent: Array) -> Array:
    """(c, 2, 4) derivatives of the extent points' x and y in the common frame by x, y, z, yaw of the user's frame."""
    c, s = np.cos(yaw), np.sin(yaw)
    jacobians = np.zeros((len(extent), 2, 4))
    jacobians[:, 0, 0] = jacobians[:, 1, 1] = 1.0
    jacobians[:, 0, 3] = -s * extent[:, 0] - c * extent[:, 1]
    jacobians[:, 1, 3] = c * extent[:, 0] - s * extent[:, 1]
    return jacobians


def _spread_in_plane(covariance: Array, yaw: float, extent: Array) -> tuple[float, Array]:
    """The largest horizontal 1 sigma (m) of any extent point (c, 3).

    And the unit vector (4,) of errors in x, y, z, yaw that go with it.
    """
    jacobians = _extent_jacobians(yaw, extent)
    variances, directions = np.linalg.eigh(jacobians @ covariance @ jacobians.transpose(0, 2, 1))
    worst = int(np.argmax(variances[:, -1]))
    error = covariance @ jacobians[worst].T @ directions[worst, :, -1]
    return float(np.sqrt(max(variances[worst, -1], 0.0))), error / max(float(np.linalg.norm(error)), 1e-300)
