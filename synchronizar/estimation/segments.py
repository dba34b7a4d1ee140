"""The first stretch of a recording, and ever longer ones: SLAM is nearly rigid for minutes, not for hours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.data.recording import Recording
from synchronizar.estimation.initialisation import Candidate, connected, extend, joint_placements
from synchronizar.estimation.local_optima import LocalOptimum, approach, by_cost, find_optima
from synchronizar.geometry import apply_frames, relative_to
from synchronizar.graph.pose_graph import PoseGraph
from synchronizar.graph.states import States
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.centering import centered, centroids
from synchronizar.preprocessing.keyframes import Keyframes
from synchronizar.preprocessing.range_measurements import RangeMeasurements

_KEYFRAMES = 20  # of a stretch, while placements are compared
_ANNEALING = 3.0  # of a stretch that was just added: SLAM has drifted there
_MOST_GROWN = 2  # joint placements that are followed into a longer stretch
_WHOLE = 2.0  # first stretches: a recording that is no longer is taken as a whole


def coarse_interval(measurements: RangeMeasurements, parameters: Parameters) -> float:
    """Seconds between the keyframes while placements are compared."""
    stretch = min(float(np.ptp(measurements.t)) if len(measurements) else 0.0, parameters.search.first_stretch)
    return max(parameters.slam.keyframe_interval, stretch / _KEYFRAMES)


def search_and_grow(
    recording: Recording,
    measurements: RangeMeasurements,
    keyframes: list[Keyframes],
    active_users: list[int],
    reference: int,
    parameters: Parameters,
) -> list[LocalOptimum]:
    """The minima of the whole recording, best first; found in its first stretch and followed from there."""
    users = recording.users
    begin, end = _first_stretch(measurements, len(users), reference, parameters)
    found: list[LocalOptimum] = []
    others: list[Array] = []
    known: list[int] = []
    while True:
        inside = _within(measurements, begin, end)
        tied = connected(measurements[inside], len(users), reference)
        part = measurements[
            np.flatnonzero(inside & np.isin(measurements.i, tied) & np.isin(measurements.j, tied)).astype(np.int32)
        ]
        graph = PoseGraph(recording, part, keyframes, tied, reference, parameters)
        if not found:
            found = find_optima(graph, _search(part, graph, parameters), parameters)
            excluded = found[0].cost + parameters.integrity.cost_excluded_nlos
            others = [s.states.anchor_poses for s in found[1:_MOST_GROWN] if s.cost < excluded]
        else:
            found = [approach(graph, _joined(graph, found[0], known, parameters), _ANNEALING)]
        known = tied
        if tied == active_users and inside.all():
            break
        length = end - begin
        begin, end = begin - 0.5 * length, end + 0.5 * length
    if np.isfinite(begin):
        # What else explained the first stretch is looked at again now that all is known.
        states = found[0].states
        elsewhere = [np.where(np.isnan(frames), states.anchor_poses, frames) for frames in others]
        found += [approach(graph, states._replace(anchor_poses=frames), 1.0) for frames in elsewhere]
    return sorted(found, key=by_cost)


def _first_stretch(
    measurements: RangeMeasurements, users: int, reference: int, parameters: Parameters
) -> tuple[float, float]:
    """The stretch (s) of `first_stretch` in which the most users hang together with the reference, the earliest."""
    if not len(measurements) or np.ptp(measurements.t) <= _WHOLE * parameters.search.first_stretch:
        return -np.inf, np.inf
    begins = np.arange(measurements.t.min(), measurements.t.max(), 0.5 * parameters.search.first_stretch)
    tied = [
        len(connected(measurements[_within(measurements, b, b + parameters.search.first_stretch)], users, reference))
        for b in begins.tolist()
    ]
    begin = float(begins[int(np.argmax(tied))])
    return begin, begin + parameters.search.first_stretch


def _within(measurements: RangeMeasurements, begin: float, end: float) -> Mask:
    return np.asarray((measurements.t >= begin) & (measurements.t <= end))


def _search(measurements: RangeMeasurements, graph: PoseGraph, parameters: Parameters) -> list[States]:
    """Joint placements of rigid walks, looked for as if ranges were no better than SLAM."""
    middle = centroids(measurements, len(graph.users))
    wide = replace(centered(measurements, middle), sigma=np.hypot(measurements.sigma, parameters.search.sigma))
    found = joint_placements(wide, graph.users, graph.active_users, graph.reference, parameters)
    anchors = np.array([k.anchor for k in graph.keyframes]) - middle
    laid = [np.column_stack([apply_frames(h.frames, anchors), h.frames[:, 3]]) for h in found]
    return [graph.initial_states(relative_to(frames, graph.reference)) for frames in laid]


def _joined(graph: PoseGraph, before: LocalOptimum, known: list[int], parameters: Parameters) -> States:
    """Walks of a shorter stretch as a start for a longer one; who has come is placed where it fits best."""
    states = before.states._replace(anchor_poses=before.states.anchor_poses.copy())
    coming = [u for u in graph.active_users if u not in known]
    while coming:
        frames = np.full_like(states.anchor_poses, np.nan)
        frames[known] = states.anchor_poses[known]
        flat = graph.to_rigid_ranges(states._replace(anchor_poses=frames))
        wide = replace(flat, sigma=np.hypot(flat.sigma, parameters.search.sigma))
        user = max(coming, key=lambda u: ties(flat, u, known))
        grown = extend(wide, [Candidate(frames, 0.0)], graph.users, user, parameters)
        states.anchor_poses[user] = grown[0].frames[user]
        known, coming = [*known, user], [u for u in coming if u != user]
    return states


def ties(measurements: RangeMeasurements, user: int, known: list[int]) -> int:
    """How many ranges tie a user to those that are known."""
    there: Array = np.isin(measurements.j, known) & (measurements.i == user) | np.isin(measurements.i, known) & (
        measurements.j == user
    )
    return int(there.sum())
