"""The recording as the solver sees it: for each range where both antennas were, each in its own user's frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array, Indices, Mask, freeze_arrays
from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.parameters import Parameters


@dataclass(frozen=True)
class RangeMeasurements:
    """n usable ranges, sorted by pair of users and, within a pair, by time; i < j are indices of users."""

    i: Indices
    """(n,) the one user."""
    j: Indices
    """(n,) the other, j > i."""
    t: Array
    """(n,) s, the range clock."""
    p_i: Array
    """(n, 3) m: the antenna in i's own frame."""
    p_j: Array
    """(n, 3) m: the antenna in j's own frame."""
    distance: Array
    """(n,) m, measured."""
    sigma: Array
    """(n,) m, of an honest range."""
    nlos_odds: Array
    """(n,) P(late) / P(not late), before its residual is known."""
    row: Indices
    """(n,) which range of the recording it is."""

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.i)

    def __getitem__(self, which: slice | Mask | Indices) -> RangeMeasurements:
        """The samples that a slice, a mask or an index array picks; their order must stay sorted by pair."""
        return RangeMeasurements(**{f.name: getattr(self, f.name)[which] for f in fields(self)})


class Pair(NamedTuple):
    """Two users that range to each other, and where their samples stand."""

    i: int
    j: int
    measurements: slice


def pairs(measurements: RangeMeasurements) -> Iterator[Pair]:
    """Each pair of users that has samples, with the slice that holds them."""
    if not len(measurements):
        return
    change = np.flatnonzero(np.diff(measurements.i) | np.diff(measurements.j)) + 1
    bounds = [0, *change.tolist(), len(measurements)]
    for begin, end in pairwise(bounds):
        yield Pair(int(measurements.i[begin]), int(measurements.j[begin]), slice(begin, end))


def range_measurements(recording: Recording, parameters: Parameters) -> RangeMeasurements:
    """The usable ranges of a recording.

    A range is usable where its number can be a distance and both devices' places at that time are known. One that
    repeats another to the letter (same time, devices, antennas and number) counts once.
    """
    ranges = recording.ranges
    distance = ranges.distance
    usable = np.isfinite(distance)
    usable &= (np.where(usable, distance, 0.0) >= parameters.ranges.shortest) & (
        np.where(usable, distance, 0.0) <= parameters.ranges.longest
    )
    p_a, p_b = np.zeros((len(ranges), 3)), np.zeros((len(ranges), 3))
    for user in range(len(recording.users)):
        for end, antenna, p in ((ranges.a, ranges.antenna_a, p_a), (ranges.b, ranges.antenna_b, p_b)):
            mine = np.flatnonzero(end == user)
            p[mine], known = recording.antenna_positions(
                user, ranges.t[mine], antenna[mine], parameters.slam.longest_pose_gap
            )
            usable[mine[~known]] = False

    swap = ranges.a > ranges.b
    i, j = np.where(swap, ranges.b, ranges.a), np.where(swap, ranges.a, ranges.b)
    antenna_i = np.where(swap, ranges.antenna_b, ranges.antenna_a)
    antenna_j = np.where(swap, ranges.antenna_a, ranges.antenna_b)
    rows = np.flatnonzero(usable)
    order = rows[np.lexsort([c[rows] for c in (distance, antenna_j, antenna_i, ranges.t, j, i)])]
    same = np.ones(max(len(order) - 1, 0), dtype=bool)
    for column in (distance, antenna_j, antenna_i, ranges.t, j, i):
        same &= np.diff(column[order]) == 0
    order = order[np.concatenate([[True], ~same])] if len(order) else order

    sigma = np.where(np.isnan(ranges.sigma), parameters.ranges.sigma, ranges.sigma)[order]
    late_share = _late_share(ranges, parameters)[order]
    swapped = swap[order, None]
    return RangeMeasurements(
        i=i[order],
        j=j[order],
        t=ranges.t[order],
        p_i=np.where(swapped, p_b[order], p_a[order]),
        p_j=np.where(swapped, p_a[order], p_b[order]),
        distance=distance[order],
        sigma=sigma,
        nlos_odds=late_share / (1.0 - late_share),
        row=order.astype(np.int32),
    )


def _late_share(ranges: Ranges, parameters: Parameters) -> Array:
    """How probable it is (n,) that each range is late, before its residual is known.

    High where the radio itself takes the signal for late; else from the power that did not come by the first path
    (DW1000 user manual 4.7: below 6 dB line of sight, above 10 dB none; in between linear); else low where the radio
    takes it for direct, and the model's share where nothing is known.
    """
    share = np.full(len(ranges), parameters.ranges.nlos_share)
    beside_first_path = ranges.rx_power - ranges.fp_power
    blocked = (beside_first_path - parameters.ranges.power_clear_db) / (
        parameters.ranges.power_blocked_db - parameters.ranges.power_clear_db
    )
    by_power = parameters.ranges.nlos_share_clear + np.clip(blocked, 0.0, 1.0) * (
        parameters.ranges.nlos_share_blocked - parameters.ranges.nlos_share_clear
    )
    share = np.where(np.isnan(beside_first_path), share, by_power)
    share = np.where(ranges.nlos == 1.0, parameters.ranges.nlos_share_blocked, share)
    return np.where((ranges.nlos == 0.0) & np.isnan(beside_first_path), parameters.ranges.nlos_share_clear, share)
