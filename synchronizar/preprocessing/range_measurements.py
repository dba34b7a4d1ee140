"""Range measurements: the usable ranges of a recording with both antenna positions, each in its user's own frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array, Indices, Mask, freeze_arrays
from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.parameters import Parameters


@dataclass(frozen=True)
class RangeMeasurements:
    """n usable ranges, sorted by pair of users and within a pair by time; i < j are indices of users."""

    i: Indices
    """(n,) first user."""
    j: Indices
    """(n,) second user, j > i."""
    t: Array
    """(n,) s, stamp by the range clock."""
    p_i: Array
    """(n, 3) m, antenna in i's own frame."""
    p_j: Array
    """(n, 3) m, antenna in j's own frame."""
    distance: Array
    """(n,) m, measured distance."""
    sigma: Array
    """(n,) m, 1 sigma of a line-of-sight range."""
    nlos_odds: Array
    """(n,) prior odds P(NLOS) / P(not NLOS), before the residual is known."""
    row: Indices
    """(n,) row of the recording's ranges."""

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.i)

    def __getitem__(self, which: slice | Mask | Indices) -> RangeMeasurements:
        """The ranges selected by a slice, mask or index array, which must keep them sorted by pair."""
        return RangeMeasurements(**{f.name: getattr(self, f.name)[which] for f in fields(self)})

    @cached_property
    def bounds(self) -> Indices:
        """(p + 1,) the first range of each of p pairs of users with ranges, and the end."""
        if not len(self):
            return np.zeros(1, dtype=np.int32)
        change = np.flatnonzero((self.i[1:] != self.i[:-1]) | (self.j[1:] != self.j[:-1])) + 1
        return np.concatenate([[0], change, [len(self)]]).astype(np.int32)


class Pair(NamedTuple):
    """Two users that range to each other, and the slice of their ranges."""

    i: int
    j: int
    measurements: slice


def pair_bounds(measurements: RangeMeasurements) -> Indices:
    """(p + 1,) the first range of each of p pairs of users with ranges, and the end."""
    return measurements.bounds


def mean_by_pair(column: Array, bounds: Indices) -> Array:
    """(p,) the mean of a column (n,) over the ranges of each pair."""
    if len(bounds) < 2:
        return np.zeros(0)
    return np.asarray(np.add.reduceat(column, bounds[:-1]) / np.diff(bounds))


def pairs(measurements: RangeMeasurements) -> Iterator[Pair]:
    """Each pair of users with ranges, and the slice of these."""
    for begin, end in pairwise(pair_bounds(measurements).tolist()):
        yield Pair(int(measurements.i[begin]), int(measurements.j[begin]), slice(begin, end))


def range_measurements(recording: Recording, parameters: Parameters) -> RangeMeasurements:
    """The usable ranges of a recording.

    A range is usable where its value can be a distance and both devices' positions at that time are known. An exact
    duplicate (same time, devices, antennas and value) counts once.
    """
    ranges = recording.ranges
    distance = ranges.distance
    usable = np.isfinite(distance)
    usable &= (np.where(usable, distance, 0.0) >= parameters.ranges.shortest) & (
        np.where(usable, distance, 0.0) <= parameters.ranges.longest
    )
    n = len(ranges)
    end, t = np.concatenate([ranges.a, ranges.b]), np.concatenate([ranges.t, ranges.t])
    antenna = np.concatenate([ranges.antenna_a, ranges.antenna_b])
    p, known = np.zeros((2 * n, 3)), np.ones(2 * n, dtype=bool)
    for user in range(len(recording.users)):
        mine = np.flatnonzero(end == user)
        p[mine], known[mine] = recording.antenna_positions(
            user, t[mine], antenna[mine], parameters.slam.longest_pose_gap
        )
    p_a, p_b = p[:n], p[n:]
    usable &= known[:n] & known[n:]

    swap = ranges.a > ranges.b
    i, j = np.where(swap, ranges.b, ranges.a), np.where(swap, ranges.a, ranges.b)
    antenna_i = np.where(swap, ranges.antenna_b, ranges.antenna_a)
    antenna_j = np.where(swap, ranges.antenna_a, ranges.antenna_b)
    rows = np.flatnonzero(usable)
    order = rows[np.lexsort([c[rows] for c in (ranges.t, j, i)])]
    if len(order) and _any_same(ranges.t[order], j[order], i[order]):
        order = rows[np.lexsort([c[rows] for c in (distance, antenna_j, antenna_i, ranges.t, j, i)])]
        same = np.ones(len(order) - 1, dtype=bool)
        for column in (distance, antenna_j, antenna_i, ranges.t, j, i):
            same &= np.diff(column[order]) == 0
        order = order[np.concatenate([[True], ~same])]

    sigma = np.where(np.isnan(ranges.sigma), parameters.ranges.sigma, ranges.sigma)[order]
    share = nlos_share(ranges, parameters)[order]
    swapped = swap[order, None]
    return RangeMeasurements(
        i=i[order],
        j=j[order],
        t=ranges.t[order],
        p_i=np.where(swapped, p_b[order], p_a[order]),
        p_j=np.where(swapped, p_a[order], p_b[order]),
        distance=distance[order],
        sigma=sigma,
        nlos_odds=share / (1.0 - share),
        row=order.astype(np.int32),
    )


def _any_same(*columns: Array | Indices) -> bool:
    """Whether two rows that follow each other are the same in all columns (n,)."""
    same = columns[0][1:] == columns[0][:-1]
    for column in columns[1:]:
        same &= column[1:] == column[:-1]
    return bool(same.any())


def nlos_share(ranges: Ranges, parameters: Parameters) -> Array:
    """(n,) prior probability that each range is NLOS, before its residual is known.

    `nlos_share_blocked` where the radio reports NLOS; else by received minus first-path power (DW1000 user manual 4.7:
    below 6 dB line of sight, above 10 dB none; linear in between); else `nlos_share_clear` where the radio reports line
    of sight, and `nlos_share` where nothing is known.
    """
    return nlos_share_of(ranges.rx_power, ranges.fp_power, ranges.nlos, parameters)


def nlos_share_of(rx_power: Array, fp_power: Array, nlos: Array, parameters: Parameters) -> Array:
    """The same, by the columns (n,) that it depends on; NaN where unknown."""
    share = np.full(len(nlos), parameters.ranges.nlos_share)
    if np.isnan(nlos).all() and np.isnan(rx_power).all():
        return share
    power_difference = rx_power - fp_power
    blocked = (power_difference - parameters.ranges.power_clear_db) / (
        parameters.ranges.power_blocked_db - parameters.ranges.power_clear_db
    )
    by_power = parameters.ranges.nlos_share_clear + np.clip(blocked, 0.0, 1.0) * (
        parameters.ranges.nlos_share_blocked - parameters.ranges.nlos_share_clear
    )
    share = np.where(np.isnan(power_difference), share, by_power)
    share = np.where(nlos == 1.0, parameters.ranges.nlos_share_blocked, share)
    return np.where((nlos == 0.0) & np.isnan(power_difference), parameters.ranges.nlos_share_clear, share)
