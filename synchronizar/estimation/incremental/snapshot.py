"""What a search is given and what it finds: plain arrays, so that it can run in another process."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from synchronizar.arrays import Array, Indices
from synchronizar.data.recording import Recording
from synchronizar.estimation.integrity import Verdict
from synchronizar.parameters import Parameters


class SlotPoses(NamedTuple):
    """Where a user's repaired SLAM has it at the begins of m slots; the last row is its last pose."""

    slots: list[int]
    """Of all rows but the last."""
    stamps: Array
    """(m + 1,) s, its own clock."""
    places: Array
    """(m + 1, 3) SLAM units."""


class Candidate(NamedTuple):
    """A joint placement that a search found, where the next one may begin."""

    frames: Array
    """(k, 4) x, y, z (m), yaw (rad): gauge's frame from each user's repaired SLAM frame; NaN for who is not in it."""
    calibration: Array
    """(k, 3)."""


@dataclass(frozen=True)
class Snapshot:
    """All that came in a stretch of time until `t`."""

    t: float
    """s, range clock."""
    clocks: Array
    """(k,) s: by how much the stamps of tracks are put back; a search looks for what their clocks are off beside."""
    recording: Recording
    """Repaired tracks and ranges; a user without a pose there has one long ago."""
    serial: Indices
    """(n,) running index of each of its ranges."""
    segments: dict[str, Indices]
    """Of each track (n,): which segment between relocalisations a pose belongs to."""
    rebuilt_sigma: dict[str, tuple[float, float]]
    """Of each track, as in `RepairedTrack`."""
    gauge: int
    """The user whose frame is the graph's."""
    sought: tuple[int, ...]
    """Users whose places are looked for; the others are followed."""
    candidates: tuple[Candidate, ...]
    """Found by the search before this one."""
    known: dict[int, Array]
    """(4,) x, y, z (m), yaw (rad) of those who are followed and not sought: some frame from their repaired SLAM's, with
    lengths in m, at their last poses."""
    poses: dict[int, SlotPoses]
    registered: tuple[int, ...]
    parameters: Parameters


class FoundUser(NamedTuple):
    """A user as a search found it, in the graph's frame."""

    verdict: Verdict
    place: Array
    """(4,) x, y, z (m), yaw (rad) of its last pose, the mean over the optima."""
    covariance: Array
    """(6, 6) of errors in x, y, z (m), yaw (rad), its log scale, the gauge's log scale."""
    calibration: Array
    """(3,) log scale, radio bias (m), clock offset (s)."""
    calibration_sigma: Array
    """(3,) 1 sigma."""
    states: Array
    """(m, 4) x, y, z, yaw at each of its slots, at the best optimum."""
    progress: float
    single: bool
    """Whether one optimum alone is left: of two that are still near only searches see whether they part."""
    rejected: float
    """Share of its latest ranges that do not fit."""
    height_spread: float
    """m^2: variance of its height from one optimum to the next, within what the best hypothesis holds."""
    height_weight: float
    """Of the prior of its height, at the best optimum."""
    calibration_prior: Array
    """(3,) 1 sigma of the prior of its calibration about what all share, there."""


class FoundRanges(NamedTuple):
    """n ranges as the best optimum takes them."""

    serial: Indices
    inlier_probability: Array
    weight: Array
    """1/m^2."""
    residual: Array
    """m, measured minus predicted."""


class Found(NamedTuple):
    """What a search found."""

    t: float
    """s: of its snapshot."""
    gauge: int
    anchor: Array
    """(3,) SLAM units: where the graph's frame has its origin, in the gauge's own."""
    poses: dict[int, SlotPoses]
    """Those of its snapshot."""
    users: dict[int, FoundUser]
    """The users that a chain of ranges connects to the gauge, it included."""
    alternatives: list[tuple[float, Array]]
    """Cost and (k, 4) last poses of each joint hypothesis, best first; one where there is no other."""
    candidates: tuple[Candidate, ...]
    noise: Array
    """(k, 2) factors on each SLAM's drift."""
    ranges: FoundRanges
