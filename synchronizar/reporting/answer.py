"""A registration with its tracks and ranges, as plots and reports need them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from synchronizar.arrays import Array
from synchronizar.data.range_ends import range_ends
from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration
from synchronizar.data.track import Track
from synchronizar.io.registration_reader import read_registration
from synchronizar.parameters import Parameters


@dataclass(frozen=True)
class Answer:
    """A registration, its tracks, SLAM's own tracks, and the ranges."""

    registration: Registration
    tracks: Mapping[str, Track]
    """Tracks in the common frame, at own stamps, of every user not disconnected; one pose for a static radio."""
    slam: Mapping[str, Track]
    """SLAM's own tracks, in their own frames, of every user that is not static."""
    ranges: Ranges

    @property
    def names(self) -> list[str]:
        """All users, in the order of the ranges' indices."""
        return list(self.registration.users)

    @property
    def reference(self) -> str:
        """Name of the reference user; blank where there is none."""
        return self.registration.reference or ""

    @property
    def corrects_slam(self) -> bool:
        """Whether the model estimates drift, jumps, scales, biases and clocks."""
        return self.registration.model == "full"

    @property
    def moving(self) -> list[str]:
        """Users with a track in the common frame that are not static."""
        return [name for name in self.tracks if not self.registration.users[name].static]

    @property
    def began(self) -> float:
        """s, range clock: time 0 of plots: the first range, or the first pose where there is no range."""
        if len(self.ranges):
            return float(self.ranges.t.min())
        return min((float(self.tracks[name].t[0]) - self.clock_offset(name) for name in self.moving), default=0.0)

    @property
    def range_sigma(self) -> float:
        """m: median 1 sigma of the usable ranges; the model's where the recording gives none."""
        sigma = self.ranges.sigma[self.registration.ranges.usable]
        model = Parameters().ranges.sigma
        return float(np.median(np.where(np.isnan(sigma), model, sigma))) if len(sigma) else model

    def other_walks(self, name: str) -> list[Array]:
        """(n, 3) m, common frame: the walk of a user that has a frame under each alternative but the best."""
        frame = self.registration.users[name].common_from_user
        assert frame is not None
        others = [other.common_from_user.get(name) for other in self.registration.alternatives[1:]]
        own = frame.inverse() @ self.tracks[name].position
        return [replace(other, scale=frame.scale) @ own for other in others if other is not None]

    def clock_offset(self, name: str) -> float:
        """s: the user's own stamp minus the range stamp of the same event; 0 for a static radio."""
        return self.registration.users[name].clock_offset or 0.0

    def elapsed(self, name: str, t: Array) -> Array:
        """(n,) s since `began`, from the user's own stamps (n,)."""
        return np.asarray(t - self.clock_offset(name) - self.began)

    def ends(self, rows: NDArray[np.intp]) -> Array:
        """(n, 2, 3) m, common frame: positions of both devices at n of the ranges; NaN where unknown."""
        return range_ends(self.ranges.select(rows), self.registration, self.tracks, np.inf)


def read_answer(folder: Path, recording: Recording) -> Answer:
    """The answer that `register --out` wrote for a recording.

    Raises InputError where a file is missing or broken, or is about another recording.
    """
    registration, tracks = read_registration(folder, recording)
    return Answer(registration, tracks, recording.tracks, recording.ranges)
