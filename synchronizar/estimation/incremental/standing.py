"""What is known of one user while people walk."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.registration import State
from synchronizar.estimation.incremental.cues import Cue
from synchronizar.estimation.integrity import Verdict
from synchronizar.geometry import apply_frames, wrap_angle
from synchronizar.parameters import IntegrityParameters


@dataclass(frozen=True)
class Placed:
    """Where a user is, by the last search or as it is followed, at one of its own poses."""

    place: Array
    """(3,) SLAM units: where its repaired SLAM has it."""
    state: Array
    """(7,) x, y (m), yaw (rad), height (m) in the common frame; log scale, radio bias (m), clock offset (s)."""
    covariance: Array
    """(6, 6) of errors in x, y, z (m, common axes), yaw (rad), its log scale, the reference's log scale."""
    calibration_sigma: Array
    """(3,) 1 sigma of log scale, bias (m), clock (s); NaN where a static radio has none."""

    def at(self, place: Array) -> Array:
        """(3,) m: where a place (3,) in its repaired SLAM frame is in the common one."""
        x, y, yaw, height, log_scale = self.state[:5].tolist()
        frame = np.array([x, y, height, yaw])
        return np.asarray(apply_frames(frame, np.exp(log_scale) * (place - self.place)))

    def is_elsewhere(self, other: Placed, parameters: IntegrityParameters) -> bool:
        """Whether it is not where the same user is by `other`, at the pose of that one."""
        apart = float(np.linalg.norm(self.at(other.place) - other.at(other.place)))
        turn = abs(wrap_angle(float(self.state[2] - other.state[2])))
        return apart > 0.5 * parameters.largest_error or turn > 0.5 * parameters.largest_yaw_error


@dataclass
class Standing:
    """The state of one user's registration, and since when."""

    state: State = State.DISCONNECTED
    reason: str = "nothing is solved yet"
    verdict: Verdict | None = None
    placed: Placed | None = None
    since: float | None = None
    """s: its first range, or when it was last given up and looked for anew; None: it has not ranged."""
    registered_at: float | None = None
    """s: since when it is registered."""
    steady_since: float | None = None
    """s: since when its place has stayed, while it is watched."""
    proven: bool = False
    """Whether it was registered for long enough, and no other placement was found: it is sought no more."""
    doubted_at: float = -inf
    """s: when its ranges contradicted it last."""
    contradicted: bool = False
    """Whether it is the reference and its ranges contradict it: then nobody is registered."""
    unconfirmed_since: float | None = None
    """s: since its SLAM went on after a pause, and its ranges have not told yet that its frame is the same."""
    left_at: float | None = None
    """s: since others were contradicted beside it, and its ranges have not told yet that it is not it that moved."""
    resumed_at: float = -inf
    """s, its own clock: the last such pause that was noticed."""
    lifted: bool = False
    """Whether it went up or down and its SLAM did not: the prior of its origin's height holds no more."""
    progress: float = 0.0
    cue: Cue | None = None

    @property
    def is_registered(self) -> bool:
        """Whether its placement can be relied on."""
        return self.state is State.REGISTERED

    def begin_again(self, now: float, state: State, reason: str) -> None:
        """What was known of its place is not believed any more: it is looked for in what comes from now on."""
        self.state, self.reason, self.since = state, reason, now
        self.registered_at, self.steady_since, self.proven = None, None, False
        self.placed, self.verdict, self.cue, self.progress = None, None, None, 0.0
        self.unconfirmed_since = self.left_at = None
