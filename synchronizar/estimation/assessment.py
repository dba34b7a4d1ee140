"""What the minima of an anchored graph mean: frames about the users' own origins, states, devices, tracks."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.data.track import Track
from synchronizar.estimation.hypotheses import Hypothesis, hypotheses
from synchronizar.estimation.integrity import Verdict, nearness, verdicts
from synchronizar.estimation.local_optima import LocalOptimum
from synchronizar.estimation.outcome import Outcome
from synchronizar.estimation.residual_statistics import ResidualStatistics
from synchronizar.estimation.slips import slips
from synchronizar.geometry import apply_frames, multiply_quaternions, wrap_angle, yaw_of_quaternions, yaw_quaternion
from synchronizar.graph.marginals import Marginals, marginals
from synchronizar.graph.pose_graph import PoseGraph, calibration_sigmas
from synchronizar.graph.states import BIAS, CLOCK, SCALE, States, common_track
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.extent import extent_points
from synchronizar.preprocessing.range_measurements import RangeMeasurements
from synchronizar.preprocessing.relocalizations import RepairedTrack


class Assessment(NamedTuple):
    """What is told of each user where its track ends."""

    said: list[Verdict | None]
    """None for those that no chain of ranges ties to the reference."""
    hypotheses: list[Hypothesis]
    """Joint placements of the last keyframes, best first, in the graph's frame."""
    covariances: Array
    """(k, 6, 6) of the best one's: additive errors in x, y, z, yaw, in the log scale, in the reference's."""
    joint: Array
    """(k, 6, k, 6) those of all users at once, the best minimum's alone."""
    inlier_probability: Array
    """(n,) the probability that each sample is."""
    weight: Array
    """(n,) 1/m^2, of each sample."""
    extent: Array
    """(k, c, 3) m: what bounds each walk, about its last keyframe, in its own axes."""
    progress: Array
    """(k,) 0 .. 1 of how near each user is to being registered; NaN for users that are not placed."""
    calibration_sigma: Array
    """(k, 3) 1 sigma of log scale, bias (m) and clock (s); NaN where a radio has none."""


def tell(
    minima: list[LocalOptimum],
    repaired: Recording,
    parameters: Parameters,
    registered: Collection[int] = (),
    sure: Marginals | None = None,
) -> Assessment:
    """States, and how sure the best placement is; `registered` are users that were so before.

    `sure` is how sure the best minimum is, where that is known.
    """
    best = minima[0]
    graph, states = best.graph, best.states
    weight, inlier_probability = graph.inlier_probability(states, best.em_weights)
    if sure is None:
        sure = marginals(graph, states, best.em_weights)
    calibrations = np.where(_static(repaired)[:, None] & (np.arange(3) != BIAS), np.nan, sure.calibrations)
    extent = _corners(repaired, graph, states)

    def relative(s: LocalOptimum) -> Array:
        return (sure if s is best else marginals(s.graph, s.states, s.em_weights)).relative

    told = hypotheses(minima, relative, extent, parameters)
    fit = {u: ResidualStatistics(1.0, _rejected(graph.measurements, inlier_probability, u)) for u in graph.free}
    said = [
        _with_device(v, calibrations[u], parameters)
        for u, v in enumerate(verdicts(told, fit, graph, extent, parameters, registered))
    ]
    heights = states.anchor_poses[:, 2] - states.anchor_poses[graph.reference, 2]
    marginal_prior = (
        () if graph.marginal_prior is None else graph.marginal_prior.users
    )  # whose heights have drifted since
    said = [
        v
        if v is None or u in marginal_prior
        else _with_height(v, float(heights[u]), float(np.sqrt(graph.prior_variances(u)[2])), parameters)
        for u, v in enumerate(said)
    ]
    # How sure it is, is judged beside the reference as it is now, and told in the frame of its first pose: what the
    # minima differ by adds to both.
    covariances = sure.poses.copy()
    covariances[:, :4, :4] += told[0].covariances - sure.relative
    near = np.full(len(graph.users), np.nan)
    near[graph.reference] = 1.0
    for u in graph.free:
        near[u] = min(1.0, nearness(told[0], u, graph.users[u].static, extent[u], parameters))
    if len(told) > 1:  # as far as the next best joint placement is excluded
        near *= min(1.0, max(told[1].cost - told[0].cost, 0.0) / parameters.integrity.cost_excluded_nlos)
        near[graph.reference] = 1.0
    weight = weight * best.em_weights.range_weight / graph.sigma**2
    return Assessment(
        said, told, covariances, sure.joint, inlier_probability, weight, extent, near, np.sqrt(calibrations)
    )


def outcome(
    recording: Recording,
    repaired: Recording,
    repaired_tracks: dict[str, RepairedTrack],
    minima: list[LocalOptimum],
    noise: Array,
    searched: float,
    parameters: Parameters,
) -> Outcome:
    """All of it, in the frame of the reference's first pose; `repaired` is the recording with mended tracks."""
    best = minima[0]
    graph, states = best.graph, best.states
    users, k = recording.users, len(recording.users)
    told = tell(minima, repaired, parameters)
    scale = np.where(_static(recording), 1.0, np.exp(states.calibration[:, SCALE]))
    last_own, turned = np.zeros((k, 3)), np.zeros(k)
    for u, user in enumerate(users):
        if not user.static:
            last_own[u] = recording.tracks[user.name].position[-1]
            turned[u] = yaw_of_quaternions(repaired_tracks[user.name].repaired_from_slam[-1:])[0]
    origin = scale[graph.reference] * graph.keyframes[graph.reference].anchor
    frames = [about_own(p.frames, turned, scale, last_own) for p in told.hypotheses]
    for of_placement in frames:
        of_placement[:, :3] += origin
    errors = errors_about_own(frames[0], scale, last_own)
    errors[:, :3, 5] = origin
    calibration = states.calibration.copy()
    calibration[:, SCALE] = scale
    sigma = told.calibration_sigma.copy()
    sigma[:, SCALE] *= scale
    tracks = {}
    jumps = {name: of_user.jumps for name, of_user in repaired_tracks.items()}
    for u, user in enumerate(users):
        if user.static or u not in graph.active_users:
            continue
        found = [*jumps[user.name], *slips(states, graph, u, repaired.tracks[user.name])]
        jumps[user.name] = tuple(sorted(found, key=lambda jump: jump.t))
        track, _ = common_track(states, u, graph.keyframes[u], repaired.tracks[user.name])
        moved = _moved(track, best.frames[u], told.hypotheses[0].frames[u])
        tracks[user.name] = replace(moved, position=moved.position + origin)
    return Outcome(
        searched=searched,
        said=told.said,
        costs=[p.cost for p in told.hypotheses],
        frames=frames,
        covariances=errors @ told.covariances @ errors.transpose(0, 2, 1),
        joint=np.einsum("uac,ucvd,vbd->uavb", errors, told.joint, errors, optimize=True),
        errors=errors[:, :, :4],
        scale=scale,
        measurements=graph.measurements,
        weight=told.weight,
        inlier_probability=told.inlier_probability,
        residual=-graph.residuals(states),
        calibration=calibration,
        calibration_sigma=sigma,
        slam_noise=np.where(_static(recording)[:, None], np.nan, noise),
        tracks=tracks,
        jumps=jumps,
    )


def _static(recording: Recording) -> Mask:
    return np.array([user.static for user in recording.users])


def _moved(track: Track, best: Array, mean: Array) -> Track:
    """A track as the best minimum has it, moved and turned as a whole so that it ends where the mean of all has it.

    `best` and `mean` (4,) are x, y, z, yaw of the last keyframe.
    """
    turn = wrap_angle(float(mean[3] - best[3]))
    position = apply_frames(np.array([*mean[:3], turn]), track.position - best[:3])
    return replace(track, position=position, quat_xyzw=multiply_quaternions(yaw_quaternion(turn), track.quat_xyzw))


def _corners(repaired: Recording, graph: PoseGraph, states: States) -> Array:
    """(k, c, 3) m: what bounds each walk, about its last keyframe."""
    extent = extent_points(repaired)
    last = np.array([of_user.place[-1] for of_user in graph.keyframes])
    return np.asarray(np.exp(states.calibration[:, SCALE])[:, None, None] * (extent - last[:, None]))


def _rejected(measurements: RangeMeasurements, inlier_probability: Array, user: int) -> float:
    mine = (measurements.i == user) | (measurements.j == user)
    return float((inlier_probability[mine] < 0.5).mean()) if mine.any() else 0.0


def _with_height(said: Verdict, above: float, sigma: float, parameters: Parameters) -> Verdict:
    """The verdict; nobody is registered whose SLAM origin would lie where the prior has next to none."""
    if said.state is not State.REGISTERED or abs(above) < parameters.integrity.height_contradicted * sigma:
        return said
    side = "above" if above > 0.0 else "below"
    reason = (
        f"its origin would lie {abs(above):.1f} m {side} the reference's: if that can be, its height_sigma is larger"
    )
    return said._replace(state=State.UNOBSERVABLE, reason=reason)


def _with_device(said: Verdict | None, variances: Array, parameters: Parameters) -> Verdict | None:
    """The verdict, with what of the device its priors determine rather than the ranges."""
    if said is None:
        return None
    own, common = calibration_sigmas(parameters)
    prior = own**2 + common**2
    names = {SCALE: "scale", BIAS: "range_bias", CLOCK: "clock_offset"}
    dominated = [name for column, name in names.items() if variances[column] > 0.5 * prior[column]]
    return said._replace(prior_dominated=(*said.prior_dominated, *dominated))


def about_own(frames: Array, turned: Array, scale: Array, last_own: Array) -> Array:
    """Frames (k, 4) of the last keyframes -> of the users' own origins, so that p_common = Rz(yaw) scale p_own + x y z.

    `turned` (k,) rad: what mending turned SLAM's axes by at the end; `last_own` (k, 3) the last pose as SLAM has it.
    """
    out = frames.copy()
    out[:, 3] = wrap_angle(frames[:, 3] + turned)
    turn = np.column_stack([np.zeros((len(out), 3)), out[:, 3]])
    out[:, :3] -= apply_frames(turn, scale[:, None] * last_own)
    return out


def errors_about_own(frames: Array, scale: Array, last_own: Array) -> Array:
    """(k, 4, 6) derivatives of `about_own` by x, y, z, yaw of the last keyframe, its log scale, the reference's."""
    out = np.zeros((len(frames), 4, 6))
    out[:, :, :4] = np.eye(4)
    turn = np.column_stack([np.zeros((len(frames), 3)), frames[:, 3]])
    arm = apply_frames(turn, scale[:, None] * last_own)
    out[:, 0, 3], out[:, 1, 3] = arm[:, 1], -arm[:, 0]
    out[:, :3, 4] = -arm
    return out
