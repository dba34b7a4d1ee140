"""What the tests of the solver share: recordings written by hand, truth of simulated ones, distances to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from synchronizar.arrays import Array, Indices
from synchronizar.geometry import YawFrame
from synchronizar.graph import RigidGraph, blocks_of
from synchronizar.model import Model
from synchronizar.pipeline import register
from synchronizar.ranges import Ranges
from synchronizar.recording import Recording
from synchronizar.registration import Registration
from synchronizar.samples import Samples, samples_of
from synchronizar.simulate import Simulation
from synchronizar.track import Track
from synchronizar.user import User

LEVEL = (0.0, 0.0, 0.0, 1.0)

register_rigid = partial(register, kind="rigid")


def track_of(t: Array, position: Array) -> Track:
    """A device that is held level all along."""
    return Track(np.asarray(t, dtype=float), np.asarray(position, dtype=float), np.tile(LEVEL, (len(t), 1)))


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


def rigid_graph(recording: Recording, reference: int = 0, model: Model | None = None) -> tuple[Samples, RigidGraph]:
    """The samples of a recording in which everybody is placed, and their graph."""
    model = model or Model()
    samples, users = samples_of(recording, model), recording.users
    return samples, RigidGraph(blocks_of(samples), users, list(range(len(users))), reference, model)


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


def distances(samples: Samples, frames: Array) -> Array:
    """(n,) m between the antennas of each sample where the users' frames are these (k, 4)."""

    def placed(who: Indices, p: Array) -> Array:
        return np.array([YawFrame(*frames[u].tolist()) @ q for u, q in zip(who, p, strict=True)])

    return np.asarray(np.linalg.norm(placed(samples.i, samples.p_i) - placed(samples.j, samples.p_j), axis=1))
