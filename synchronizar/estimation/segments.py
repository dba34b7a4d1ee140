"""Initialisation by segments: a search in one segment of a long recording, then optimisation in ever longer ones.

The search takes SLAM for rigid, which holds for minutes, not for hours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.estimation.comparing import by_cost
from synchronizar.estimation.initialisation import Candidate, extend, joint_placements
from synchronizar.estimation.local_optima import approach, find_optima
from synchronizar.geometry import apply_frames, difference, relative_to
from synchronizar.graph.pose_graph import LocalOptimum, PoseGraph
from synchronizar.graph.problem import Problem
from synchronizar.graph.states import SCALE, States
from synchronizar.preprocessing.centering import centered, centroids
from synchronizar.preprocessing.keyframes import STATIC_KEYFRAME, Keyframes, keyframes_of
from synchronizar.preprocessing.range_measurements import RangeMeasurements
from synchronizar.preprocessing.relocalizations import RepairedTrack
from synchronizar.progress import Progress, stage, unheard

_KEYFRAMES = 20  # per first segment, while candidates are compared
_MOST_GROWN = 2  # optima of the first segment that are optimised on the whole recording
_ABOUT_M, _ABOUT_RAD = 0.3, 0.15  # starts that are nearer to one another lead to the same optimum
_WHOLE = 2.0  # first segments: a recording that is no longer is searched as a whole


def coarse_interval(problem: Problem) -> float:
    """Interval (s) of the keyframes while candidates are compared."""
    measurements, parameters = problem.measurements, problem.parameters
    length = min(float(np.ptp(measurements.t)) if len(measurements) else 0.0, parameters.search.first_stretch)
    return max(parameters.slam.keyframe_interval, length / _KEYFRAMES)


def keyframes_of_all(
    problem: Problem,
    repaired_tracks: dict[str, RepairedTrack],
    interval: float,
    noise: Array | None = None,
    unit: Array | None = None,
) -> list[Keyframes]:
    """Keyframes of all k users, `interval` s apart.

    `noise` (k, 2) are factors on the drift of `parameters.slam`, `unit` (k,) m the tracks' units of length.
    """
    k = len(problem.users)
    factors, units = np.ones((k, 2)) if noise is None else noise, np.ones(k) if unit is None else unit
    return [
        STATIC_KEYFRAME
        if user.static
        else keyframes_of(repaired_tracks[user.name], interval, problem.parameters, (place, heading), metres)
        for user, (place, heading), metres in zip(problem.users, factors.tolist(), units.tolist(), strict=True)
    ]


def search_and_grow(
    problem: Problem,
    keyframes: list[Keyframes],
    progress: Progress = unheard,
    begun: Sequence[tuple[Array, Array]] = (),
) -> list[LocalOptimum]:
    """Local optima of the whole recording, best first: found in one segment, which doubles until it holds all.

    `begun` are frames (k, 4) about the users' own origins and calibrations (k, 3) that were found before: the search
    begins with them, and leaves out what it finds about there.
    """
    parameters = problem.parameters
    begin, end = _first_segment(problem)
    grown = bool(np.isfinite(begin))
    # A wrong placement in the first segment would hold where all that comes later may pass for foreign.
    own = replace(problem, parameters=parameters.changed(ranges={"foreign_share": 0.0})) if grown else problem
    found: list[LocalOptimum] = []
    others: list[Array] = []
    known: list[int] = []
    while True:
        inside = _within(problem.measurements, begin, end)
        part = own.part(inside)
        graph, whole = PoseGraph(part, keyframes), part.active_users == problem.active_users and inside.all()
        if not found:
            first = stage(progress, 0.0, 1.0 if whole else 0.3)
            known_starts = [_begun(graph, frames, calibration) for frames, calibration in begun]
            others_found = [s for s in starts_of(graph, parameters.search.sigma) if not _about(graph, s, known_starts)]
            found = find_optima(graph, [*known_starts, *others_found], first)
            excluded = found[0].cost + parameters.integrity.cost_excluded_nlos
            others = [s.states.anchor_poses for s in found[1:_MOST_GROWN] if s.cost < excluded]
        else:
            progress(float(np.clip(inside.mean(), 0.3, 1.0)))
            found = [approach(graph, _extended_states(graph, found[0], known), graph.parameters.search.annealing)]
        known = part.active_users
        if whole:
            break
        length = end - begin
        begin, end = begin - 0.5 * length, end + 0.5 * length
    if grown:
        # Other optima of the first segment are optimised on the whole recording too.
        best, states = found[0], found[0].states
        elsewhere = [np.where(np.isnan(frames), states.anchor_poses, frames) for frames in others]
        found += [approach(best.graph, states._replace(anchor_poses=frames), 1.0) for frames in elsewhere]
        found = [approach(PoseGraph(problem, keyframes), s.states, 1.0) for s in found]
    return sorted(found, key=by_cost)


def _first_segment(problem: Problem) -> tuple[float, float]:
    """Begin and end (s) of the earliest segment of `first_stretch` s with the most users connected to the reference."""
    measurements, length = problem.measurements, problem.parameters.search.first_stretch
    if not len(measurements) or np.ptp(measurements.t) <= _WHOLE * length:
        return -np.inf, np.inf
    # Segments in which there are ranges: sessions may lie weeks apart, and a stamp be decades astray.
    step = 0.5 * length
    begins = measurements.t.min() + step * np.unique((measurements.t - measurements.t.min()) // step)
    linked = [len(problem.part(_within(measurements, b, b + length)).active_users) for b in begins.tolist()]
    begin = float(begins[int(np.argmax(linked))])
    return begin, begin + length


def _within(measurements: RangeMeasurements, begin: float, end: float) -> Mask:
    return np.asarray((measurements.t >= begin) & (measurements.t <= end))


def _begun(graph: PoseGraph, frames: Array, calibration: Array) -> States:
    """SLAM's own poses with anchors where frames (k, 4) about the users' own origins put them."""
    scale = np.exp(calibration[:, SCALE])[:, None]
    turn = np.column_stack([np.zeros((len(frames), 3)), frames[:, 3]])
    anchors = frames.copy()
    anchors[:, :3] += apply_frames(turn, scale * np.array([k.anchor for k in graph.keyframes]))
    return graph.initial_states(relative_to(anchors, graph.reference), calibration)


def _about(graph: PoseGraph, states: States, others: list[States]) -> bool:
    """Whether states have everybody about where some others have them: both lead to the same optimum."""
    here = states.anchor_poses[graph.active_users]
    for other in others:
        off = difference(here, other.anchor_poses[graph.active_users])
        if (np.linalg.norm(off[:, :3], axis=1) < _ABOUT_M).all() and (np.abs(off[:, 3]) < _ABOUT_RAD).all():
            return True
    return False


def starts_of(graph: PoseGraph, slam_sigma: float = 0.0) -> list[States]:
    """Starts from the global search with rigid SLAM; ranges' sigmas include `slam_sigma` (m) for what is not rigid."""
    middle = centroids(graph.measurements, len(graph.users))
    about_middle = graph.problem.with_measurements(centered(graph.measurements, middle))
    found = joint_placements(about_middle.widened(slam_sigma))
    anchors = np.array([k.anchor for k in graph.keyframes]) - middle
    about_anchors = [np.column_stack([apply_frames(h.frames, anchors), h.frames[:, 3]]) for h in found]
    return [graph.initial_states(relative_to(frames, graph.reference)) for frames in about_anchors]


def _extended_states(graph: PoseGraph, before: LocalOptimum, known: list[int]) -> States:
    """The states of a shorter segment as a start for a longer one; new users are added where they fit best."""
    states = before.states._replace(anchor_poses=before.states.anchor_poses.copy())
    new = [u for u in graph.active_users if u not in known]
    while new:
        frames = np.full_like(states.anchor_poses, np.nan)
        frames[known] = states.anchor_poses[known]
        rigid = graph.rigid_problem(states._replace(anchor_poses=frames))
        user = max(new, key=lambda u: ties(rigid.measurements, u, known))
        grown = extend(rigid.widened(graph.parameters.search.sigma), [Candidate(frames, 0.0)], user)
        states.anchor_poses[user] = grown[0].frames[user]
        known, new = [*known, user], [u for u in new if u != user]
    return states


def ties(measurements: RangeMeasurements, user: int, known: list[int]) -> int:
    """Number of ranges between a user and the known ones."""
    there: Array = np.isin(measurements.j, known) & (measurements.i == user) | np.isin(measurements.i, known) & (
        measurements.j == user
    )
    return int(there.sum())
