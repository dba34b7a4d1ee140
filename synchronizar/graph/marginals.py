"""How sure the walks of an anchored graph are, by Laplace's method."""

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
from synchronizar.preprocessing.range_measurements import pairs


class Marginals(NamedTuple):
    """NaN for users that are not placed."""

    poses: Array
    """(k, 6, 6) covariances of additive errors in x, y, z (m, common axes) and yaw (rad) of each user's last keyframe,
    in its log scale and in the reference's."""
    relative: Array
    """(k, 4, 4) those of x, y, z, yaw as seen from the reference's last keyframe."""
    joint: Array
    """(k, 6, k, 6) of all users' poses at once: `poses` on its diagonal, and how their errors hang together."""
    calibrations: Array
    """(k, 3) variances of log scale, bias (m^2) and clock (s^2)."""


class Errors(NamedTuple):
    """What d independent unit errors do, by user."""

    poses: dict[int, Array]
    """(5, d): to x, y, z, yaw of its last keyframe and its log scale."""
    calibrations: dict[int, Array]
    """(3, d): to its device."""


def marginals(graph: PoseGraph, states: States, em_weights: EmWeights) -> Marginals:
    """How sure the walks are, by Laplace's method."""
    return marginals_of(graph, states, finish(errors_of(graph, states, em_weights)))


def marginals_of(graph: PoseGraph, states: States, sources: Errors) -> Marginals:
    """`marginals`, where errors are known."""
    k = len(graph.users)
    relative, calibrations = np.full((k, 4, 4), np.nan), np.full((k, 3), np.nan)
    errors, of_calibrations = sources
    now, reference = graph.last_poses(states), graph.reference
    of_poses = np.full((k, 6, len(of_calibrations[reference][SCALE])), np.nan)
    for u in graph.active_users:
        of_poses[u] = np.vstack([errors[u], of_calibrations[reference][SCALE]])
        beside = _seen_from(now[reference], errors[reference][:4], now[u], errors[u][:4])
        relative[u] = beside @ beside.T
        calibrations[u] = (of_calibrations[u] ** 2).sum(axis=1)
    joint = np.tensordot(of_poses, of_poses, axes=(2, 2))
    return Marginals(joint[np.arange(k), :, np.arange(k)], relative, joint, calibrations)


def marginalized(graph: PoseGraph, states: States, sources: Errors, own_height: Array) -> MarginalPrior:
    """What is known of everybody beside the reference's last keyframe, for a graph that begins at the last ones.

    `own_height` (k,) SLAM's lengths: how high each last keyframe is in its own frame as that was before any jump.
    """
    errors, of_calibrations = sources
    now, reference = graph.last_poses(states), graph.reference
    above = np.exp(states.calibration[:, SCALE]) * own_height
    to_reference = rotation_2d(-float(now[reference, 3]))
    rows = []
    for u in graph.free:
        beside = _seen_from(now[reference], errors[reference][:4], now[u], errors[u][:4])
        height = beside[2] - above[u] * errors[u][4] + above[reference] * errors[reference][4]
        rows += [*(to_reference @ beside[:2]), beside[3], height]
    rows += [row for u in graph.active_users for row in of_calibrations[u]]
    root = np.array(rows)
    frames = relative_to(now, reference)
    frames[:, 2] += above[reference] - above
    return MarginalPrior(list(graph.active_users), reference, frames, states.calibration.copy(), root @ root.T)


def errors_of(graph: PoseGraph, states: States, em_weights: EmWeights) -> Cooperative[Errors]:
    """By Laplace's method."""
    wanted = [
        key
        for u in graph.active_users
        if (last := len(graph.keyframes[u]) - 1) > 0
        for key in (keys.pose(u, last), keys.local_height(u, last))
    ]
    height_curvature = graph.height_curvature(states, em_weights)
    linear = yield from graph.linearizing(states, em_weights, _shared(graph, height_curvature))
    yield
    others, kept = list(graph.keyframe_keys(set(wanted))), [*graph.shared_keys(), *wanted]
    try:
        jacobian = reduced(linear, others, kept)
    except RuntimeError:  # too near to singular for gtsam's Cholesky: all columns then, by the QR below
        kept = [*kept, *others]
        jacobian, _ = linear.jacobian(keys.ordering(kept))
    # Columns of unit length, and a QR that never squares them: the system may be nearly singular.
    size = np.linalg.norm(jacobian, axis=0)
    root = np.linalg.inv(np.linalg.qr(jacobian / size, mode="r")) / size[:, None]
    rows_of = dict(zip(kept, keys.rows(kept), strict=True))
    heights = root[[rows_of[keys.height(u)].start for u in graph.free]]
    # Between two heights that are as good the cost is flatter than the factors say; to a tenth, for not for ever.
    to_rigid_ranges, vectors = np.linalg.eigh(
        np.eye(len(root)) + heights.T @ _negative(graph, height_curvature) @ heights
    )
    root = root @ vectors / np.sqrt(np.maximum(to_rigid_ranges, 0.1))
    errors = {
        u: sum(by @ root[rows_of[key]] for key, by in _last_pose_by_keys(graph, states, u).items())
        for u in graph.active_users
    }
    return Errors(errors, {u: root[rows_of[keys.calibration(u)]] for u in graph.active_users})


def _shared(graph: PoseGraph, height_curvature: Array) -> Array:
    """(n,) what the ranges of each pair say together, where it is positive, in equal shares."""
    out = np.zeros_like(height_curvature)
    for pair in pairs(graph.measurements):
        out[pair.measurements] = max(height_curvature[pair.measurements].mean(), 0.0)
    return out


def _negative(graph: PoseGraph, height_curvature: Array) -> Array:
    """What of the cost's second derivatives in the heights of those that are free is below 0."""
    column = {u: n for n, u in enumerate(graph.free)}
    out = np.zeros((len(column), len(column)))
    for pair in pairs(graph.measurements):
        row = np.zeros(len(column))
        for user, sign in ((pair.i, 1.0), (pair.j, -1.0)):
            if user in column:
                row[column[user]] = sign
        out += min(height_curvature[pair.measurements].sum(), 0.0) * np.outer(row, row)
    return out


def _last_pose_by_keys(graph: PoseGraph, states: States, user: int) -> dict[int, Array]:
    """Derivatives (5, d) of x, y, z, yaw of the last keyframe, and log scale, by the variables they hang on."""
    x, y, z, chi = states.keyframe_poses[user][-1]
    yaw, scale = states.anchor_poses[user, 3], float(np.exp(states.calibration[user, SCALE]))
    arm = scale * rotation_2d(yaw) @ np.array([x, y])
    by_device = np.zeros((5, 3))
    by_device[:3, SCALE] = *arm, scale * z
    by_device[4, SCALE] = 1.0
    out = {keys.calibration(user): by_device}
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


def _seen_from(reference: Array, error_of_reference: Array, pose: Array, error: Array) -> Array:
    """Errors (4, d) of a pose x, y, z, yaw beside the reference's: what moves and turns both is none."""
    away = pose[:2] - reference[:2]
    out = error - error_of_reference
    out[0] += away[1] * error_of_reference[3]
    out[1] -= away[0] * error_of_reference[3]
    return np.asarray(out)
