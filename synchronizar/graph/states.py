"""Where everybody was, as the anchored pose graph has it: frames, keyframes, devices; and tracks read off it."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array, Indices
from synchronizar.data.track import Track
from synchronizar.geometry import apply_frames, multiply_quaternions, wrap_angle
from synchronizar.preprocessing.keyframes import Ends, Keyframes
from synchronizar.preprocessing.range_measurements import Samples

SCALE, BIAS, CLOCK = range(3)
"""Columns of `Walks.device`."""


class Walks(NamedTuple):
    """Numbers for all variables of k users."""

    frames: Array
    """(k, 4) x, y, z (m), yaw (rad): where each user's anchor lies in the common frame; NaN where it is not placed."""
    local: list[Array]
    """Of each user (m, 4): its keyframes about its anchor, x, y, z in SLAM's lengths, correction of heading (rad)."""
    device: Array
    """(k, 3): log scale, radio bias (m), clock offset (s)."""


def begin(frames: Array, keyframes: list[Keyframes], device: Array) -> Walks:
    """SLAM as it is, laid at frames (k, 4) of the anchors."""
    local = [np.column_stack([k.place - k.anchor, np.zeros(len(k))]) for k in keyframes]
    return Walks(frames.copy(), local, device.copy())


def antennas(walks: Walks, who: Indices, ends: Ends, assumed_clock: Array) -> Array:
    """(n, 3) m: antennas in the axes of their users' anchors, drift, scale and clock taken into account.

    `assumed_clock` (k,) s are the clock offsets at which the ends were read.
    """
    first = np.concatenate([[0], np.cumsum([len(local) for local in walks.local])])
    at = np.concatenate(walks.local)[first[who] + ends.keyframe]
    scale = np.exp(walks.device[who, SCALE])[:, None]
    late = (walks.device[:, CLOCK] - assumed_clock)[who][:, None]
    beside = scale * ends.offset + ends.lever + late * ends.velocity
    at[:, :3] *= scale
    return apply_frames(at, beside)


def steps(local: Array, keyframes: Keyframes) -> Array:
    """(m - 1, 4): each step minus SLAM's, in units of its sigma: x, y in the keyframe's axes, z, heading."""
    away = np.diff(local, axis=0)
    c, s = np.cos(local[:-1, 3]), np.sin(local[:-1, 3])
    x, y = c * away[:, 0] + s * away[:, 1], -s * away[:, 0] + c * away[:, 1]
    said = np.diff(keyframes.place, axis=0)
    beyond = np.column_stack([x - said[:, 0], y - said[:, 1], away[:, 2] - said[:, 2], wrap_angle(away[:, 3])])
    return np.asarray(beyond / keyframes.step_sigma[:, [0, 0, 1, 2]])


def corrected(local: Array, keyframes: Keyframes, t: Array, position: Array) -> tuple[Array, Array]:
    """Poses of the device's track, drift taken out: (n, 3) about its anchor in SLAM's lengths, and (n,) rad turned.

    A pose between two keyframes is as seen from both, the nearer one weighing more.
    """
    before = np.clip(np.searchsorted(keyframes.t, t, side="right") - 1, 0, max(len(keyframes) - 2, 0))
    after = np.minimum(before + 1, len(keyframes) - 1)
    gap = keyframes.t[after] - keyframes.t[before]
    u = np.clip(np.divide(t - keyframes.t[before], gap, out=np.zeros(len(t)), where=gap > 0.0), 0.0, 1.0)
    seen = [apply_frames(local[n], position - keyframes.place[n]) for n in (before, after)]
    turned = local[before, 3] + u * wrap_angle(local[after, 3] - local[before, 3])
    return np.asarray((1.0 - u[:, None]) * seen[0] + u[:, None] * seen[1]), np.asarray(turned)


def interpolated(walks: Walks, coarse: list[Keyframes], fine: list[Keyframes]) -> Walks:
    """The same walks at other keyframes."""
    local = []
    for of_user, old, new in zip(walks.local, coarse, fine, strict=True):
        place, turned = corrected(of_user, old, new.t, new.place)
        local.append(np.column_stack([place, turned]))
    return walks._replace(local=local)


def common_track(walks: Walks, user: int, keyframes: Keyframes, track: Track) -> tuple[Track, Array]:
    """A mended track in the common frame, and by how much (n,) rad each pose was turned about the vertical."""
    place, turned = corrected(walks.local[user], keyframes, track.t, track.position)
    frame = np.broadcast_to(walks.frames[user], (len(place), 4))
    position = apply_frames(frame, np.exp(walks.device[user, SCALE]) * place)
    yaw = turned + walks.frames[user, 3]
    turn = np.column_stack([np.zeros((len(yaw), 2)), np.sin(0.5 * yaw), np.cos(0.5 * yaw)])
    return Track(track.t, position, multiply_quaternions(turn, track.quat_xyzw)), yaw


def flattened(samples: Samples, walks: Walks, ends: tuple[Ends, Ends], assumed_clock: Array) -> Samples:
    """The samples of a rigid model: antennas in metres, drift taken out; distances without the radios' bias."""
    bias = walks.device[:, BIAS]
    return replace(
        samples,
        p_i=antennas(walks, samples.i, ends[0], assumed_clock),
        p_j=antennas(walks, samples.j, ends[1], assumed_clock),
        distance=samples.distance - bias[samples.i] - bias[samples.j],
    )
