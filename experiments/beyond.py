"""What the experiments beyond the paper's own share: the methods, how far off each is, and intervals.

Errors are of what a user sees through the reference's device: where another user's last place lies in the reference's
own frame as that is at the end, so that a method that trusts SLAM is not blamed for how far the reference has drifted
since it began.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from time import process_time
from typing import NamedTuple

import numpy as np
import scipy.optimize  # noqa: F401  (the paper's method imports it when called: not on its time)

from experiments.study import CONFIDENCE, RESAMPLED, Interval
from synchronizar.arrays import Array
from synchronizar.geometry import YawFrame, wrap_angle
from synchronizar.model import Model
from synchronizar.pairwise import register_pairwise
from synchronizar.pipeline import register
from synchronizar.recording import Recording
from synchronizar.registration import Registration, State
from synchronizar.track import Track

WALKS, WALKS_FULL = 5, 30
"""Of each kind, quickly and at full size."""
CLOCKS_TRUSTED = Model(clock_sigma=1e-4, clock_common_sigma=1e-4)
"""The full model without its estimate of clocks."""
METHODS: dict[str, Callable[[Recording], Registration]] = {
    "pairwise": register_pairwise,
    "rigid": partial(register, kind="rigid"),
    "joint": register,
    "joint, clocks trusted": partial(register, model=CLOCKS_TRUSTED),
}
"""The paper's; ours with SLAM trusted; ours as it is by default; that without its estimate of clocks."""


class Placed(NamedTuple):
    """What a method makes of the users of a walk but the reference, in their order."""

    plane: Array
    """(k - 1,) m: how far off each one's last place is; infinite where there is no placement. So also:"""
    z: Array
    """(k - 1,) m."""
    yaw: Array
    """(k - 1,) rad."""
    states: list[State]
    seconds: float
    """Of computing, on one core: idle time of a busy machine does not count."""


def placed(recording: Recording, world_from_user: Mapping[str, YawFrame], method: str) -> Placed:
    """A recording by one of METHODS; `world_from_user` is the truth at each user's last pose."""
    began = process_time()
    registration = METHODS[method](recording)
    seconds = process_time() - began
    reference = registration.reference
    others = [name for name in registration.users if name != reference]
    plane, z, yaw = (np.full(len(others), np.inf) for _ in range(3))
    for n, name in enumerate(others):
        if registration.users[name].common_from_user is None:
            continue
        found = registration.between(reference, name)
        true = world_from_user[reference].inverse() @ world_from_user[name]
        last = recording.tracks[name].position[-1]
        dx, dy, dz = (found @ last - true @ last).tolist()
        plane[n], z[n], yaw[n] = np.hypot(dx, dy), abs(dz), abs(wrap_angle(found.yaw - true.yaw))
    return Placed(plane, z, yaw, [registration.users[name].state for name in others], seconds)


def beginning(recording: Recording, seconds: float) -> Recording:
    """The first so many seconds of a recording whose clocks agree: the ranges, and each track until just after."""
    return replace(
        recording,
        tracks={name: _until(track, seconds) for name, track in recording.tracks.items()},
        ranges=recording.ranges.select(recording.ranges.t < seconds),
    )


def bootstrap(values: Array, statistic: Callable[[Array], Array], seed: int = 0) -> Interval:
    """The percentile bootstrap (Efron 1979) of a statistic of n independent values (n, ...), which may be infinite.

    `statistic` makes (m,) of m samples at once, (m, n, ...); samples of which it makes NaN do not count.
    """
    random = np.random.default_rng(seed)
    drawn = statistic(values[random.integers(len(values), size=(RESAMPLED, len(values)))])
    half = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.nanquantile(drawn, [half, 1.0 - half], method="inverted_cdf")  # no mean of two infinite ones
    return Interval(float(statistic(values[None])[0]), float(low), float(high))


def median(samples: Array) -> Array:
    """(m,) of (m, n)."""
    return np.asarray(np.median(samples, axis=1))


def share(samples: Array) -> Array:
    """(m,) of (m, n, ...): how many are true."""
    return np.asarray(samples.reshape(len(samples), -1).mean(axis=1))


def _until(track: Track, seconds: float) -> Track:
    kept = slice(int(np.searchsorted(track.t, seconds)) + 1)
    return Track(track.t[kept], track.position[kept], track.quat_xyzw[kept])
