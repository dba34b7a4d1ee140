"""Range factors for gtsam over the C++ core; they can be used alone, in any NonlinearFactorGraph.

A user's frame `common_from_user` is a Pose2 (key F) and a height (double, key H). Where its SLAM poses are variables
too, a keyframe is a Pose2 and a height in the user's own frame (keys X and Z), and antenna positions are in the
keyframe's frame. An antenna at o lies at F (X o_xy), H + Z + o_z in the common frame; a range predicts the distance of
two antennas. factors/range.h has the equations and the Jacobians.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from synchronizar._core import RangeBlock, RangeSlot, UserPose, range_residual
from synchronizar.arrays import Array

if TYPE_CHECKING:
    from synchronizar._core import Loss

_BLOCK_NOISE = gtsam.noiseModel.Unit.Create(5)

_Error = Callable[[gtsam.CustomFactor, gtsam.Values, "list[Array] | None"], Array]


class UserKeys(NamedTuple):
    """The gtsam keys on which the positions of a user's antennas depend."""

    frame: int
    """Pose2: common_from_user."""
    height: int
    """double (m): the height of the user's origin in the common frame."""
    pose: int | None = None
    """Pose2: a keyframe in the user's own frame; None where SLAM's poses are no variables."""
    local_height: int | None = None
    """double (m): the keyframe's height; None where it is 0."""

    def keys(self) -> list[int]:
        """The keys that are not None, in the order of the Jacobians."""
        return [key for key in self if key is not None]

    def columns(self, offset: int) -> list[slice]:
        """The columns of each key in a row of the core, whose columns for this user begin at `offset`."""
        bounds = [(0, 3), (3, 4), (4, 7), (7, 8)]
        return [
            slice(offset + begin, offset + end)
            for key, (begin, end) in zip(self, bounds, strict=True)
            if key is not None
        ]

    def read(self, values: gtsam.Values) -> UserPose:
        """The user's pose at these values."""
        frame, height = values.atPose2(self.frame), values.atDouble(self.height)
        x, y, yaw, local_height = 0.0, 0.0, 0.0, 0.0
        if self.pose is not None:
            pose = values.atPose2(self.pose)
            x, y, yaw = pose.x(), pose.y(), pose.theta()
        if self.local_height is not None:
            local_height = values.atDouble(self.local_height)
        return UserPose(frame.x(), frame.y(), frame.theta(), height, x, y, yaw, local_height)


class FixedUser(NamedTuple):
    """A user with a fixed pose: a surveyed anchor, or the reference, which fixes the gauge."""

    pose: UserPose

    def keys(self) -> list[int]:
        """No keys."""
        return []

    def columns(self, offset: int) -> list[slice]:  # noqa: ARG002 - the face of UserKeys
        """No columns."""
        return []

    def read(self, values: gtsam.Values) -> UserPose:  # noqa: ARG002 - the face of UserKeys
        """The fixed pose; the values do not matter."""
        return self.pose


class RangeFactor(gtsam.CustomFactor):
    """One range between an antenna of user i and an antenna of user j; its error is predicted minus measured (m)."""

    def __init__(
        self,
        i: UserKeys | FixedUser,
        j: UserKeys | FixedUser,
        antenna_i: ArrayLike,
        antenna_j: ArrayLike,
        measured: float,
        noise_model: gtsam.noiseModel.Base,
    ) -> None:
        """Antennas (3,) m in the user's own frame, or in that of its keyframe where it has one.

        `noise_model` has dimension 1 and its sigma in m; it may be one of gtsam's robust ones.
        """
        columns = i.columns(0) + j.columns(8)
        o_i, o_j = np.asarray(antenna_i, dtype=float), np.asarray(antenna_j, dtype=float)

        # The closure must not hold `self`: the factor would hold itself through C++ and never be freed.
        def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
            residual, row = range_residual(i.read(values), o_i, j.read(values), o_j, measured)
            if jacobians is not None:
                for k, which in enumerate(columns):
                    jacobians[k] = row[None, which]
            return np.array([residual])

        super().__init__(noise_model, i.keys() + j.keys(), error)


class RangeBlockFactor(gtsam.CustomFactor):
    """Many ranges between the same two users (and the same two keyframes) under a robust loss, as one factor.

    Its error has five rows, whatever the number of ranges, with the cost and, when linearised, the information of all
    of them: least squares depends on a range's row only by its square, and each row is a linear map of four numbers
    and a residual (factors/range.h). Half the squared norm of the error is the sum of the losses, so an optimiser's
    acceptance test holds.
    """

    def __init__(
        self, i: UserKeys | FixedUser, j: UserKeys | FixedUser, block: RangeBlock, loss: Loss, annealing: float = 1.0
    ) -> None:
        """`annealing` >= 1 widens the loss (graduated non-convexity)."""
        columns = i.columns(0) + j.columns(8)

        def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
            pose_i, pose_j = i.read(values), j.read(values)
            if jacobians is None:
                norm = np.zeros(5)
                norm[0] = np.sqrt(2.0 * block.cost(pose_i, pose_j, loss, annealing))
                return norm
            root = block.square_root(pose_i, pose_j, loss, annealing)
            for k, which in enumerate(columns):
                jacobians[k] = root[:, which]
            return root[:, -1]

        super().__init__(_BLOCK_NOISE, i.keys() + j.keys(), error)


_WIDTHS = (3, 1, 3, 1, 3)  # of the columns of frame, height, keyframe, its height, calibration
_FRAMES_ALONE_WIDTHS = (3, 1, 0, 0, 3)


@cache
def _columns(present: tuple[bool, ...], offset: int, widths: tuple[int, ...]) -> list[slice]:
    """The columns of each variable that is present, in a row of the core."""
    bounds = np.concatenate([[offset], offset + np.cumsum(widths)]).tolist()
    return [slice(a, b) for there, (a, b) in zip(present, pairwise(bounds), strict=True) if there]


class CalibratedUserKeys(NamedTuple):
    """The gtsam keys of a user whose device has a calibration; variables whose key is None are fixed."""

    frame: int | None
    """Pose2: common_from_anchor."""
    height: int | None
    """double (m): the height of the user's origin in the common frame."""
    pose: int | None
    """Pose2: a keyframe in the axes of the anchor, SLAM units."""
    local_height: int | None
    """double: the keyframe's height, SLAM units."""
    calibration: int | None
    """Vector (3,): log scale, radio bias (m), clock offset (s) minus the one at which antennas were read."""
    held_frame: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """x, y, yaw, height of the frame where `frame` is None."""
    held_local: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """The same of the keyframe where `pose` is None."""
    held_calibration: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The calibration where `calibration` is None."""

    def keys(self) -> list[int]:
        """The keys that are not None, in the order of the Jacobians."""
        return [key for key in self[:5] if key is not None]

    def columns(self, offset: int, frames_alone: bool = False) -> list[slice]:
        """The columns of each key in a row of the core, whose columns for this user begin at `offset`.

        `frames_alone` is for rows that have none for keyframes.
        """
        widths = _FRAMES_ALONE_WIDTHS if frames_alone else _WIDTHS
        return _columns(tuple(key is not None for key in self[:5]), offset, widths)

    @property
    def at_origin(self) -> bool:
        """Whether the keyframe is no variable and lies at the frame's origin."""
        return self.pose is None and self.local_height is None and self.held_local == (0.0, 0.0, 0.0, 0.0)

    def read(self, values: gtsam.Values) -> tuple[float, ...]:
        """At these values: the 8 numbers of the user's pose, and the 3 of its device's calibration."""
        frame, height, pose, local_height, device, (x, y, yaw, z), (own_x, own_y, own_yaw, own_z), calibration = self
        if frame is not None:
            at = values.atPose2(frame)
            x, y, yaw = at.x(), at.y(), at.theta()
        if height is not None:
            z = values.atDouble(height)
        if pose is not None:
            at = values.atPose2(pose)
            own_x, own_y, own_yaw = at.x(), at.y(), at.theta()
        if local_height is not None:
            own_z = values.atDouble(local_height)
        if device is not None:
            calibration = values.atVector(device).tolist()
        return x, y, yaw, z, own_x, own_y, own_yaw, own_z, *calibration


class RangeSlotFactor(gtsam.CustomFactor):
    """All ranges of a slot, between any users, each of whom is at one keyframe: one factor.

    As in RangeBlockFactor, half the squared norm of the error is the sum of the losses, and the linearised rows have
    the ranges' information. It has no noise model, for the number of rows varies: one where only the error is asked
    for, and when linearised as many as the information's rank, at most seven a user and one.
    """

    def __init__(
        self,
        users: Sequence[CalibratedUserKeys],
        slot: RangeSlot,
        loss: Loss,
        annealing: float = 1.0,
        height_curvature: Array | None = None,
    ) -> None:
        """`users` as the slot numbers them; `annealing` >= 1 widens the loss.

        `height_curvature` (1/m^2) is that of `RangeSlot.square_root`.
        """
        frames_alone = all(user.at_origin for user in users)
        width = 7 if frames_alone else 11
        columns = [which for n, user in enumerate(users) for which in user.columns(width * n, frames_alone)]

        def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
            at = np.array([user.read(values) for user in users])
            if jacobians is None:
                return np.array([np.sqrt(2.0 * slot.cost(at[:, :8], at[:, 8:], loss, annealing))])
            if frames_alone:
                root = slot.square_root_frames(at[:, :4], at[:, 8:], loss, annealing, height_curvature)
            else:
                root = slot.square_root(at[:, :8], at[:, 8:], loss, annealing, height_curvature)
            for k, which in enumerate(columns):
                jacobians[k] = root[:, which]
            return root[:, -1]

        of_all = [key for user in users for key in user.keys()]  # noqa: SIM118 - no mapping
        super().__init__(None, of_all, error)  # type: ignore[call-overload]  # gtsam's stubs know no missing model
