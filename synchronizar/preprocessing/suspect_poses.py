"""Poses of a track that cannot be where they say: stray stamps, and poses repeated while the device moved on."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array, Indices, Mask
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.parameters import Parameters


class FrozenRun(NamedTuple):
    """A stretch of a track in which one pose is repeated."""

    first: int
    """Index of the pose that is repeated."""
    last: int
    """Index of its last repetition."""


def stray_poses(track: Track, parameters: Parameters) -> Mask:
    """(n,) which poses are stamped far away from all others: a day ahead, or 0 where the rest has seconds since 1970.

    Few poses on either side of the longest part of the track, farther from it than it is long.
    """
    t, limits = track.t, parameters.diagnosis
    stray = np.zeros(len(t), dtype=bool)
    if len(t) < limits.fewest_poses:
        return stray
    most = max(limits.stray_few, int(limits.stray_share * len(t)))
    gap = np.diff(t)
    # The main part lies between the `most`-th pose from either end: its length is safe from a few strays.
    length = max(float(t[-1 - most] - t[most]), limits.stray_gap)
    wide = np.flatnonzero(gap > length)
    before, after = wide[wide < most], wide[wide >= len(t) - 1 - most]
    if len(before):
        stray[: before[-1] + 1] = True
    if len(after):
        stray[after[0] + 1 :] = True
    return stray


def frozen_runs(track: Track, parameters: Parameters) -> list[FrozenRun]:
    """Stretches in which the same pose is repeated to the last digit while the device moved on.

    The latter shows in the step that ends a stretch: it is longer than any usual one. Where it shows once, the other
    stretches of the track are taken for the same; a device that merely stands still shows it never.
    """
    limits = parameters.diagnosis
    if len(track) < limits.fewest_poses:
        return []
    same: Mask = ~np.asarray(np.diff(np.column_stack([track.position, track.quat_xyzw]), axis=0).any(axis=1))
    if not same.any() or same.all():
        return []
    first, last = _runs(same)
    long = track.t[last] - track.t[first] >= limits.frozen_duration
    first, last = first[long], last[long]
    ended = last < len(track) - 1
    if not ended.any():
        return []
    step = np.linalg.norm(np.diff(track.position, axis=0), axis=1)
    turn = 2.0 * np.arccos(np.clip(np.abs(np.sum(track.quat_xyzw[1:] * track.quat_xyzw[:-1], axis=1)), 0.0, 1.0))
    at = last[ended]
    jumped = step[at] > max(limits.frozen_jump, limits.frozen_steps * _usual(step[~same]))
    jumped |= turn[at] > max(limits.frozen_turn, limits.frozen_steps * _usual(turn[~same]))
    if not jumped.any():
        return []
    return [FrozenRun(int(a), int(b)) for a, b in zip(first, last, strict=True)]


def frozen_poses(track: Track, parameters: Parameters) -> Mask:
    """(n,) which poses repeat an earlier one while the device moved on; the first of each stretch is a good one."""
    frozen = np.zeros(len(track), dtype=bool)
    for run in frozen_runs(track, parameters):
        frozen[run.first + 1 : run.last + 1] = True
    return frozen


def without_suspect_poses(recording: Recording, parameters: Parameters) -> Recording:
    """The same recording without poses that cannot be where they say: it is solved as if they were not there."""
    return without_frozen_poses(without_stray_poses(recording, parameters), parameters)


def without_stray_poses(recording: Recording, parameters: Parameters) -> Recording:
    """The same recording without the poses that are stamped far away from all others."""
    return _without(recording, {name: stray_poses(track, parameters) for name, track in recording.tracks.items()})


def without_frozen_poses(recording: Recording, parameters: Parameters) -> Recording:
    """The same recording without the poses that repeat an earlier one while the device moved on."""
    return _without(recording, {name: frozen_poses(track, parameters) for name, track in recording.tracks.items()})


def _without(recording: Recording, wrong: dict[str, Mask]) -> Recording:
    if not any(mask.any() for mask in wrong.values()):
        return recording
    tracks = {
        name: Track(track.t[keep], track.position[keep], track.quat_xyzw[keep]) if not keep.all() else track
        for name, track in recording.tracks.items()
        for keep in [~wrong[name]]
    }
    return replace(recording, tracks=tracks)


def _runs(same: Mask) -> tuple[Indices, Indices]:
    """First and last pose of each run of steps that lead nowhere."""
    edges = np.diff(np.concatenate([[0], same.astype(np.int8), [0]]))
    return np.flatnonzero(edges == 1).astype(np.int32), np.flatnonzero(edges == -1).astype(np.int32)


def _usual(size: Array) -> float:
    """The size that nine of ten do not exceed."""
    return float(np.quantile(size, 0.9))
