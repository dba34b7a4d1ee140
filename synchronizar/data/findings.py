"""What looks wrong in a recording: one code, one message and one remedy each."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Code(StrEnum):
    """Every kind of finding there is."""

    TIME_OVERLAP = "time-overlap"
    """No range falls within a track's time."""
    TIME_UNIT = "time-unit"
    """Stamps in milliseconds, microseconds or nanoseconds."""
    STRAY_STAMP = "stray-stamp"
    """A few poses stamped far away from all others; they are not used."""
    CLOCK = "clock"
    """A device's clock is minutes to days off."""
    RANGE_UNIT = "range-unit"
    """Ranges in millimetres, centimetres or feet."""
    TRACK_UNIT = "track-unit"
    """Positions in millimetres, centimetres or feet."""
    UP_AXIS = "up-axis"
    """Another axis of the track is vertical than `up` says."""
    OPTICAL_AXES = "optical-axes"
    """A track in a camera's axes: x right, y down, z forward."""
    QUATERNION_ORDER = "quaternion-order"
    """Quaternions written as w x y z."""
    ATTITUDE_UNKNOWN = "attitude-unknown"
    """A device that moves and never turns: its attitude is not written."""
    HEIGHT = "height"
    """A SLAM origin that lies higher or lower than its height_sigma allows."""
    SURVEY = "survey"
    """A radio that is not where it was surveyed to be."""
    RANGE_BIAS = "range-bias"
    """Ranges that are too long or too short by an antenna delay."""
    UNKNOWN_COLUMN = "unknown-column"
    """A column of ranges.csv that nobody reads."""
    UNKNOWN_SETTING = "unknown-setting"
    """A setting of recording.toml that nobody reads."""
    UNKNOWN_USER = "unknown-user"
    """A name in ranges.csv that has no track and no settings."""
    REPEATED_RANGES = "repeated-ranges"
    """The same measurement more than once."""
    POSE_GAP = "pose-gap"
    """A stretch without poses while ranges were measured."""
    FROZEN_POSES = "frozen-poses"
    """The last pose repeated while the device moved on; the repetitions are not used."""
    SPARSE_POSES = "sparse-poses"
    """Fewer poses than are needed to tell where a device was at a range."""
    SWAPPED_RADIOS = "swapped-radios"
    """The radios of two devices exchanged."""
    NEVER_MOVES = "never-moves"
    """A device with a track that stands still."""
    NO_RANGES = "no-ranges"
    """A device without a single range."""


@dataclass(frozen=True)
class Finding:
    """Something in a recording that looks wrong. It changes no number by itself."""

    code: Code
    user: str | None
    """Whose it is; None where it is everybody's, or nobody's in particular."""
    message: str
    """What was seen, with the number that makes it likely."""
    remedy: str
    """What the user can do about it."""
    others: tuple[str, ...] = ()
    """Further users whose it is."""

    def __str__(self) -> str:
        whose = "" if self.user is None else f" {self.user}:"
        return f"{self.code}:{whose} {self.message}. Remedy: {self.remedy}"


def finding_json(finding: Finding) -> dict[str, str | None]:
    """A finding as it stands in registration.json and in what `check` prints."""
    return {
        "code": str(finding.code),
        "user": finding.user,
        "message": finding.message,
        "remedy": finding.remedy,
    }
