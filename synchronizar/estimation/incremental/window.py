"""The placements that explain the ranges of a window, begun from whatever is known of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from synchronizar.arrays import Array
from synchronizar.cooperative import Portions
from synchronizar.data.recording import Recording
from synchronizar.estimation.full import keyframes_of_all, solve
from synchronizar.estimation.initialisation import Hypothesis, extend
from synchronizar.estimation.local_optima import Settled, compare, settle_all
from synchronizar.estimation.segments import coarse_interval, ties
from synchronizar.graph.marginal_prior import Carried
from synchronizar.graph.pose_graph import AnchoredGraph
from synchronizar.graph.states import Walks, interpolated
from synchronizar.parameters import Model
from synchronizar.preprocessing.range_measurements import Samples
from synchronizar.preprocessing.relocalizations import Mended

_STEPS = 3  # of a solution that is followed: it is near already


@dataclass(frozen=True)
class Window:
    """What is known of a stretch of time before it is solved."""

    smooth: Recording
    """With mended tracks."""
    mended: dict[str, Mended]
    samples: Samples
    placed: list[int]
    """Whom ranges tie together."""
    gauge: int
    """Beside whom the others are placed."""
    carried: Carried | None
    """What earlier ranges told of some of them."""
    noise: Array
    """(k, 2) of each SLAM, as it was found before."""
    worth: float
    """Of a range, as it was found before."""

    def minima(self, last: Settled | None, others: bool, model: Model) -> Portions[tuple[list[Settled], Array]]:
        """Best first, and how noisy each SLAM is taken to be.

        `last` is the solution of a window that began where this one does, of all that are in this one. From it, or from
        what is carried, all are followed; `others` says to look also for other minima near, and for mirror images.
        """
        if self.carried is None and last is None:
            solved = solve(self.smooth, self.mended, self.gauge, model)
            return solved.minima, solved.noise
        long = float(np.ptp(self.samples.t)) > 2.0 * model.window
        interval = coarse_interval(self.samples, model) if long else model.keyframe_interval
        keyframes = keyframes_of_all(self.smooth, self.mended, interval, model, self.noise)
        yield
        graph = AnchoredGraph(self.smooth, self.samples, keyframes, self.placed, self.gauge, model, self.carried)
        yield
        if last is not None:
            starts = [interpolated(last.walks, last.graph.keyframes, keyframes)]
        else:
            carried = self.carried
            assert carried is not None
            begun = graph.begin(carried.frames, carried.device)
            known = set(self.placed) <= set(carried.users)
            starts = [begun] if known else _joined(graph, begun, carried, model)
            others = others or not known
        if not others:
            return (yield from _followed(graph, starts[0], self.worth)), self.noise
        found = settle_all(graph, starts, model)
        (best,) = yield from _followed(graph, found[0].walks, self.worth)
        return compare(found, best, model), self.noise


def _followed(graph: AnchoredGraph, walks: Walks, worth: float) -> Portions[list[Settled]]:
    """The minimum that walks lead to; ranges were worth so much before."""
    before = replace(graph.first_judgement(), worth=np.full(len(graph.samples), worth))
    walks, judgement, _ = yield from graph.settling(walks, before, 1, steps_a_round=_STEPS)
    yield
    judgement = graph.measured(walks, judgement)
    return [Settled(graph, *(yield from graph.settling(walks, judgement, 1, steps_a_round=_STEPS)))]


def _joined(graph: AnchoredGraph, begun: Walks, carried: Carried, model: Model) -> list[Walks]:
    """Walks with those who are new wherever their ranges to all others allow."""
    frames = np.full_like(begun.frames, np.nan)
    frames[carried.users] = begun.frames[carried.users]
    flat = graph.flattened(begun._replace(frames=np.nan_to_num(begun.frames)))
    wide = replace(flat, sigma=np.hypot(flat.sigma, model.search_sigma))
    alive = [Hypothesis(frames, 0.0)]
    coming = [u for u in graph.placed if u not in carried.users]
    while coming:
        there = ~np.isnan(alive[0].frames[:, 0])
        user = max(coming, key=lambda u: ties(wide, u, np.flatnonzero(there).tolist()))
        coming.remove(user)
        alive = extend(wide, alive, graph.users, user, model)
    return [begun._replace(frames=h.frames) for h in alive]
