"""The main job: a recording in, everybody's frame out."""

from __future__ import annotations

from time import perf_counter

import numpy as np

from synchronizar.arrays import Array
from synchronizar.batch import Settled, solve
from synchronizar.centre import about_origins, centred, errors_about_origins, middles
from synchronizar.errors import InputError
from synchronizar.geometry import YawFrame
from synchronizar.graph import RigidGraph, blocks_of
from synchronizar.initialise import connected, joint_placements
from synchronizar.model import Model
from synchronizar.placement import fits, placements
from synchronizar.recording import Recording
from synchronizar.registration import Alternative, RangeVerdicts, Registration, State, UserRegistration
from synchronizar.samples import Samples, samples_of
from synchronizar.user import User
from synchronizar.verdict import Verdict, verdicts


def register(recording: Recording, reference: str | None = None, model: Model | None = None) -> Registration:
    """Where every user's frame lies in the reference's, how sure that is, and which ranges it rests on.

    The rigid model: SLAM is trusted, one frame per user and nothing else. Raises InputError where `reference` is nobody
    or a radio that stands still, or where nobody can be the reference. What cannot be answered is told as a state.
    """
    model = model or Model()
    users = recording.users
    began = perf_counter()
    ref = _reference(recording, reference, model)
    samples = samples_of(recording, model)
    placed = connected(samples, len(users), ref)
    samples = samples[np.isin(samples.i, placed)]
    middle = middles(samples, len(users))
    samples = centred(samples, middle)
    graph = RigidGraph(blocks_of(samples), users, placed, ref, model)
    starts = joint_placements(samples, users, placed, ref, model)
    searched = perf_counter()
    settled = solve(samples, graph, placed, starts, model)
    corners = _corners(recording) - middle[:, None]
    fit = fits(settled[0], samples)
    found = placements(settled, fit, corners, model)
    said = verdicts(found, fit, graph, corners, model)
    errors = errors_about_origins(found[0].frames, middle)
    covariances = errors @ found[0].covariances @ errors.transpose(0, 2, 1)
    frames = [about_origins(placement.frames, middle, ref) for placement in found]
    return Registration(
        reference=users[ref].name,
        model="rigid",
        method="joint",
        users={
            user.name: _user(user, frames[0][u], covariances[u], said[u], errors[u]) for u, user in enumerate(users)
        },
        alternatives=_alternatives(recording, [placement.cost for placement in found], frames),
        ranges=_range_verdicts(recording, samples, settled[0]),
        seconds={"load": 0.0, "initialise": searched - began, "solve": perf_counter() - searched},
    )


def _reference(recording: Recording, name: str | None, model: Model) -> int:
    if name is None:
        moving = [u for u, user in enumerate(recording.users) if not user.static]
        if not moving:
            raise InputError("recording.toml", "every user is a static radio: nobody has a frame to be the common one")
        far = [u for u in moving if recording.tracks[recording.users[u].name].extent() > model.moving]
        return (far or moving)[0]
    try:
        user = recording.index(name)
    except KeyError:
        raise InputError("--reference", f"there is no user '{name}'") from None
    if recording.users[user].static:
        raise InputError("--reference", f"'{name}' is a static radio: it has no heading for the common frame")
    return user


def _corners(recording: Recording) -> Array:
    """Points (k, c, 3) of each user's own track that bound it: its ends, and the furthest to eight sides."""
    sides = np.array([[1, 0, 0], [0, 1, 0], [1, 1, 0], [1, -1, 0]], dtype=float)
    corners = np.zeros((len(recording.users), 2 + 2 * len(sides), 3))
    for u, user in enumerate(recording.users):
        if not user.static:
            p = recording.tracks[user.name].position
            along = p @ sides.T
            corners[u] = p[[0, len(p) - 1, *along.argmin(axis=0), *along.argmax(axis=0)]]
    return corners


def _user(user: User, frame: Array, covariance: Array, said: Verdict | None, error: Array) -> UserRegistration:
    """`error` (4, 4) turns the verdict's unseen direction into that of the frame about its origin."""
    if said is None:
        reason = "no chain of ranges ties it to the reference"
        return UserRegistration(user.name, State.DISCONNECTED, reason, None, None, user.static)
    if user.static:
        covariance = covariance.copy()
        covariance[3, :] = covariance[:, 3] = np.nan
    unseen = None if said.unseen_direction is None else error @ said.unseen_direction
    return UserRegistration(
        user.name,
        said.state,
        said.reason,
        YawFrame(*frame.tolist()),
        covariance,
        user.static,
        None if unseen is None else unseen / np.linalg.norm(unseen),
        said.prior_dominated,
    )


def _alternatives(recording: Recording, costs: list[float], frames: list[Array]) -> tuple[Alternative, ...]:
    if len(frames) < 2:
        return ()
    return tuple(
        Alternative(
            cost - costs[0],
            {
                user.name: YawFrame(*frame.tolist())
                for user, frame in zip(recording.users, of_all, strict=True)
                if not np.isnan(frame[0])
            },
        )
        for cost, of_all in zip(costs, frames, strict=True)
    )


def _range_verdicts(recording: Recording, samples: Samples, best: Settled) -> RangeVerdicts:
    n = len(recording.ranges)
    usable, used = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    weight, residual = np.zeros(n), np.full(n, np.nan)
    usable[samples.row] = True
    used[samples.row] = best.graph.honest(best.values) > 0.5
    weight[samples.row] = best.graph.weights(best.values) / samples.sigma**2
    residual[samples.row] = best.graph.residuals(best.values)
    return RangeVerdicts(usable, used, weight, residual)
