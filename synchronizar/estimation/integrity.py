"""Integrity: whether each user is registered, ambiguous or unobservable, by the probability of a wrong frame."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from statistics import NormalDist
from types import MappingProxyType
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from synchronizar.arrays import Array
from synchronizar.data.registration import State
from synchronizar.data.user import User
from synchronizar.estimation.hypotheses import Hypothesis, moved
from synchronizar.geometry import apply_frames, wrap_angle
from synchronizar.parameters import Parameters

_NAMES = ("x", "y", "z", "yaw")
_Z = 2
_LEAST = 1e-9  # m and rad: lower bound of a sigma that is divided by
_DIRECTIONS = (np.arange(32) + 0.5) * (0.5 * np.pi / 32)  # rad, evenly in a quarter turn
_COSINES_2, _SINES_2 = np.cos(_DIRECTIONS) ** 2, np.sin(_DIRECTIONS) ** 2


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


class Evidence(NamedTuple):
    """What tells of k users besides the hypotheses of where they are."""

    rejected: Array
    """(k,) the share of each user's ranges that do not fit."""
    extent: Array
    """(k, c, 3) m, the extent points of each user's track in its own frame."""
    systematic: Collection[int] = ()
    """Users whose residuals are no noise."""
    registered: Collection[int] = ()
    """Users who are registered already: they stay so up to a higher probability of being wrong."""
    contradicted: Mapping[int, str] = MappingProxyType({})
    """Users who are not where they seem, with the reason."""
    whole: bool = False
    """Whether all has come, and nothing more will tell heights."""


class _Others(NamedTuple):
    """How far other hypotheses than the best one have k users from where that has them."""

    apart: Array
    """(k,) m: at most, of those that differ in the plane or in yaw."""
    in_plane: Array
    """(k,) m: at most, but for heights, of all."""
    at_all: Array
    """(k,) m: at most, of all."""
    wrong_height: Array
    """(k,) share of those that differ by more than the largest error, and in height alone."""


def verdicts(
    found: list[Hypothesis], evidence: Evidence, graph: GraphUsers, parameters: Parameters
) -> list[Verdict | None]:
    """The verdict on each active user, None for the others; `found` are the hypotheses, best first."""
    others = _others(found, evidence.extent, parameters.integrity.largest_error)
    out: list[Verdict | None] = [None] * len(graph.users)
    out[graph.reference] = Verdict(State.REGISTERED, "the reference: its frame is the common one")
    if graph.reference in evidence.contradicted:
        out[graph.reference] = Verdict(State.UNOBSERVABLE, evidence.contradicted[graph.reference])
    for u in graph.free:
        out[u] = _verdict(u, found, others, evidence, graph, parameters)
    return out


def _others(found: list[Hypothesis], extent: Array, largest_error: float) -> _Others:
    best, k = found[0], len(extent)
    apart, in_plane, at_all, wrong_height = np.zeros((4, k))
    # Evidence tells heights apart; what may be mirror images of straight walks is not told by it, however unlikely.
    share = np.exp([best.cost - hypothesis.cost for hypothesis in found])
    share /= share.sum()
    for of_other, other in zip(share[1:].tolist(), found[1:], strict=True):
        off = moved(best.frames, other.frames, extent)
        level = np.where(np.arange(4) == _Z, best.frames, other.frames)
        off_plane = moved(best.frames, level, extent)
        in_height = off_plane <= largest_error
        apart, in_plane = np.fmax(apart, np.where(in_height, 0.0, off)), np.fmax(in_plane, off_plane)
        at_all = np.fmax(at_all, off)
        wrong_height += np.where(in_height & (off > largest_error), of_other, 0.0)
    return _Others(apart, in_plane, at_all, wrong_height)


def _verdict(
    user: int,
    found: list[Hypothesis],
    others: _Others,
    evidence: Evidence,
    graph: GraphUsers,
    parameters: Parameters,
) -> Verdict:
    """The verdict on a user that is free."""
    m, best, static = parameters.integrity, found[0], graph.users[user].static
    dominated = tuple(
        name
        for name, own, of in zip(_NAMES, np.diag(best.covariances[user]), graph.prior_variances(user), strict=True)
        if own > 0.5 * of and not (name == "yaw" and static)
    )
    wrong_share = m.wrong_share_kept if user in evidence.registered else m.wrong_share
    limits = wrong_share, max(wrong_share, m.wrong_height_share) if evidence.whole else wrong_share
    apart, higher = float(others.apart[user]), float(others.wrong_height[user])
    if higher > limits[1]:  # other heights are as good as other places
        apart, higher = max(apart, float(others.at_all[user])), 0.0
    state, reason, direction = _state(best, user, static, evidence.extent[user], limits, higher, parameters)
    rejected = float(evidence.rejected[user])
    if rejected > (0.5 if user in evidence.systematic else m.largest_rejected):
        reason = f"{rejected:.0%} of its ranges do not fit: its track or a radio is not what it is taken for"
        state = State.UNOBSERVABLE
    if apart > m.largest_error and state is State.REGISTERED:
        state, reason, direction = State.AMBIGUOUS, f"{len(found)} joint placements explain the ranges", None
        if others.in_plane[user] <= m.largest_error:
            reason += ", apart in height: set height_sigma, if its height is known better"
    if user in evidence.contradicted and state is State.REGISTERED:
        state, reason = State.UNOBSERVABLE, evidence.contradicted[user]
    elif graph.reference in evidence.contradicted and state is State.REGISTERED:
        state, reason = State.UNOBSERVABLE, "the reference's own track is contradicted"
    return Verdict(state, reason, direction, dominated)


def nearness(best: Hypothesis, user: int, static: bool, extent: Array, parameters: Parameters) -> float:
    """The factor by which a user's sigmas may grow until it is no longer registered; below 1 it is not registered."""
    yaw = float(best.frames[user, 3])
    return float(nearness_of(best.covariances[user][None], yaw, static, extent, parameters)[0])


def nearness_of(covariances: Array, yaw: float, static: bool, extent: Array, parameters: Parameters) -> Array:
    """(m,) the same of a user at `yaw` (rad), were these its covariances (m, 4, 4)."""
    m, normal = parameters.integrity, NormalDist()
    in_plane = m.largest_error / np.sqrt(-2.0 * np.log(m.wrong_share))
    in_line = normal.inv_cdf(1.0 - 0.5 * m.wrong_share)
    plane, _ = _axes(covariances, np.full(len(covariances), yaw), extent)
    height, heading = np.sqrt(np.maximum(covariances[:, [2, 3], [2, 3]], 0.0)).T
    ratios = [in_plane / np.maximum(plane, _LEAST), m.largest_error / in_line / np.maximum(height, _LEAST)]
    if not static:
        ratios.append(m.largest_yaw_error / in_line / np.maximum(heading, _LEAST))
    return np.asarray(np.min(ratios, axis=0))


def _state(
    best: Hypothesis,
    user: int,
    static: bool,
    extent: Array,
    limits: tuple[float, float],
    higher: float,
    parameters: Parameters,
) -> tuple[State, str, Array | None]:
    """State, reason and least observable direction (4,) of a user.

    Registered where errors beyond the limits, in position anywhere on the user's track or in yaw, are improbable:
    `limits` in the plane or yaw, and in height, where it has the probability `higher` by other hypotheses.
    """
    wrong_share, wrong_height_share = limits
    in_plane, in_height, in_heading = _wrong_probabilities(best, user, extent, parameters)
    covariance, yaw = best.covariances[user], best.frames[user, 3]
    plane = _sigma_in_plane(covariance, yaw, extent)
    height = float(np.sqrt(max(covariance[2, 2], 0.0)))
    if not static and in_heading > wrong_share:
        direction = covariance[3] / np.linalg.norm(covariance[3])
        heading = np.sqrt(covariance[3, 3])
        return State.UNOBSERVABLE, f"its heading is known to {np.degrees(heading):.0f} deg only (1 sigma)", direction
    if in_plane > wrong_share:
        error = _worst_in_plane(covariance, yaw, extent)
        where = np.degrees(np.arctan2(error[1], error[0])) % 180.0
        reason = f"its place along {where:.0f} deg is known to {plane:.2f} m only (1 sigma)"
        return State.UNOBSERVABLE, reason, error
    if in_height + higher > wrong_height_share:
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
    components = best.components_of(user)
    weight = np.array([component.weight for component in components])
    frames = np.array([component.frames[user] for component in components])
    covariances = np.array([component.covariances[user] for component in components])
    off = apply_frames(frames[:, None], extent) - apply_frames(best.frames[user], extent)
    margins = np.maximum(limit - np.hypot(off[..., 0], off[..., 1]).max(axis=1), 0.0)
    plane = float(weight @ _beyond_in_plane(margins, *_axes(covariances, frames[:, 3], extent)))
    height = heading = 0.0
    yaw_errors = wrap_angle(frames[:, 3] - best.frames[user, 3])
    sigmas = np.sqrt(np.maximum(covariances[:, [2, 3], [2, 3]], 0.0)).tolist()
    for share, z, yaw, (z_sigma, yaw_sigma) in zip(
        weight.tolist(), off[:, 0, 2].tolist(), yaw_errors.tolist(), sigmas, strict=True
    ):
        height += share * _beyond(limit, z, z_sigma)
        heading += share * _beyond(parameters.integrity.largest_yaw_error, yaw, yaw_sigma)
    return plane, height, heading


def _beyond(limit: float, mean: float, sigma: float) -> float:
    """P(|x| > limit) of a normal x with this mean and 1 sigma."""
    normal = NormalDist(mean, max(sigma, _LEAST))
    return 1.0 - normal.cdf(limit) + normal.cdf(-limit)


def _beyond_in_plane(limit: ArrayLike, long: ArrayLike, short: ArrayLike) -> Array:
    """(...) P(|e| > limit) of zero-mean normals e in the plane with 1 sigma `long` and `short` along their axes.

    In polar coordinates of the whitened plane it is the mean over the angle of
    exp(-limit^2 / (2 (long^2 cos^2 + short^2 sin^2))).
    """
    variance = np.multiply.outer(np.square(long), _COSINES_2)
    variance += np.multiply.outer(np.square(short), _SINES_2)
    squares = np.square(limit)[..., None]
    return np.asarray(np.exp(-0.5 * squares / np.maximum(variance, _LEAST**2)).mean(axis=-1))


def _axes(covariances: Array, yaw: Array, extent: Array) -> tuple[Array, Array]:
    """(m,) 1 sigma (m), long and short axis, of the horizontal error ellipse of the extent point with the longest axis.

    `covariances` (m, 4, 4) and `yaw` (m,) of the user's frame.
    """
    jacobians = _extent_jacobians(yaw, extent)
    variances = jacobians @ covariances[:, None] @ jacobians.swapaxes(-1, -2)
    xx, xy, yy = variances[..., 0, 0], variances[..., 0, 1], variances[..., 1, 1]
    middle, radius = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    each = np.arange(len(yaw)), np.argmax(middle + radius, axis=1)
    long, short = middle[each] + radius[each], middle[each] - radius[each]
    return np.sqrt(np.maximum(long, 0.0)), np.sqrt(np.maximum(short, 0.0))


def _extent_jacobians(yaw: Array, extent: Array) -> Array:
    """(m, c, 2, 4) derivatives of the extent points' x and y in the common frame by x, y, z, yaw of frames at `yaw`."""
    c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    jacobians = np.zeros((len(yaw), len(extent), 2, 4))
    jacobians[..., 0, 0] = jacobians[..., 1, 1] = 1.0
    jacobians[..., 0, 3] = -s * extent[:, 0] - c * extent[:, 1]
    jacobians[..., 1, 3] = c * extent[:, 0] - s * extent[:, 1]
    return jacobians


def _sigma_in_plane(covariance: Array, yaw: float, extent: Array) -> float:
    """The largest horizontal 1 sigma (m) of any extent point (c, 3)."""
    long, _ = _axes(covariance[None], np.array([yaw]), extent)
    return float(long[0])


def _worst_in_plane(covariance: Array, yaw: float, extent: Array) -> Array:
    """The unit vector (4,) of errors in x, y, z, yaw that go with it."""
    jacobians = _extent_jacobians(np.array([yaw]), extent)[0]
    variances, directions = np.linalg.eigh(jacobians @ covariance @ jacobians.transpose(0, 2, 1))
    worst = int(np.argmax(variances[:, -1]))
    error = covariance @ jacobians[worst].T @ directions[worst, :, -1]
    return np.asarray(error / max(float(np.linalg.norm(error)), 1e-300))
