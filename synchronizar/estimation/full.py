"""Batch registration under the full model: drift, jumps, scale, clock offset and radio bias in one pose graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration, UserRegistration
from synchronizar.data.track import Track
from synchronizar.estimation.answer import OwnFrames, registration_of
from synchronizar.estimation.assessment import Assessment, assess_calibrated
from synchronizar.estimation.comparing import BETTER, by_cost, compare, nlos_share
from synchronizar.estimation.far_drift import Searched, far_noise, searched
from synchronizar.estimation.lasting import measured_noise
from synchronizar.estimation.measured_weights import (
    refine,
    with_devices_trusted,
    with_measured_weights,
    with_noise_alone,
)
from synchronizar.estimation.optimum_images import images
from synchronizar.estimation.other_entries import other_entries
from synchronizar.estimation.other_optima import is_at_other_heights, other_heights, other_places, otherwise_held
from synchronizar.estimation.segments import keyframes_of_all
from synchronizar.estimation.slips import slips
from synchronizar.geometry import apply_frames, difference, wrap_angle
from synchronizar.graph.calibration_priors import with_measured_priors
from synchronizar.graph.pose_graph import LocalOptimum, PoseGraph
from synchronizar.graph.problem import Problem
from synchronizar.graph.states import SCALE, common_track
from synchronizar.graph.step_noise import StepNoise
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.raised import lowered, raised_by
from synchronizar.preprocessing.relocalizations import RepairedTrack, repair_relocalizations
from synchronizar.progress import Progress, stage, unheard
from synchronizar.quaternions import multiply_quaternions, yaw_of_quaternions, yaw_quaternion

_HEIGHT_ROUNDS = 6  # in each of which one device may prove to be held otherwise
_OTHER_UNIT = 2.0  # in scale
_ROUNDS = 4  # of expectation maximisation once priors are measured


class Solved(NamedTuple):
    """Result of the batch solve of a recording."""

    minima: list[LocalOptimum]
    """The local optima that explain the ranges, best first."""
    noise: StepNoise
    """Of each user's steps."""
    searched: float
    """s, perf_counter at the end of the search."""


def register_full(recording: Recording, reference: int, parameters: Parameters, progress: Progress) -> Registration:
    """The registration of a recording: every user's frame, drift, scale, clock offset, radio bias and verdict."""
    began = perf_counter()
    raised = raised_by(recording, parameters)
    recording = lowered(recording, raised)
    repaired_tracks = {name: repair_relocalizations(track, parameters) for name, track in recording.tracks.items()}
    repaired = replace(recording, tracks={name: of_user.track for name, of_user in repaired_tracks.items()})
    problem = Problem.of(repaired, reference, parameters)
    optima, (used, _, told), searched = solve(problem, repaired_tracks, stage(progress, 0.0, 0.9))
    assessed = _as_it_drifts(assess_calibrated(optima, told), problem, repaired_tracks, used)
    own = _own_frames(recording, repaired_tracks, assessed.optimum, raised)
    registration = registration_of(assessed, own, len(recording.ranges), {})
    users = {
        user.name: _with_slam(registration.users[user.name], u, repaired_tracks[user.name], assessed, own, told[u])
        for u, user in enumerate(recording.users)
        if not user.static
    }
    seconds = {"load": 0.0, "initialise": searched - began, "solve": perf_counter() - searched}
    return replace(registration, users={**registration.users, **users}, seconds=seconds)


def _as_it_drifts(assessed: Assessment, problem: Problem, tracks: dict[str, RepairedTrack], used: Array) -> Assessment:
    """The same with everybody where SLAM that drifts by these factors (k, 2) has them, and known as before.

    Where it drifts less than while optima were compared, walks bend less. Unless that leads to another placement: which
    one is right was decided before.
    """
    best = assessed.optimum
    keyframes = keyframes_of_all(problem, tracks, problem.parameters.slam.keyframe_interval, used, _units(best))
    near = best.graph.with_keyframes(keyframes).run_em(best.states, best.em_weights, _ROUNDS)
    shift = difference(near.frames, best.frames)
    if (np.linalg.norm(shift[best.graph.active_users, :3], axis=1) > problem.parameters.integrity.largest_error).any():
        return assessed
    moved = [of_all._replace(frames=of_all.frames + shift) for of_all in assessed.hypotheses]
    return assessed._replace(optimum=best._replace(states=near.states), hypotheses=moved)


def _own_frames(
    recording: Recording, repaired_tracks: dict[str, RepairedTrack], best: LocalOptimum, raised: Array
) -> OwnFrames:
    """How users' frames lie beside their last keyframes; the common frame is the reference's at its first pose.

    `raised` (k,): how high the recording's zeros lie in the users' own frames. A reference on a map stays where it
    begins, whatever its scale: the map's origin may be thousands of kilometres away.
    """
    k, graph = len(recording.users), best.graph
    scale, turned, last = np.ones(k), np.zeros(k), np.zeros((k, 3))
    for u, user in enumerate(recording.users):
        if not user.static:
            scale[u] = np.exp(best.states.calibration[u, SCALE])
            turned[u] = yaw_of_quaternions(repaired_tracks[user.name].repaired_from_slam[-1:])[0]
            last[u] = recording.tracks[user.name].position[-1] + np.array([0.0, 0.0, raised[u]])
    survey = recording.users[graph.reference].position
    if survey is not None:
        return OwnFrames(scale, turned, last, np.array([*survey, 0.0]), np.zeros(3))
    first = graph.keyframes[graph.reference].anchor + np.array([0.0, 0.0, raised[graph.reference]])
    if np.linalg.norm(first) > graph.parameters.priors.farthest_begin:
        return OwnFrames(scale, turned, last, np.append(first, 0.0), np.zeros(3))
    origin = scale[graph.reference] * first
    return OwnFrames(scale, turned, last, np.append(origin, 0.0), origin)


def _with_slam(
    user: UserRegistration,
    u: int,
    repaired: RepairedTrack,
    assessed: Assessment,
    own: OwnFrames,
    noise: Array,
) -> UserRegistration:
    """A user with a track, with what is known of its SLAM: jumps and slips, noise factors, the corrected track."""
    graph, states = assessed.optimum.graph, assessed.optimum.states
    jumps, track = repaired.jumps, repaired.track
    user = replace(user, slam_noise=None if u not in graph.active_users else (float(noise[0]), float(noise[1])))
    if u not in graph.active_users:
        return replace(user, jumps=jumps)
    found = [*jumps, *slips(states, graph, u, track)]
    common, _ = common_track(states, u, graph.keyframes[u], track)
    common = _moved(common, assessed.optimum.frames[u], assessed.hypotheses[0].frames[u])
    common = replace(common, position=common.position + own.common[:3])
    return replace(user, jumps=tuple(sorted(found, key=lambda jump: jump.t)), common_track=common)


def _moved(track: Track, optimum: Array, mean: Array) -> Track:
    """A track as the best optimum has it, moved and turned as a whole so that it ends where the mean of all has it.

    `optimum` and `mean` (4,) are x, y, z, yaw of the last keyframe.
    """
    turn = wrap_angle(float(mean[3] - optimum[3]))
    position = apply_frames(np.array([*mean[:3], turn]), track.position - optimum[:3])
    return replace(track, position=position, quat_xyzw=multiply_quaternions(yaw_quaternion(turn), track.quat_xyzw))


def solve(
    problem: Problem,
    repaired_tracks: dict[str, RepairedTrack],
    progress: Progress = unheard,
    begun: Sequence[tuple[Array, Array]] = (),
    whole: bool = True,
) -> Solved:
    """The local optima of a problem, solved without a start; the recording's tracks are `repaired_tracks`.

    `begun` are joint placements that were found before, to begin with besides: frames (k, 4) about the users' own
    origins, and calibrations (k, 3). Of `whole` recordings it is asked more of how far SLAM
    drifts: many times as far as usual (`far_drift`), or how far beside errors of ranges that last (`lasting`).
    """
    search = searched(problem, repaired_tracks, stage(progress, 0.0, 0.7), begun, whole)
    at = perf_counter()
    heights = [frames[:, 2] for frames, _ in begun]
    minima, noise = _refined(problem, repaired_tracks, search, heights, whole)
    progress(0.9)
    if len(minima) > 1 and minima[1].cost < minima[0].cost - BETTER:  # new range weights may change the order
        search = search._replace(found=[*minima[1:], *search.found])
        minima, noise = _refined(problem, repaired_tracks, search, heights, whole)
    return Solved(minima, noise, at)


def _refined(
    problem: Problem, repaired_tracks: dict[str, RepairedTrack], search: Searched, heights: Sequence[Array], whole: bool
) -> tuple[list[LocalOptimum], StepNoise]:
    """The first optimum at fine keyframes, the others that explain the ranges, and the noise of steps.

    All of them with priors of calibrations as wide as the ranges make likely (`calibration_priors`), and with the step
    noise that they show of each device (`step_noise`). `heights` (k,) m were found before.
    """
    found, interval, finest = search.found, search.interval, problem.parameters.slam.keyframe_interval
    first = found[0]
    unit = _units(first)
    begun_with = keyframes_of_all(problem, repaired_tracks, interval, search.far, unit)
    best = with_noise_alone(with_measured_weights(first._replace(graph=first.graph.with_keyframes(begun_with))))
    if search.far is None:
        best = with_devices_trusted(best)
    for again in (True, False):
        graph, usual = with_measured_priors(best.graph, best.states, best.em_weights), best.held_as_usual
        priors = graph.calibration_priors
        best = graph.run_em(best.states, best.em_weights, _ROUNDS)
        if search.far is not None:
            far = far_noise(best, problem, repaired_tracks)
            noise = StepNoise(far, far, far)
        else:
            noise = measured_noise(
                best, keyframes_of_all(problem, repaired_tracks, finest, None, unit) if whole else None
            )
        coarse = keyframes_of_all(problem, repaired_tracks, interval, noise.sought, unit)
        best, others = _likeliest_held(best._replace(graph=best.graph.with_keyframes(coarse)))
        if not again or np.array_equal(best.held_as_usual, usual):
            break
        # What other heights explain passed for drift, biases and noise: all of that is measured once more.
        best = with_measured_weights(best._replace(graph=best.graph.with_keyframes(begun_with)))
    fine = keyframes_of_all(problem, repaired_tracks, finest, noise.sought, unit)
    found = [s._replace(graph=s.graph.with_calibration_priors(priors).with_keyframes(coarse)) for s in found]
    others += [*other_heights(best, heights), *other_entries(best)]
    if nlos_share(best) > problem.parameters.search.doubtful_share:
        others += other_places(best)
    better = min(others, key=by_cost, default=best)
    if better.cost < best.cost - BETTER:
        best, others = better, [best, *(s for s in others if s is not better)]
    if is_at_other_heights(best, first):
        others += images(best)
    most = best.cost + problem.parameters.integrity.cost_excluded_nlos
    found, others = [best, *found[1:]], [s for s in others if s.cost < most]
    graph = PoseGraph(problem, fine).with_calibration_priors(priors).with_held_as_usual(best.graph.held_as_usual)
    best, *others = compare(found, refine(best, graph), others)
    told = keyframes_of_all(problem, repaired_tracks, interval, noise.told, unit)
    minima = [s._replace(graph=s.graph.with_keyframes(told)) for s in others]
    told = keyframes_of_all(problem, repaired_tracks, finest, noise.told, unit)
    return [best._replace(graph=best.graph.with_keyframes(told)), *minima], noise


def _units(optimum: LocalOptimum) -> Array:
    """(k,) m: the units of tracks that are not in metres, 1 of the others.

    SLAM drifts by the way walked, in metres: in centimetres ten times as far in heading. Within a factor of two the
    figures are no better known.
    """
    log_scale = optimum.states.calibration[:, SCALE]
    return np.where(np.abs(log_scale) > np.log(_OTHER_UNIT), np.exp(log_scale), 1.0)


def _likeliest_held(best: LocalOptimum) -> tuple[LocalOptimum, list[LocalOptimum]]:
    """The optimum in which devices are held as the ranges make likely, and others in which one of them is not."""
    others: list[LocalOptimum] = []
    for _ in range(_HEIGHT_ROUNDS):
        others += otherwise_held(best)
        better = min(others, key=by_cost, default=best)
        if better.cost > best.cost - BETTER:
            break
        best, others = better, [best, *(s for s in others if s is not better)]
    return best, others
