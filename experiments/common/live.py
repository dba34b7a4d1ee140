"""Shared by experiments on the live estimator: feeds it a recording as that would have come, and keeps what it told.

Only `synchronizar.Estimator` is used, as an application would: poses and ranges as they come, ten times a second
`advance` and `registration()`. A pose is told by the registration before it: that is what an application has then.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields
from multiprocessing import get_context
from typing import NamedTuple, TypeVar

import numpy as np

import synchronizar as sz
from synchronizar.arrays import Array, Mask
from synchronizar.data.ranges import SOURCES, Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration, State, UserRegistration
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.geometry import YawFrame, apply_frames, wrap_angle
from synchronizar.quaternions import multiply_quaternions, yaw_quaternions

A_SECOND = 10.0
"""Updates."""
OFF = 0.6
"""m: a user that is further off should not be called registered."""
_NUMBERS = ("sigma", "rx_power", "fp_power", "nlos")
_SETTINGS = ("static", "height_sigma")

Call = Callable[[sz.Estimator], None]
Task = TypeVar("Task")
Result = TypeVar("Result")


class Moment(NamedTuple):
    """One update."""

    t: float
    """s, range clock."""
    events: list[str]
    registration: Registration
    wall: float
    """s: that `advance` and `registration` took."""
    behind: float
    """s: wall time since the feeding began minus data time; of use only where it is fed by the wall clock."""


class Said(NamedTuple):
    """What was said of one user at m moments."""

    registered: Mask
    """(m,)."""
    frame: Array
    """(m, 5) x, y, z (m), yaw (rad) and scale of `common_from_user`; NaN where there is none."""
    covariance: Array
    """(m, 4, 4); NaN where there is none."""


class Told(NamedTuple):
    """What was said of everybody."""

    t: Array
    """(m,) s, range clock."""
    wall: Array
    """(m,) s of each update."""
    behind: Array
    """(m,) s: wall time minus data time; of use only where it is fed by the wall clock."""
    users: dict[str, Said]
    reference: str | None
    events: list[tuple[float, str]]


def estimator_of(recording: Recording, reference: str | None = None, workers: int | None = 0) -> sz.Estimator:
    """An estimator for a recording's users; tracks in memory are z up."""
    return sz.Estimator({u.name: _settings(u) for u in recording.users}, reference=reference, workers=workers)


def _settings(user: User) -> dict[str, object]:
    return {name: getattr(user, name) for name in _SETTINGS} | {"antennas": dict(user.antennas)}


def fed(
    recording: Recording,
    estimator: sz.Estimator,
    *,
    arrivals: Mapping[str, Array] | None = None,
    calls: Sequence[tuple[float, Call]] = (),
    until: float = np.inf,
    a_second: float = A_SECOND,
    real_time: bool = False,
) -> Iterator[Moment]:
    """Feed a recording and say each update; the first is one after the first range.

    `arrivals`: when poses come (s, range clock), of users whose stamps do not say; `calls`: what is done besides, and
    when; `until`: s after the first range; `real_time`: wait until the wall clock is as far.
    """
    names = [user.name for user in recording.users]
    add, stamp = _events(recording, names, estimator, arrivals or {}, calls)
    came = come_of(recording.ranges.t)
    start = float(came.min())
    end = min(float(came.max()), start + until)
    began, n = time.perf_counter(), 0
    for k in range(1, int(np.ceil((end - start) * a_second)) + 1):
        t = start + k / a_second
        if real_time:
            time.sleep(max(0.0, began + (t - start) - time.perf_counter()))
        upto = int(np.searchsorted(stamp, t))
        for row in range(n, upto):
            add(row)
        n, before = upto, time.perf_counter()
        events, registration = estimator.advance(t), estimator.registration()
        now = time.perf_counter()
        yield Moment(t, events, registration, now - before, now - began - (t - start))


def _events(
    recording: Recording,
    names: list[str],
    estimator: sz.Estimator,
    arrivals: Mapping[str, Array],
    calls: Sequence[tuple[float, Call]],
) -> tuple[Callable[[int], None], Array]:
    """What adds the n-th of all that comes, and when each comes (s, range clock): at one time calls, poses, ranges."""
    r, moving = recording.ranges, [name for name in names if name in recording.tracks]
    came = [arrivals.get(name, arrival_of(recording.tracks[name])) for name in moving]
    stamps = [np.array([t for t, _ in calls]), *came, come_of(r.t)]
    whose = np.repeat(np.arange(len(stamps)), [len(s) for s in stamps])
    which = np.concatenate([np.arange(len(s)) for s in stamps])
    stamp = np.concatenate(stamps)
    order = np.lexsort([whose, stamp])
    whose, which = whose[order], which[order]
    columns = {f.name: getattr(r, f.name) for f in fields(Ranges)}
    antennas = [list(user.antennas) for user in recording.users]

    def add(n: int) -> None:
        of, row = int(whose[n]), int(which[n])
        if of == 0:
            calls[row][1](estimator)
        elif of <= len(moving):
            track = recording.tracks[moving[of - 1]]
            estimator.add_pose(moving[of - 1], float(track.t[row]), track.position[row], track.quat_xyzw[row])
        else:
            a, b = int(r.a[row]), int(r.b[row])
            optional = {name: float(columns[name][row]) for name in _NUMBERS if not np.isnan(columns[name][row])}
            source = int(r.source[row])
            estimator.add_range(
                float(r.t[row]),
                names[a],
                names[b],
                float(r.distance[row]),
                antenna_a=antennas[a][r.antenna_a[row]] if r.antenna_a[row] >= 0 else None,
                antenna_b=antennas[b][r.antenna_b[row]] if r.antenna_b[row] >= 0 else None,
                source=SOURCES[source] if source >= 0 else None,
                **optional,
            )

    return add, stamp[order]


def arrival_of(track: Track) -> Array:
    """(n,) s: when its poses come."""
    return come_of(track.t)


def come_of(stamps: Array) -> Array:
    """(n,) s: when what is stamped so comes: then; the earliest or latest that is far from the rest beside these."""
    out = stamps.copy()
    if len(out) > 2:
        order = np.argsort(stamps)
        first, second, last_but_one, last = order[[0, 1, -2, -1]]
        out[first] = max(out[first], out[second] - 1.0)
        out[last] = min(out[last], out[last_but_one] + 1.0)
    return out


def told(recording: Recording, moments: Iterator[Moment], estimator: sz.Estimator) -> Told:
    """All moments as columns."""
    kept = []
    for moment in moments:
        kept.append((moment.t, moment.wall, moment.behind, moment.events, _rows(moment.registration)))
    users = {}
    for u, user in enumerate(recording.users):
        registered, frame, covariance = zip(*[rows[u] for *_, rows in kept], strict=True)
        users[user.name] = Said(np.array(registered), np.array(frame), np.array(covariance))
    t, wall, behind, events, _ = zip(*kept, strict=True)
    happened = [(at, event) for at, of_moment in zip(t, events, strict=True) for event in of_moment]
    return Told(np.array(t), np.array(wall), np.array(behind), users, estimator.reference, happened)


def _rows(registration: Registration) -> list[tuple[bool, Array, Array]]:
    return [(is_registered(user), frame_row(user.common_from_user), _covariance(user)) for user in _users(registration)]


def _users(registration: Registration) -> list[UserRegistration]:
    return [registration.users[name] for name in sorted(registration.users)]


def is_registered(user: UserRegistration) -> bool:
    """Whether it has a place that can be relied on."""
    return user.state is State.REGISTERED and user.common_from_user is not None


def frame_row(frame: YawFrame | None) -> Array:
    """(5,) x, y, z, yaw, scale."""
    return np.full(5, np.nan) if frame is None else np.array([frame.x, frame.y, frame.z, frame.yaw, frame.scale])


def _covariance(user: UserRegistration) -> Array:
    return np.full((4, 4), np.nan) if user.covariance is None else user.covariance


class Written(NamedTuple):
    """One user's n poses in the common frame, each as it was told when it came."""

    t: Array
    """(n,) s, range clock: when it came."""
    registered: Mask
    """(n,)."""
    position: Array
    """(n, 3) m; NaN where it had no place."""
    quat_xyzw: Array
    """(n, 4)."""


def written(of: Told, track: Track, name: str, arrival: Array | None = None) -> Written:
    """The poses of a user's track while the estimator was fed."""
    came = arrival_of(track) if arrival is None else arrival
    at = np.searchsorted(of.t, came, side="right") - 1
    said, placed = of.users[name], (at >= 0) & (came <= of.t[-1])
    row = np.maximum(at, 0)
    frame = np.where(placed[:, None], said.frame[row], np.nan)
    position = apply_frames(frame[:, :4], frame[:, 4:] * track.position)
    quat = multiply_quaternions(yaw_quaternions(np.nan_to_num(wrap_angle(frame[:, 3]))), track.quat_xyzw)
    return Written(came, placed & said.registered[row], position, quat)


def first_registered(of: Told, name: str) -> float:
    """Seconds (s) after the first range until it was; infinite for never."""
    at = np.flatnonzero(of.users[name].registered)
    return float(of.t[at[0]] - of.t[0] + 1.0 / A_SECOND) if len(at) else np.inf


def one_at_a_time(work: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
    """Each task in a process of its own, one after the other: nothing else is on its time."""
    for task in tasks:
        with ProcessPoolExecutor(1, mp_context=get_context("fork")) as process:
            yield process.submit(work, task).result()
