"""A search for users whose places are not known, or not proven: the batch solve's own, on a stretch of time."""

from __future__ import annotations

import numpy as np

from synchronizar.arrays import Array
from synchronizar.estimation.assessment import Assessment, assess_calibrated
from synchronizar.estimation.full import keyframes_of_all, solve
from synchronizar.estimation.hypotheses import Hypothesis, places
from synchronizar.estimation.incremental.snapshot import (
    Candidate,
    Found,
    FoundRanges,
    FoundUser,
    Snapshot,
)
from synchronizar.estimation.initialisation import Candidate as Placement
from synchronizar.estimation.initialisation import extend
from synchronizar.estimation.local_optima import compare, find_optima
from synchronizar.estimation.segments import coarse_interval, ties
from synchronizar.geometry import apply_frames, wrap_angle
from synchronizar.graph.marginal_prior import MarginalPrior
from synchronizar.graph.pose_graph import LocalOptimum, PoseGraph
from synchronizar.graph.problem import Problem
from synchronizar.graph.states import SCALE, States, corrected
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.relocalizations import RepairedTrack
from synchronizar.quaternions import IDENTITY
from synchronizar.threads import one_blas_thread

FEWEST_RANGES = 20  # fewer tell nothing worth a search
_PARTING = 0.25  # of the largest error: optima that are further apart at some extent point may part
_MOST_CANDIDATES = 4


@one_blas_thread()
def search(snapshot: Snapshot) -> Found | None:
    """What the ranges of a stretch tell of the users in it; None where there are too few."""
    problem = Problem.of(snapshot.recording, snapshot.gauge, snapshot.parameters)
    if len(problem.measurements) < FEWEST_RANGES:
        return None
    repaired = {name: _repaired(snapshot, name) for name in snapshot.recording.tracks}
    prior = _of_active(snapshot.prior, problem.active_users)
    if prior is None:
        minima, noise, _ = solve(problem, repaired)
    else:
        minima, noise = _beside_known(problem, repaired, prior, snapshot), snapshot.noise
    assessed = assess_calibrated(minima, snapshot.registered)
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
        tuple(_candidate(optimum) for optimum in minima[:_MOST_CANDIDATES]),
        noise,
        float(best.em_weights.range_weight.mean()),
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
    return RepairedTrack(track, (), segment, np.tile(IDENTITY, (count, 1)), np.ones(count, dtype=bool))


def _of_active(prior: MarginalPrior | None, active_users: list[int]) -> MarginalPrior | None:
    if prior is None:
        return None
    prior = prior.without({u for u in prior.users if u not in active_users})
    return prior if prior.free else None


def _beside_known(
    problem: Problem, repaired: dict[str, RepairedTrack], prior: MarginalPrior, snapshot: Snapshot
) -> list[LocalOptimum]:
    """Optima with those who are followed about where they are known, the others wherever their ranges allow."""
    parameters = problem.parameters
    interval = max(parameters.slam.keyframe_interval, coarse_interval(problem))
    graph = PoseGraph(problem, keyframes_of_all(problem, repaired, interval, snapshot.noise), prior)
    begun = graph.initial_states(prior.frames, prior.calibration)
    found = find_optima(graph, _starts(graph, begun, prior))
    best = found[0]
    weighted = best.graph.with_range_weights(best.states, best.em_weights)
    return compare(found, best.graph.run_em(best.states, weighted, 2))


def _starts(graph: PoseGraph, begun: States, prior: MarginalPrior) -> list[States]:
    """States with those who are new wherever their ranges to all others allow."""
    frames = np.full_like(begun.anchor_poses, np.nan)
    frames[prior.users] = begun.anchor_poses[prior.users]
    somewhere = begun._replace(anchor_poses=np.nan_to_num(begun.anchor_poses))
    wide = graph.rigid_problem(somewhere).widened(graph.parameters.search.sigma)
    alive = [Placement(frames, 0.0)]
    coming = [u for u in graph.active_users if u not in prior.users]
    while coming:
        there = np.flatnonzero(~np.isnan(alive[0].frames[:, 0])).tolist()
        user = max(coming, key=lambda u: ties(wide.measurements, u, there))
        coming.remove(user)
        alive = extend(wide, alive, user)
    return [begun._replace(anchor_poses=h.frames) for h in alive]


def _candidate(optimum: LocalOptimum) -> Candidate:
    """Where an optimum has each user's own frame, by its last keyframe."""
    graph, states = optimum.graph, optimum.states
    frames = graph.last_poses(states)
    scale = np.exp(states.calibration[:, SCALE])[:, None]
    last = np.array([of_user.place[-1] for of_user in graph.keyframes])
    turn = np.column_stack([np.zeros((len(frames), 3)), frames[:, 3]])
    frames[:, :3] -= apply_frames(turn, scale * last)
    return Candidate(frames, states.calibration.copy())


def _found(snapshot: Snapshot, assessed: Assessment, user: int) -> FoundUser:
    graph, states = assessed.optimum.graph, assessed.optimum.states
    verdict, sigma = assessed.verdicts[user], assessed.calibration_sigma
    assert verdict is not None
    assert sigma is not None
    poses = snapshot.poses[user]
    place, turned = corrected(states.keyframe_poses[user], graph.keyframes[user], poses.stamps, poses.places)
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
        states.calibration[user].copy(),
        sigma[user],
        at[:-1],
        float(np.nan_to_num(assessed.progress[user])),
        _is_single(assessed.hypotheses[0], assessed.extent, user, graph.parameters),
        _rejected(snapshot, assessed, user),
    )


def _is_single(best: Hypothesis, extent: Array, user: int, parameters: Parameters) -> bool:
    where = np.array([places(m.frames, extent)[user, :, :2] for m in best.components_of(user)])
    return bool(np.linalg.norm(where - where[0], axis=2).max() < _PARTING * parameters.integrity.largest_error)


def _rejected(snapshot: Snapshot, assessed: Assessment, user: int) -> float:
    """The share of a user's latest ranges that are more likely NLOS, or outliers, than inliers."""
    measurements = assessed.optimum.graph.measurements
    recent = measurements.t > snapshot.t - snapshot.parameters.incremental.recent
    mine = recent & ((measurements.i == user) | (measurements.j == user))
    return float((assessed.inlier_probability[mine] < 0.5).mean()) if mine.sum() >= FEWEST_RANGES else 0.0
