"""The full model: SLAM may drift, jump, have a wrong scale and clock, radios a bias; one graph for all of it."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

import numpy as np

from synchronizar.anchored import AnchoredGraph, device_sigmas
from synchronizar.arrays import Array, Mask
from synchronizar.corners import corners_of
from synchronizar.geometry import (
    apply_frames,
    multiply_quaternions,
    wrap_angle,
    yaw_of_quaternions,
    yaw_quaternion,
)
from synchronizar.initialise import connected
from synchronizar.jumps import Mended, mend
from synchronizar.keyframes import STANDING, Keyframes, keyframes_of
from synchronizar.misfit import Misfit
from synchronizar.model import Model
from synchronizar.outcome import Outcome
from synchronizar.placement import placements
from synchronizar.recording import Recording
from synchronizar.samples import Samples, samples_of
from synchronizar.settled import BETTER, Settled, compare, measured, refine
from synchronizar.slips import slips
from synchronizar.spans import coarse_interval, search_and_grow
from synchronizar.step_noise import step_noise
from synchronizar.sureness import sureness
from synchronizar.track import Track
from synchronizar.verdict import Verdict, verdicts
from synchronizar.walks import BIAS, CLOCK, SCALE, Walks, common_track


def register_full(recording: Recording, reference: int, model: Model) -> Outcome:
    """Everybody's frame, drift, scale, clock and radio bias."""
    users = recording.users
    mended = {name: mend(track, model) for name, track in recording.tracks.items()}
    smooth = replace(recording, tracks={name: of_user.track for name, of_user in mended.items()})
    samples = samples_of(smooth, model)
    placed = connected(samples, len(users), reference)
    samples = samples[np.isin(samples.i, placed)]

    coarse = _keyframes(recording, mended, coarse_interval(samples, model), model)
    found = search_and_grow(smooth, samples, coarse, placed, reference, model)
    searched = perf_counter()
    graph = AnchoredGraph(
        smooth, samples, _keyframes(recording, mended, model.keyframe_interval, model), placed, reference, model
    )
    minima, noise = _refined(recording, mended, found, graph, model)
    if len(minima) > 1 and minima[1].cost < minima[0].cost - BETTER:  # what ranges are worth may turn their order
        minima, noise = _refined(recording, mended, [minima[1], *found], graph, model)
    return _outcome(recording, smooth, mended, minima, noise, searched, model)


def _refined(
    recording: Recording, mended: dict[str, Mended], found: list[Settled], graph: AnchoredGraph, model: Model
) -> tuple[list[Settled], Array]:
    """The first minimum at the keyframes of `graph`, those others that explain the ranges too, and the noise of SLAM.

    All with the noise (k, 2) that each device's SLAM is found to have.
    """
    best = measured(found[0])
    noise = step_noise(best.graph, best.walks, best.judgement)
    coarse = _keyframes(recording, mended, coarse_interval(graph.samples, model), model, noise)
    fine = _keyframes(recording, mended, model.keyframe_interval, model, noise)
    found = [s._replace(graph=s.graph.with_keyframes(coarse)) for s in found]
    best = best._replace(graph=found[0].graph)
    return compare(found, refine(best, graph.with_keyframes(fine)), model), noise


def _keyframes(
    recording: Recording, mended: dict[str, Mended], interval: float, model: Model, noise: Array | None = None
) -> list[Keyframes]:
    """`noise` (k, 2): how many times as far as the model says each SLAM drifts; None where that is not known."""
    times = np.ones((len(recording.users), 2)) if noise is None else noise
    return [
        STANDING if user.static else keyframes_of(mended[user.name], interval, model, (place, heading))
        for user, (place, heading) in zip(recording.users, times.tolist(), strict=True)
    ]


def _outcome(
    recording: Recording,
    smooth: Recording,
    mended: dict[str, Mended],
    minima: list[Settled],
    noise: Array,
    searched: float,
    model: Model,
) -> Outcome:
    best = minima[0]
    graph, walks = best.graph, best.walks
    users, k = recording.users, len(recording.users)
    samples = graph.samples
    weight, honest = graph.honest(walks, best.judgement)
    sure = sureness(graph, walks, best.judgement)
    devices = np.where(_static(recording)[:, None] & (np.arange(3) != BIAS), np.nan, sure.devices)
    corners = _corners(smooth, graph, walks)
    told = placements(
        minima,
        lambda s: (sure if s.graph is graph else sureness(s.graph, s.walks, s.judgement)).relative,
        corners,
        model,
    )
    fit = {u: Misfit(1.0, _rejected(samples, honest, u)) for u in graph.free}
    said = verdicts(told, fit, graph, corners, model)
    said = [_with_device(v, devices[u], model) for u, v in enumerate(said)]

    scale = np.where(_static(recording), 1.0, np.exp(walks.device[:, SCALE]))
    last_own, turned = np.zeros((k, 3)), np.zeros(k)
    for u, user in enumerate(users):
        if not user.static:
            last_own[u] = recording.tracks[user.name].position[-1]
            turned[u] = yaw_of_quaternions(mended[user.name].mended_from_slam[-1:])[0]
    origin = scale[graph.reference] * graph.keyframes[graph.reference].anchor
    frames = [_about_own(p.frames, turned, scale, last_own, origin) for p in told]
    errors = _errors(frames[0], scale, last_own, origin)
    # How sure it is, is judged beside the reference as it is now, and told in the frame of its first pose: what the
    # minima differ by adds to both.
    poses = sure.poses.copy()
    poses[:, :4, :4] += told[0].covariances - sure.relative
    device = walks.device.copy()
    device[:, SCALE] = scale
    sigma = np.sqrt(devices)
    sigma[:, SCALE] *= scale
    tracks = {}
    jumps = {name: of_user.jumps for name, of_user in mended.items()}
    for u, user in enumerate(users):
        if user.static or u not in graph.placed:
            continue
        found = [*jumps[user.name], *slips(walks, graph, u, smooth.tracks[user.name])]
        jumps[user.name] = tuple(sorted(found, key=lambda jump: jump.t))
        track, _ = common_track(walks, u, graph.keyframes[u], smooth.tracks[user.name])
        moved = _moved(track, best.frames[u], told[0].frames[u])
        tracks[user.name] = replace(moved, position=moved.position + origin)
    return Outcome(
        searched=searched,
        said=said,
        costs=[p.cost for p in told],
        frames=frames,
        covariances=errors @ poses @ errors.transpose(0, 2, 1),
        errors=errors[:, :, :4],
        scale=scale,
        samples=samples,
        weight=weight * best.judgement.worth / graph.sigma**2,
        honest=honest,
        residual=-graph.residuals(walks),
        device=device,
        device_sigma=sigma,
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


def _corners(smooth: Recording, graph: AnchoredGraph, walks: Walks) -> Array:
    """(k, c, 3) m: what bounds each walk, about its last keyframe."""
    corners = corners_of(smooth)
    last = np.array([of_user.place[-1] for of_user in graph.keyframes])
    return np.asarray(np.exp(walks.device[:, SCALE])[:, None, None] * (corners - last[:, None]))


def _rejected(samples: Samples, honest: Array, user: int) -> float:
    mine = (samples.i == user) | (samples.j == user)
    return float((honest[mine] < 0.5).mean()) if mine.any() else 0.0


def _with_device(said: Verdict | None, variances: Array, model: Model) -> Verdict | None:
    """The verdict, with what of the device its priors determine rather than the ranges."""
    if said is None:
        return None
    own, common = device_sigmas(model)
    prior = own**2 + common**2
    names = {SCALE: "scale", BIAS: "range_bias", CLOCK: "clock_offset"}
    dominated = [name for column, name in names.items() if variances[column] > 0.5 * prior[column]]
    return said._replace(prior_dominated=(*said.prior_dominated, *dominated))


def _about_own(frames: Array, turned: Array, scale: Array, last_own: Array, origin: Array) -> Array:
    """Frames (k, 4) of the last keyframes -> of the users' own origins, so that p_common = Rz(yaw) scale p_own + x y z.

    `turned` (k,) rad: what mending turned SLAM's axes by at the end; `last_own` (k, 3) the last pose as SLAM has it.
    """
    out = frames.copy()
    out[:, 3] = wrap_angle(frames[:, 3] + turned)
    turn = np.column_stack([np.zeros((len(out), 3)), out[:, 3]])
    out[:, :3] += origin - apply_frames(turn, scale[:, None] * last_own)
    return out


def _errors(frames: Array, scale: Array, last_own: Array, origin: Array) -> Array:
    """(k, 4, 6) derivatives of `_about_own` by x, y, z, yaw of the last keyframe, its log scale, the reference's."""
    out = np.zeros((len(frames), 4, 6))
    out[:, :, :4] = np.eye(4)
    turn = np.column_stack([np.zeros((len(frames), 3)), frames[:, 3]])
    arm = apply_frames(turn, scale[:, None] * last_own)
    out[:, 0, 3], out[:, 1, 3] = arm[:, 1], -arm[:, 0]
    out[:, :3, 4] = -arm
    out[:, :3, 5] = origin
    return out
