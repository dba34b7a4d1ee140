"""The main job: a recording in, everybody's frame out."""

from __future__ import annotations

from collections.abc import Mapping
from time import perf_counter
from typing import Literal

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.data.registration import (
    Alternative,
    CalibrationSigma,
    RangeVerdicts,
    Registration,
    State,
    UserRegistration,
)
from synchronizar.data.user import User
from synchronizar.diagnosis import findings_of
from synchronizar.diagnosis.reasons import with_reasons
from synchronizar.diagnosis.solution import findings_of_solution
from synchronizar.errors import InputError
from synchronizar.estimation.full import register_full
from synchronizar.estimation.outcome import Outcome
from synchronizar.estimation.rigid import register_rigid
from synchronizar.geometry import YawFrame
from synchronizar.graph.states import BIAS, CLOCK
from synchronizar.parameters import Parameters
from synchronizar.progress import Progress, unheard


def register(
    recording: Recording,
    reference: str | None = None,
    model: Literal["full", "rigid"] = "full",
    parameters: Parameters | None = None,
    progress: Progress | None = None,
) -> Registration:
    """Where every user's frame lies in the reference's, how sure that is, and which ranges it rests on.

    `model` full: SLAM may drift, jump, have a wrong scale and clock, radios a bias. rigid: SLAM is trusted, one frame
    per user and nothing else. `progress` hears what share of the work is done. Raises InputError where `reference` is
    nobody or a static radio, or where nobody can be the reference. What cannot be answered is told as a state.
    """
    parameters = parameters or Parameters()
    began = perf_counter()
    ref = reference_of(recording, reference, parameters)
    found = findings_of(recording)
    solve = register_full if model == "full" else register_rigid
    outcome = solve(recording, ref, parameters, progress or unheard)
    seconds = {"load": 0.0, "initialise": outcome.searched - began, "solve": perf_counter() - outcome.searched}
    ranges = range_verdicts(outcome, len(recording.ranges))
    registration = registration_of(recording.users, outcome, ref, model, ranges, seconds)
    return with_reasons(registration, [*found, *findings_of_solution(recording, registration, found)])


def registration_of(
    users: tuple[User, ...],
    outcome: Outcome,
    reference: int,
    model: str,
    ranges: RangeVerdicts,
    seconds: Mapping[str, float],
) -> Registration:
    """An outcome as it is told."""
    return Registration(
        reference=users[reference].name,
        model=model,
        method="joint",
        users={user.name: _user(user, outcome, u) for u, user in enumerate(users)},
        alternatives=_alternatives(users, outcome),
        ranges=ranges,
        seconds=seconds,
        joint_covariance=_joint(users, outcome),
    )


def reference_of(recording: Recording, name: str | None, parameters: Parameters) -> int:
    """Whose frame the common one is: a user of that name, or the first by name that moves. InputError if nobody."""
    if name is None:
        moving = [u for u, user in enumerate(recording.users) if not user.static]
        if not moving:
            raise InputError("recording.toml", "every user is a static radio: nobody has a frame to be the common one")
        far = [u for u in moving if recording.tracks[recording.users[u].name].extent() > parameters.priors.least_extent]
        return (far or moving)[0]
    try:
        user = recording.index(name)
    except KeyError:
        raise InputError("--reference", f"there is no user '{name}'") from None
    if recording.users[user].static:
        raise InputError("--reference", f"'{name}' is a static radio: it has no heading for the common frame")
    return user


def _user(user: User, outcome: Outcome, u: int) -> UserRegistration:
    said, jumps = outcome.said[u], outcome.jumps.get(user.name, ())
    if said is None:
        reason = "no chain of ranges ties it to the reference"
        return UserRegistration(user.name, State.DISCONNECTED, reason, None, None, user.static, jumps=jumps)
    covariance = outcome.covariances[u].copy()
    if user.static:
        covariance[3, :] = covariance[:, 3] = np.nan
    unseen = None if said.unseen_direction is None else outcome.errors[u] @ said.unseen_direction
    calibration, sigma = outcome.calibration, outcome.calibration_sigma
    bias, clock = (0.0, 0.0) if calibration is None else (float(calibration[u, BIAS]), float(calibration[u, CLOCK]))
    return UserRegistration(
        user.name,
        said.state,
        said.reason,
        _frame(user, outcome, u, 0),
        covariance,
        user.static,
        None if unseen is None else unseen / np.linalg.norm(unseen),
        said.prior_dominated,
        bias,
        None if user.static and calibration is not None else clock,
        None if sigma is None else CalibrationSigma(*sigma[u].tolist()),
        _noise(outcome, u),
        jumps,
        outcome.tracks.get(user.name),
    )


def _joint(users: tuple[User, ...], outcome: Outcome) -> Array | None:
    if outcome.joint is None:
        return None
    out = outcome.joint.copy()
    for u, user in enumerate(users):
        if user.static:
            out[u, 3] = out[:, :, u, 3] = np.nan
    return out


def _noise(outcome: Outcome, user: int) -> tuple[float, float] | None:
    noise = outcome.slam_noise
    return None if noise is None or np.isnan(noise[user, 0]) else (float(noise[user, 0]), float(noise[user, 1]))


def _frame(user: User, outcome: Outcome, u: int, placement: int) -> YawFrame:
    x, y, z, yaw = outcome.frames[placement][u].tolist()
    return YawFrame(x, y, z, yaw, float(outcome.scale[u]), "z" if user.static else user.up)


def _alternatives(users: tuple[User, ...], outcome: Outcome) -> tuple[Alternative, ...]:
    if len(outcome.frames) < 2:
        return ()
    return tuple(
        Alternative(
            max(cost - outcome.costs[0], 0.0),
            {user.name: _frame(user, outcome, u, n) for u, user in enumerate(users) if not np.isnan(frames[u, 0])},
        )
        for n, (cost, frames) in enumerate(zip(outcome.costs, outcome.frames, strict=True))
    )


def range_verdicts(outcome: Outcome, n: int) -> RangeVerdicts:
    """What became of each of n ranges."""
    row = outcome.measurements.row
    usable, used = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    weight, residual = np.zeros(n), np.full(n, np.nan)
    usable[row] = True
    used[row] = outcome.inlier_probability > 0.5
    weight[row] = outcome.weight
    residual[row] = outcome.residual
    return RangeVerdicts(usable, used, weight, residual)
