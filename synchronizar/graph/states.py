"""States of the pose graph as arrays: frames, keyframe poses, calibrations; antennas and tracks computed from them.

"SLAM units" are lengths as SLAM reports them; times exp(log scale) they are metres.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array, Indices
from synchronizar.data.track import Track
from synchronizar.geometry import apply_frames, wrap_angle
from synchronizar.preprocessing.keyframes import Keyframes, RangeEnds
from synchronizar.preprocessing.range_measurements import RangeMeasurements
from synchronizar.quaternions import multiply_quaternions

SCALE, BIAS, CLOCK = range(3)
"""Columns of `States.calibration`."""


class States(NamedTuple):
    """Values of all variables of k users."""

    anchor_poses: Array
    """(k, 4) x, y, z (m), yaw (rad): common_from_anchor of each user; NaN for users that are not active."""
    keyframe_poses: list[Array]
    """Of each user (m, 4): keyframe positions x, y, z in the axes of its anchor (SLAM units), yaw correction (rad)."""
    calibration: Array
    """(k, 3): log scale, radio bias (m), clock offset (s)."""
    lasting: Array = np.zeros(0)
    """(v,) m: what lasting errors make ranges longer by; empty where they are no variables."""


def slam_states(frames: Array, keyframes: list[Keyframes], calibration: Array) -> States:
    """SLAM's own poses as states, with anchors at frames (k, 4) x, y, z (m), yaw (rad); `calibration` (k, 3)."""
    keyframe_poses = [np.column_stack([k.place - k.anchor, np.zeros(len(k))]) for k in keyframes]
    return States(frames.copy(), keyframe_poses, calibration.copy())


def antennas(states: States, who: Indices, ends: RangeEnds, assumed_clock: Array) -> Array:
    """(n, 3) m: antenna of user `who` (n,) at each range, about its anchor, corrected for drift, scale and clock.

    `assumed_clock` (k,) s are the clock offsets at which `ends` were read from the tracks.
    """
    first = np.concatenate([[0], np.cumsum([len(keyframe_poses) for keyframe_poses in states.keyframe_poses])])
    at = np.concatenate(states.keyframe_poses)[first[who] + ends.keyframe]
    scale = np.exp(states.calibration[who, SCALE])[:, None]
    clock_error = (states.calibration[:, CLOCK] - assumed_clock)[who][:, None]
    from_keyframe = scale * ends.offset + ends.lever + clock_error * ends.velocity
    at[:, :3] *= scale
    return apply_frames(at, from_keyframe)


def steps(keyframe_poses: Array, keyframes: Keyframes) -> Array:
    """(m - 1, 4) whitened odometry errors: each step minus SLAM's, over sigma; x, y in keyframe axes, z, yaw."""
    step = np.diff(keyframe_poses, axis=0)
    c, s = np.cos(keyframe_poses[:-1, 3]), np.sin(keyframe_poses[:-1, 3])
    x, y = c * step[:, 0] + s * step[:, 1], -s * step[:, 0] + c * step[:, 1]
    slam = np.diff(keyframes.place, axis=0)
    error = np.column_stack([x - slam[:, 0], y - slam[:, 1], step[:, 2] - slam[:, 2], wrap_angle(step[:, 3])])
    return np.asarray(error / keyframes.step_sigma[:, [0, 0, 1, 2]])


def corrected(keyframe_poses: Array, keyframes: Keyframes, t: Array, position: Array) -> tuple[Array, Array]:
    """SLAM positions (n, 3) corrected for drift, in the axes of the anchor (SLAM units); yaw corrections (n,) rad.

    `t` (n,) s are the stamps of `position` (n, 3). Between two keyframes the result is the mean of both keyframes'
    corrections, weighted linearly in time.
    """
    before = np.clip(np.searchsorted(keyframes.t, t, side="right") - 1, 0, max(len(keyframes) - 2, 0))
    after = np.minimum(before + 1, len(keyframes) - 1)
    gap = keyframes.t[after] - keyframes.t[before]
    u = np.clip(np.divide(t - keyframes.t[before], gap, out=np.zeros(len(t)), where=gap > 0.0), 0.0, 1.0)
    by_keyframe = [apply_frames(keyframe_poses[n], position - keyframes.place[n]) for n in (before, after)]
    yaw = keyframe_poses[before, 3] + u * wrap_angle(keyframe_poses[after, 3] - keyframe_poses[before, 3])
    return np.asarray((1.0 - u[:, None]) * by_keyframe[0] + u[:, None] * by_keyframe[1]), np.asarray(yaw)


def interpolated(states: States, coarse: list[Keyframes], fine: list[Keyframes]) -> States:
    """The same states at other keyframes, interpolated in time; lasting errors are of ranges, and stay."""
    keyframe_poses = []
    for of_user, old, new in zip(states.keyframe_poses, coarse, fine, strict=True):
        place, yaw = corrected(of_user, old, new.t, new.place)
        keyframe_poses.append(np.column_stack([place, yaw]))
    return states._replace(keyframe_poses=keyframe_poses)


def common_track(states: States, user: int, keyframes: Keyframes, track: Track) -> tuple[Track, Array]:
    """A repaired track in the common frame (m), and the yaw (n,) rad that turned each of its poses."""
    place, correction = corrected(states.keyframe_poses[user], keyframes, track.t, track.position)
    frame = np.broadcast_to(states.anchor_poses[user], (len(place), 4))
    position = apply_frames(frame, np.exp(states.calibration[user, SCALE]) * place)
    yaw = correction + states.anchor_poses[user, 3]
    turn = np.column_stack([np.zeros((len(yaw), 2)), np.sin(0.5 * yaw), np.cos(0.5 * yaw)])
    return Track(track.t, position, multiply_quaternions(turn, track.quat_xyzw)), yaw


def to_rigid_ranges(
    measurements: RangeMeasurements, states: States, ends: tuple[RangeEnds, RangeEnds], assumed_clock: Array
) -> RangeMeasurements:
    """The ranges for a rigid model, corrected for drift, scale, clock and bias.

    Antennas are about their anchors (m), as `antennas` has them; distances are without the radio biases.
    """
    bias = states.calibration[:, BIAS]
    return replace(
        measurements,
        p_i=antennas(states, measurements.i, ends[0], assumed_clock),
        p_j=antennas(states, measurements.j, ends[1], assumed_clock),
        distance=measurements.distance - bias[measurements.i] - bias[measurements.j],
    )
