"""Relocalisation jumps of a device's SLAM: found in its track alone, and removed from it.

A jump carries no information on the device's motion, but the steps beside it do: velocity and angular rate in body axes
continue, whatever happened to SLAM's axes. So an impossible step is rebuilt from its neighbours, and each segment after
a jump is transformed rigidly to continue the one before.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array, Indices, Mask
from synchronizar.data.jump import Jump
from synchronizar.data.track import Track
from synchronizar.parameters import Parameters
from synchronizar.quaternions import (
    IDENTITY,
    angles_between,
    cumulative_products,
    inverse_quaternions,
    multiply_quaternions,
    normalized_quaternions,
    quaternions_of_rotation_vectors,
    rotate_by_quaternions,
    rotation_angles,
    rotation_vectors,
    tilt_of_quaternions,
    yaw_of_quaternions,
    yaw_quaternion,
    yaw_quaternions,
)

_UP = np.array([0.0, 0.0, 1.0])
_PASSES = 4  # of the search: each excludes the jumps found so far from the neighbours
_FEWEST_NEIGHBOURS = 3
_LEAST_WAY = 1e-3  # m: directions of less are made of rounding


@dataclass(frozen=True)
class RepairedTrack:
    """A track with its jumps removed."""

    track: Track
    """Same stamps; continuous and level. Begins at SLAM's position and yaw; height as SLAM's first level segment."""
    jumps: tuple[Jump, ...]
    segment: Indices
    """(n,) index of the segment between jumps that each pose belongs to; 0 before the first jump."""
    repaired_from_slam: Array
    """(segments, 4) quaternions x y z w: a repaired attitude is this times SLAM's."""
    level: Mask
    """(segments,) whether SLAM's vertical was right. Where not, its steps are taken for horizontal."""
    rebuilt_sigma: tuple[float, float] = (np.inf, np.inf)
    """1 sigma of a rebuilt step (the track's unit of length; rad), by how well its steps are predicted; else infinite.

    It is what tells jumps from motion, since smaller ones may be left in the steps beside."""


def repair_relocalizations(track: Track, parameters: Parameters) -> RepairedTrack:
    """The repaired track; without jumps it is the given track itself."""
    search = search_jumps(track, parameters)
    steps, jumped = search.steps, search.jumped
    segment = np.concatenate([[0], np.cumsum(jumped)]).astype(np.int32)
    if not jumped.any():
        return RepairedTrack(track, (), segment, IDENTITY[None, :].copy(), np.ones(1, dtype=bool))

    at = _rows(jumped)
    least_tilt = search.least_tilt(parameters)
    continued, displacement = rebuild_jumps(track, search, least_tilt, parameters)
    repaired_from_slam, level = _level_segments(track, segment, continued, least_tilt)

    attitude = multiply_quaternions(repaired_from_slam[segment], track.quat_xyzw)
    repaired_displacement = rotate_by_quaternions(repaired_from_slam[segment[:-1]], displacement)
    repaired_displacement[:, 2] *= level[segment[:-1]]
    position = track.position[0] + np.vstack([np.zeros(3), np.cumsum(repaired_displacement, axis=0)])
    first_level = int(np.argmax(level[segment]))
    position[:, 2] += track.position[first_level, 2] - position[first_level, 2]
    change = multiply_quaternions(inverse_quaternions(continued[1:]), continued[:-1])
    jump_lengths = np.linalg.norm(steps.displacement[at] - displacement[at], axis=1)
    jumps = tuple(
        Jump(float(track.t[k + 1]), int(k) + 1, float(distance), float(turn), float(tilt))
        for k, distance, turn, tilt in zip(
            at, jump_lengths, yaw_of_quaternions(change), tilt_of_quaternions(change), strict=True
        )
    )
    spread = parameters.slam.jump_spread
    return RepairedTrack(
        Track(track.t, position, normalized_quaternions(attitude)),
        jumps,
        segment,
        repaired_from_slam,
        level,
        (spread * search.noise.position, spread * search.noise.attitude),
    )


class NoiseLevels(NamedTuple):
    """What the steps of a track are like where nothing is wrong."""

    interval: float
    """s: median of the steps' durations."""
    position: float
    """m: 95 % quantile of the errors with which a step is predicted from its neighbours."""
    attitude: float
    """rad: the same of its turn."""


class Steps(NamedTuple):
    """The n steps between consecutive poses of a track."""

    begin: Array
    """(n,) s, stamp of the pose before the step."""
    dt: Array
    """(n,) s."""
    displacement: Array
    """(n, 3) m, displacement in SLAM's axes."""
    twist: Array
    """(n, 9): velocity in body axes, velocity in SLAM's axes (m/s), angular rate in body axes (rad/s)."""


class JumpSearch(NamedTuple):
    """What was found out about the n steps of a track."""

    steps: Steps
    jumped: Mask
    """(n,) which are jumps."""
    turned: Mask
    """(n,) which others turned faster than a device can; those that turned back, or turned alone, are no jumps."""
    position_error: Array
    """(n,) m: distance of the step from any that its neighbours allow, jumps not among these."""
    attitude_error: Array
    """(n,) rad: the same of the attitude."""
    noise: NoiseLevels
    measured: bool = True
    """Whether attitudes tell how SLAM's axes turn: not where they follow from the path (`attitude_follows`)."""

    def least_tilt(self, parameters: Parameters) -> float:
        """rad: the vertical of SLAM's axes changed in a jump if it did by more than this."""
        return max(parameters.slam.jump_tilt, parameters.slam.jump_spread * self.noise.attitude)


class Prediction(NamedTuple):
    """Prediction of n steps from the steps beside them."""

    twist: Array
    """(n, 9) as in `Steps`: mean of the medians before and after."""
    position_error: Array
    """(n,) m: distance of the step from any that the neighbours' velocities allow."""
    attitude_error: Array
    """(n,) rad: the same of the attitude."""


def attitude_follows(track: Track, parameters: Parameters) -> bool | None:
    """Whether a track's attitudes may be no more than its path; None where it hardly moves.

    They are the same throughout, or each is turned to the direction of motion exactly, as no hand keeps it: computed
    from that, they flip where the device turns back.
    """
    slam, q = parameters.slam, track.quat_xyzw
    way = [np.diff(track.position[:-1], axis=0), np.diff(track.position[1:], axis=0)]
    stencils = [*way, way[0] + way[1]]  # to the pose, from it, and about it
    if len(track) < 3:
        return None
    length = np.linalg.norm(stencils[2], axis=1)
    moving = length > slam.jump_speed * (track.t[2:] - track.t[:-2])
    if moving.sum() < slam.aligned_fewest:
        moving = length > _LEAST_WAY
    if moving.sum() < slam.aligned_fewest:
        return None
    if not np.diff(q, axis=0).any():
        return True
    inverse = inverse_quaternions(q[1:-1][moving])
    for stencil in stencils:
        flat = stencil[moving] * [1.0, 1.0, 0.0]
        ahead = rotate_by_quaternions(inverse, flat / np.maximum(np.linalg.norm(flat, axis=1), 1e-12)[:, None])
        mean = ahead.mean(axis=0)
        off = np.linalg.norm(ahead - mean / max(float(np.linalg.norm(mean)), 1e-12), axis=1)
        if float(np.quantile(off, slam.aligned_share)) < slam.aligned_turn:
            return True
    return False


def search_jumps(
    track: Track,
    parameters: Parameters,
    noise: NoiseLevels | None = None,
    decided: Mask | None = None,
    follows: bool | None = None,
    measured: bool = True,
) -> JumpSearch:
    """Which steps of a track are jumps.

    A stretch of a longer track is searched with that track's `noise`, which else is the stretch's own, and with what
    was `decided` (k,) of its first k steps before: which of them are jumps; with whether its attitudes may follow from
    its path, and with whether they were still `measured`. One that follows flips where the device turns back, and
    beside a jump, which turns no axes; once it did, attitudes tell nothing of these.
    """
    follows = bool(attitude_follows(track, parameters)) if follows is None else follows
    steps = steps_of(track)
    decided = np.zeros(0, dtype=bool) if decided is None else decided
    nothing = np.zeros(len(steps.dt), dtype=bool)
    if not len(steps.dt):
        none = noise or NoiseLevels(0.0, 0.0, 0.0)
        return JumpSearch(steps, nothing, nothing, np.zeros(0), np.zeros(0), none, measured)
    interval = float(np.median(steps.dt)) if noise is None else noise.interval
    factor = parameters.slam.jump_spread * np.maximum(steps.dt / interval, 1.0)
    jumped, prediction = _jumped_by_position(steps, factor, noise, decided, parameters)
    turned = _turned_too_fast(steps, factor, noise, jumped, prediction.attitude_error, parameters)
    turned[: len(decided)] = False
    if follows:
        flipped = turned & (_turns_back(steps) | _beside(jumped))
        turned &= ~flipped
        measured &= bool(np.diff(track.quat_xyzw, axis=0).any() and not flipped.any())
    by_attitude = _jumped_by_attitude(track, steps, jumped, turned, prediction.attitude_error, parameters)
    if by_attitude.any():
        prediction = predict_steps(steps, ~(jumped | by_attitude), parameters.slam.jump_neighbours, parameters)
    errors = prediction.position_error, prediction.attitude_error
    noise = noise or NoiseLevels(interval, _noise_level(errors[0]), _noise_level(errors[1]))
    return JumpSearch(steps, jumped | by_attitude, turned, *errors, noise, measured)


def steps_of(track: Track) -> Steps:
    """The steps between the poses of a track."""
    q = track.quat_xyzw
    dt, displacement = np.diff(track.t), np.diff(track.position, axis=0)
    inverse = inverse_quaternions(q[:-1])
    body_displacement = rotate_by_quaternions(inverse, displacement)
    turn = rotation_vectors(multiply_quaternions(inverse, q[1:]))
    return Steps(track.t[:-1], dt, displacement, np.column_stack([body_displacement, displacement, turn]) / dt[:, None])


def _jumped_by_position(
    steps: Steps, factor: Array, noise: NoiseLevels | None, decided: Mask, parameters: Parameters
) -> tuple[Mask, Prediction]:
    """(n,) which steps are jumps by their displacement; and how the others predict each.

    A jump must exceed: the least one that is worth repairing; a dt^2 / 4, the most that the acceleration a makes of a
    step that begins and ends with the neighbours' velocity; and `factor` times the track's own noise level. In a
    resampled track a jump between two stamps shows in two steps, so beside a jump half of the first two bounds is
    enough.
    """
    least = np.maximum(parameters.slam.jump_least, 0.25 * parameters.slam.jump_acceleration * steps.dt**2)
    jumped = np.zeros(len(steps.dt), dtype=bool)
    jumped[: len(decided)] = decided
    prediction = predict_steps(steps, ~jumped, parameters.slam.jump_neighbours, parameters)
    for _ in range(_PASSES):
        error = prediction.position_error
        level = factor * (_noise_level(error) if noise is None else noise.position)
        found = error > np.maximum(least, level)
        beside = np.zeros_like(found)
        beside[1:] |= found[:-1]
        beside[:-1] |= found[1:]
        found |= beside & (error > np.maximum(0.5 * least, level))
        found[: len(decided)] = decided
        if (found == jumped).all():
            break
        jumped = found
        prediction = predict_steps(steps, ~jumped, parameters.slam.jump_neighbours, parameters)
    return jumped, prediction


def _turned_too_fast(
    steps: Steps, factor: Array, noise: NoiseLevels | None, jumped: Mask, error: Array, parameters: Parameters
) -> Mask:
    """(n,) which steps that are no jumps turn the attitude faster than a device can."""
    level = factor * (_noise_level(error) if noise is None else noise.attitude)
    least = np.maximum(np.maximum(level, parameters.slam.jump_turn), parameters.slam.jump_rate * steps.dt)
    return np.asarray((error > least) & ~jumped)


def _beside(jumped: Mask) -> Mask:
    """(n,) the two steps on either side of each jump: there a direction of motion is that of the jump."""
    return np.asarray(np.convolve(jumped, np.ones(5), "same")[: len(jumped)] > 0.5)


def _turns_back(steps: Steps) -> Mask:
    """(n,) at which steps a device is slow, beside how fast it mostly is: there its direction may turn at once."""
    speed = np.linalg.norm(steps.twist[:, 3:6], axis=1)
    beside = np.concatenate([speed[:1], speed, speed[-1:]])
    return np.asarray(np.minimum(np.minimum(beside[:-2], beside[2:]), speed) < 0.5 * np.median(speed))


def _jumped_by_attitude(
    track: Track, steps: Steps, jumped: Mask, turned: Mask, error: Array, parameters: Parameters
) -> Mask:
    """(n,) which of the steps that `turned` too fast are jumps: SLAM's axes turned about the device.

    The attitude does not return within `glitch_duration`; one that returns was a glitch of the attitude alone. As at
    every jump, velocities then decide whether axes or attitude turned.
    """
    candidates = _rows(turned)
    found = np.zeros_like(jumped)
    if not len(candidates):
        return found
    q = track.quat_xyzw
    for moment in np.split(
        candidates, np.flatnonzero(np.diff(steps.begin[candidates]) > parameters.slam.glitch_duration) + 1
    ):
        before, after = moment[0], moment[-1] + 1
        earlier = np.searchsorted(track.t, track.t[before] - parameters.slam.glitch_duration)
        later = np.searchsorted(track.t, track.t[after] + parameters.slam.glitch_duration, side="right")
        angles = np.append(angles_between(q[before], q[after:later]), angles_between(q[after], q[earlier : before + 1]))
        if angles.min() > 0.5 * error[moment].max():
            found[moment] = not _axes_stayed(steps, jumped, moment, parameters)
    return found


def predict_steps(steps: Steps, good: Mask, neighbours: int, parameters: Parameters) -> Prediction:
    """Each step as predicted by the medians of so many good steps before and after it.

    A device that starts, stops or turns has different velocities before and after, and any in between during the step:
    the error is the distance from the segment between both. Velocity of a device that turns continues in body axes,
    which matters where only one side has neighbours; where the attitude is wrong it continues in SLAM's axes. The
    smaller error of both counts.
    """
    end = steps.begin + steps.dt
    middle = 0.5 * (steps.begin + end)
    k, near = np.arange(len(steps.dt)), np.arange(neighbours)
    rows = np.flatnonzero(good)
    if not len(rows):
        return Prediction(np.zeros_like(steps.twist), np.zeros(len(k)), np.zeros(len(k)))
    sides = []
    for index in (np.searchsorted(rows, k)[:, None] - 1 - near, np.searchsorted(rows, k, "right")[:, None] + near):
        there = rows[np.clip(index, 0, len(rows) - 1)]
        apart = np.maximum(steps.begin[:, None] - middle[there], middle[there] - end[:, None])
        valid = (index >= 0) & (index < len(rows)) & (apart <= parameters.slam.longest_pose_gap)
        sides.append(_median(steps.twist[there], valid))
    (before, n_before), (after, n_after) = sides
    before, after = np.where(n_before[:, None], before, after), np.where(n_after[:, None], after, before)

    body, slam, rate = (
        _distance_to_segment(*(a[:, i : i + 3] for a in (steps.twist, before, after))) for i in (0, 3, 6)
    )
    predicted = np.where(n_before + n_after >= _FEWEST_NEIGHBOURS, steps.dt, 0.0)
    return Prediction(0.5 * (before + after), predicted * np.minimum(body, slam), predicted * rate)


def rebuild_jumps(track: Track, search: JumpSearch, least_tilt: float, parameters: Parameters) -> tuple[Array, Array]:
    """Each segment's axes (segments, 4) in those of the first, and all displacements (n, 3) m with jumps rebuilt.

    A jump is replaced by the mean of the steps beside it. Consecutive jumps are one event; only its total turn counts.
    SLAM's axes did not turn where velocities show so; else they turned about the vertical, unless the tilt itself
    changed beyond noise. Where attitudes were not measured the direction of motion alone tells how they turned.
    """
    steps, jumped = search.steps, search.jumped
    at = _rows(jumped)
    moved = predict_steps(steps, ~jumped, 1, parameters).twist[at] * steps.dt[at, None]
    q, q_next = track.quat_xyzw[at], track.quat_xyzw[at + 1]
    turns = multiply_quaternions(
        multiply_quaternions(q, quaternions_of_rotation_vectors(moved[:, 6:])), inverse_quaternions(q_next)
    )
    rebuilt = rotate_by_quaternions(q, moved[:, :3])
    axes = np.tile(IDENTITY, (len(at) + 1, 1))
    for event in np.split(np.arange(len(at)), np.flatnonzero(np.diff(at) > 1) + 1):
        turned = cumulative_products(turns[event])
        if not search.measured:
            turned, rebuilt[event] = _by_direction(steps, jumped, at[event], parameters)
        elif rotation_angles(turned[-1]) > parameters.slam.jump_turn and _axes_stayed(
            steps, jumped, at[event], parameters
        ):
            turned = np.tile(IDENTITY, (len(event), 1))
            rebuilt[event] = moved[event, 3:6]
        elif tilt_of_quaternions(turned[-1]) <= least_tilt:
            turned = yaw_quaternions(yaw_of_quaternions(turned))
        axes[event + 1] = normalized_quaternions(multiply_quaternions(axes[event[0]], turned))
    displacement = steps.displacement.copy()
    displacement[at] = rebuilt
    return axes, displacement


def _by_direction(steps: Steps, jumped: Mask, run: Indices, parameters: Parameters) -> tuple[Array, Array]:
    """(m, 4) how SLAM's axes turned in a run of m steps, and (m, 3) m the steps, by velocities on both sides.

    Where the device hardly moves on either side, or there is only one, they are taken not to have turned.
    """
    good, n = np.flatnonzero(~jumped), parameters.slam.jump_neighbours
    sides = (good[good < run[0]][-n:], good[good > run[-1]][:n])
    if not all(map(len, sides)):
        near = np.concatenate(sides)
        velocity = steps.twist[near, 3:6].mean(axis=0) if len(near) else np.zeros(3)
        return np.tile(IDENTITY, (len(run), 1)), velocity * steps.dt[run, None]
    before, after = (steps.twist[side, 3:6].mean(axis=0) for side in sides)
    turn = 0.0
    if min(np.hypot(*before[:2]), np.hypot(*after[:2])) > parameters.slam.jump_speed:
        turn = float(np.arctan2(before[1], before[0]) - np.arctan2(after[1], after[0]))
    axes = yaw_quaternion(turn)
    velocity = 0.5 * (before + rotate_by_quaternions(axes, after))
    return np.tile(axes, (len(run), 1)), velocity * steps.dt[run, None]


def _axes_stayed(steps: Steps, jumped: Mask, run: Indices, parameters: Parameters) -> bool:
    """Whether the attitude alone went wrong in a run of steps: velocity continues in SLAM's axes, not in the body's.

    Velocities are means over half of `glitch_duration` before and after. Where the device hardly moves they do not
    decide, and the axes count as turned: SLAM's motion and attitude come from one estimate, and an attitude that goes
    wrong alone returns.
    """
    before, after = run[0], run[-1]
    t, half = steps.begin, 0.5 * parameters.slam.glitch_duration
    others = np.setdiff1d(np.flatnonzero(jumped), run)
    first = max(np.searchsorted(t, t[before] - half), others[others < before].max(initial=-1) + 1)
    last = min(np.searchsorted(t, t[after] + half), others[others > after].min(initial=len(t)))
    if first == before or last <= after + 1:
        return False
    sides = (slice(first, before), slice(after + 1, last))
    v_before, v_after = (np.average(steps.twist[side, :6], axis=0, weights=steps.dt[side]) for side in sides)
    body, slam = np.linalg.norm((v_after - v_before).reshape(2, 3), axis=1)
    return bool(body > parameters.slam.jump_speed and slam < 0.5 * body)


def _level_segments(track: Track, segment: Indices, axes: Array, least_tilt: float) -> tuple[Array, Mask]:
    """`repaired_from_slam` (segments, 4), level and with the yaw of the first segment; which segments were level.

    The vertical is the one on which segments of the longest total duration agree, since SLAM that loses gravity finds
    it again. These segments keep their vertical; the others are turned to it.
    """
    up = rotate_by_quaternions(axes, _UP)
    begin = np.searchsorted(segment, np.arange(len(axes)))
    duration = track.t[np.append(begin[1:], len(segment)) - 1] - track.t[begin]
    agree = up @ up.T >= np.cos(least_tilt)
    level = int(np.argmax(agree @ duration))
    untilted = multiply_quaternions(
        yaw_quaternion(float(yaw_of_quaternions(axes[level]))), inverse_quaternions(axes[level])
    )
    levelled = multiply_quaternions(untilted, axes)
    kept = agree[level]
    return np.where(kept[:, None], yaw_quaternions(yaw_of_quaternions(levelled)), levelled), kept


def _noise_level(errors: Array) -> float:
    """Noise level of prediction errors: their 95 % quantile. Jumps are rarer than one in twenty and do not raise it."""
    return float(np.quantile(errors, 0.95)) if len(errors) else 0.0


def _median(values: Array, valid: Mask) -> tuple[Array, Indices]:
    """Medians (n, m) over the valid (n, k) rows of (n, k, m), 0 where none is valid; and the numbers (n,) of these."""
    count = valid.sum(axis=1)
    ordered = np.sort(np.where(valid[..., None], values, np.inf), axis=1)
    rows, middle = np.arange(len(count)), np.maximum(count - 1, 0)
    low, high = ordered[rows, middle // 2], ordered[rows, np.minimum((middle + 1) // 2, values.shape[1] - 1)]
    return np.where(count[:, None], 0.5 * (low + high), 0.0), count


def _distance_to_segment(points: Array, a: Array, b: Array) -> Array:
    """Distances (n,) of points (n, 3) from the segments between a and b (n, 3)."""
    along = b - a
    length = np.sum(along**2, axis=1)
    u = np.divide(np.sum((points - a) * along, axis=1), length, out=np.zeros(len(length)), where=length > 0.0)
    return np.asarray(np.linalg.norm(points - a - np.clip(u, 0.0, 1.0)[:, None] * along, axis=1))


def _rows(which: Mask) -> Indices:
    return np.flatnonzero(which).astype(np.int32)
