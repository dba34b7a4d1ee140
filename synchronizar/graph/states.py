"""Where everybody was, as the anchored pose graph has it: frames, keyframes, devices; and tracks read off it."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array, Indices
from synchronizar.data.track import Track
from synchronizar.geometry import apply_frames, multiply_quaternions, wrap_angle
from synchronizar.preprocessing.keyframes import Keyframes, RangeEnds
from synchronizar.preprocessing.range_measurements import RangeMeasurements

SCALE, BIAS, CLOCK = range(3)
"""Columns of `States.calibration`."""


class States(NamedTuple):
    """Numbers for all variables of k users."""

    anchor_poses: Array
    """(k, 4) x, y, z (m), yaw (rad): where each user's anchor lies in the common frame; NaN where it is not placed."""
    keyframe_poses: list[Array]
    """Of each user (m, 4): its keyframes about its anchor, x, y, z in SLAM's lengths, correction of heading (rad)."""
    calibration: Array
    """(k, 3): log scale, radio bias (m), clock offset (s)."""


def slam_states(frames: Array, keyframes: list[Keyframes], calibration: Array) -> States:
    """SLAM as it is, laid at frames (k, 4) of the anchors."""
    keyframe_poses = [np.column_stack([k.place - k.anchor, np.zeros(len(k))]) for k in keyframes]
    return States(frames.copy(), keyframe_poses, calibration.copy())


def antennas(states: States, who: Indices, ends: RangeEnds, assumed_clock: Array) -> Array:
    """(n, 3) m: antennas in the axes of their users' anchors, drift, scale and clock taken into account.

    `assumed_clock` (k,) s are the clock offsets at which the ends were read.
    """
    first = np.concatenate([[0], np.cumsum([len(keyframe_poses) for keyframe_poses in states.keyframe_poses])])
    at = np.concatenate(states.keyframe_poses)[first[who] + ends.keyframe]
    scale = np.exp(states.calibration[who, SCALE])[:, None]
    late = (states.calibration[:, CLOCK] - assumed_clock)[who][:, None]
    beside = scale * ends.offset + ends.lever + late * ends.velocity
    at[:, :3] *= scale
    return apply_frames(at, beside)


def steps(keyframe_poses: Array, keyframes: Keyframes) -> Array:
    """(m - 1, 4): each step minus SLAM's, in units of its sigma: x, y in the keyframe's axes, z, heading."""
    away = np.diff(keyframe_poses, axis=0)
    c, s = np.cos(keyframe_poses[:-1, 3]), np.sin(keyframe_poses[:-1, 3])
    x, y = c * away[:, 0] + s * away[:, 1], -s * away[:, 0] + c * away[:, 1]
    said = np.diff(keyframes.place, axis=0)
    beyond = np.column_stack([x - said[:, 0], y - said[:, 1], away[:, 2] - said[:, 2], wrap_angle(away[:, 3])])
    return np.asarray(beyond / keyframes.step_sigma[:, [0, 0, 1, 2]])


def corrected(keyframe_poses: Array, keyframes: Keyframes, t: Array, position: Array) -> tuple[Array, Array]:
    """Poses of the device's track, drift taken out: (n, 3) about its anchor in SLAM's lengths, and (n,) rad turned.

    A pose between two keyframes is as seen from both, the nearer one weighing more.
    """
    before = np.clip(np.searchsorted(keyframes.t, t, side="right") - 1, 0, max(len(keyframes) - 2, 0))
    after = np.minimum(before + 1, len(keyframes) - 1)
    gap = keyframes.t[after] - keyframes.t[before]
    u = np.clip(np.divide(t - keyframes.t[before], gap, out=np.zeros(len(t)), where=gap > 0.0), 0.0, 1.0)
    seen = [apply_frames(keyframe_poses[n], position - keyframes.place[n]) for n in (before, after)]
    turned = keyframe_poses[before, 3] + u * wrap_angle(keyframe_poses[after, 3] - keyframe_poses[before, 3])
    return np.asarray((1.0 - u[:, None]) * seen[0] + u[:, None] * seen[1]), np.asarray(turned)


def interpolated(states: States, coarse: list[Keyframes], fine: list[Keyframes]) -> States:
    """The same walks at other keyframes."""
    keyframe_poses = []
    for of_user, old, new in zip(states.keyframe_poses, coarse, fine, strict=True):
        place, turned = corrected(of_user, old, new.t, new.place)
        keyframe_poses.append(np.column_stack([place, turned]))
    return states._replace(keyframe_poses=keyframe_poses)


def common_track(states: States, user: int, keyframes: Keyframes, track: Track) -> tuple[Track, Array]:
    """A mended track in the common frame, and by how much (n,) rad each pose was turned about the vertical."""
    place, turned = corrected(states.keyframe_poses[user], keyframes, track.t, track.position)
    frame = np.broadcast_to(states.anchor_poses[user], (len(place), 4))
    position = apply_frames(frame, np.exp(states.calibration[user, SCALE]) * place)
    yaw = turned + states.anchor_poses[user, 3]
    turn = np.column_stack([np.zeros((len(yaw), 2)), np.sin(0.5 * yaw), np.cos(0.5 * yaw)])
    return Track(track.t, position, multiply_quaternions(turn, track.quat_xyzw)), yaw


def to_rigid_ranges(
    measurements: RangeMeasurements, states: States, ends: tuple[RangeEnds, RangeEnds], assumed_clock: Array
) -> RangeMeasurements:
    """The samples of a rigid model: antennas in metres, drift taken out; distances without the radios' bias."""
    bias = states.calibration[:, BIAS]
    return replace(
        measurements,
        p_i=antennas(states, measurements.i, ends[0], assumed_clock),
        p_j=antennas(states, measurements.j, ends[1], assumed_clock),
        distance=measurements.distance - bias[measurements.i] - bias[measurements.j],
    )
