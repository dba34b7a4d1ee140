"""Where each device's SLAM says it was, about once a second, and how far the steps in between can be trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from synchronizar.arrays import Array, Indices, Mask, freeze_arrays
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.geometry import rotate_by_quaternions
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import RangeMeasurements
from synchronizar.preprocessing.relocalizations import RepairedTrack

_REACH = 0.1  # s: over which to either side a velocity is taken
_LEAST_SIGMA = 1e-4  # m and rad: a step that is known any better makes the system singular in its numbers


@dataclass(frozen=True)
class Keyframes:
    """n poses of one device in its own frame, jumps mended; one at the origin for a radio that stands still."""

    t: Array
    """(n,) s, own stamps."""
    place: Array
    """(n, 3) SLAM's lengths."""
    step_sigma: Array
    """(n - 1, 3): 1 sigma of each step in the plane (m, each axis), in height (m) and in heading (rad)."""
    until: Array
    """(n - 1,) s: when one keyframe's turn ends and the next one's begins."""
    rebuilt: Mask
    """(n - 1,) whether a step is none of SLAM's: it jumped, or had lost gravity."""

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.t)

    @property
    def anchor(self) -> Array:
        """(3,) what the device's own frame is solved about: its first place, but its own origin in height."""
        return np.append(self.place[0, :2], 0.0)

    def nearest(self, t: Array) -> Indices:
        """(m,) the keyframe whose turn it is at each time."""
        return np.searchsorted(self.until, t).astype(np.int32)


STATIC_KEYFRAME = Keyframes(np.zeros(1), np.zeros((1, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=bool))
"""Of a radio that stands still."""


def keyframes_of(
    repaired: RepairedTrack, interval: float, parameters: Parameters, noise: tuple[float, float] = (1.0, 1.0)
) -> Keyframes:
    """At multiples of `interval` s, at both ends of the track, and on both sides of each jump and gap.

    `noise`: how many times as far as the model says this SLAM drifts, in place and in heading.
    """
    track, segment = repaired.track, repaired.segment
    broken = (np.diff(segment) != 0) | (np.diff(track.t) > parameters.slam.longest_pose_gap)
    begins = np.concatenate([[0], np.flatnonzero(broken) + 1])
    ends = np.concatenate([begins[1:], [len(track)]]) - 1
    pieces = [_spread(track.t, int(a), int(b), interval) for a, b in zip(begins, ends, strict=True)]
    at = np.concatenate([of_piece for of_piece, _ in pieces])
    due = np.concatenate([of_piece for _, of_piece in pieces])

    gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(track.position, axis=0), axis=1))])
    dt, way = np.diff(track.t[at]), np.diff(gone[at])
    jumped = np.diff(segment[at]) != 0
    metres = noise[0] * np.sqrt(
        parameters.slam.drift_m_per_sqrt_s**2 * dt + parameters.slam.drift_m_per_sqrt_m**2 * way
    )
    radians = noise[1] * np.sqrt(
        parameters.slam.drift_rad_per_sqrt_s**2 * dt + parameters.slam.drift_rad_per_sqrt_m**2 * way
    )
    # SLAM that had lost gravity knew of a step its length at best.
    lost = ~repaired.level[segment[at[:-1]]]
    metres = np.hypot(metres, np.where(lost, way, 0.0))
    metres = np.where(jumped, parameters.slam.jump_sigma_m, metres)
    radians = np.where(jumped, parameters.slam.jump_sigma_rad, radians)
    sigma = np.maximum(np.column_stack([metres, metres, radians]), _LEAST_SIGMA)
    return Keyframes(track.t[at], track.position[at], sigma, _between(due), jumped | lost)


def _spread(t: Array, begin: int, end: int, interval: float) -> tuple[Indices, Array]:
    """Indices from begin to end, both among them, and when (s) they were due: at multiples of the interval.

    All devices have theirs at the same times, but for their clocks, so that ranges fall into few blocks.
    """
    multiples = np.arange(np.ceil(t[begin] / interval), np.floor(t[end] / interval) + 1) * interval
    inner = multiples[(multiples > t[begin] + 0.5 * interval) & (multiples < t[end] - 0.5 * interval)]
    due = np.concatenate([[t[begin]], inner, [t[end]]])
    at, first = np.unique(np.clip(np.searchsorted(t, due), begin, end), return_index=True)
    return at.astype(np.int32), due[first]


def _between(t: Array) -> Array:
    return np.asarray(0.5 * (t[1:] + t[:-1]))


@dataclass(frozen=True)
class RangeEnds:
    """What n ranges see of one of their two devices: the antenna beside its keyframe, in the keyframe's axes."""

    keyframe: Indices
    """(n,)"""
    offset: Array
    """(n, 3) from the keyframe, SLAM's lengths."""
    lever: Array
    """(n, 3) m, from there to the antenna."""
    velocity: Array
    """(n, 3) m/s, of the antenna."""

    def __post_init__(self) -> None:
        freeze_arrays(self)


def range_ends(
    recording: Recording, measurements: RangeMeasurements, who: Indices, keyframes: list[Keyframes], clock_offset: Array
) -> RangeEnds:
    """The end `who` (n,) of each sample, read from the tracks at range time + clock_offset (k,) of the user."""
    n = len(measurements)
    ranges, row = recording.ranges, measurements.row
    antenna = np.where(ranges.a[row] == who, ranges.antenna_a[row], ranges.antenna_b[row])
    keyframe = np.zeros(n, dtype=np.int32)
    offset, lever, velocity = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    for u, user in enumerate(recording.users):
        mine = np.flatnonzero(who == u)
        if user.static or not len(mine):
            continue
        track = recording.tracks[user.name]
        t = np.clip(measurements.t[mine] + clock_offset[u], track.t[0], track.t[-1])
        place, arm = _antennas(track, user, t, antenna[mine])
        before, after = np.maximum(t - _REACH, track.t[0]), np.minimum(t + _REACH, track.t[-1])
        begin, end = (
            sum(_antennas(track, user, before, antenna[mine])),
            sum(_antennas(track, user, after, antenna[mine])),
        )
        # By the ranges' clock: any keyframe near is good, and so both ends change theirs at the same time.
        keyframe[mine] = keyframes[u].nearest(measurements.t[mine])
        offset[mine] = place - keyframes[u].place[keyframe[mine]]
        lever[mine] = arm
        velocity[mine] = (end - begin) / np.maximum(after - before, 1e-3)[:, None]
    return RangeEnds(keyframe, offset, lever, velocity)


def _antennas(track: Track, user: User, t: Array, antenna: Indices) -> tuple[Array, Array]:
    """(n, 3) each: where the device was, and the lever arms from there to its antennas."""
    poses = track.at(t, np.inf)
    return poses.position, rotate_by_quaternions(poses.quat_xyzw, user.levers[antenna])
