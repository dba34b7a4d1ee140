"""The answer: where every device's frame lies in the common frame, how sure that is, and which ranges it rests on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.data.findings import Finding
from synchronizar.data.jump import Jump
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.geometry import YawFrame


class State(StrEnum):
    """What can be said of a user's placement."""

    REGISTERED = "registered"
    AMBIGUOUS = "ambiguous"
    UNOBSERVABLE = "unobservable"
    DISCONNECTED = "disconnected"


class CalibrationSigma(NamedTuple):
    """1 sigma of what is wrong with a device."""

    scale: float
    range_bias: float
    """m."""
    clock_offset: float
    """s."""


@dataclass(frozen=True)
class UserRegistration:
    """One user's part of the answer."""

    name: str
    state: State
    reason: str
    """One sentence: why the state is what it is."""
    common_from_user: YawFrame | None
    """Its own frame in the common one, at its last pose where SLAM drifts. Takes points in the axes of its own track, y
    up where that is y up, to the common frame, z up. None where it is disconnected."""
    covariance: Array | None
    """(4, 4) of additive errors in x, y, z (m, common axes) and yaw (rad); NaN rows for what it does not have."""
    static: bool = False
    """A radio that stands still: it has a place and no heading."""
    unseen_direction: Array | None = None
    """(4,) unit vector over x, y, z, yaw (m and rad) that the ranges see least, where that makes it unobservable."""
    prior_dominated: tuple[str, ...] = ()
    """Which of its numbers a prior determines rather than the ranges."""
    range_bias: float = 0.0
    """m: what its radio adds to each range; a range of two is too long by the sum of theirs."""
    clock_offset: float | None = 0.0
    """s: its own stamp minus the range stamp of the same event; None for a radio that stands still."""
    calibration_sigma: CalibrationSigma | None = None
    """1 sigma of its scale, range_bias and clock_offset; None where they are taken for known."""
    slam_noise: tuple[float, float] | None = None
    """How many times as far as the model says its SLAM drifts, in place and in heading; None where it is trusted."""
    jumps: tuple[Jump, ...] = ()
    """Where its SLAM jumped or slipped and it did not, in the order of time."""
    common_track: Track | None = None
    """Its poses in the common frame at its own stamps, SLAM's drift and jumps taken out; None where SLAM is trusted
    and none of its poses was set aside."""
    progress: float | None = None
    """0 to 1: how near it is to being registered; None but while people walk."""
    cue: str | None = None
    """Which way to walk to be registered soonest, while people walk; None where no walk would help."""


@dataclass(frozen=True)
class Alternative:
    """One joint placement of all users that explains the ranges."""

    cost: float
    """Negative log likelihood relative to the best placement's, which has 0."""
    common_from_user: Mapping[str, YawFrame]


@dataclass(frozen=True)
class RangeVerdicts:
    """What became of each range of the recording, in its order."""

    usable: Mask
    """(n,) whether it can be used: a distance by its number, both places at that time known, no repetition of another,
    and its two devices tied to the reference by some chain of ranges; of the pairwise method, that was sampled."""
    used: Mask
    """(n,) whether the answer takes it for an honest measurement; a usable range that is not used was rejected."""
    weight: Array
    """(n,) 1/m^2: the information it brought along its line, robust weight included; 0 where not usable."""
    residual: Array
    """(n,) m, measured minus predicted; NaN where not usable."""


@dataclass(frozen=True)
class Registration:
    """Every user's frame in one common frame.

    The common frame is metric; its origin and heading are the reference's own at the reference's first pose.
    """

    reference: str | None
    """Whose frame the common one is; None while people walk and nobody has moved yet."""
    model: str
    method: str
    users: Mapping[str, UserRegistration]
    alternatives: tuple[Alternative, ...]
    """The joint placements that explain the ranges, best first, where there are two or more; else none."""
    ranges: RangeVerdicts
    seconds: Mapping[str, float]
    joint_covariance: Array | None = None
    """(k, 4, k, 4), users in order: how the errors of all `common_from_user` hang together, as each one's `covariance`
    has its own; of the best placement alone. None from the rigid model and while people walk."""

    findings: tuple[Finding, ...] = ()
    """What looks wrong in the recording."""

    def between(self, to: str, of: str) -> YawFrame:
        """`to_from_of`: `between("alice", "bob") @ points` takes points in Bob's own axes to Alice's.

        Its x, y, z, yaw are of both frames read z up; `matrix` and `translation` are in the users' own axes. It holds
        at both users' last poses. Raises KeyError for a user that is not there, ValueError for one without a frame.
        """
        to_from_common = self._placed(to).inverse()
        return to_from_common @ self._placed(of)

    def _placed(self, name: str) -> YawFrame:
        if name not in self.users:
            raise KeyError(f"there is no user {name!r}; there are {', '.join(self.users)}")
        frame = self.users[name].common_from_user
        if frame is None:
            raise ValueError(f"{name} is {self.users[name].state}: {self.users[name].reason}")
        return frame

    def tracks(self, recording: Recording) -> dict[str, Track]:
        """The track of every user that has a placement, in the common frame; one pose at t = 0 for a static radio."""
        out = {}
        for name, user in self.users.items():
            if user.common_from_user is None:
                continue
            if user.common_track is not None:
                out[name] = user.common_track
            elif user.static:
                position = user.common_from_user.translation[None, :]
                out[name] = Track(np.zeros(1), position, np.array([[0.0, 0.0, 0.0, 1.0]]))
            else:
                own = recording.tracks[name]
                out[name] = replace(
                    own,
                    position=user.common_from_user.z_up @ own.position,
                    quat_xyzw=user.common_from_user.z_up.rotate_quaternions(own.quat_xyzw),
                )
        return out
