"""Shared by experiments on the full model: true final poses, and maximum likelihood started at the truth.

The common frame is the reference's own at its first pose, as `register` has it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.geometry import YawFrame, apply_frames, difference, wrap_angle
from synchronizar.graph.pose_graph import PoseGraph
from synchronizar.graph.problem import Problem
from synchronizar.graph.states import CLOCK, States, common_track
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.keyframes import STATIC_KEYFRAME, keyframes_of
from synchronizar.preprocessing.range_measurements import range_measurements
from synchronizar.preprocessing.relocalizations import repair_relocalizations
from synchronizar.quaternions import inverse_quaternions, multiply_quaternions, yaw_of_quaternions
from synchronizar.simulation.simulate import Simulation

_KNOWN = 1e-4  # a sigma that is next to nothing
_ROUNDS = 10
_SAME_CLOCK = 1e-4  # s


def common_from_world(simulation: Simulation, reference: str) -> YawFrame:
    """The room's frame in the reference's own as it was at its first pose; simulated SLAM begins at its origin."""
    x, y, z = simulation.truth[reference].position[0].tolist()
    yaw = _slam_headings(simulation.truth[reference], simulation.recording.tracks[reference])[0]
    return YawFrame(x, y, z, float(yaw)).inverse()


def true_tracks(simulation: Simulation, reference: str) -> dict[str, Track]:
    """Where every device really was, in the common frame."""
    frame = common_from_world(simulation, reference)
    return {
        name: replace(t, position=frame @ t.position, quat_xyzw=frame.rotate_quaternions(t.quat_xyzw))
        for name, t in simulation.truth.items()
    }


def true_frames_along(simulation: Simulation, reference: str, name: str) -> Array:
    """(n, 4) x, y, z, yaw: how a device's own frame lay in the common one at each of its poses."""
    own, true = simulation.recording.tracks[name], true_tracks(simulation, reference)[name]
    yaw = _slam_headings(true, own)
    turn = np.column_stack([np.zeros((len(own), 3)), yaw])
    return np.column_stack(
        [true.position - apply_frames(turn, simulation.world_from_user[name].scale * own.position), yaw]
    )


def last_poses(tracks: Mapping[str, Track]) -> dict[str, Array]:
    """(7,) of each track: x, y, z and attitude x y z w at its last stamp."""
    return {name: np.concatenate([track.position[-1], track.quat_xyzw[-1]]) for name, track in tracks.items()}


def last_errors(poses: Mapping[str, Array], truth: Mapping[str, Array], names: list[str]) -> Array:
    """(n, 4) x, y, z (m), yaw (rad): last poses of these users beside the true ones; NaN where there is none."""
    out = np.full((len(names), 4), np.nan)
    for row, name in zip(out, names, strict=True):
        if name in poses:
            row[:3] = poses[name][:3] - truth[name][:3]
            row[3] = yaw_of_quaternions(_beside(poses[name][None, 3:], truth[name][None, 3:]))[0]
    return out


def model_of_scene(simulation: Simulation) -> Parameters:
    """The model that a scene was drawn from: what it has none of is as by default."""
    scene, model = simulation.scene, Parameters()
    if scene.drift_m_per_sqrt_s > 0.0:
        model = model.changed(slam={"drift_m_per_sqrt_s": scene.drift_m_per_sqrt_s, "drift_m_per_sqrt_m": _KNOWN})
    if scene.drift_rad_per_sqrt_s > 0.0:
        model = model.changed(slam={"drift_rad_per_sqrt_s": scene.drift_rad_per_sqrt_s, "drift_rad_per_sqrt_m": _KNOWN})
    if scene.scale_sigma > 0.0:
        model = model.changed(devices={"scale_sigma": scene.scale_sigma, "scale_common_sigma": _KNOWN})
    if any(simulation.range_bias.values()):
        # Of the biases that there are: an experiment may have added to one radio's.
        bias = float(np.sqrt(np.mean(np.square(list(simulation.range_bias.values())))))
        model = model.changed(devices={"bias_sigma": max(bias, scene.bias_sigma), "bias_common_sigma": _KNOWN})
    if scene.clock_offset_sigma > 0.0:
        model = model.changed(devices={"clock_sigma": scene.clock_offset_sigma, "clock_common_sigma": _KNOWN})
    # Ranges as they were drawn: white noise, those that are late left out.
    return model.changed(ranges={"sigma": scene.sigma, "multipath_sigma": 0.0, "short_share": 0.0})


def oracle(simulation: Simulation, reference: str) -> dict[str, Track]:
    """Everybody's track by Gaussian maximum likelihood from the truth's start, on the ranges that are not late.

    The same anchored pose graph as `register` solves, with squared losses, the noise that the scene was drawn with,
    every range worth 1 and every step of SLAM believed alike; jumps are mended as there.
    """
    model, recording = model_of_scene(simulation), simulation.recording
    mended = {name: repair_relocalizations(track, model) for name, track in recording.tracks.items()}
    smooth = replace(recording, tracks={name: of_user.track for name, of_user in mended.items()})
    samples = range_measurements(smooth, model)
    samples = samples[np.flatnonzero(~simulation.late[samples.row]).astype(np.int32)]
    samples = replace(samples, nlos_odds=np.zeros(len(samples)))
    users = recording.users
    keyframes = [
        STATIC_KEYFRAME if u.static else keyframes_of(mended[u.name], model.slam.keyframe_interval, model)
        for u in users
    ]
    problem = Problem(smooth, samples, list(range(len(users))), recording.index(reference), model)
    graph = PoseGraph(problem, keyframes)
    walks = _maximum_likelihood(graph, true_walks(graph, simulation, smooth))
    return {
        user.name: common_track(walks, u, keyframes[u], smooth.tracks[user.name])[0]
        for u, user in enumerate(users)
        if not user.static
    }


def true_walks(graph: PoseGraph, simulation: Simulation, smooth: Recording) -> States:
    """The truth in the graph's variables; `smooth` has the mended tracks that its keyframes are of."""
    k = len(graph.users)
    reference = graph.users[graph.reference].name
    truth = true_tracks(simulation, reference)
    frames, device, local = np.zeros((k, 4)), np.zeros((k, 3)), []
    for u, user in enumerate(graph.users):
        name, keyframes, true = user.name, graph.keyframes[u], truth[user.name]
        scale = simulation.world_from_user[name].scale
        device[u] = np.log(scale), simulation.range_bias[name], simulation.clock_offset[name]
        if user.static:
            frames[u, :3] = true.position[0]
            local.append(np.zeros((1, 4)))
            continue
        at = np.searchsorted(true.t, keyframes.t)
        place, yaw = true.position[at], _slam_headings(true, smooth.tracks[name])[at]
        first = keyframes.place[0] - keyframes.anchor
        frames[u, 3] = yaw[0]
        frames[u, :3] = place[0] - apply_frames(frames[u] * [0.0, 0.0, 0.0, 1.0], scale * first)
        back = np.array([0.0, 0.0, 0.0, -yaw[0]])
        own = apply_frames(np.broadcast_to(back, (len(place), 4)), place - frames[u, :3]) / scale
        local.append(np.column_stack([own, wrap_angle(yaw - yaw[0])]))
    frames[graph.reference] = 0.0
    return States(frames, local, device)


def _maximum_likelihood(graph: PoseGraph, walks: States) -> States:
    """The minimum next to these walks; antennas are read anew while clocks still move."""
    about, ones = walks.anchor_poses, np.ones(len(graph.measurements))
    judgement = replace(graph.initial_em_weights(), nlos_odds=0.0 * ones, range_weight=ones)
    for _ in range(_ROUNDS):
        before = walks.calibration[:, CLOCK].copy()
        graph = graph.with_antennas_at(before)
        walks = graph.optimised(walks, about, judgement, annealing=1.0, iterations=100, gain=1e-6)
        if np.abs(walks.calibration[:, CLOCK] - before).max() < _SAME_CLOCK:
            break
    return walks


def frame_errors(frames: Mapping[str, YawFrame], truth: Mapping[str, YawFrame], names: list[str]) -> Array:
    """(n, 4) x, y, z (m), yaw (rad) of frames beside the true ones."""
    pairs = [(frames[name], truth[name]) for name in names]
    ours, true = (np.array([[f.x, f.y, f.z, f.yaw] for f in side]) for side in zip(*pairs, strict=True))
    return difference(ours, true)


def _slam_headings(truth: Track, own: Track) -> Array:
    """(n,) rad: how SLAM's axes lie in the truth's at each pose."""
    return yaw_of_quaternions(_beside(truth.quat_xyzw, own.quat_xyzw))


def _beside(left: Array, right: Array) -> Array:
    """(n, 4): what turns the attitudes `right` into `left`."""
    return multiply_quaternions(left, inverse_quaternions(right))
