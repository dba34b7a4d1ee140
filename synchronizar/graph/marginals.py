"""How sure the walks of an anchored graph are, by Laplace's method."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.cooperative import Portions, finish
from synchronizar.geometry import relative_to, rotation_2d
from synchronizar.graph import keys
from synchronizar.graph.marginal_prior import Carried
from synchronizar.graph.optimization import reduced
from synchronizar.graph.pose_graph import AnchoredGraph, Judgement
from synchronizar.graph.states import SCALE, Walks
from synchronizar.preprocessing.range_measurements import pairs


class Sureness(NamedTuple):
    """NaN for users that are not placed."""

    poses: Array
    """(k, 6, 6) covariances of additive errors in x, y, z (m, common axes) and yaw (rad) of each user's last keyframe,
    in its log scale and in the reference's."""
    relative: Array
    """(k, 4, 4) those of x, y, z, yaw as seen from the reference's last keyframe."""
    joint: Array
    """(k, 6, k, 6) of all users' poses at once: `poses` on its diagonal, and how their errors hang together."""
    devices: Array
    """(k, 3) variances of log scale, bias (m^2) and clock (s^2)."""


class Errors(NamedTuple):
    """What d independent unit errors do, by user."""

    poses: dict[int, Array]
    """(5, d): to x, y, z, yaw of its last keyframe and its log scale."""
    devices: dict[int, Array]
    """(3, d): to its device."""


def sureness(graph: AnchoredGraph, walks: Walks, judgement: Judgement) -> Sureness:
    """How sure the walks are, by Laplace's method."""
    return sureness_of(graph, walks, finish(errors_of(graph, walks, judgement)))


def sureness_of(graph: AnchoredGraph, walks: Walks, sources: Errors) -> Sureness:
    """`sureness`, where errors are known."""
    k = len(graph.users)
    relative, devices = np.full((k, 4, 4), np.nan), np.full((k, 3), np.nan)
    errors, of_devices = sources
    now, reference = graph.last_poses(walks), graph.reference
    of_poses = np.full((k, 6, len(of_devices[reference][SCALE])), np.nan)
    for u in graph.placed:
        of_poses[u] = np.vstack([errors[u], of_devices[reference][SCALE]])
        beside = _seen_from(now[reference], errors[reference][:4], now[u], errors[u][:4])
        relative[u] = beside @ beside.T
        devices[u] = (of_devices[u] ** 2).sum(axis=1)
    joint = np.tensordot(of_poses, of_poses, axes=(2, 2))
    return Sureness(joint[np.arange(k), :, np.arange(k)], relative, joint, devices)


def carry(graph: AnchoredGraph, walks: Walks, sources: Errors, own_height: Array) -> Carried:
    """What is known of everybody beside the reference's last keyframe, for a graph that begins at the last ones.

    `own_height` (k,) SLAM's lengths: how high each last keyframe is in its own frame as that was before any jump.
    """
    errors, of_devices = sources
    now, reference = graph.last_poses(walks), graph.reference
    above = np.exp(walks.device[:, SCALE]) * own_height
    to_reference = rotation_2d(-float(now[reference, 3]))
    rows = []
    for u in graph.free:
        beside = _seen_from(now[reference], errors[reference][:4], now[u], errors[u][:4])
        height = beside[2] - above[u] * errors[u][4] + above[reference] * errors[reference][4]
        rows += [*(to_reference @ beside[:2]), beside[3], height]
    rows += [row for u in graph.placed for row in of_devices[u]]
    root = np.array(rows)
    frames = relative_to(now, reference)
    frames[:, 2] += above[reference] - above
    return Carried(list(graph.placed), reference, frames, walks.device.copy(), root @ root.T)


def errors_of(graph: AnchoredGraph, walks: Walks, judgement: Judgement) -> Portions[Errors]:
    """By Laplace's method."""
    wanted = [
        key
        for u in graph.placed
        if (last := len(graph.keyframes[u]) - 1) > 0
        for key in (keys.pose(u, last), keys.local_height(u, last))
    ]
    bending = graph.bending(walks, judgement)
    linear = yield from graph.linearizing(walks, judgement, _shared(graph, bending))
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
    flattened, vectors = np.linalg.eigh(np.eye(len(root)) + heights.T @ _negative(graph, bending) @ heights)
    root = root @ vectors / np.sqrt(np.maximum(flattened, 0.1))
    errors = {
        u: sum(by @ root[rows_of[key]] for key, by in _last_pose_by_keys(graph, walks, u).items()) for u in graph.placed
    }
    return Errors(errors, {u: root[rows_of[keys.device(u)]] for u in graph.placed})


def _shared(graph: AnchoredGraph, bending: Array) -> Array:
    """(n,) what the ranges of each pair say together, where it is positive, in equal shares."""
    out = np.zeros_like(bending)
    for pair in pairs(graph.samples):
        out[pair.samples] = max(bending[pair.samples].mean(), 0.0)
    return out


def _negative(graph: AnchoredGraph, bending: Array) -> Array:
    """What of the cost's second derivatives in the heights of those that are free is below 0."""
    column = {u: n for n, u in enumerate(graph.free)}
    out = np.zeros((len(column), len(column)))
    for pair in pairs(graph.samples):
        row = np.zeros(len(column))
        for user, sign in ((pair.i, 1.0), (pair.j, -1.0)):
            if user in column:
                row[column[user]] = sign
        out += min(bending[pair.samples].sum(), 0.0) * np.outer(row, row)
    return out


def _last_pose_by_keys(graph: AnchoredGraph, walks: Walks, user: int) -> dict[int, Array]:
    """Derivatives (5, d) of x, y, z, yaw of the last keyframe, and log scale, by the variables they hang on."""
    x, y, z, chi = walks.local[user][-1]
    yaw, scale = walks.frames[user, 3], float(np.exp(walks.device[user, SCALE]))
    arm = scale * rotation_2d(yaw) @ np.array([x, y])
    by_device = np.zeros((5, 3))
    by_device[:3, SCALE] = *arm, scale * z
    by_device[4, SCALE] = 1.0
    out = {keys.device(user): by_device}
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
