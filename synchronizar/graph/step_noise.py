"""Noise of each device's SLAM steps, by what the ranges of a recording say of it.

Most SLAM drifts less than the model's, some more, and a walk is too short to tell each device's drift from its ranges
alone. So all users' drift is a common factor times that of `parameters.slam`: next to nothing (`slam.drift_least`) with
probability `slam.driftless_share`, else half of Student's t with three degrees of freedom, whose mean square is 1 (a
spike and a slab). Each user's own factor lies about the common one, as if so many steps (`slam.drift_weight`) had been
seen with it. The evidence (marginal likelihood) of a common factor is known in closed form in the graph linearised at
an optimum; own factors are found by expectation maximisation.

Several common factors explain the ranges, and none is chosen: the graph is solved with the one under which the ranges
determine as many errors of steps as they do on average (MacKay, Neural Computation 4, 1992), so nothing flips.
Covariances are told with the mean square of the factors, since the spike is there for the estimate alone: it gains
where nothing is wrong, but SLAM that ranges do not see drift hardly ever does not. So for telling there is no spike,
and small factors f are less likely by f than the slab has them. Where the mean square is less than the usual one a
standard deviation of it is added, up to that: a factor that is hardly known gives errors with tails.

Shumway and Stoffer (J. Time Series Analysis 3, 1982): the expected square of a step's error is the square at the most
likely states plus its posterior variance. Steps are Gaussian here, and slips are left out; with the graph's weights of
Student's t, ordinary steps would get too small a noise.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.graph.em_weights import EmWeights
from synchronizar.graph.pose_graph import PoseGraph
from synchronizar.graph.states import States, steps
from synchronizar.graph.walks import Walks
from synchronizar.preprocessing.keyframes import Keyframes

PLACE, HEADING = range(2)
"""Columns of the factors."""

_STEP = np.sqrt(2.0)  # between factors that are tried
_ROUNDS = 4
_FAR_WEIGHT = 2.0  # steps that usual drift counts as where it is far
_FAR_ROUNDS = 40  # from wide drift, what steps hardly determine shrinks slowly
_MOST_KEYFRAMES = 400  # of a longer walk only the middle is used


class _Search(NamedTuple):
    """How users' own factors on the noise of steps are sought."""

    tried: Array
    """(b,) common factors."""
    begin: float
    """Times a common factor, where users' own begin."""
    weight: float
    """Steps that the common factor counts as."""
    rounds: int
    """Of expectation maximisation."""


class StepNoise(NamedTuple):
    """Factors (k, 2) on each user's step sigmas in position and heading, relative to `parameters.slam`."""

    used: Array
    """With which the graph is solved in the end."""
    sought: Array
    """With which optima are sought and compared: as if all SLAM drifted, by `slam.drift_sought_least` at least."""
    told: Array
    """With which it is told how sure that is: as all factors that explain the ranges have it."""


def step_noise(graph: PoseGraph, states: States, em_weights: EmWeights, drift: Array | None = None) -> StepNoise:
    """What the ranges say at an optimum of the graph, whose steps have `drift` (k, 2) times the usual noise (None: 1).

    1 where there are none, or where they say nothing of it.
    """
    k, slam = len(graph.users), graph.parameters.slam
    drift = np.ones((k, 2)) if drift is None else drift
    used, sought, told = np.ones((3, k, 2))
    if not len(graph.measurements):
        return StepNoise(used, sought, told)
    walks = graph.walks
    tried = slam.drift_least * _STEP ** np.arange(np.log(slam.drift_largest / slam.drift_least) / np.log(_STEP) + 1.0)
    search = _Search(tried, 1.0, slam.drift_weight, _ROUNDS)
    of_users, evidence, determined = _about(graph, states, em_weights, drift, search)
    likely = np.isfinite(determined)
    if not (determined[likely] > 0.0).any():
        return StepNoise(used, sought, told)
    factors, evidence, determined = np.array(of_users)[likely], evidence[likely], determined[likely]
    prior = tried / (1.0 + tried**2) ** 2
    prior /= prior.sum()
    spike = slam.driftless_share * (np.arange(len(tried)) == 0)
    likelihood = np.exp(evidence - evidence.max())
    weight = (spike + (1.0 - slam.driftless_share) * prior)[likely] * likelihood
    used[walks.users] = _matching(weight, determined, factors)
    sought_weight = (prior * (tried > slam.drift_sought_least))[likely] * likelihood
    sought[walks.users] = (
        _matching(sought_weight, determined, factors) if sought_weight.any() else slam.drift_sought_least
    )
    slab = (prior * tried / np.sqrt(1.0 + tried**2))[likely] * likelihood
    slab /= slab.sum()
    squared = np.tensordot(slab, factors**2, axes=1)
    spread = np.sqrt(np.tensordot(slab, (factors**2 - squared) ** 2, axes=1))
    told[walks.users] = np.sqrt(np.minimum(squared + spread, np.maximum(squared, 1.0)))
    return StepNoise(used, sought, np.maximum(used, told))


def _matching(weight: Array, determined: Array, factors: Array) -> Array:
    """(m, 2) the factors under which as many errors are determined as on average over all (f, m, 2), by `weight`."""
    at = float(np.interp(weight @ determined / weight.sum(), determined, np.arange(len(weight))))
    low = max(min(int(at), len(weight) - 2), 0)
    return np.asarray(factors[low] ** (low + 1 - at) * factors[min(low + 1, len(weight) - 1)] ** (at - low))


def with_drift(keyframes: list[Keyframes], factors: Array) -> list[Keyframes]:
    """The same keyframes where SLAM drifts `factors` (k, 2) times as far; a rebuilt step is as good as before."""
    return [
        replace(of_user, step_sigma=np.where(of_user.rebuilt[:, None], 1.0, by[[0, 0, 1]]) * of_user.step_sigma)
        for of_user, by in zip(keyframes, factors, strict=True)
    ]


def far_step_noise(graph: PoseGraph, states: States, em_weights: EmWeights, wide: float) -> Array:
    """(k, 2) factors relative to `parameters.slam` at an optimum whose steps have `wide` times its noise.

    Each user's own is hardly tied to the usual one: what drifts so far is one device in many.
    """
    out = np.ones((len(graph.users), 2))
    drift = wide * out
    of_users, _, _ = _about(graph, states, em_weights, drift, _Search(np.ones(1), wide, _FAR_WEIGHT, _FAR_ROUNDS))
    out[graph.walks.users] = of_users[0]
    return out


def _about(
    graph: PoseGraph, states: States, em_weights: EmWeights, drift: Array, search: _Search
) -> tuple[list[Array], Array, Array]:
    """Users' own factors about each that is tried, its evidence, and how many errors are determined.

    Factors are on the steps' noise without the `drift` (k, 2) that the graph has, by which slips are told.
    """
    walks, weights, counted = graph.walks, list(em_weights.step_weight), []
    for u in walks.users:
        ordinary = _ordinary(graph, states, u)
        weights[u] = np.where(ordinary, 1.0, weights[u] / drift[u, PLACE] ** 2)
        counted += [False, *ordinary.tolist()]
    graph = graph.with_keyframes(with_drift(graph.keyframes, 1.0 / drift))
    return walks.solver.step_noise(
        walks.places(states),
        states.calibration[walks.users],
        graph.lasting_of(states),
        graph.walk_noise(states.anchor_poses, replace(em_weights, step_weight=weights)),
        graph.loss,
        _middle(graph, walks),
        np.array(counted),
        *search,
    )


def _ordinary(graph: PoseGraph, states: States, user: int) -> Mask:
    """(m - 1,) whether a step is SLAM's own: neither rebuilt nor a slip."""
    frames = graph.keyframes[user]
    squared_error = (steps(states.keyframe_poses[user], frames) ** 2).sum(axis=1)
    return np.asarray(~frames.rebuilt & (squared_error < graph.parameters.slam.slip_sigmas**2))


def _middle(graph: PoseGraph, walks: Walks) -> Mask:
    """(m,) the middle `_MOST_KEYFRAMES` keyframes by time, and the only one of whoever has one."""
    t = np.concatenate([graph.keyframes[u].t for u in walks.users])
    alone = np.repeat(np.diff(walks.first) == 1, np.diff(walks.first))
    by_time = np.sort(t[~alone])
    excess = max(len(by_time) - _MOST_KEYFRAMES, 0)
    if not excess:
        return np.ones(len(t), dtype=bool)
    begin, end = by_time[excess // 2], by_time[excess // 2 + _MOST_KEYFRAMES - 1]
    return np.asarray(alone | ((t >= begin) & (t <= end)))
