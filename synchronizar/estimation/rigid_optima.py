"""All users at once: every joint placement that explains the ranges, each settled in one graph.

Which ranges are late and where the users are is found in turn, each given the other (expectation maximisation), and so
from every start that could lead elsewhere: all placements that the search finds; where signals are late, those that it
finds in parts of the walk as well, since a part may be free of the burst that misleads the whole; and mirror images,
which users that walk a line, or on the level, cannot tell from themselves.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.estimation.hypotheses import SAME
from synchronizar.estimation.initialisation import Candidate, connected, joint_placements
from synchronizar.estimation.mirror_images import height_mirrors, reflections
from synchronizar.geometry import difference
from synchronizar.graph.optimization import Values, levenberg_marquardt
from synchronizar.graph.rigid_graph import RigidGraph
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import RangeMeasurements

_GAIN = 5e-3  # of log likelihood, in units of 1: a step that gains less changes nothing that could be measured


class LocalOptimum(NamedTuple):
    """A joint placement at a minimum of the cost."""

    frames: Array
    """(k, 4) x, y, z, yaw: common_from_user; NaN where it is not placed."""
    cost: float
    """Negative log likelihood, up to a constant that all placements share."""
    graph: RigidGraph
    """The graph whose minimum it is, late bursts judged."""
    values: Values


def solve(
    measurements: RangeMeasurements,
    graph: RigidGraph,
    active_users: list[int],
    starts: list[Candidate],
    parameters: Parameters,
) -> list[LocalOptimum]:
    """Every joint placement that explains the ranges, best first; some may be all but the same.

    `starts` are those that the search found in the whole walk.
    """
    found = _Minima(graph)
    for start in starts:
        found.follow(start.frames)
    if not graph.free:
        return found.optimum
    excluded = parameters.integrity.cost_excluded
    if found.best.graph.rejected(found.best.values) > parameters.search.doubtful_share:
        excluded = parameters.integrity.cost_excluded_nlos
        for start in starts:
            found.follow(start.frames, annealing=parameters.search.annealing)
        for part in _parts(measurements, parameters):
            if connected(part, len(graph.users), graph.reference) == active_users:
                likely = joint_placements(part, graph.users, active_users, graph.reference, parameters)
                for start in likely[: parameters.search.most_followed]:
                    found.follow(start.frames)
    mirrored: LocalOptimum | None = None
    while mirrored is not found.best:  # a mirror image may be better, and have images of its own
        mirrored = found.best
        _follow_mirrors(measurements, found, mirrored, excluded)
    return sorted((s for s in found.optimum if s.cost <= found.best.cost + excluded), key=_cost)


def _cost(optimum: LocalOptimum) -> float:
    return optimum.cost


class _Minima:
    """The minima found so far."""

    def __init__(self, graph: RigidGraph) -> None:
        self._graph = graph
        self.optimum: list[LocalOptimum] = []

    @property
    def best(self) -> LocalOptimum:
        return min(self.optimum, key=_cost)

    def follow(self, frames: Array, annealing: float = 1.0) -> None:
        """Add the minimum that `frames` (k, 4) lead to, unless it is known already, or hopelessly above the best."""
        graph, values = self._graph.about(frames), self._graph.values(frames)
        if not graph.free:
            self.optimum.append(LocalOptimum(frames, 0.0, graph, values))
            return
        if annealing > 1.0:
            values = levenberg_marquardt(graph.factors(annealing), values, 3, _GAIN)
        search = graph.parameters.search
        hopeless = self.best.cost + search.hopeless_cost if self.optimum else np.inf
        before = np.inf
        for k in range(search.most_rounds):
            judged, cost = graph.with_bursts(values)
            if before - cost < _GAIN or (k > 0 and cost > hopeless):
                break
            before = cost
            values = levenberg_marquardt(judged.factors(), values, 20, _GAIN)
            frames = graph.frames(values)
            if any(np.nanmax(np.abs(difference(frames, known.frames))) < SAME for known in self.optimum):
                return
        self.optimum.append(LocalOptimum(graph.frames(values), cost, judged, values))


def _follow_mirrors(measurements: RangeMeasurements, found: _Minima, best: LocalOptimum, excluded: float) -> None:
    graph = best.graph
    search = graph.parameters.search
    cost = graph.cost(best.values)
    sigma = np.sqrt(graph.covariances(best.values)[:, 2, 2])
    heights = graph.other_heights(best.frames, excluded)
    for frames in height_mirrors(measurements, best.frames, graph.reference):
        if graph.cost(graph.values(frames)) < cost + search.hopeless_cost:
            heights.append(frames)
    for frames in heights:
        if (np.abs(frames[:, 2] - best.frames[:, 2]) > search.mirror_sigmas * sigma)[graph.free].any():
            found.follow(frames)
    for frames in reflections(measurements, best.frames, graph.reference):
        if graph.cost(graph.values(frames)) < cost + search.mirror_cost_per_range * len(measurements):
            found.follow(frames)


def _parts(measurements: RangeMeasurements, parameters: Parameters) -> Iterator[RangeMeasurements]:
    """Random parts of the walk, the same ones each time."""
    random = np.random.default_rng(0)
    begin, end = measurements.t.min(), measurements.t.max()
    piece = np.minimum(
        (measurements.t - begin) / max(end - begin, 1e-9) * parameters.search.part_pieces,
        parameters.search.part_pieces - 1,
    ).astype(int)
    for _ in range(parameters.search.parts):
        taken = (
            random.permutation(parameters.search.part_pieces)
            < random.uniform(parameters.search.least_part, parameters.search.largest_part)
            * parameters.search.part_pieces
        )
        if taken[piece].any():
            yield measurements[taken[piece]]
