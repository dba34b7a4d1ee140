"""What an engine knows at one moment, as the registration that `register` returns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.registration import (
    Alternative,
    CalibrationSigma,
    RangeVerdicts,
    Registration,
    State,
    UserRegistration,
)
from synchronizar.data.survey import SURVEY
from synchronizar.data.user import User
from synchronizar.estimation.incremental.engine import Engine
from synchronizar.estimation.incremental.standing import Placed
from synchronizar.geometry import YawFrame

NOTHING_SOLVED = "nothing is solved yet"
_NO_SECONDS = {"load": 0.0, "initialise": 0.0, "solve": 0.0}


def registration_now(engine: Engine) -> Registration:
    """Frames at each user's last pose, states, progress and cues; nobody is placed before anything is solved."""
    users = {user.name: user_now(engine, u) for u, user in enumerate(engine.users) if not user.is_survey_origin}
    reference = engine.users[engine.reference]
    alternatives = tuple(
        Alternative(
            cost,
            {
                engine.users[u].name: _frame(engine.users[u], frame, 1.0)
                for u, frame in frames.items()
                if not engine.users[u].is_survey_origin
            },
        )
        for cost, frames in engine.findings.alternatives
    )
    name = SURVEY if reference.is_survey_origin else reference.name
    return Registration(name, "full", "joint", users, alternatives, range_verdicts(engine), _NO_SECONDS)


def user_now(engine: Engine, u: int) -> UserRegistration:
    """One user, at its last pose."""
    user, standing = engine.users[u], engine.roster.standings[u]
    if not engine.solved:
        return _disconnected(user, NOTHING_SOLVED)
    state, reason = engine.state(u), engine.reason(u)
    placed = standing.placed
    if placed is None and u == engine.reference and state is State.REGISTERED:
        # Nobody is followed beside it yet: its own frame, as it was before its SLAM jumped, is the common one.
        own = engine.roster.frame_at(u, np.zeros(4), 0.0, np.zeros(3))
        frame_now, sure = _frame(user, own, 1.0), np.zeros((4, 4))
        return UserRegistration(user.name, state, reason, frame_now, sure, progress=1.0, jumps=engine.jumps(u))
    if placed is None or state is State.DISCONNECTED:
        unplaced = State.DISCONNECTED if state is State.DISCONNECTED else state
        return UserRegistration(
            user.name, unplaced, reason, None, None, user.static, progress=standing.progress, jumps=engine.jumps(u)
        )
    frame, covariance, unseen = _about_origin(engine, u, placed)
    scale = 1.0 if user.static else float(np.exp(placed.state[4]))
    sigma = placed.calibration_sigma
    verdict = standing.verdict
    place, heading = engine.following.tracking.noise[u].tolist()
    return UserRegistration(
        name=user.name,
        state=state,
        reason=reason,
        common_from_user=_frame(user, frame, scale),
        covariance=covariance,
        static=user.static,
        unseen_direction=unseen if state is State.UNOBSERVABLE else None,
        prior_dominated=() if verdict is None else verdict.prior_dominated,
        range_bias=float(placed.state[5]) + (user.range_bias or 0.0),
        clock_offset=None if user.static else float(placed.state[6]),
        calibration_sigma=CalibrationSigma(float(sigma[0]) * scale, float(sigma[1]), float(sigma[2])),
        slam_noise=None if user.static else (place, heading),
        jumps=engine.jumps(u),
        progress=1.0 if state is State.REGISTERED else standing.progress,
        cue=None if standing.cue is None or state is State.REGISTERED else standing.cue.sentence,
    )


def _disconnected(user: User, reason: str) -> UserRegistration:
    return UserRegistration(user.name, State.DISCONNECTED, reason, None, None, user.static, progress=0.0)


def _about_origin(engine: Engine, u: int, placed: Placed) -> tuple[Array, Array, Array | None]:
    """common_from_user (4,), its covariance (4, 4), and the direction seen least (4,), about the user's own origin."""
    user, verdict = engine.users[u], engine.roster.standings[u].verdict
    frame = engine.roster.own_frame(u, placed)
    x, y, _, height = placed.state[:4].tolist()
    arm = np.array([x, y, height]) - frame[:3]
    by_last = np.eye(4, 6)
    by_last[0, 3], by_last[1, 3] = arm[1], -arm[0]
    by_last[:3, 4] = -arm
    covariance = by_last @ placed.covariance @ by_last.T
    if user.static:
        covariance[3, :] = covariance[:, 3] = np.nan
    unseen = None
    if verdict is not None and verdict.unseen_direction is not None:
        unseen = by_last[:, :4] @ verdict.unseen_direction
        unseen = unseen / max(float(np.linalg.norm(unseen)), 1e-300)
    return frame, covariance, unseen


def _frame(user: User, frame: Array, scale: float) -> YawFrame:
    x, y, z, yaw = frame.tolist()
    return YawFrame(x, y, z, yaw, scale, "z" if user.static else user.up)


class NewestRange(NamedTuple):
    """The newest range of a pair of users."""

    t: float
    """s, range clock."""
    a: str
    b: str
    distance: float
    """m."""
    residual: float | None
    """m, measured minus predicted; None where it is not compared yet."""
    used: bool
    """Whether it is taken for an honest measurement."""


def newest_ranges(engine: Engine) -> tuple[NewestRange, ...]:
    """The newest range of each pair in the recent past."""
    rows = engine.log.rows
    if not len(rows):
        return ()
    a, b = engine.log.users(rows)
    pair = np.minimum(a, b) * len(engine.users) + np.maximum(a, b)
    newest = np.lexsort((rows[:, 0], pair))
    newest = newest[np.append(pair[newest][1:] != pair[newest][:-1], True)]
    usable, inlier, _, residual = engine.range_verdicts(rows[newest, -1].astype(np.int32))
    return tuple(
        NewestRange(t, engine.users[i].name, engine.users[j].name, d, None if np.isnan(r) else r, used)
        for t, i, j, d, r, used in zip(
            rows[newest, 0].tolist(),
            a[newest].tolist(),
            b[newest].tolist(),
            rows[newest, 3].tolist(),
            residual.tolist(),
            (usable & (inlier > 0.5)).tolist(),
            strict=True,
        )
    )


def range_verdicts(engine: Engine) -> RangeVerdicts:
    """What became of each range of the recent past, by time."""
    rows = engine.log.rows
    serial = rows[np.lexsort((rows[:, -1], rows[:, 0])), -1].astype(np.int32)
    usable, inlier, weight, residual = engine.range_verdicts(serial)
    return RangeVerdicts(usable, usable & (inlier > 0.5), weight, residual)
