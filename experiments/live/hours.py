"""Hours: whether updates, memory and errors stay as they are.

`python -m experiments.live.hours [--users 4] [--minutes 60] [--day] [--seeds 1]`: free walks, all pairs ranging at 8
Hz, tracks at 30 Hz, SLAM that drifts by 0.01 m and 0.003 rad per root second (the reference's own too), clocks that run
up to 20 ppm fast or slow, fed to an `Estimator` of one thread; `advance` and `registration()` ten times a second.
`--day`: a day at a tenth of all these rates. Told are how long updates take, in quarters of the time, and in multiples
of a fixed computation in the same process; memory at the quarters' ends; and the pairs' transfer error in the plane:
where one registered user is told to be, in the other's own axes as they are told to lie at that moment, beside where it
is; of all pairs by quarters, and in the last of those with the reference and of those without it. The common frame
itself follows the reference's first pose: by how much all were off in it at the end. Nothing is kept of what was told
but one row a second. The figure draws the errors.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from experiments.common.cpu import cpu_seconds, resident_mb, yardstick_seconds
from experiments.common.full_oracle import true_frames_along, true_tracks
from experiments.common.live import A_SECOND, estimator_of, fed, frame_row, is_registered, one_at_a_time
from experiments.common.results import FOLDER, write_table
from experiments.common.study import figure
from synchronizar.arrays import Array, Indices, Mask
from synchronizar.geometry import apply_frames
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

RANGES_HZ, TRACK_HZ = 8.0, 30.0
DRIFT_M, DRIFT_RAD = 0.01, 0.003
PPM = 20.0
MINUTES_A_DAY, SLOWER = 24.0 * 60.0, 10.0
QUARTERS = 4


class Task(NamedTuple):
    """One walk."""

    users: int
    seed: int
    minutes: float
    slower: float


class Long(NamedTuple):
    """What became of it."""

    wall: Array
    """(m,) s of each update."""
    megabytes: Array
    """(4,) at the quarters' ends; before it began in front."""
    yardsticks: float
    """CPU a second of data, in fixed computations."""
    t: Array
    """(n,) s."""
    errors: Array
    """(n, pairs) m: transfer in the plane; NaN while one of the two is not registered."""
    with_reference: Mask
    """(pairs,) whether the reference is one of the two."""
    common: float
    """m: rms of all in the common frame at the end."""
    registered: Array
    """(n,) share of the users."""


def simulation_of(task: Task) -> Simulation:
    """The walk, its tracks stamped by their clocks."""
    scene = Scene(
        users=task.users,
        seed=task.seed,
        seconds=60.0 * task.minutes,
        rate_hz=RANGES_HZ / task.slower,
        track_rate_hz=TRACK_HZ / task.slower,
        drift_m_per_sqrt_s=DRIFT_M,
        drift_rad_per_sqrt_s=DRIFT_RAD,
    )
    simulation = simulate(scene)
    fast = 1e-6 * PPM * np.random.default_rng([task.seed, 20]).uniform(-1.0, 1.0, task.users)
    recording = simulation.recording
    tracks = {
        name: replace(t, t=t.t + f * (t.t - t.t[0]))
        for (name, t), f in zip(recording.tracks.items(), fast.tolist(), strict=True)
    }
    return replace(simulation, recording=replace(recording, tracks=tracks))


def transfer(told: Array, true: Array, pairs: Indices) -> Array:
    """(..., pairs) m in the plane: the second's place in the first's axes, as told beside as it is.

    `told` and `true`: (..., k, 4) x, y, z of each device and the yaw of its own frame, in one frame each.
    """
    a, b = pairs

    def seen(of: Array) -> Array:
        way = (of[..., b, :2] - of[..., a, :2]).copy()
        c, s = np.cos(of[..., a, 3]), np.sin(of[..., a, 3])
        return np.stack([c * way[..., 0] + s * way[..., 1], c * way[..., 1] - s * way[..., 0]], axis=-1)

    return np.asarray(np.linalg.norm(seen(told) - seen(true), axis=-1))


def walk(task: Task) -> Long:
    """Follow one."""
    simulation = simulation_of(task)
    recording, arrivals = simulation.recording, {name: track.t for name, track in simulation.truth.items()}
    names, a_second = list(recording.tracks), A_SECOND / task.slower
    rows = np.zeros((int(60.0 * task.minutes) + 2, len(names), 5))
    registered = np.zeros(rows.shape[:2], dtype=bool)
    wall = np.full(int(60.0 * task.minutes * a_second) + 2, -1.0)
    yardstick, megabytes = yardstick_seconds(), [resident_mb()]
    estimator, began, n = estimator_of(recording), cpu_seconds(), 0
    second: list[float] = []
    every, end = round(a_second) or 1, len(wall) - 2
    for n, moment in enumerate(fed(recording, estimator, arrivals=arrivals, a_second=a_second)):
        wall[n] = moment.wall
        if n % every == 0:
            users = moment.registration.users
            rows[len(second)] = [frame_row(users[name].common_from_user) for name in names]
            registered[len(second)] = [is_registered(users[name]) for name in names]
            second.append(moment.t)
        if (n + 1) * QUARTERS >= end * len(megabytes) and len(megabytes) <= QUARTERS:
            megabytes.append(resident_mb())
    used = (cpu_seconds() - began) / yardstick / (60.0 * task.minutes)
    reference = estimator.reference or names[0]
    t, told_frames, known = np.array(second), rows[: len(second)], registered[: len(second)]
    told, true = _places(simulation, reference, arrivals, t, told_frames)
    pairs = np.array([(a, b) for a in range(len(names)) for b in range(len(names)) if a != b]).T
    errors = np.where(known[:, pairs[0]] & known[:, pairs[1]], transfer(told, true, pairs), np.nan)
    with_reference = (pairs == names.index(reference)).any(axis=0)
    common = float(np.sqrt(np.mean(np.sum((told[-1, :, :2] - true[-1, :, :2]) ** 2, axis=1))))
    return Long(wall[:n], np.array(megabytes), used, t, errors, with_reference, common, known.mean(axis=1))


def _places(
    simulation: Simulation, reference: str, arrivals: Mapping[str, Array], t: Array, frames: Array
) -> tuple[Array, Array]:
    """(n, k, 4) twice: each device at times t (n,), as told by `frames` (n, k, 5), and as it was."""
    told, true, truth = [], [], true_tracks(simulation, reference)
    for u, (name, track) in enumerate(simulation.recording.tracks.items()):
        last = np.searchsorted(arrivals[name], t) - 1
        place = apply_frames(frames[:, u, :4], frames[:, u, 4:] * track.position[last])
        told.append(np.column_stack([place, frames[:, u, 3]]))
        heading = true_frames_along(simulation, reference, name)[last, 3]
        true.append(np.column_stack([truth[name].position[last], heading]))
    return np.stack(told, axis=1), np.stack(true, axis=1)


def row_of(task: Task, found: Long) -> dict[str, Any]:
    """A line of the table."""
    wall, errors = np.array_split(found.wall, QUARTERS), np.array_split(found.errors, QUARTERS)
    row: dict[str, Any] = {"users": task.users, "minutes": task.minutes, "seed": task.seed}
    row |= {f"p{q:g} ms": 1e3 * float(np.quantile(found.wall, q / 100.0)) for q in (50, 99)}
    row |= {
        "max ms": 1e3 * float(found.wall.max()),
        "last quarter / second": float(wall[-1].sum() / wall[1].sum()),
        "its p99": float(np.quantile(wall[-1], 0.99) / np.quantile(wall[1], 0.99)),
        "yardsticks a second": found.yardsticks,
        "MB": " ".join(f"{mb:.0f}" for mb in found.megabytes),
        "pairs' transfer xy, quarters": " ".join(f"{_rms(e):.3f}" for e in errors),
        "with the reference": _rms(errors[-1][:, found.with_reference]),
        "without": _rms(errors[-1][:, ~found.with_reference]),
        "largest": float(np.nanmax(found.errors)) if np.isfinite(found.errors).any() else np.nan,
        "registered": float(found.registered.mean()),
        "in the common frame at the end": found.common,
    }
    return row


def _rms(errors: Array) -> float:
    known = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else np.nan


def draw(found: Long, name: str) -> None:
    """The pairs' errors over time."""
    made, axes = figure(height=2.4)
    ax = axes[0, 0]
    minutes = found.t / 60.0
    for pairs, colour, label in (
        (found.with_reference, "#332288", "with the reference"),
        (~found.with_reference, "#44AA99", "others"),
    ):
        if pairs.any():
            ax.plot(minutes, np.sqrt(np.mean(found.errors[:, pairs] ** 2, axis=1)), color=colour, lw=0.6, label=label)
    ax.set(xlabel="time (min)", ylabel="pairs' transfer error, rms (m)", ylim=(0.0, None))
    ax.legend()
    FOLDER.mkdir(exist_ok=True)
    made.savefig(FOLDER / f"{name}.png", dpi=150)
    print(FOLDER / f"{name}.png")


def main() -> None:
    """The table and the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--users", type=int, default=4)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--day", action="store_true")
    parser.add_argument("--seeds", type=int, default=1)
    options = parser.parse_args()
    minutes, slower = (MINUTES_A_DAY, SLOWER) if options.day else (options.minutes, 1.0)
    tasks = [Task(options.users, seed, minutes, slower) for seed in range(options.seeds)]
    found = list(one_at_a_time(walk, tasks))
    rows = [row_of(task, of) for task, of in zip(tasks, found, strict=True)]
    name = "hours_day" if options.day else "hours"
    print(write_table(name, rows, {**vars(options), "cores": os.cpu_count(), "load": os.getloadavg()}))
    draw(found[0], name)


if __name__ == "__main__":
    main()
