"""The first stretch of a recording, and ever longer ones: SLAM is nearly rigid for minutes, not for hours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.data.recording import Recording
from synchronizar.estimation.initialisation import Hypothesis, connected, extend, joint_placements
from synchronizar.estimation.local_optima import Settled, approach, by_cost, settle_all
from synchronizar.geometry import apply_frames, relative_to
from synchronizar.graph.pose_graph import AnchoredGraph
from synchronizar.graph.states import Walks
from synchronizar.parameters import Model
from synchronizar.preprocessing.centering import centred, middles
from synchronizar.preprocessing.keyframes import Keyframes
from synchronizar.preprocessing.range_measurements import Samples

_KEYFRAMES = 20  # of a stretch, while placements are compared
_ANNEALING = 3.0  # of a stretch that was just added: SLAM has drifted there
_MOST_GROWN = 2  # joint placements that are followed into a longer stretch
_WHOLE = 2.0  # first stretches: a recording that is no longer is taken as a whole


def coarse_interval(samples: Samples, model: Model) -> float:
    """Seconds between the keyframes while placements are compared."""
    stretch = min(float(np.ptp(samples.t)) if len(samples) else 0.0, model.first_stretch)
    return max(model.keyframe_interval, stretch / _KEYFRAMES)


def search_and_grow(
    recording: Recording,
    samples: Samples,
    keyframes: list[Keyframes],
    placed: list[int],
    reference: int,
    model: Model,
) -> list[Settled]:
    """The minima of the whole recording, best first; found in its first stretch and followed from there."""
    users = recording.users
    begin, end = _first_stretch(samples, len(users), reference, model)
    found: list[Settled] = []
    others: list[Array] = []
    known: list[int] = []
    while True:
        inside = _within(samples, begin, end)
        tied = connected(samples[inside], len(users), reference)
        part = samples[np.flatnonzero(inside & np.isin(samples.i, tied) & np.isin(samples.j, tied)).astype(np.int32)]
        graph = AnchoredGraph(recording, part, keyframes, tied, reference, model)
        if not found:
            found = settle_all(graph, _search(part, graph, model), model)
            excluded = found[0].cost + model.cost_excluded_late
            others = [s.walks.frames for s in found[1:_MOST_GROWN] if s.cost < excluded]
        else:
            found = [approach(graph, _joined(graph, found[0], known, model), _ANNEALING)]
        known = tied
        if tied == placed and inside.all():
            break
        length = end - begin
        begin, end = begin - 0.5 * length, end + 0.5 * length
    if np.isfinite(begin):
        # What else explained the first stretch is looked at again now that all is known.
        walks = found[0].walks
        elsewhere = [np.where(np.isnan(frames), walks.frames, frames) for frames in others]
        found += [approach(graph, walks._replace(frames=frames), 1.0) for frames in elsewhere]
    return sorted(found, key=by_cost)


def _first_stretch(samples: Samples, users: int, reference: int, model: Model) -> tuple[float, float]:
    """The stretch (s) of `first_stretch` in which the most users hang together with the reference, the earliest."""
    if not len(samples) or np.ptp(samples.t) <= _WHOLE * model.first_stretch:
        return -np.inf, np.inf
    begins = np.arange(samples.t.min(), samples.t.max(), 0.5 * model.first_stretch)
    tied = [
        len(connected(samples[_within(samples, b, b + model.first_stretch)], users, reference)) for b in begins.tolist()
    ]
    begin = float(begins[int(np.argmax(tied))])
    return begin, begin + model.first_stretch


def _within(samples: Samples, begin: float, end: float) -> Mask:
    return np.asarray((samples.t >= begin) & (samples.t <= end))


def _search(samples: Samples, graph: AnchoredGraph, model: Model) -> list[Walks]:
    """Joint placements of rigid walks, looked for as if ranges were no better than SLAM."""
    middle = middles(samples, len(graph.users))
    wide = replace(centred(samples, middle), sigma=np.hypot(samples.sigma, model.search_sigma))
    found = joint_placements(wide, graph.users, graph.placed, graph.reference, model)
    anchors = np.array([k.anchor for k in graph.keyframes]) - middle
    laid = [np.column_stack([apply_frames(h.frames, anchors), h.frames[:, 3]]) for h in found]
    return [graph.begin(relative_to(frames, graph.reference)) for frames in laid]


def _joined(graph: AnchoredGraph, before: Settled, known: list[int], model: Model) -> Walks:
    """Walks of a shorter stretch as a start for a longer one; who has come is placed where it fits best."""
    walks = before.walks._replace(frames=before.walks.frames.copy())
    coming = [u for u in graph.placed if u not in known]
    while coming:
        frames = np.full_like(walks.frames, np.nan)
        frames[known] = walks.frames[known]
        flat = graph.flattened(walks._replace(frames=frames))
        wide = replace(flat, sigma=np.hypot(flat.sigma, model.search_sigma))
        user = max(coming, key=lambda u: ties(flat, u, known))
        grown = extend(wide, [Hypothesis(frames, 0.0)], graph.users, user, model)
        walks.frames[user] = grown[0].frames[user]
        known, coming = [*known, user], [u for u in coming if u != user]
    return walks


def ties(samples: Samples, user: int, known: list[int]) -> int:
    """How many ranges tie a user to those that are known."""
    there: Array = np.isin(samples.j, known) & (samples.i == user) | np.isin(samples.i, known) & (samples.j == user)
    return int(there.sum())
