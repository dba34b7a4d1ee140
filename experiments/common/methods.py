"""Shared by experiments beyond the paper's: the compared methods, their errors, confidence intervals and plots.

Errors are of what a user sees through the reference's device: where another user's last place lies in the reference's
own frame as that is at the end, so that a method that trusts SLAM is not blamed for how far the reference has drifted
since it began.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from time import process_time
from typing import NamedTuple

import numpy as np
import scipy.optimize  # noqa: F401  (the paper's method imports it when called: not on its time)
from matplotlib.axes import Axes
from matplotlib.markers import CARETUP
from scipy.stats import binomtest

from experiments.common.study import COLOURS, CONFIDENCE, RESAMPLED, Interval, points
from synchronizar.arrays import Array, Mask
from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration, State
from synchronizar.data.track import Track
from synchronizar.estimation.pairwise.register import register_pairwise
from synchronizar.estimation.register import register
from synchronizar.geometry import YawFrame, wrap_angle
from synchronizar.parameters import Parameters

WALKS, WALKS_FULL = 5, 30
"""Of each kind, quickly and at full size."""
METHODS: dict[str, Callable[[Recording], Registration]] = {
    "pairwise": register_pairwise,
    "rigid": partial(register, model="rigid"),
    "joint": register,
}
"""The paper's; ours with SLAM trusted; ours as it is by default."""
CLOCKS_TRUSTED = "joint, clocks trusted"
"""Ours as it is by default, but without its estimate of clocks."""
EVERY_METHOD = METHODS | {
    CLOCKS_TRUSTED: partial(
        register, parameters=Parameters().changed(devices={"clock_sigma": 1e-4, "clock_common_sigma": 1e-4})
    )
}


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
    """CPU time of the process, all threads together: waiting does not count, and a second core saves nothing."""


def placed(recording: Recording, world_from_user: Mapping[str, YawFrame], method: str) -> Placed:
    """A recording by one of EVERY_METHOD; `world_from_user` is the truth at each user's last pose."""
    began = process_time()
    registration = EVERY_METHOD[method](recording)
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

    `statistic` makes (m,) of m samples at once, (m, n, ...); samples of which it makes NaN do not count. Without any
    that count, the interval is NaN.
    """
    random = np.random.default_rng(seed)
    drawn = statistic(values[random.integers(len(values), size=(RESAMPLED, len(values)))])
    drawn = drawn[~np.isnan(drawn)]
    value = float(statistic(values[None])[0])
    if len(drawn) == 0:
        return Interval(value, np.nan, np.nan)
    half = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.quantile(drawn, [half, 1.0 - half], method="inverted_cdf")  # no mean of two infinite ones
    return Interval(value, float(low), float(high))


def median(samples: Array) -> Array:
    """(m,) of (m, n)."""
    return np.asarray(np.median(samples, axis=1))


def share(true: Mask) -> Interval:
    """How many of n independent ones (n,) are true, by Clopper and Pearson (1934): 0 of n is not certainly never."""
    found = binomtest(int(np.sum(true)), len(true))
    low, high = found.proportion_ci(CONFIDENCE, method="exact")
    return Interval(float(found.statistic), float(low), float(high))


def points_or_arrows(ax: Axes, x: Array, of: Sequence[Interval], method: str, label: str | None = None) -> None:
    """A line of intervals that may be infinite: the bar of one without an upper end goes up to an arrow at the top.

    Where the value is infinite too, it is not drawn; where even the lower end is, there is the arrow alone.
    """
    value, low, high = np.array(of).T
    closed = np.where(np.isfinite(value), value, np.nan)
    points(ax, x, list(map(Interval, closed, low, np.where(np.isinf(high), closed, high))), method, label)
    top, colour, endless = ax.get_xaxis_transform(), COLOURS[method], np.isinf(high)
    ax.plot(x[endless], np.ones(endless.sum()), linestyle="", marker=CARETUP, color=colour, transform=top)
    begun = endless & np.isfinite(low)
    ax.plot(x[begun], low[begun], "_", color=colour, markersize=4)
    bar = {"arrowstyle": "-", "color": colour, "linewidth": 1.2, "shrinkA": 0.0, "shrinkB": 0.0}
    for at, bottom in zip(x[begun].tolist(), low[begun].tolist(), strict=True):
        ax.annotate("", (at, 1.0), (at, bottom), xycoords=top, textcoords="data", arrowprops=bar)


def _until(track: Track, seconds: float) -> Track:
    kept = slice(int(np.searchsorted(track.t, seconds)) + 1)
    return Track(track.t[kept], track.position[kept], track.quat_xyzw[kept])
