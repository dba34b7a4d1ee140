"""What either model hands back, to be told as a Registration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from synchronizar.arrays import Array
from synchronizar.data.jump import Jump
from synchronizar.data.track import Track
from synchronizar.estimation.integrity import Verdict
from synchronizar.preprocessing.range_measurements import RangeMeasurements


@dataclass(frozen=True)
class Outcome:
    """The solution for k users; everything about their own origins, in the common frame as it is told."""

    searched: float
    """By perf_counter: when the search was over and the solving began."""
    said: list[Verdict | None]
    """Of each user; None for those that no chain of ranges ties to the reference."""
    costs: list[float]
    """Negative log likelihoods of the joint placements, best first."""
    frames: list[Array]
    """Of each joint placement (k, 4) x, y, z, yaw: common_from_user; NaN where it is not placed."""
    covariances: Array
    """(k, 4, 4) of the best one's."""
    errors: Array
    """(k, 4, 4): turns the direction that a verdict calls unseen into one of `frames`."""
    scale: Array
    """(k,) metres in each user's own unit of length."""
    measurements: RangeMeasurements
    weight: Array
    """(n,) 1/m^2, of each sample."""
    inlier_probability: Array
    """(n,) the probability that each is."""
    residual: Array
    """(n,) m, measured minus predicted."""
    joint: Array | None = None
    """(k, 4, k, 4) covariances of all users at once; None where that is not looked at."""
    calibration: Array | None = None
    """(k, 3) scale, radio bias (m), clock offset (s); None where they are taken for perfect."""
    calibration_sigma: Array | None = None
    """(k, 3) 1 sigma of them."""
    slam_noise: Array | None = None
    """(k, 2) how many times as far as the model says SLAM drifts, in place and in heading; NaN where it has no SLAM."""
    tracks: Mapping[str, Track] = field(default_factory=dict)
    """Corrected tracks in the common frame, where SLAM is not trusted."""
    jumps: Mapping[str, tuple[Jump, ...]] = field(default_factory=dict)
