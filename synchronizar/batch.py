"""All users at once: every joint placement that explains the ranges, each settled in one graph.

Which ranges are late and where the users are is found in turn, each given the other (expectation maximisation), and so
from every start that could lead elsewhere: all placements that the search finds; where signals are late, those that it
finds in parts of the walk as well, since a part may be free of the burst that misleads the whole; and each user's
mirror image in height, which a level walk cannot tell from the user itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import gtsam
import numpy as np

from synchronizar.arrays import Array
from synchronizar.graph import RigidGraph
from synchronizar.initialise import Hypothesis, connected, joint_placements
from synchronizar.model import Model
from synchronizar.samples import Samples

_GAIN = 1e-3  # of log likelihood: a step that gains less changes nothing that could be measured
_MOST_ROUNDS = 10
_HOPELESS = 50.0  # of log likelihood: more than a further round may gain
_PIECES = 12  # that a walk is cut into to draw parts of it


class Settled(NamedTuple):
    """A joint placement at a minimum of the cost."""

    frames: Array
    """(k, 4) x, y, z, yaw: common_from_user; NaN where it is not placed."""
    cost: float
    """Negative log likelihood, up to a constant that all placements share."""
    graph: RigidGraph
    """The graph whose minimum it is, late bursts judged."""
    values: gtsam.Values


def solve(
    samples: Samples, graph: RigidGraph, placed: list[int], starts: list[Hypothesis], model: Model
) -> list[Settled]:
    """Every joint placement that explains the ranges, best first; some may be all but the same.

    `starts` are those that the search found in the whole walk.
    """
    found = [_settle(graph, h.frames) for h in starts]
    if not graph.free:
        return found
    best = min(found, key=_cost)
    excluded = model.cost_excluded
    if (best.graph.honest(best.values) < 0.5).mean() > model.doubtful_share:
        excluded = model.cost_excluded_late
        found += [_settle(graph, s.frames, annealing=model.annealing) for s in list(found)]
        for part in _parts(samples, model):
            if connected(part, len(graph.users), graph.reference) == placed:
                best = min(found, key=_cost)
                likely = joint_placements(part, graph.users, placed, graph.reference, model)[: model.most_followed]
                found += [_settle(graph, h.frames, hopeless=best.cost + _HOPELESS) for h in likely]
        best = min(found, key=_cost)
    found += [_settle(graph, frames) for frames in best.graph.other_heights(best.frames, excluded)]
    best = min(found, key=_cost)
    found += [_settle(graph, frames) for frames in _mirrored(samples, best)]
    found.sort(key=_cost)
    return [s for s in found if s.cost <= found[0].cost + excluded]


def _cost(settled: Settled) -> float:
    return settled.cost


def _settle(graph: RigidGraph, frames: Array, annealing: float = 1.0, hopeless: float = np.inf) -> Settled:
    """The minimum that `frames` (k, 4) lead to; one above `hopeless` after a round is not followed further."""
    values = graph.values(frames)
    if not graph.free:
        return Settled(frames, 0.0, graph, values)
    if annealing > 1.0:
        values = _optimize(graph.factors(annealing), values, iterations=3)
    before, judged = np.inf, graph
    for k in range(_MOST_ROUNDS):
        judged, cost = graph.with_bursts(values)
        if before - cost < _GAIN or (k > 0 and cost > hopeless):
            break
        before = cost
        values = _optimize(judged.factors(), values, iterations=20)
    return Settled(graph.frames(values), cost, judged, values)


def _parts(samples: Samples, model: Model) -> Iterator[Samples]:
    """Random parts of the walk, the same ones each time."""
    random = np.random.default_rng(0)
    begin, end = samples.t.min(), samples.t.max()
    piece = np.minimum((samples.t - begin) / max(end - begin, 1e-9) * _PIECES, _PIECES - 1).astype(int)
    for _ in range(model.parts):
        taken = random.permutation(_PIECES) < random.uniform(model.least_part, model.largest_part) * _PIECES
        if taken[piece].any():
            yield samples[taken[piece]]


def _mirrored(samples: Samples, best: Settled) -> list[Array]:
    """Placements (k, 4) with one user, or all of them, mirrored in height, where that is not out of the question.

    With places and headings held such a placement may be no minimum (`other_heights` misses it then), and yet lead to
    one with them free.
    """
    heights = best.frames[:, 2]
    sigma = np.sqrt(best.graph.covariances(best.values)[:, 2, 2])
    above = heights[samples.i] + samples.p_i[:, 2] - heights[samples.j] - samples.p_j[:, 2]
    everybody = [best.graph.reference, *best.graph.free]
    shifts = np.zeros((len(everybody) + 1, len(heights)))
    shifts[-1] = -2.0 * heights
    for shift, u in zip(shifts, everybody, strict=False):
        i, j = samples.i == u, samples.j == u
        shift[u] = -2.0 * (above[i].sum() - above[j].sum()) / max(i.sum() + j.sum(), 1)
    out = []
    cost = best.graph.cost(best.values)
    for shift in shifts:
        shift -= shift[best.graph.reference]
        frames = best.frames.copy()
        frames[:, 2] += shift
        told_apart = (np.abs(shift) > 1.5 * sigma)[best.graph.free].any()
        if told_apart and best.graph.cost(best.graph.values(frames)) < cost + _HOPELESS:
            out.append(frames)
    return out


def _optimize(factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, iterations: int) -> gtsam.Values:
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(iterations)
    parameters.setAbsoluteErrorTol(_GAIN)
    parameters.setRelativeErrorTol(0.0)
    parameters.setlambdaInitial(1e-3)
    return gtsam.LevenbergMarquardtOptimizer(factors, values, parameters).optimize()
