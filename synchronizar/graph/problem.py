"""The problem that a graph states and the search begins with: which ranges between which users, in whose frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.data.recording import Recording
from synchronizar.data.user import User
from synchronizar.graph.priors import known_biases, survey_of
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import RangeMeasurements, pair_bounds, range_measurements


@dataclass(frozen=True)
class Problem:
    """Find the frames of some users of a recording in the reference's, from n range measurements between them."""

    recording: Recording
    """With repaired tracks, unless SLAM is trusted."""
    measurements: RangeMeasurements
    """The n ranges, all of them between active users."""
    active_users: list[int]
    """Indices of the users whose frames are looked for, and of the reference among them; sorted."""
    reference: int
    """Index of the user whose frame is the common one."""
    parameters: Parameters

    @classmethod
    def of(cls, recording: Recording, reference: int, parameters: Parameters) -> Problem:
        """All usable ranges of a recording, between the users that a chain of them connects to the reference."""
        measurements = range_measurements(recording, parameters)
        biases = known_biases(recording.users)
        if biases.any():
            known = biases[measurements.i] + biases[measurements.j]
            measurements = replace(measurements, distance=measurements.distance - known)
        everybody = list(range(len(recording.users)))
        return cls(recording, measurements, everybody, reference, parameters).part(np.ones(len(measurements), bool))

    @property
    def users(self) -> tuple[User, ...]:
        """All users of the recording, active or not."""
        return self.recording.users

    @property
    def free(self) -> list[int]:
        """The active users but the reference: those whose frames are unknown."""
        return [u for u in self.active_users if u != self.reference]

    @cached_property
    def survey(self) -> Array:
        """(k, 3) m: where surveyed radios are in the reference's frame; NaN of all others."""
        return survey_of(self.users, self.reference)

    @property
    def surveyed(self) -> Mask:
        """(k,) which users are surveyed radios."""
        return np.asarray(~np.isnan(self.survey[:, 0]))

    def linked(self, measurements: RangeMeasurements) -> list[set[int]]:
        """Whom each of k users is tied to: by ranges, surveyed radios by the survey to its origin."""
        out = ranging(measurements, len(self.users))
        for u in np.flatnonzero(self.surveyed).tolist():
            out[u].add(self.reference)
            out[self.reference].add(u)
        return out

    def part(self, which: Mask) -> Problem:
        """The same with the ranges `which` (n,) alone, between the users that these connect to the reference."""
        chosen = self.measurements if which.all() else self.measurements[which]
        active_users = sorted(reached_from(self.reference, self.linked(chosen)))
        if len(active_users) < len(self.users):
            chosen = chosen[np.isin(chosen.i, active_users)]
        return replace(self, measurements=chosen, active_users=active_users)

    def with_measurements(self, measurements: RangeMeasurements) -> Problem:
        """The same users with other ranges between them."""
        return replace(self, measurements=measurements)

    def widened(self, sigma: float) -> Problem:
        """The same with a further error of 1 sigma `sigma` (m) in each range: what a rigid model of SLAM leaves out."""
        ranges = self.measurements
        if sigma == 0.0:
            return self
        return self.with_measurements(replace(ranges, sigma=np.hypot(ranges.sigma, sigma)))


def ranging(measurements: RangeMeasurements, users: int) -> list[set[int]]:
    """Whom each of k users ranges to."""
    begin = pair_bounds(measurements)[:-1]
    out: list[set[int]] = [set() for _ in range(users)]
    for i, j in zip(measurements.i[begin].tolist(), measurements.j[begin].tolist(), strict=True):
        out[i].add(j)
        out[j].add(i)
    return out


def reached_from(user: int, linked: list[set[int]], without: int | None = None) -> set[int]:
    """The users that a chain of links connects to a user, itself included, but for chains by the user `without`."""
    reached = newest = {user}
    while newest:
        newest = set().union(*(linked[u] for u in newest)) - reached - {without}
        reached = reached | newest
    return reached
