"""Marginal covariances of the states of a pose graph, by Laplace's method."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.graph.em_weights import EmWeights
from synchronizar.graph.pose_graph import PoseGraph
from synchronizar.graph.states import SCALE, States
from synchronizar.preprocessing.range_measurements import mean_by_pair, pair_bounds

_UNDOUBTED = 3.5  # sigmas: whose height is so much better known than the largest error needs no better shape
_PINNED_STEPS, _PINNED_GAIN = 3, 0.1
_LEAST_COST = 0.05  # of a height that far off: the optimum is one
_REACH = 4.0  # of the quartic, in such steps or sigmas


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
    log_volume: float
    """The logarithm of how much room the heights have: half that of their covariance's determinant."""


class Errors(NamedTuple):
    """Square roots of the joint covariance, by user: the effect of d independent errors of unit variance."""

    poses: dict[int, Array]
    """(5, d) on x, y, z (m), yaw (rad) of the last keyframe, and on log scale."""
    calibrations: dict[int, Array]
    """(3, d) on log scale, bias (m) and clock offset (s)."""
    heights: Array
    """(f, d) on the heights of the free users' origins."""


def marginals(graph: PoseGraph, states: States, em_weights: EmWeights, bent: int | None = None) -> Marginals:
    """The marginals at the states, which are to be a local optimum.

    Of `bent` heights at most, the least known, or of all, the spread is asked of the costs on either side.
    """
    k = len(graph.users)
    relative, calibrations = np.full((k, 4, 4), np.nan), np.full((k, 3), np.nan)
    errors, of_calibrations, heights = _errors(graph, states, em_weights, bent)
    now, reference = graph.last_poses(states), graph.reference
    of_poses = np.full((k, 6, errors[reference].shape[1]), np.nan)
    for u in graph.active_users:
        of_poses[u] = np.vstack([errors[u], errors[reference][4]])
        relative_error = _relative_errors(now[reference], errors[reference][:4], now[u], errors[u][:4])
        relative[u] = relative_error @ relative_error.T
        calibrations[u] = (of_calibrations[u] ** 2).sum(axis=1)
    joint = np.tensordot(of_poses, of_poses, axes=(2, 2))
    volume = 0.5 * float(np.linalg.slogdet(heights @ heights.T)[1]) if len(heights) else 0.0
    return Marginals(joint[np.arange(k), :, np.arange(k)], relative, joint, calibrations, volume)


def _errors(graph: PoseGraph, states: States, em_weights: EmWeights, bent: int | None) -> Errors:
    """Square roots of the joint covariance at the states.

    Laplace's method: the covariance is the inverse of the cost's second derivatives.
    """
    walks = graph.walks
    k, first, last = len(walks.users), walks.first[:-1], walks.first[1:] - 1
    wanted, at = np.unique(np.concatenate([first, last]), return_inverse=True)
    height_curvature = graph.height_curvature(states, em_weights)
    covariance = walks.solver.covariance(
        walks.places(states),
        states.calibration[walks.users],
        graph.lasting_of(states),
        graph.walk_noise(states.anchor_poses, em_weights),
        graph.loss,
        mean_curvature(graph, height_curvature),
        wanted,
    )
    size = np.sqrt(np.diag(covariance))
    size[size == 0.0] = 1.0  # of what is fixed
    eigenvalues, axes = np.linalg.eigh(covariance / np.outer(size, size))
    root = size[:, None] * axes * np.sqrt(np.maximum(eigenvalues, 0.0))
    of_keyframes = root[: 4 * len(wanted)].reshape(len(wanted), 4, -1)
    of_first, of_last = of_keyframes[at[:k]], of_keyframes[at[k:]]
    of_calibrations = root[4 * len(wanted) :].reshape(k, 3, -1)
    # A height of SLAM's grows with scale.
    by_scale = np.exp(states.calibration[walks.users, SCALE]) * walks.slam[first, 2]
    of_scale = of_calibrations[:, SCALE]
    if last[walks.reference] == first[walks.reference]:
        of_last[walks.reference, 2] += by_scale[walks.reference] * of_scale[walks.reference]
    free = [n for n in range(k) if n != walks.reference]
    heights = of_first[free, 2] - by_scale[free, None] * of_scale[free]
    straight = _with_negative_curvature(heights, _negative_curvature(graph, height_curvature))
    straight = straight @ _with_bends(graph, states, em_weights, heights @ straight, bent)
    of_calibrations = of_calibrations @ straight
    errors = np.concatenate([of_last, of_scale[:, None]], axis=1) @ straight
    if graph.calibration_priors.to_told is not None:
        total = _by_calibrations(of_calibrations, graph.calibration_priors.to_told)
        errors, of_calibrations = errors @ total, of_calibrations @ total
    return Errors(
        {u: errors[n] for n, u in enumerate(walks.users)},
        {u: of_calibrations[n] for n, u in enumerate(walks.users)},
        heights @ straight,
    )


def _by_calibrations(of_calibrations: Array, to_told: Array) -> Array:
    """(d, d): takes all errors to those where errors of calibrations are `to_told` (3 k, 3 k) times theirs.

    `of_calibrations` (k, 3, d) is their square root C. All else follows calibrations as it does in the graph, and what
    it does not share with them stays (the law of total variance): 1 + C' (C C')^-1 (A - 1) C.
    """
    rows = of_calibrations.reshape(len(to_told), -1)
    more = (to_told - np.eye(len(to_told))) @ rows
    return np.asarray(np.eye(rows.shape[1]) + rows.T @ np.linalg.solve(rows @ rows.T, more))


def _with_negative_curvature(heights: Array, negative_curvature: Array) -> Array:
    """(d, d): what takes square roots of a covariance to those of it with negative curvature in height.

    `heights` are the square root's rows of the free users' heights. The factors leave out negative curvature in height:
    between two equally good heights the cost is flatter than they say. It is added here; the information in any
    direction falls to no less than a tenth.
    """
    eigenvalues, vectors = np.linalg.eigh(np.eye(heights.shape[1]) + heights.T @ negative_curvature @ heights)
    return np.asarray(vectors / np.sqrt(np.maximum(eigenvalues, 0.1)))


def _with_bends(graph: PoseGraph, states: States, em_weights: EmWeights, heights: Array, most: int | None) -> Array:
    """(d, d): what takes square roots of a covariance to those of it with heights as wide as their costs have them.

    `heights` (f, d) are the square root's rows of the free users' heights. A level walk tells a height by its square,
    so its cost is no parabola: flat at first, steep further off. Where that matters the cost is asked on either side,
    all else at its best there, and the height's variance is that of the quartic through both; of `most` heights, the
    least known. All else follows the height as it does in the graph.
    """
    out, limit = np.eye(heights.shape[1]), graph.parameters.integrity.largest_error
    here: float | None = None
    for n in np.argsort(-np.linalg.norm(heights, axis=1), kind="stable")[:most].tolist():
        row = heights[n] @ out
        sigma = float(np.linalg.norm(row))
        if sigma < limit / _UNDOUBTED:
            continue
        if here is None:
            here = graph.e_step(states, em_weights)[1]
        step = min(2.0 * sigma, limit)
        follow = (heights @ out) @ row / sigma**2
        above, below = (_cost_at(graph, states, em_weights, n, side * step * follow) - here for side in (1.0, -1.0))
        along = row / sigma
        wider = _sigma_of_quartic(sigma, step, above, below) / sigma
        out = out @ (np.eye(len(row)) + (wider - 1.0) * np.outer(along, along))
    return out


def _cost_at(graph: PoseGraph, states: States, em_weights: EmWeights, n: int, shifts: Array) -> float:
    """The cost with all free users' heights moved by `shifts` (f,) m and that of the n-th held there, at its best."""
    frames = states.anchor_poses.copy()
    frames[graph.free, 2] += shifts
    pinned = graph.with_pinned_heights(frames[:, 2], [graph.free[n]])
    there = pinned.optimised(
        states._replace(anchor_poses=frames), states.anchor_poses, em_weights, 1.0, _PINNED_STEPS, _PINNED_GAIN
    )
    return graph.e_step(there, em_weights)[1]


def _sigma_of_quartic(sigma: float, step: float, above: float, below: float) -> float:
    """1 sigma of exp(-c) about 0, where c is x^2 / (2 sigma^2) near 0 and `above` and `below` at x = +-`step`.

    No further than c grows; where c is flatter than that parabola, it is a wider one.
    """
    mean = max(0.5 * (above + below), _LEAST_COST)
    square, cube = 0.5 / sigma**2, 0.5 * (above - below) / step**3
    fourth = (mean - square * step**2) / step**4
    if fourth < 0.0:
        square, fourth = mean / step**2, 0.0
    x = np.linspace(0.0, _REACH * max(step, sigma), 256)
    squares = weights = 0.0
    for side in (cube, -cube):
        cost = square * x**2 + side * x**3 + fourth * x**4
        rising = np.concatenate([[True], np.cumsum(np.diff(cost) < 0.0) == 0])
        density = np.where(rising, np.exp(-cost), 0.0)
        squares, weights = squares + float(density @ x**2), weights + float(density.sum())
    return float(np.sqrt(squares / weights))


def mean_curvature(graph: PoseGraph, height_curvature: Array) -> Array:
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


def _relative_errors(reference: Array, error_of_reference: Array, pose: Array, error: Array) -> Array:
    """Errors (4, d) of a pose x, y, z, yaw relative to the reference's; a common shift and turn cancel."""
    offset = pose[:2] - reference[:2]
    out = error - error_of_reference
    out[0] += offset[1] * error_of_reference[3]
    out[1] -= offset[0] * error_of_reference[3]
    return np.asarray(out)
