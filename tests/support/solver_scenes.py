"""What the tests of the solver share: recordings written by hand, truth of simulated ones, distances to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import gtsam
import numpy as np

from synchronizar._core import RangeBlock, UserPose
from synchronizar.arrays import Array, Indices
from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.estimation.register import register
from synchronizar.geometry import YawFrame
from synchronizar.graph.em_weights import EmWeights
from synchronizar.graph.gtsam_form import GtsamForm
from synchronizar.graph.pose_graph import PoseGraph
from synchronizar.graph.priors import nlos_mixture
from synchronizar.graph.problem import Problem
from synchronizar.graph.rigid_graph import RigidGraph
from synchronizar.graph.states import States
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import Pair, RangeMeasurements, pairs, range_measurements
from synchronizar.simulation.simulate import Simulation

MEAN_HEIGHT = (0.0, 0.0, 0.0, 1.0)

register_rigid = partial(register, model="rigid")


def track_of(t: Array, position: Array) -> Track:
    """A device that is held level all along."""
    return Track(np.asarray(t, dtype=float), np.asarray(position, dtype=float), np.tile(MEAN_HEIGHT, (len(t), 1)))


def recording_of(
    tracks: Mapping[str, Track | None],
    rows: Sequence[tuple[float, str, str, float]],
    users: Sequence[User] = (),
    **columns: Array | Indices,
) -> Recording:
    """Ranges in rows t, a, b, distance; a user whose track is None is a static radio; `users` tell more of some."""
    known = {user.name: user for user in users}
    names = sorted(tracks)
    index = {name: k for k, name in enumerate(names)}
    ranges = Ranges.of(
        np.array([row[0] for row in rows], dtype=float),
        np.array([index[row[1]] for row in rows], dtype=np.int32),
        np.array([index[row[2]] for row in rows], dtype=np.int32),
        np.array([row[3] for row in rows], dtype=float),
        **columns,
    )
    return Recording(
        tuple(known.get(name, User(name, static=tracks[name] is None)) for name in names),
        {name: track for name, track in tracks.items() if track is not None},
        ranges,
    )


def moved_by(recording: Recording, own_from_new: Mapping[str, YawFrame]) -> Recording:
    """The same walk, the devices' own frames lying elsewhere."""
    tracks = dict(recording.tracks)
    for name, frame in own_from_new.items():
        new_from_own = frame.inverse()
        own = tracks[name]
        tracks[name] = replace(
            own, position=new_from_own @ own.position, quat_xyzw=new_from_own.rotate_quaternions(own.quat_xyzw)
        )
    return replace(recording, tracks=tracks)


def rigid_graph(
    recording: Recording, reference: int = 0, model: Parameters | None = None
) -> tuple[RangeMeasurements, RigidGraph]:
    """The samples of a recording in which everybody is placed, and their graph."""
    model = model or Parameters()
    samples, k = range_measurements(recording, model), len(recording.users)
    problem = Problem(recording, samples, list(range(k)), reference, model)
    return samples, RigidGraph(problem, np.zeros((k, 3)))


def true_frames(simulation: Simulation, reference: str) -> Array:
    """(k, 4) x, y, z, yaw: the true `common_from_user`, the common frame being the reference's own."""
    common_from_world = simulation.world_from_user[reference].inverse()
    frames = [common_from_world @ simulation.world_from_user[user.name] for user in simulation.recording.users]
    return np.array([[f.x, f.y, f.z, f.yaw] for f in frames])


def own_points(recording: Recording, name: str) -> Array:
    """(n, 3) m: where a user walked, in its own frame; its origin for a static radio."""
    return recording.tracks[name].position if name in recording.tracks else np.zeros((1, 3))


def off_in_plane(simulation: Simulation, reference: str, name: str, common_from_user: YawFrame) -> float:
    """How far (m) from its true place, in the plane, the worst point of a user's walk is put."""
    points = own_points(simulation.recording, name)
    true = simulation.world_from_user[reference].inverse() @ simulation.world_from_user[name]
    return float(np.linalg.norm((common_from_user @ points - true @ points)[:, :2], axis=1).max())


def offs(simulation: Simulation, registration: Registration) -> dict[str, float]:
    """The same of every user that is placed, the reference's own left out."""
    return {
        name: off_in_plane(simulation, registration.reference, name, user.common_from_user)
        for name, user in registration.users.items()
        if user.common_from_user is not None and name != registration.reference
    }


def frames_of(registration: Registration) -> Array:
    """(k, 4) x, y, z, yaw, in the order of the users' names; NaN where there is none."""
    out = np.full((len(registration.users), 4), np.nan)
    for row, user in zip(out, registration.users.values(), strict=True):
        f = user.common_from_user
        if f is not None:
            row[:] = f.x, f.y, f.z, f.yaw
    return out


def difference(frames: Array, others: Array) -> Array:
    """(k, 4) with the yaw's within [-pi, pi)."""
    out = frames - others
    out[:, 3] = np.remainder(out[:, 3] + np.pi, 2.0 * np.pi) - np.pi
    return np.asarray(out)


def distances(samples: RangeMeasurements, frames: Array) -> Array:
    """(n,) m between the antennas of each sample where the users' frames are these (k, 4)."""

    def placed(who: Indices, p: Array) -> Array:
        return np.array([YawFrame(*frames[u].tolist()) @ q for u, q in zip(who, p, strict=True)])

    return np.asarray(np.linalg.norm(placed(samples.i, samples.p_i) - placed(samples.j, samples.p_j), axis=1))


def pair_bending(graph: PoseGraph, walks: States, em_weights: EmWeights) -> list[tuple[Pair, float]]:
    """1/m^2: the second derivative in height that bending makes for each pair, as the rigid model's blocks have it.

    What ranges are worth must be the same within a pair.
    """
    flat = replace(graph.to_rigid_ranges(walks), nlos_odds=em_weights.nlos_odds)
    poses = [UserPose(x, y, yaw, z) for x, y, z, yaw in walks.anchor_poses.tolist()]
    out = []
    for pair in pairs(flat):
        s = flat[pair.measurements]
        block = RangeBlock(s.p_i, s.p_j, s.distance, s.sigma, s.nlos_odds)
        bends = block.height_curvature(poses[pair.i], poses[pair.j], nlos_mixture(graph.parameters))
        out.append((pair, float(em_weights.range_weight[pair.measurements].mean()) * bends))
    return out


def flat_keys(keys: list[int]) -> list[int]:
    """Each as often as it has rows."""
    return [key for key in keys for _ in range({"H": 1, "Z": 1, "L": 1}.get(chr(gtsam.symbolChr(key)), 3))]


def honest_information(graph: PoseGraph, walks: States, em_weights: EmWeights) -> Array:
    """That of all variables in the graph's ordering; bending in height taken pair by pair, negative or not."""
    form = GtsamForm(graph)
    count, ordering = len(graph.users), form.ordering()
    keys = flat_keys([ordering.at(n) for n in range(ordering.size())])
    shared, below = np.zeros(len(graph.measurements)), np.zeros((count, count))
    for pair, bend in pair_bending(graph, walks, em_weights):
        shared[pair.measurements] = max(bend, 0.0) / (pair.measurements.stop - pair.measurements.start)
        apart = np.eye(count)[pair.i] - np.eye(count)[pair.j]
        below += min(bend, 0.0) * np.outer(apart, apart)
    linear = form.factors(walks.anchor_poses, em_weights, height_curvature=shared).linearize(form.values(walks))
    information, _ = linear.hessian(ordering)
    heights = [n for n, key in enumerate(keys) if chr(gtsam.symbolChr(key)) == "H"]
    users = [gtsam.symbolIndex(keys[n]) for n in heights]
    information[np.ix_(heights, heights)] += below[np.ix_(users, users)]
    return np.asarray(information)
