"""Marginal covariances of the states of a pose graph, by Laplace's method."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.cooperative import Cooperative, finish
from synchronizar.geometry import relative_to, rotation_2d
from synchronizar.graph import keys
from synchronizar.graph.marginal_prior import MarginalPrior
from synchronizar.graph.optimization import reduced
from synchronizar.graph.pose_graph import EmWeights, PoseGraph
from synchronizar.graph.states import SCALE, States
from synchronizar.preprocessing.range_measurements import mean_by_pair, pair_bounds


class Marginals(NamedTuple):
    """Marginal covariances of the last keyframes and calibrations; NaN for users that are not active."""

    poses: Array
    """(k, 6, 6) of additive errors in x, y, z (m, common axes) and yaw (rad) of each user's last keyframe, in its log
    scale and in the reference's log scale."""
    relative: Array
    """(k, 4, 4) of x, y, z (m, common axes) and yaw (rad) relative to the reference's last keyframe."""
    joint: Array
    """(k, 6, k, 6) joint covariance of all users: `poses` on its diagonal, cross-covariances off it."""
    calibrations: Array
    """(k, 3) variances of log scale, bias (m^2) and clock (s^2); NaN where they are no variables."""


class Errors(NamedTuple):
    """Square roots of the joint covariance, by user: the effect of d independent errors of unit variance."""

    poses: dict[int, Array]
    """(5, d) on x, y, z (m), yaw (rad) of the last keyframe, and on log scale."""
    calibrations: dict[int, Array]
    """(3, d) on log scale, bias (m) and clock offset (s), where they are variables."""


def marginals(graph: PoseGraph, states: States, em_weights: EmWeights) -> Marginals:
    """The marginals at the states, which are to be a local optimum."""
    return marginals_of(graph, states, finish(errors_of(graph, states, em_weights)))


def marginals_of(graph: PoseGraph, states: States, sources: Errors) -> Marginals:
    """The marginals from the square roots that `errors_of` returns."""
    k = len(graph.users)
    relative, calibrations = np.full((k, 4, 4), np.nan), np.full((k, 3), np.nan)
    errors, of_calibrations = sources
    now, reference = graph.last_poses(states), graph.reference
    of_poses = np.full((k, 6, errors[reference].shape[1]), np.nan)
    for u in graph.active_users:
        of_poses[u] = np.vstack([errors[u], errors[reference][4]])
        relative_error = _relative_errors(now[reference], errors[reference][:4], now[u], errors[u][:4])
        relative[u] = relative_error @ relative_error.T
    for u in graph.calibrations:
        calibrations[u] = (of_calibrations[u] ** 2).sum(axis=1)
    joint = np.tensordot(of_poses, of_poses, axes=(2, 2))
    return Marginals(joint[np.arange(k), :, np.arange(k)], relative, joint, calibrations)


def marginalized(graph: PoseGraph, states: States, sources: Errors, own_height: Array) -> MarginalPrior:
    """The marginal prior of a graph that begins at the last keyframes; relative to the reference's last keyframe.

    `own_height` (k,) SLAM units: height of each last keyframe in its user's own frame, as it was before any jump.
    """
    errors, of_calibrations = sources
    now, reference = graph.last_poses(states), graph.reference
    above = np.exp(states.calibration[:, SCALE]) * own_height
    to_reference = rotation_2d(-float(now[reference, 3]))
    rows = []
    for u in graph.free:
        relative_error = _relative_errors(now[reference], errors[reference][:4], now[u], errors[u][:4])
        height = relative_error[2] - above[u] * errors[u][4] + above[reference] * errors[reference][4]
        rows += [*(to_reference @ relative_error[:2]), relative_error[3], height]
    rows += [row for u in graph.active_users for row in of_calibrations[u]]
    root = np.array(rows)
    frames = relative_to(now, reference)
    frames[:, 2] += above[reference] - above
    return MarginalPrior(list(graph.active_users), reference, frames, states.calibration.copy(), root @ root.T)


def errors_of(graph: PoseGraph, states: States, em_weights: EmWeights) -> Cooperative[Errors]:
    """Square roots of the joint covariance at the states, as a cooperative task.

    Laplace's method: the covariance is the inverse of the cost's second derivatives.
    """
    if graph.marginal_prior is not None:
        return (yield from _errors_in_frames(graph, states, em_weights))
    yield
    walks, calibrated = graph.walks, bool(graph.calibrations)
    k, first, last = len(walks.users), walks.first[:-1], walks.first[1:] - 1
    wanted, at = np.unique(np.concatenate([first, last]), return_inverse=True)
    height_curvature = graph.height_curvature(states, em_weights)
    covariance = walks.solver.covariance(
        walks.places(states),
        states.calibration[walks.users],
        graph.walk_noise(states.anchor_poses, em_weights),
        graph.loss,
        _mean_curvature(graph, height_curvature),
        wanted,
    )
    size = np.sqrt(np.diag(covariance))
    size[size == 0.0] = 1.0  # of what is fixed
    eigenvalues, axes = np.linalg.eigh(covariance / np.outer(size, size))
    root = size[:, None] * axes * np.sqrt(np.maximum(eigenvalues, 0.0))
    none = np.zeros((3, root.shape[1]))
    of_keyframes = root[: 4 * len(wanted)].reshape(len(wanted), 4, -1)
    of_first, of_last = of_keyframes[at[:k]], of_keyframes[at[k:]]
    of_calibrations = (
        root[4 * len(wanted) :].reshape(k, 3, -1) if calibrated else np.broadcast_to(none, (k, *none.shape))
    )
    # A height of SLAM's grows with scale.
    by_scale = np.exp(states.calibration[walks.users, SCALE]) * walks.slam[first, 2]
    of_scale = of_calibrations[:, SCALE]
    if last[walks.reference] == first[walks.reference]:
        of_last[walks.reference, 2] += by_scale[walks.reference] * of_scale[walks.reference]
    free = [n for n in range(k) if n != walks.reference]
    heights = of_first[free, 2] - by_scale[free, None] * of_scale[free]
    bent = _negative_curvature(graph, height_curvature)
    errors = np.concatenate([of_last, of_scale[:, None]], axis=1)
    straight = _with_negative_curvature(heights, bent)
    return Errors(
        {u: errors[n] @ straight for n, u in enumerate(walks.users)},
        {u: of_calibrations[n] @ straight for n, u in enumerate(walks.users) if calibrated},
    )


def _with_negative_curvature(heights: Array, negative_curvature: Array) -> Array:
    """(d, d): what takes square roots of a covariance to those of it with negative curvature in height.

    `heights` are the square root's rows of the free users' heights. The factors leave out negative curvature in height:
    between two equally good heights the cost is flatter than they say. It is added here; the information in any
    direction falls to no less than a tenth.
    """
    eigenvalues, vectors = np.linalg.eigh(np.eye(heights.shape[1]) + heights.T @ negative_curvature @ heights)
    return np.asarray(vectors / np.sqrt(np.maximum(eigenvalues, 0.1)))


def _errors_in_frames(graph: PoseGraph, states: States, em_weights: EmWeights) -> Cooperative[Errors]:
    """The same by gtsam's factors; where its Cholesky fails, a QR of the whole Jacobian takes its place."""
    last_keys = [
        key
        for u in graph.active_users
        if (last := len(graph.keyframes[u]) - 1) > 0
        for key in (keys.pose(u, last), keys.local_height(u, last))
    ]
    height_curvature = graph.height_curvature(states, em_weights)
    linear = yield from graph.linearizing(states, em_weights, _mean_curvature(graph, height_curvature))
    yield
    others, kept = list(graph.keyframe_keys(set(last_keys))), [*graph.shared_keys(), *last_keys]
    try:
        jacobian = reduced(linear, others, kept)
    except RuntimeError:  # too near to singular for gtsam's Cholesky: the QR below takes all columns
        kept = [*kept, *others]
        jacobian, _ = linear.jacobian(keys.ordering(kept))
    # The system may be nearly singular: columns are normalised, and a QR avoids the normal equations.
    size = np.linalg.norm(jacobian, axis=0)
    root = np.linalg.inv(np.linalg.qr(jacobian / size, mode="r")) / size[:, None]
    rows_of = dict(zip(kept, keys.rows(kept), strict=True))
    heights = root[[rows_of[keys.height(u)].start for u in graph.free]]
    root = root @ _with_negative_curvature(heights, _negative_curvature(graph, height_curvature))
    none = np.zeros((5, root.shape[1]))
    errors = {
        u: sum((by @ root[rows_of[key]] for key, by in _last_pose_jacobians(graph, states, u).items()), none)
        for u in graph.active_users
    }
    return Errors(errors, {u: root[rows_of[keys.calibration(u)]] for u in graph.calibrations})


def _mean_curvature(graph: PoseGraph, height_curvature: Array) -> Array:
    """(n,) 1/m^2: the mean height curvature of each pair's ranges where it is positive, 0 elsewhere."""
    bounds = pair_bounds(graph.measurements)
    return np.repeat(np.maximum(mean_by_pair(height_curvature, bounds), 0.0), np.diff(bounds))


def _negative_curvature(graph: PoseGraph, height_curvature: Array) -> Array:
    """The negative height curvature of pairs as second derivatives (1/m^2) by the free users' heights."""
    bounds, k = pair_bounds(graph.measurements), len(graph.users)
    begin = bounds[:-1]
    negative = np.minimum(mean_by_pair(height_curvature, bounds) * np.diff(bounds), 0.0)
    out, i, j = np.zeros((k, k)), graph.measurements.i[begin], graph.measurements.j[begin]
    for at, value in (((i, i), negative), ((j, j), negative), ((i, j), -negative), ((j, i), -negative)):
        np.add.at(out, at, value)
    return out[np.ix_(graph.free, graph.free)]


def _last_pose_jacobians(graph: PoseGraph, states: States, user: int) -> dict[int, Array]:
    """Jacobians (5, d) of x, y, z, yaw of the last keyframe and of log scale, by each variable that they depend on."""
    x, y, z, chi = states.keyframe_poses[user][-1]
    yaw, scale = states.anchor_poses[user, 3], float(np.exp(states.calibration[user, SCALE]))
    arm = scale * rotation_2d(yaw) @ np.array([x, y])
    out = {}
    if user in graph.calibrations:
        by_calibration = np.zeros((5, 3))
        by_calibration[:3, SCALE] = *arm, scale * z
        by_calibration[4, SCALE] = 1.0
        out[keys.calibration(user)] = by_calibration
    if user != graph.reference:
        by_frame = np.zeros((5, 3))
        by_frame[:2, :2] = rotation_2d(yaw)
        by_frame[:4, 2] = -arm[1], arm[0], 0.0, 1.0
        out[keys.frame(user)] = by_frame
        out[keys.height(user)] = np.eye(5)[:, 2:3]
    last = len(graph.keyframes[user]) - 1
    if last > 0:
        by_pose = np.zeros((5, 3))
        by_pose[:2, :2] = scale * rotation_2d(yaw + chi)
        by_pose[3, 2] = 1.0
        out[keys.pose(user, last)] = by_pose
        out[keys.local_height(user, last)] = scale * np.eye(5)[:, 2:3]
    return out


def _relative_errors(reference: Array, error_of_reference: Array, pose: Array, error: Array) -> Array:
    """Errors (4, d) of a pose x, y, z, yaw relative to the reference's; a common shift and turn cancel."""
    offset = pose[:2] - reference[:2]
    out = error - error_of_reference
    out[0] += offset[1] * error_of_reference[3]
    out[1] -= offset[0] * error_of_reference[3]
    return np.asarray(out)
