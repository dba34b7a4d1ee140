"""From an assessment at the last keyframes to a Registration about each user's own origin."""

from __future__ import annotations

from collections.abc import Mapping
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
from synchronizar.estimation.assessment import Assessment
from synchronizar.geometry import YawFrame, apply_frames, moved_frames, wrap_angle

NO_CHAIN = "no chain of ranges ties it to the reference"


class OwnFrames(NamedTuple):
    """How the frames of k users lie beside their last keyframes, and the graph's frame in the common one."""

    scale: Array
    """(k,) metres in each user's own unit of length."""
    turned: Array
    """(k,) rad: what repairing relocalisations turned SLAM's axes by at the end."""
    last: Array
    """(k, 3) the last pose as SLAM has it, in SLAM's lengths."""
    common: Array
    """(4,) x, y, z (m), yaw (rad): the graph's frame in the common frame."""
    by_scale: Array
    """(3,) m: derivative of that place by the reference's log scale."""

    def frames(self, last_poses: Array) -> Array:
        """(k, 4) common_from_user, p_common = Rz(yaw) scale p_own + (x, y, z), of last keyframes (k, 4)."""
        out = moved_frames(self.common, last_poses)
        out[:, 3] = wrap_angle(out[:, 3] + self.turned)
        out[:, :3] -= self._arms(out)
        return out

    def derivatives(self, frames: Array) -> Array:
        """(k, 4, 6) of `frames` by x, y, z, yaw of the last keyframe, its log scale, the reference's log scale."""
        out = np.zeros((len(frames), 4, 6))
        out[:, :, :4] = np.eye(4)
        arm = self._arms(frames)
        out[:, 0, 3], out[:, 1, 3] = arm[:, 1], -arm[:, 0]
        out[:, :3, 4] = -arm
        out[:, :3, 5] = self.by_scale
        return out

    def _arms(self, frames: Array) -> Array:
        """(k, 3) m: from each user's origin to its last pose, in common axes."""
        turn = np.column_stack([np.zeros((len(frames), 3)), frames[:, 3]])
        return apply_frames(turn, self.scale[:, None] * self.last)


def registration_of(assessed: Assessment, own: OwnFrames, ranges: int, seconds: Mapping[str, float]) -> Registration:
    """The answer that an assessment is, to a recording of so many ranges."""
    reference = assessed.optimum.graph.users[assessed.optimum.graph.reference]
    users = assessed.optimum.graph.users
    listed = [u for u, user in enumerate(users) if not user.is_survey_origin]
    frames = [own.frames(hypothesis.frames) for hypothesis in assessed.hypotheses]
    derivatives = own.derivatives(frames[0])
    covariances = derivatives @ assessed.covariances @ derivatives.transpose(0, 2, 1)
    return Registration(
        reference=SURVEY if reference.is_survey_origin else reference.name,
        model="rigid" if assessed.calibration_sigma is None else "full",
        method="joint",
        users={users[u].name: _user(assessed, own, u, frames[0][u], covariances[u], derivatives[u]) for u in listed},
        alternatives=_alternatives(assessed, own, frames),
        ranges=_range_verdicts(assessed, ranges),
        seconds=seconds,
        joint_covariance=_joint(assessed, derivatives, listed),
    )


def _user(
    assessed: Assessment, own: OwnFrames, u: int, frame: Array, covariance: Array, derivatives: Array
) -> UserRegistration:
    user, verdict = assessed.optimum.graph.users[u], assessed.verdicts[u]
    if verdict is None:
        return UserRegistration(user.name, State.DISCONNECTED, NO_CHAIN, None, None, user.static)
    if user.static:
        covariance[3, :] = covariance[:, 3] = np.nan
    unseen = None if verdict.unseen_direction is None else derivatives[:, :4] @ verdict.unseen_direction
    known_bias = bias = user.range_bias or 0.0
    clock, sigma = 0.0, None
    if assessed.calibration_sigma is not None:
        _, bias, clock = assessed.optimum.states.calibration[u].tolist()
        bias += known_bias
        of_log_scale, of_bias, of_clock = assessed.calibration_sigma[u].tolist()
        sigma = CalibrationSigma(of_log_scale * float(own.scale[u]), of_bias, of_clock)
    return UserRegistration(
        name=user.name,
        state=verdict.state,
        reason=verdict.reason,
        common_from_user=_frame(user, frame, own.scale[u]),
        covariance=covariance,
        static=user.static,
        unseen_direction=None if unseen is None else unseen / np.linalg.norm(unseen),
        prior_dominated=verdict.prior_dominated,
        range_bias=bias,
        clock_offset=None if user.static and sigma is not None else clock,
        calibration_sigma=sigma,
    )


def _frame(user: User, frame: Array, scale: float) -> YawFrame:
    x, y, z, yaw = frame.tolist()
    return YawFrame(x, y, z, yaw, float(scale), "z" if user.static else user.up)


def _joint(assessed: Assessment, derivatives: Array, listed: list[int]) -> Array | None:
    if assessed.joint is None:
        return None
    out = np.einsum("uac,ucvd,vbd->uavb", derivatives, assessed.joint, derivatives, optimize=True)
    for u, user in enumerate(assessed.optimum.graph.users):
        if user.static:
            out[u, 3] = out[:, :, u, 3] = np.nan
    return np.asarray(out[listed][:, :, listed])


def _alternatives(assessed: Assessment, own: OwnFrames, frames: list[Array]) -> tuple[Alternative, ...]:
    if len(frames) < 2:
        return ()
    users, best = assessed.optimum.graph.users, assessed.hypotheses[0].cost
    return tuple(
        Alternative(
            max(hypothesis.cost - best, 0.0),
            {
                user.name: _frame(user, of[u], own.scale[u])
                for u, user in enumerate(users)
                if not np.isnan(of[u, 0]) and not user.is_survey_origin
            },
        )
        for hypothesis, of in zip(assessed.hypotheses, frames, strict=True)
    )


def _range_verdicts(assessed: Assessment, n: int) -> RangeVerdicts:
    graph, states = assessed.optimum.graph, assessed.optimum.states
    row = graph.measurements.row
    usable, used = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    weight, residual = np.zeros(n), np.full(n, np.nan)
    usable[row] = True
    used[row] = assessed.inlier_probability > 0.5
    weight[row] = assessed.weight
    residual[row] = -graph.residuals(states)
    return RangeVerdicts(usable, used, weight, residual)
