"""Keyframes: SLAM poses about once a second, the sigmas of the steps between them, antennas relative to them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from synchronizar.arrays import Array, Indices, Mask, freeze_arrays
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import RangeMeasurements
from synchronizar.preprocessing.relocalizations import RepairedTrack
from synchronizar.quaternions import rotate_by_quaternions

VELOCITY_REACH = 0.1
"""s before and after a range between which the antenna's velocity is taken."""
_LEAST_SIGMA = 1e-4  # m and rad: smaller step sigmas make the linear system numerically singular


@dataclass(frozen=True)
class Keyframes:
    """n keyframes of one device in its own SLAM frame, jumps repaired; one at the origin for a static radio."""

    t: Array
    """(n,) s, the track's stamps."""
    place: Array
    """(n, 3) position, SLAM units."""
    step_sigma: Array
    """(n - 1, 3): 1 sigma of each step in x and y (m), in height (m) and in yaw (rad)."""
    until: Array
    """(n - 1,) s: boundaries between the slots of consecutive keyframes."""
    rebuilt: Mask
    """(n - 1,) whether a step was rebuilt or lost gravity, so that its sigma is not SLAM's."""
    level_information: Array
    """(n,) 1/m^2: how well it is known that the device is at the height at which it is carried, in metres."""

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.t)

    @property
    def anchor(self) -> Array:
        """(3,) SLAM units: origin of the anchor's axes in the device's own frame, the first x and y, and height 0."""
        return np.append(self.place[0, :2], 0.0)

    def nearest(self, t: Array) -> Indices:
        """(m,) the keyframe in whose slot each time lies."""
        return np.searchsorted(self.until, t).astype(np.int32)


def standing_at(place: Array) -> Keyframes:
    """One keyframe for all times, at a position (3,) m."""
    return Keyframes(np.zeros(1), place[None], np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=bool), np.zeros(1))


STATIC_KEYFRAME = standing_at(np.zeros(3))
"""The only keyframe of a static radio."""


def keyframes_of(
    repaired: RepairedTrack,
    interval: float,
    parameters: Parameters,
    noise: tuple[float, float] = (1.0, 1.0),
    unit: float = 1.0,
) -> Keyframes:
    """The keyframes of a track: at multiples of `interval` s, at both ends, and on both sides of each jump and gap.

    `noise` are factors on the drift of `parameters.slam`, in position and in heading. The variance of a step is
    drift_m_per_sqrt_s^2 dt + drift_m_per_sqrt_m^2 distance; that of its yaw has the same form. `unit` (m) is the
    track's unit of length.
    """
    track, segment = repaired.track, repaired.segment
    broken = (np.diff(segment) != 0) | (np.diff(track.t) > parameters.slam.longest_pose_gap)
    begins = np.concatenate([[0], np.flatnonzero(broken) + 1])
    ends = np.concatenate([begins[1:], [len(track)]]) - 1
    pieces = [_keyframe_rows(track.t, int(a), int(b), interval) for a, b in zip(begins, ends, strict=True)]
    at = np.concatenate([of_piece for of_piece, _ in pieces])
    due = np.concatenate([of_piece for _, of_piece in pieces])

    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(track.position, axis=0), axis=1))])
    dt, distance = np.diff(track.t[at]), unit * np.diff(travelled[at])
    jumped = np.diff(segment[at]) != 0
    metres = noise[0] * np.sqrt(
        parameters.slam.drift_m_per_sqrt_s**2 * dt + parameters.slam.drift_m_per_sqrt_m**2 * distance
    )
    radians = noise[1] * np.sqrt(
        parameters.slam.drift_rad_per_sqrt_s**2 * dt + parameters.slam.drift_rad_per_sqrt_m**2 * distance
    )
    # Where SLAM had lost gravity only the length of a step is known.
    lost = ~repaired.level[segment[at[:-1]]]
    metres = np.hypot(metres, np.where(lost, distance, 0.0))
    of_metres, of_radians = repaired.rebuilt_sigma  # the first in the track's unit
    metres = np.where(jumped, min(parameters.slam.jump_sigma_m, unit * of_metres), metres)
    radians = np.where(jumped, min(parameters.slam.jump_sigma_rad, of_radians), radians)
    sigma = np.maximum(np.column_stack([metres, metres, radians]), _LEAST_SIGMA) / [unit, unit, 1.0]
    level = _level_information(track.t[at], unit * track.position[at, 2], parameters)
    return Keyframes(track.t[at], track.position[at], sigma, _midpoints(due), jumped | lost, level)


def _level_information(t: Array, height: Array, parameters: Parameters) -> Array:
    """(n,) 1/m^2, of keyframes at t (n,) s where SLAM has heights (n,) m.

    Whoever walks on one floor stays about as high all along, while SLAM's heights drift. A deviation lasts for
    `level_duration`, so that all keyframes of such a time count as one. Where SLAM has the device go up and down
    within that time it does so: drift is slower.
    """
    priors = parameters.priors
    lasts = priors.level_duration
    begin, end = np.searchsorted(t, t - lasts), np.searchsorted(t, t + lasts, side="right")
    beside = height - height.mean()
    sums = np.concatenate([np.zeros((1, 2)), np.cumsum(np.column_stack([beside, beside**2]), axis=0)])
    mean, square = ((sums[end] - sums[begin]) / (end - begin)[:, None]).T
    moves = np.maximum(square - mean**2, 0.0)
    half = 0.5 * np.diff(t)
    stands = np.concatenate([[0.0], half]) + np.concatenate([half, [0.0]])
    return np.asarray(np.minimum(stands / lasts, 1.0) / (priors.level_sigma**2 + moves))


def _keyframe_rows(t: Array, begin: int, end: int, interval: float) -> tuple[Indices, Array]:
    """Rows from begin to end, both included, and the times (s) they stand for: multiples of the interval.

    All devices use the same times, up to their clock offsets, so that ranges fall into few blocks.
    """
    if begin == end:
        return np.array([begin], dtype=np.int32), t[begin : begin + 1]
    multiples = np.arange(np.ceil(t[begin] / interval), np.floor(t[end] / interval) + 1) * interval
    inner = multiples[(multiples > t[begin] + 0.5 * interval) & (multiples < t[end] - 0.5 * interval)]
    due = np.concatenate([[t[begin]], inner, [t[end]]])
    at, first = np.unique(np.clip(np.searchsorted(t, due), begin, end), return_index=True)
    return at.astype(np.int32), due[first]


def _midpoints(t: Array) -> Array:
    return np.asarray(0.5 * (t[1:] + t[:-1]))


@dataclass(frozen=True)
class RangeEnds:
    """One end of n ranges: the antenna relative to its device's keyframe, in the keyframe's axes."""

    keyframe: Indices
    """(n,) index of the keyframe."""
    offset: Array
    """(n, 3) from the keyframe to the device, SLAM units."""
    lever: Array
    """(n, 3) m, lever arm from the device to the antenna."""
    velocity: Array
    """(n, 3) m/s, velocity of the antenna."""

    def __post_init__(self) -> None:
        freeze_arrays(self)


def range_ends(
    recording: Recording, measurements: RangeMeasurements, who: Indices, keyframes: list[Keyframes], clock_offset: Array
) -> RangeEnds:
    """The ends of ranges at users `who` (n,), read from the tracks at range time + their `clock_offset` (k,) s."""
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
        before, after = np.maximum(t - VELOCITY_REACH, track.t[0]), np.minimum(t + VELOCITY_REACH, track.t[-1])
        places, arms = _antennas(track, user, np.concatenate([t, before, after]), np.tile(antenna[mine], 3))
        (place, *_), (arm, *_) = np.split(places, 3), np.split(arms, 3)
        _, begin, end = np.split(places + arms, 3)
        # By the range clock: any near keyframe will do, and both ends change theirs at the same time.
        keyframe[mine] = keyframes[u].nearest(measurements.t[mine])
        offset[mine] = place - keyframes[u].place[keyframe[mine]]
        lever[mine] = arm
        velocity[mine] = (end - begin) / np.maximum(after - before, 1e-3)[:, None]
    return RangeEnds(keyframe, offset, lever, velocity)


def _antennas(track: Track, user: User, t: Array, antenna: Indices) -> tuple[Array, Array]:
    """(n, 3) each: device positions (SLAM units) and lever arms to its antennas (m), in the SLAM frame."""
    if not user.antennas:
        place = np.column_stack([np.interp(t, track.t, track.position[:, n]) for n in range(3)])
        return place, np.zeros_like(place)
    poses = track.at(t, np.inf)
    return poses.position, rotate_by_quaternions(poses.quat_xyzw, user.levers[antenna])
