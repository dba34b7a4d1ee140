"""Mistakes that people make with recordings, made by hand in a recording that is right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.quaternions import multiply_quaternions


@dataclass(frozen=True)
class Mistake:
    """One mistake, and what is to be said of it."""

    name: str
    make: Callable[[Recording], Recording]
    code: str
    users: tuple[str | None, ...]
    """Whose findings are to be there, no others: None is the recording's own."""


PHONES = ("phone0", "phone1", "phone2")
ALL: tuple[str | None, ...] = PHONES
ONE: tuple[str | None, ...] = ("phone1",)
NOBODY: tuple[str | None, ...] = (None,)

# Rows: the axes of the wrong frame in those of the right one, z up.
Y_UP = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
OPTICAL = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def turned(track: Track, rows: Array) -> Track:
    """The track in a frame whose axes are the rows; its body axes stay."""
    return replace(
        track,
        position=track.position @ rows.T,
        quat_xyzw=multiply_quaternions(quaternion_of(rows), track.quat_xyzw),
    )


def held(track: Track, body_from_new: Array) -> Track:
    """The track with other body axes."""
    q = np.broadcast_to(quaternion_of(body_from_new), track.quat_xyzw.shape)
    return replace(track, quat_xyzw=multiply_quaternions(track.quat_xyzw, q))


def quaternion_of(rotation: Array) -> Array:
    """(4,) x y z w of a rotation matrix whose angle is below pi."""
    w = 0.5 * np.sqrt(1.0 + np.trace(rotation))
    x, y, z = rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]
    return np.array([x, y, z, 4.0 * w * w]) / (4.0 * w)


def of_tracks(
    change: Callable[[Track], Track], names: tuple[str | None, ...] = ALL
) -> Callable[[Recording], Recording]:
    """The change made to these tracks."""

    def make(recording: Recording) -> Recording:
        tracks = {n: change(track) if n in names else track for n, track in recording.tracks.items()}
        return replace(recording, tracks=tracks)

    return make


def of_ranges(**columns: Callable[[Array], Array]) -> Callable[[Recording], Recording]:
    """Columns of the ranges changed."""

    def make(recording: Recording) -> Recording:
        r = recording.ranges
        return replace(recording, ranges=replace(r, **{n: f(getattr(r, n)) for n, f in columns.items()}))

    return make


def both(*makes: Callable[[Recording], Recording]) -> Callable[[Recording], Recording]:
    """One change after another."""

    def make(recording: Recording) -> Recording:
        for one in makes:
            recording = one(recording)
        return recording

    return make


def in_unit(per_metre: float) -> Callable[[Track], Track]:
    return lambda track: replace(track, position=per_metre * track.position)


def delayed(seconds: float) -> Callable[[Track], Track]:
    return lambda track: replace(track, t=track.t + seconds)


def in_ticks(per_second: float) -> Callable[[Track], Track]:
    return lambda track: replace(track, t=per_second * track.t)


def w_first(track: Track) -> Track:
    return replace(track, quat_xyzw=track.quat_xyzw[:, [3, 0, 1, 2]])


def unturned(track: Track) -> Track:
    return replace(track, quat_xyzw=np.tile([0.0, 0.0, 0.0, 1.0], (len(track), 1)))


def frozen(track: Track, begin: float = 0.4, seconds: float = 3.0) -> Track:
    """The pose at that share of the walk repeated for so long."""
    first = int(begin * len(track))
    last = int(np.searchsorted(track.t, track.t[first] + seconds))
    at = np.arange(len(track))
    at[first:last] = first
    return replace(track, position=track.position[at], quat_xyzw=track.quat_xyzw[at])


def without(track: Track, begin: float = 0.4, seconds: float = 4.0) -> Track:
    """No pose for so long from that share of the walk on."""
    start = track.t[int(begin * len(track))]
    return chosen(track, ~((track.t > start) & (track.t < start + seconds)))


def chosen(track: Track, which: Array) -> Track:
    return Track(track.t[which], track.position[which], track.quat_xyzw[which])


def last_ahead(seconds: float) -> Callable[[Track], Track]:
    return lambda track: replace(track, t=np.append(track.t[:-1], track.t[-1] + seconds))


def first_at(stamp: float) -> Callable[[Track], Track]:
    return lambda track: replace(track, t=np.append(stamp, track.t[1:]))


def still(track: Track) -> Track:
    """On a tripod, with the noise of a SLAM."""
    rng = np.random.default_rng(len(track))
    noise = 1e-3 * rng.standard_normal(track.position.shape)
    return replace(track, position=track.position[0] + noise, quat_xyzw=np.tile(track.quat_xyzw[0], (len(track), 1)))


def copied(recording: Recording) -> Recording:
    """Each tenth range twice."""
    n = len(recording.ranges)
    return replace(recording, ranges=recording.ranges.select(np.sort(np.append(np.arange(n), np.arange(0, n, 10)))))


def held_numbers(recording: Recording) -> Recording:
    """Each range again, 10 ms later."""
    r = recording.ranges
    again = r.select(np.repeat(np.arange(len(r)), 2))
    later = np.tile([0.0, 0.01], len(r))
    return replace(recording, ranges=replace(again, t=again.t + later))


def swapped(recording: Recording) -> Recording:
    """phone0 and phone1 carry each other's radio."""
    r = recording.ranges
    other = np.arange(len(recording.users), dtype=np.int32)
    other[[0, 1]] = [1, 0]
    return replace(recording, ranges=replace(r, a=other[r.a], b=other[r.b]))


def unheard(recording: Recording) -> Recording:
    """phone1 has no range."""
    r = recording.ranges
    return replace(recording, ranges=r.select((r.a != 1) & (r.b != 1)))


EPOCH = 1.7e9

MISTAKES = [
    Mistake("y up, taken for z up", of_tracks(lambda t: turned(t, Y_UP)), "up-axis", ALL),
    Mistake("y up, of one device", of_tracks(lambda t: turned(t, Y_UP), ONE), "up-axis", ONE),
    Mistake("z up, taken for y up", of_tracks(lambda t: turned(t, Y_UP.T)), "up-axis", ALL),
    Mistake("y up, camera body", of_tracks(lambda t: held(turned(t, Y_UP), Y_UP.T)), "up-axis", ALL),
    Mistake("a camera's axes, robot body", of_tracks(lambda t: turned(t, OPTICAL)), "optical-axes", ALL),
    Mistake("a camera's axes", of_tracks(lambda t: held(turned(t, OPTICAL), OPTICAL.T)), "optical-axes", ALL),
    Mistake("w x y z", of_tracks(w_first), "quaternion-order", ALL),
    Mistake("w x y z, of one device", of_tracks(w_first, ONE), "quaternion-order", ONE),
    Mistake("w x y z, camera body", of_tracks(lambda t: w_first(held(t, OPTICAL.T))), "quaternion-order", ALL),
    Mistake("no attitude", of_tracks(unturned), "attitude-unknown", ALL),
    Mistake("ranges in mm", of_ranges(distance=lambda d: 1e3 * d), "range-unit", NOBODY),
    Mistake("ranges in cm", of_ranges(distance=lambda d: 1e2 * d), "range-unit", NOBODY),
    Mistake("ranges in feet", of_ranges(distance=lambda d: d / 0.3048), "range-unit", NOBODY),
    Mistake("tracks in mm", of_tracks(in_unit(1e3)), "track-unit", ALL),
    Mistake("a track in mm", of_tracks(in_unit(1e3), ONE), "track-unit", ONE),
    Mistake("tracks in cm", of_tracks(in_unit(1e2)), "track-unit", ALL),
    Mistake("tracks in feet", of_tracks(in_unit(1 / 0.3048)), "track-unit", ALL),
    Mistake("a track in feet", of_tracks(in_unit(1 / 0.3048), ONE), "track-unit", ONE),
    Mistake(
        "tracks by uptime, ranges since 1970",
        both(of_tracks(delayed(81234.5)), of_ranges(t=lambda t: t + EPOCH)),
        "time-overlap",
        ALL,
    ),
    Mistake("a track since 1970, ranges by uptime", of_tracks(delayed(EPOCH), ONE), "time-overlap", ONE),
    Mistake("stamps of a track in ms", of_tracks(in_ticks(1e3), ONE), "time-unit", ONE),
    Mistake("stamps of tracks in ms", of_tracks(in_ticks(1e3)), "time-unit", ALL),
    Mistake("stamps of tracks in us", of_tracks(in_ticks(1e6)), "time-unit", ALL),
    Mistake("stamps of tracks in ns", of_tracks(in_ticks(1e9)), "time-unit", ALL),
    Mistake("stamps of ranges in ms", of_ranges(t=lambda t: 1e3 * t), "time-unit", NOBODY),
    Mistake("stamps of ranges in ns", of_ranges(t=lambda t: 1e9 * t), "time-unit", NOBODY),
    Mistake(
        "all stamps in ms", both(of_tracks(in_ticks(1e3)), of_ranges(t=lambda t: 1e3 * t)), "time-unit", (*ALL, None)
    ),
    Mistake(
        "stamps of tracks in ms since 1970",
        both(of_tracks(lambda t: in_ticks(1e3)(delayed(EPOCH)(t))), of_ranges(t=lambda t: t + EPOCH)),
        "time-unit",
        ALL,
    ),
    Mistake(
        "stamps of ranges in ms since 1970",
        both(of_tracks(delayed(EPOCH)), of_ranges(t=lambda t: 1e3 * (t + EPOCH))),
        "time-unit",
        NOBODY,
    ),
    Mistake("a clock two hours ahead", of_tracks(delayed(7200.0), ONE), "clock", ONE),
    Mistake("a clock a day behind", of_tracks(delayed(-86400.0), ONE), "clock", ONE),
    Mistake("a clock five minutes ahead", of_tracks(delayed(300.0), ONE), "clock", ONE),
    Mistake("a pose a day ahead", of_tracks(last_ahead(86400.0), ONE), "stray-stamp", ONE),
    Mistake("a pose ten minutes ahead", of_tracks(last_ahead(600.0), ONE), "stray-stamp", ONE),
    Mistake(
        "the first pose at 0",
        both(of_tracks(delayed(EPOCH)), of_tracks(first_at(0.0), ONE), of_ranges(t=lambda t: t + EPOCH)),
        "stray-stamp",
        ONE,
    ),
    Mistake("frozen poses", of_tracks(frozen, ONE), "frozen-poses", ONE),
    Mistake("a stretch without poses", of_tracks(without, ONE), "pose-gap", ONE),
    Mistake(
        "a pose each two seconds", of_tracks(lambda t: chosen(t, np.arange(0, len(t), 60)), ONE), "sparse-poses", ONE
    ),
    Mistake("a device on a tripod", of_tracks(still, ONE), "never-moves", ONE),
    Mistake("copied ranges", copied, "repeated-ranges", NOBODY),
    Mistake("ranges written again", held_numbers, "repeated-ranges", NOBODY),
    Mistake("swapped radios", swapped, "swapped-radios", ("phone0",)),
    Mistake("a radio that was off", unheard, "no-ranges", ONE),
]
