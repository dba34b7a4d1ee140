"""What is in a recording: of each device its poses and ranges, of each pair how often and how far it ranged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.data.recording import Recording
from synchronizar.parameters import Parameters


@dataclass(frozen=True)
class DeviceSummary:
    """What is there of one device; numbers that there are not are None."""

    name: str
    static: bool
    poses: int
    rate: float | None
    """Poses a second, by the median time between two."""
    begin: float | None
    """s, own stamp of the first pose,"""
    end: float | None
    """and of the last."""
    extent: float | None
    """m: diagonal of the box that holds its positions."""
    ranges: int
    coverage: float | None
    """Share of its ranges at whose time its place is known."""


@dataclass(frozen=True)
class PairSummary:
    """What is there of two devices."""

    a: str
    b: str
    ranges: int
    usable: int
    """Of which the number can be a distance and both places at that time are known."""
    rate: float | None
    """Ranges a second, by the median time between two."""
    median: float | None
    """m, of the usable ones."""


@dataclass(frozen=True)
class Summary:
    """What is in a recording."""

    devices: tuple[DeviceSummary, ...]
    pairs: tuple[PairSummary, ...]
    """Those that ranged."""
    ranges: int
    usable: int
    no_distance: int
    """Ranges whose number can be no distance, whatever the tracks say."""
    shortest: float | None
    """m: the smallest number of all,"""
    longest: float | None
    """and the largest."""
    begin: float | None
    """s, the range clock: the first range,"""
    end: float | None
    """and the last."""


def summary_of(recording: Recording, parameters: Parameters) -> Summary:
    """What is in a recording, before anything is solved."""
    r, users = recording.ranges, recording.users
    finite = np.isfinite(r.distance)
    sensible = finite & (np.where(finite, r.distance, 0.0) >= parameters.ranges.shortest)
    sensible &= np.where(finite, r.distance, 0.0) <= parameters.ranges.longest
    known_a, known_b = np.ones(len(r), dtype=bool), np.ones(len(r), dtype=bool)
    devices = []
    for u, user in enumerate(users):
        own, mine_a, mine_b = (r.a == u) | (r.b == u), r.a == u, r.b == u
        if user.static:
            devices.append(DeviceSummary(user.name, True, 0, None, None, None, None, int(own.sum()), None))
            continue
        track = recording.tracks[user.name]
        known_a[mine_a] = track.at(r.t[mine_a], parameters.slam.longest_pose_gap).valid
        known_b[mine_b] = track.at(r.t[mine_b], parameters.slam.longest_pose_gap).valid
        there = np.concatenate([known_a[mine_a], known_b[mine_b]])
        devices.append(
            DeviceSummary(
                user.name,
                False,
                len(track),
                _rate(track.t),
                float(track.t[0]),
                float(track.t[-1]),
                track.extent(),
                int(own.sum()),
                float(there.mean()) if len(there) else None,
            )
        )
    usable = sensible & known_a & known_b
    return Summary(
        tuple(devices),
        _pairs(recording, usable),
        len(r),
        int(usable.sum()),
        int((~sensible).sum()),
        float(r.distance[finite].min()) if finite.any() else None,
        float(r.distance[finite].max()) if finite.any() else None,
        float(r.t.min()) if len(r) else None,
        float(r.t.max()) if len(r) else None,
    )


def _pairs(recording: Recording, usable: Mask) -> tuple[PairSummary, ...]:
    r, names = recording.ranges, [user.name for user in recording.users]
    key = np.minimum(r.a, r.b).astype(np.int64) * len(names) + np.maximum(r.a, r.b)
    order = np.lexsort((r.t, key))
    bounds = np.flatnonzero(np.diff(key[order])) + 1
    pairs = []
    for mine in np.split(order, bounds) if len(order) else []:
        i, j = divmod(int(key[mine[0]]), len(names))
        good = mine[usable[mine]]
        middle = float(np.median(r.distance[good])) if len(good) else None
        pairs.append(PairSummary(names[i], names[j], len(mine), len(good), _rate(r.t[mine]), middle))
    return tuple(pairs)


def _rate(t: Array) -> float | None:
    dt = np.diff(t)
    dt = dt[dt > 0.0]
    return 1.0 / float(np.median(dt)) if len(dt) else None
