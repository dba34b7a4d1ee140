"""A search for users whose places are not known, or not proven: the batch solve's own, on a stretch of time."""

from __future__ import annotations

import numpy as np

from synchronizar.arrays import Array
from synchronizar.estimation.assessment import Assessment, assess_calibrated
from synchronizar.estimation.full import solve
from synchronizar.estimation.hypotheses import Hypothesis, places
from synchronizar.estimation.incremental.snapshot import (
    Candidate,
    Found,
    FoundRanges,
    FoundUser,
    Snapshot,
)
from synchronizar.geometry import apply_frames, difference, relative_to, wrap_angle
from synchronizar.graph.pose_graph import LocalOptimum
from synchronizar.graph.problem import Problem
from synchronizar.graph.states import CLOCK, SCALE, corrected
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.relocalizations import RepairedTrack
from synchronizar.quaternions import IDENTITY
from synchronizar.threads import one_blas_thread

_PARTING = 0.25  # of the largest error: optima that are further apart at some extent point may part
_MOST_CANDIDATES = 4


@one_blas_thread()
def search(snapshot: Snapshot) -> Found | None:
    """What the ranges of a stretch tell of the users in it; None where there are too few."""
    # While people walk contradictions tell: foreign ranges that are not over yet would pass for everybody's own.
    parameters = snapshot.parameters.changed(ranges={"foreign_share": 0.0})
    problem = Problem.of(snapshot.recording, snapshot.gauge, parameters)
    if len(problem.measurements) < parameters.incremental.search_fewest:
        return None
    repaired = {name: _repaired(snapshot, name) for name in snapshot.recording.tracks}
    minima, (_, _, told), _ = solve(problem, repaired, begun=_starts(snapshot, problem.active_users), whole=False)
    minima = [optimum for optimum in minima if _agrees(optimum, snapshot)] or minima
    assessed = assess_calibrated(minima, told, snapshot.registered, snapshot.parameters.incremental.judged_walk)
    users = {u: _found(snapshot, assessed, u) for u in problem.active_users}
    best = minima[0]
    measurements = best.graph.measurements
    return Found(
        snapshot.t,
        snapshot.gauge,
        best.graph.keyframes[snapshot.gauge].anchor,
        snapshot.poses,
        users,
        [(hypothesis.cost, hypothesis.frames) for hypothesis in assessed.hypotheses],
        tuple(_candidate(optimum, snapshot.clocks) for optimum in minima[:_MOST_CANDIDATES]),
        told,
        FoundRanges(
            snapshot.serial[measurements.row],
            assessed.inlier_probability,
            assessed.weight,
            -best.graph.residuals(best.states),
        ),
    )


def _repaired(snapshot: Snapshot, name: str) -> RepairedTrack:
    track = snapshot.recording.tracks[name]
    segment = snapshot.segments[name] - snapshot.segments[name][0]
    count = int(segment[-1]) + 1
    return RepairedTrack(
        track,
        (),
        segment,
        np.tile(IDENTITY, (count, 1)),
        np.ones(count, dtype=bool),
        snapshot.rebuilt_sigma[name],
    )


def _agrees(optimum: LocalOptimum, snapshot: Snapshot) -> bool:
    """Whether an optimum has those who are followed where they are followed to be, beside the gauge.

    What told the one mirror image from the other may be longer ago than a window reaches.
    """
    graph = optimum.graph
    known = [u for u in graph.active_users if u in snapshot.known and u != snapshot.gauge]
    if not known or snapshot.gauge not in snapshot.known:
        return True
    scale = np.exp(optimum.states.calibration[:, SCALE])
    last = np.array([of_user.place[-1] for of_user in graph.keyframes])
    there = np.full((len(graph.users), 4), np.nan)
    for u in (*known, snapshot.gauge):
        there[u] = np.append(apply_frames(snapshot.known[u], scale[u] * last[u]), snapshot.known[u][3])
    off = difference(relative_to(optimum.frames, snapshot.gauge), relative_to(there, snapshot.gauge))[known]
    limits = snapshot.parameters.integrity
    apart = np.linalg.norm(off[:, :2], axis=1)
    return bool((apart < limits.largest_error).all() and (np.abs(off[:, 3]) < limits.largest_yaw_error).all())


def _starts(snapshot: Snapshot, active_users: list[int]) -> list[tuple[Array, Array]]:
    """The candidates of the search before that have all active users: frames (k, 4), calibrations (k, 3)."""
    ahead = np.zeros((len(snapshot.clocks), 3))
    ahead[:, CLOCK] = snapshot.clocks
    return [
        (c.frames, c.calibration - ahead) for c in snapshot.candidates if not np.isnan(c.frames[active_users]).any()
    ]


def _candidate(optimum: LocalOptimum, clocks: Array) -> Candidate:
    """Where an optimum has each user's own frame, by its last keyframe."""
    graph, states = optimum.graph, optimum.states
    frames = graph.last_poses(states)
    scale = np.exp(states.calibration[:, SCALE])[:, None]
    last = np.array([of_user.place[-1] for of_user in graph.keyframes])
    turn = np.column_stack([np.zeros((len(frames), 3)), frames[:, 3]])
    frames[:, :3] -= apply_frames(turn, scale * last)
    calibration = states.calibration.copy()
    calibration[:, CLOCK] += clocks
    return Candidate(frames, calibration)


def _found(snapshot: Snapshot, assessed: Assessment, user: int) -> FoundUser:
    graph, states = assessed.optimum.graph, assessed.optimum.states
    verdict, sigma = assessed.verdicts[user], assessed.calibration_sigma
    assert verdict is not None
    assert sigma is not None
    poses, ahead = snapshot.poses[user], float(snapshot.clocks[user])
    calibration = states.calibration[user].copy()
    calibration[CLOCK] += ahead
    place, turned = corrected(states.keyframe_poses[user], graph.keyframes[user], poses.stamps - ahead, poses.places)
    frame = np.broadcast_to(states.anchor_poses[user], (len(place), 4))
    scale = float(np.exp(states.calibration[user, SCALE]))
    at = np.column_stack([apply_frames(frame, scale * place), wrap_angle(turned + states.anchor_poses[user, 3])])
    # As far as the mean over all optima lies beside the best one, about the last keyframe.
    best, mean = assessed.optimum.frames[user], assessed.hypotheses[0].frames[user]
    turn = wrap_angle(float(mean[3] - best[3]))
    last = np.append(
        apply_frames(np.array([*mean[:3], turn]), at[-1, :3] - best[:3]), wrap_angle(float(at[-1, 3] + turn))
    )
    return FoundUser(
        verdict,
        last,
        assessed.covariances[user],
        calibration,
        sigma[user],
        at[:-1],
        float(np.nan_to_num(assessed.progress[user])),
        _is_single(assessed.hypotheses[0], assessed.extent, user, graph.parameters),
        _rejected(snapshot, assessed, user),
        _height_spread(assessed.hypotheses[0], user),
        float(assessed.optimum.em_weights.height_weight[user]),
        graph.calibration_priors.own / np.sqrt(assessed.optimum.em_weights.calibration_weight[user]),
    )


def _is_single(best: Hypothesis, extent: Array, user: int, parameters: Parameters) -> bool:
    components, least = best.components_of(user), parameters.integrity.wrong_share
    total = sum(m.weight for m in components)
    likely = [components[0], *(m for m in components[1:] if m.weight > least * total)]
    where = np.array([places(m.frames, extent)[user, :, :2] for m in likely])
    return bool(np.linalg.norm(where - where[0], axis=2).max() < _PARTING * parameters.integrity.largest_error)


def _height_spread(best: Hypothesis, user: int) -> float:
    components = best.components_of(user)
    heights, weight = np.array([m.frames[user, 2] for m in components]), np.array([m.weight for m in components])
    mean = float(weight @ heights / weight.sum())
    return float(weight @ (heights - mean) ** 2 / weight.sum())


def _rejected(snapshot: Snapshot, assessed: Assessment, user: int) -> float:
    """The share of a user's latest ranges that are more likely NLOS, or outliers, than inliers."""
    measurements = assessed.optimum.graph.measurements
    recent = measurements.t > snapshot.t - snapshot.parameters.incremental.recent
    mine = recent & ((measurements.i == user) | (measurements.j == user))
    enough = mine.sum() >= snapshot.parameters.integrity.share_fewest
    return float((assessed.inlier_probability[mine] < 0.5).mean()) if enough else 0.0
