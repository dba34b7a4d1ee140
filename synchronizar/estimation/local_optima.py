"""Minima of an anchored graph: those that the search's placements lead to, and their mirror images."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.estimation.hypotheses import SAME
from synchronizar.estimation.mirror_images import height_mirrors, reflections
from synchronizar.estimation.slips import relaid
from synchronizar.geometry import difference
from synchronizar.graph.pose_graph import AnchoredGraph, Judgement
from synchronizar.graph.rigid_graph import RigidGraph, blocks_of
from synchronizar.graph.states import Walks, interpolated
from synchronizar.parameters import Model

_ANNEALING = (4.0, 2.0)
_FIRST_ROUNDS = 2
_ROUNDS = 8
_MEASURING_ROUNDS = (4, 2)
_REFINING_ROUNDS = 4
_HOPELESS = 50.0  # of log likelihood: more than settling may gain
_NATS_A_RANGE = 1.0  # a mirror image that fits worse than that on average is none
_TOLD_APART = 3.0  # sigmas: a height that is closer is within the minimum's own uncertainty
_MOST_IMAGES = 6  # that are followed of one minimum
_MOST_COMPARED = 6
BETTER = 1.0  # of log likelihood: less does not tell two minima apart


class Settled(NamedTuple):
    """A minimum of an anchored graph."""

    graph: AnchoredGraph
    walks: Walks
    judgement: Judgement
    cost: float
    """Negative log likelihood, up to a constant that all minima of the same samples and worth share."""

    @property
    def frames(self) -> Array:
        """(k, 4) x, y, z, yaw: where each user's last keyframe is, and how SLAM's axes lie there."""
        return self.graph.last_poses(self.walks)


def by_cost(settled: Settled) -> float:
    """For sorting: best first."""
    return settled.cost


def settle_all(graph: AnchoredGraph, starts: list[Walks], model: Model) -> list[Settled]:
    """The minima that some walks and their mirror images lead to, best first."""
    found: list[Settled] = []
    for walks in starts:
        _follow(graph, walks, found, _ANNEALING)
    best = min(found, key=by_cost)
    while graph.free:
        for walks in chain(relaid(graph, best.walks, model), _images(best, model)):
            _follow(graph, walks, found, ())
        better = min(found, key=by_cost)
        if better.cost > best.cost - BETTER:
            break
        best = better  # and may have images of its own
    return sorted(found, key=by_cost)


def approach(graph: AnchoredGraph, walks: Walks, annealing: float) -> Settled:
    """Walks that have come near to a minimum: enough to go on from."""
    walks, judgement, _ = graph.settle(walks, _undecided(graph.first_judgement()), _FIRST_ROUNDS, annealing)
    return Settled(graph, *graph.settle(walks, judgement, _FIRST_ROUNDS))


def _follow(graph: AnchoredGraph, walks: Walks, found: list[Settled], annealing: tuple[float, ...]) -> None:
    """Add the minimum that some walks lead to, unless it is known."""
    judgement = _undecided(graph.first_judgement())
    for wide in annealing:
        walks, judgement, _ = graph.settle(walks, judgement, 3, wide)
    settled = Settled(graph, *graph.settle(walks, judgement, _FIRST_ROUNDS))
    if found and settled.cost > min(found, key=by_cost).cost + _HOPELESS:
        return
    settled = Settled(graph, *graph.settle(settled.walks, settled.judgement, _ROUNDS))
    frames = settled.frames
    if not any(np.nanmax(np.abs(difference(frames, known.frames))) < SAME for known in found):
        found.append(settled)


def _undecided(judgement: Judgement) -> Judgement:
    """Ranges worth the geometric mean of what they are by themselves and at worst: which of both holds shows later.

    With the least of it, half a walk of ranges that pass for late would be cheaper than one slip of SLAM.
    """
    return replace(judgement, worth=np.sqrt(judgement.worth))


def _images(settled: Settled, model: Model) -> Iterator[Walks]:
    """Walks that might explain the ranges as well, likeliest first: what levels and lines cannot tell apart."""
    graph, walks = settled.graph, settled.walks
    flat = graph.flattened(walks)
    rigid = RigidGraph(blocks_of(flat), graph.users, graph.placed, graph.reference, model).about(walks.frames)
    worth = float(settled.judgement.worth.mean())
    values = rigid.values(walks.frames)
    sigma = np.sqrt(rigid.covariances(values)[:, 2, 2] / worth)

    def above(frames: Array) -> float:
        return worth * (rigid.cost(rigid.values(frames)) - rigid.cost(values))

    heights = rigid.other_heights(walks.frames, model.cost_excluded_late / worth)
    heights += height_mirrors(flat, walks.frames, graph.reference)
    apart = [f for f in heights if (np.abs(f[:, 2] - walks.frames[:, 2]) > _TOLD_APART * sigma)[graph.free].any()]
    images = [(cost, frames) for frames in apart if (cost := above(frames)) < _HOPELESS]
    most = _HOPELESS + _NATS_A_RANGE * worth * len(flat)
    images += [
        (cost, frames) for frames in reflections(flat, walks.frames, graph.reference) if (cost := above(frames)) < most
    ]
    for _, frames in sorted(images, key=lambda image: image[0])[:_MOST_IMAGES]:
        yield walks._replace(frames=frames)


def measured(coarse: Settled) -> Settled:
    """The same minimum, what ranges are worth measured on what is left of them."""
    graph = coarse.graph
    walks, judgement = coarse.walks, coarse.judgement
    for rounds in _MEASURING_ROUNDS:
        walks, judgement, cost = graph.settle(walks, graph.measured(walks, judgement), rounds)
    return Settled(graph, walks, judgement, cost)


def refine(coarse: Settled, graph: AnchoredGraph) -> Settled:
    """The same placement at the keyframes of another graph."""
    walks, judgement, _ = coarse.graph.settle(coarse.walks, coarse.judgement, _REFINING_ROUNDS)
    walks = interpolated(walks, coarse.graph.keyframes, graph.keyframes)
    first = replace(graph.first_judgement(), worth=judgement.worth)
    walks, judgement, _ = graph.settle(walks, first, _REFINING_ROUNDS)
    return Settled(graph, *graph.settle(walks, graph.measured(walks, judgement), _REFINING_ROUNDS))


def compare(found: list[Settled], best: Settled, model: Model) -> list[Settled]:
    """The best of them as it is refined, then those others that explain the ranges too, likeliest first.

    All costs are those that the minima found have with ranges worth what the best one's residuals say.
    """
    if len(found) == 1:
        return [best]
    likely = [s for s in found if s.cost < found[0].cost + _HOPELESS][:_MOST_COMPARED]
    compared = []
    for s in likely:
        judgement = replace(s.judgement, worth=best.judgement.worth)
        compared.append(Settled(s.graph, *s.graph.settle(s.walks, judgement, _FIRST_ROUNDS)))
    _, honest = best.graph.honest(best.walks, best.judgement)
    late = len(honest) > 0 and float((honest < 0.5).mean()) > model.doubtful_share
    # What drift bends a straight walk by speaks for it or for its mirror image by chance: the sum of a term for each
    # device whose SLAM may drift, which grows with the root of how many there are.
    drifting = max(sum(len(k.step_sigma) > 0 for k in best.graph.keyframes), 1)
    excluded = max(model.cost_excluded_late if late else 0.0, model.cost_excluded * np.sqrt(drifting))
    first, *others = compared
    others = [s for s in others if s.cost <= first.cost + excluded]
    return [best._replace(cost=first.cost), *sorted(others, key=by_cost)]
