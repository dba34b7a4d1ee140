"""Whether some users are somewhere else than they are followed to be: likelihoods of one shift of theirs.

Ranges of the last moments are looked at as they came, before they were used. If a group of users is off by one shift,
their ranges to the others show it, and those among themselves do not (factors/innovation_tests.h).
"""

from __future__ import annotations

from typing import NamedTuple

from synchronizar._core import shifted_groups
from synchronizar.arrays import Array
from synchronizar.estimation.incremental.innovations import Innovations
from synchronizar.graph.priors import bursts_of, nlos_mixture
from synchronizar.parameters import Parameters


class Shifted(NamedTuple):
    """Users who may be somewhere else, all by one shift."""

    users: frozenset[int]
    shift: Array
    """(3,) m, now."""
    gain: float
    """Log likelihood that the shift gains."""


def shifted(recent: Innovations, now: float, parameters: Parameters) -> list[Shifted]:
    """Groups of users whose latest ranges one shift explains better, which is there all along or grows evenly."""
    m = parameters.integrity
    stretches = [(now - m.shift_steady, now, False), *((now - window, now, True) for window in m.shift_growing)]
    limits = float(m.innovation_fewest), m.shift_sigma, m.shift_looked_at
    found = shifted_groups(recent.rows, stretches, *limits, nlos_mixture(parameters), bursts_of(parameters))
    return [Shifted(frozenset(users), shift, gain) for users, shift, gain in found]
