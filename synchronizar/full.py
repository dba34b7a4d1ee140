"""The full model: SLAM may drift, jump, have a wrong scale and clock, radios a bias; one anchored pose graph for all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from time import perf_counter
from typing import NamedTuple

import numpy as np

from synchronizar.anchored import AnchoredGraph, Judgement
from synchronizar.arrays import Array
from synchronizar.centre import centred, middles
from synchronizar.corners import corners_of
from synchronizar.geometry import apply_frames, difference, wrap_angle, yaw_of_quaternions
from synchronizar.graph import RigidGraph, blocks_of
from synchronizar.initialise import connected, joint_placements, relative_to
from synchronizar.jumps import Mended, mend
from synchronizar.keyframes import STANDING, Keyframes, keyframes_of
from synchronizar.mirrors import height_mirrors, reflections
from synchronizar.misfit import Misfit
from synchronizar.model import Model
from synchronizar.outcome import Outcome
from synchronizar.placement import SAME, placements
from synchronizar.recording import Recording
from synchronizar.samples import Samples, samples_of
from synchronizar.track import Track
from synchronizar.verdict import Verdict, verdicts
from synchronizar.walks import BIAS, CLOCK, SCALE, Walks, common_track, interpolated

_COARSE = 20  # keyframes of a walk while placements are compared
_HOPELESS = 50.0  # of log likelihood: more than settling may gain
_TOLD_APART = 3.0  # sigmas: a height that is closer is within the minimum's own uncertainty
_ANNEALING = (4.0, 2.0)


class Settled(NamedTuple):
    """A minimum of an anchored graph."""

    graph: AnchoredGraph
    walks: Walks
    judgement: Judgement
    cost: float
    """Negative log likelihood, up to a constant that all minima of the same graph and worth share."""

    @property
    def frames(self) -> Array:
        """(k, 4) x, y, z, yaw: where the last keyframe is, and how SLAM's axes lie there."""
        w, out = self.walks, self.walks.frames.copy()
        for u, local in enumerate(w.local):
            out[u, :3] = apply_frames(w.frames[u], np.exp(w.device[u, SCALE]) * local[-1, :3])
            out[u, 3] = wrap_angle(out[u, 3] + local[-1, 3])
        return out


def register_full(recording: Recording, reference: int, model: Model) -> Outcome:
    """Everybody's frame, drift, scale, clock and radio bias."""
    users = recording.users
    mended = {name: mend(track, model) for name, track in recording.tracks.items()}
    smooth = replace(recording, tracks={name: of_user.track for name, of_user in mended.items()})
    samples = samples_of(smooth, model)
    placed = connected(samples, len(users), reference)
    samples = samples[np.isin(samples.i, placed)]

    span = float(np.ptp(samples.t)) if len(samples) else 0.0
    coarse = _keyframes(recording, mended, max(model.keyframe_interval, span / _COARSE), model)
    graph = AnchoredGraph(smooth, samples, coarse, placed, reference, model)
    starts = _search(samples, graph, model)
    searched = perf_counter()
    found = _settle_all(graph, starts, model)

    fine = AnchoredGraph(
        smooth, samples, _keyframes(recording, mended, model.keyframe_interval, model), placed, reference, model
    )
    best = _refine(found[0], fine)
    found = _compare(found, best, model)
    return _outcome(recording, smooth, mended, best, found, searched, model)


def _keyframes(
    recording: Recording, mended: dict[str, Mended], interval: float, model: Model
) -> list[Keyframes]:
    return [STANDING if u.static else keyframes_of(mended[u.name], interval, model) for u in recording.users]


def _search(samples: Samples, graph: AnchoredGraph, model: Model) -> list[Array]:
    """Frames (k, 4) of the anchors: joint placements of rigid walks, looked for as if ranges were no better than SLAM."""
    middle = middles(samples, len(graph.users))
    wide = replace(centred(samples, middle), sigma=np.hypot(samples.sigma, model.search_sigma))
    found = joint_placements(wide, graph.users, graph.placed, graph.reference, model)
    anchors = np.array([k.anchor for k in graph.keyframes]) - middle
    out = []
    for hypothesis in found:
        laid = np.column_stack([apply_frames(hypothesis.frames, anchors), hypothesis.frames[:, 3]])
        out.append(relative_to(laid, graph.reference))
    return out


def _settle_all(graph: AnchoredGraph, starts: list[Array], model: Model) -> list[Settled]:
    """The minima that starts and their mirror images lead to, best first."""
    found: list[Settled] = []
    for frames in starts:
        _follow(graph, graph.begin(frames), found)
    if graph.free:
        mirrored: Settled | None = None
        while mirrored is not min(found, key=_cost):
            mirrored = min(found, key=_cost)
            for walks in _mirrors(mirrored, model):
                _follow(graph, walks, found, annealing=())
    return sorted(found, key=_cost)


def _cost(settled: Settled) -> float:
    return settled.cost


def _follow(
    graph: AnchoredGraph, walks: Walks, found: list[Settled], annealing: tuple[float, ...] = _ANNEALING
) -> None:
    """Add the minimum that these walks lead to, unless it is known."""
    judgement = graph.first_judgement()
    for wide in annealing:
        walks, judgement, _ = graph.settle(walks, judgement, rounds=3, annealing=wide)
    settled = Settled(graph, *graph.settle(walks, judgement, rounds=10))
    frames = settled.frames
    if not any(np.nanmax(np.abs(difference(frames, known.frames))) < SAME for known in found):
        found.append(settled)


def _mirrors(settled: Settled, model: Model) -> Iterator[Walks]:
    """Walks that might explain the ranges as well: what levels and lines cannot tell apart."""
    graph, walks = settled.graph, settled.walks
    flat = graph.flattened(walks)
    rigid = RigidGraph(blocks_of(flat), graph.users, graph.placed, graph.reference, model).about(walks.frames)
    worth = float(settled.judgement.worth.mean())
    values = rigid.values(walks.frames)
    cost = rigid.cost(values)
    sigma = np.sqrt(rigid.covariances(values)[:, 2, 2] / worth)
    heights = rigid.other_heights(walks.frames, model.cost_excluded_late / worth)
    heights += height_mirrors(flat, walks.frames, graph.reference)
    for frames in heights:
        if (np.abs(frames[:, 2] - walks.frames[:, 2]) > _TOLD_APART * sigma)[graph.free].any():
            if worth * (rigid.cost(rigid.values(frames)) - cost) < _HOPELESS:
                yield walks._replace(frames=frames)
    for frames in reflections(flat, walks.frames, graph.reference):
        if worth * (rigid.cost(rigid.values(frames)) - cost) < _HOPELESS + worth * len(flat):
            yield walks._replace(frames=frames)


def _refine(coarse: Settled, graph: AnchoredGraph) -> Settled:
    """The same placement at every keyframe, and what ranges are worth measured on what it leaves."""
    walks = interpolated(coarse.walks, coarse.graph.keyframes, graph.keyframes)
    judgement = graph.first_judgement()
    judgement = replace(judgement, bias_weight=coarse.judgement.bias_weight)
    return Settled(graph, *graph.settle(walks, judgement, rounds=6, measure_worth=True))


def _compare(found: list[Settled], best: Settled, model: Model) -> list[Settled]:
    """The placements that explain the ranges, best first, all by the same worth of ranges."""
    compared = []
    for s in found:
        if s.cost > found[0].cost + _HOPELESS:
            break
        judgement = replace(s.judgement, worth=best.judgement.worth)
        compared.append(Settled(s.graph, *s.graph.settle(s.walks, judgement, rounds=6)))
    compared.sort(key=_cost)
    rejected = float((best.graph.honest(best.walks, best.judgement)[1] < 0.5).mean()) if len(best.judgement.worth) else 0
    excluded = model.cost_excluded_late if rejected > model.doubtful_share else model.cost_excluded
    return [s for s in compared if s.cost <= compared[0].cost + excluded]


def _outcome(
    recording: Recording,
    smooth: Recording,
    mended: dict[str, Mended],
    best: Settled,
    found: list[Settled],
    searched: float,
    model: Model,
) -> Outcome:
    graph, walks = best.graph, best.walks
    users, k = recording.users, len(recording.users)
    samples = graph.samples
    weight, honest = graph.honest(walks, best.judgement)
    poses, devices = graph.covariances(walks, best.judgement)
    # The best placement is told as it is at every keyframe, the others as they are coarsely.
    minima = [best, *found[1:]]
    told = placements(
        minima,
        lambda s: poses[:, :4, :4] if s is best else s.graph.covariances(s.walks, s.judgement)[0][:, :4, :4],
        _corners(smooth, graph, walks),
        model,
    )
    fit = {u: Misfit(1.0, _rejected(samples, honest, u)) for u in graph.free}
    said = verdicts(told, fit, graph, _corners(smooth, graph, walks), model)
    said = [_with_device(v, devices[u], users[u].static, model) for u, v in enumerate(said)]

    scale = np.exp(walks.device[:, SCALE])
    last_own, turned = np.zeros((k, 3)), np.zeros(k)
    for u, user in enumerate(users):
        if not user.static:
            last_own[u] = recording.tracks[user.name].position[-1]
            turned[u] = yaw_of_quaternions(mended[user.name].mended_from_slam[-1:])[0]
    origin = scale[graph.reference] * graph.keyframes[graph.reference].anchor
    frames = [_about_own(p.frames, turned, scale, last_own, origin) for p in told]
    errors = _errors(frames[0], scale, last_own, origin)
    # The mixture's covariance of the pose, and the devices' part beside it.
    full = poses.copy()
    full[:, :4, :4] = told[0].covariances
    device = walks.device.copy()
    device[:, SCALE] = scale
    sigma = np.sqrt(devices)
    sigma[:, SCALE] *= scale
    tracks = {}
    for u, user in enumerate(users):
        if user.static or u not in graph.placed:
            continue
        track, _ = common_track(walks, u, graph.keyframes[u], smooth.tracks[user.name])
        tracks[user.name] = Track(track.t, track.position + origin, track.quat_xyzw)
    return Outcome(
        searched=searched,
        said=said,
        costs=[p.cost for p in told],
        frames=frames,
        covariances=errors @ full @ errors.transpose(0, 2, 1),
        errors=errors[:, :, :4],
        scale=scale,
        samples=samples,
        weight=weight * best.judgement.worth / graph.sigma**2,
        honest=honest,
        residual=-graph.residuals(walks),
        device=device,
        device_sigma=sigma,
        tracks=tracks,
        jumps={name: of_user.jumps for name, of_user in mended.items()},
    )


def _corners(smooth: Recording, graph: AnchoredGraph, walks: Walks) -> Array:
    """(k, c, 3) m: what bounds each walk, about its last keyframe."""
    corners = corners_of(smooth)
    last = np.array([of_user.place[-1] for of_user in graph.keyframes])
    return np.asarray(np.exp(walks.device[:, SCALE])[:, None, None] * (corners - last[:, None]))


def _rejected(samples: Samples, honest: Array, user: int) -> float:
    mine = (samples.i == user) | (samples.j == user)
    return float((honest[mine] < 0.5).mean()) if mine.any() else 0.0


def _with_device(said: Verdict | None, variances: Array, static: bool, model: Model) -> Verdict | None:
    """The verdict, with what of the device its priors determine rather than the ranges."""
    if said is None:
        return None
    prior = np.array([model.scale_sigma, model.bias_sigma, model.clock_sigma]) ** 2
    names = {SCALE: "scale", BIAS: "range_bias", CLOCK: "clock_offset"}
    dominated = [
        name for column, name in names.items() if variances[column] > 0.5 * prior[column] and not (static and column != BIAS)
    ]
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
