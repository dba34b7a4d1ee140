"""The start: what it costs until everybody is registered, how soon that is, and whether it keeps up.

`python -m experiments.live.start [--users 2 4 8 16] [--seeds 5] [--real-time]`: free walks with nothing wrong, all
pairs ranging at the paper's rate, fed to an `Estimator` of one thread (workers=0), ten times a second `advance` and
`registration()`. Told are the CPU seconds of the first 10 s of data, all of it (also as multiples of a fixed
computation, done in the same process just before, which a machine's speed and load move alike); after how much data
each user is registered; the longest update; and how many users were called registered while their place was off by more
than 0.6 m. `--real-time` feeds by the wall clock, with the worker that there is by default, on two cores: how far the
wall clock is ahead of the data when the last user is registered, and at most; and the CPU seconds, the worker's too.
Walks are measured one at a time, each in a process of its own.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from experiments.common.cpu import cpu_seconds, yardstick_seconds
from experiments.common.full_oracle import true_tracks
from experiments.common.live import (
    A_SECOND,
    OFF,
    Moment,
    estimator_of,
    fed,
    first_registered,
    one_at_a_time,
    told,
    written,
)
from experiments.common.results import write_table
from synchronizar.arrays import Array
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

FIRST_S = 10.0
SECONDS = 15.0
CORES = 2


class Task(NamedTuple):
    """One walk."""

    users: int
    seed: int
    seconds: float
    real_time: bool


class Start(NamedTuple):
    """What became of it."""

    cpu: float
    """s in the first 10 s of data."""
    yardstick: float
    """s: of the fixed computation."""
    first: Array
    """(k - 1,) s of data until each is registered; infinite for never."""
    wall: Array
    """(m,) s of each update."""
    behind: Array
    """(m,) s: wall time minus data time."""
    t: Array
    """(m,) s of data."""
    wrong: int
    """Users that were ever registered and off."""


def walk(task: Task) -> Start:
    """Feed one."""
    if task.real_time and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:CORES])
    simulation = simulate(Scene(users=task.users, seconds=task.seconds, seed=task.seed))
    recording = simulation.recording
    yardstick = yardstick_seconds()
    began = cpu_seconds()
    estimator = estimator_of(recording, workers=None if task.real_time else 0)
    cpu = 0.0

    def watched() -> Iterator[Moment]:
        nonlocal cpu
        for n, moment in enumerate(fed(recording, estimator, real_time=task.real_time)):
            if n + 1 == round(FIRST_S * A_SECOND):
                cpu = cpu_seconds() - began
            yield moment

    of = told(recording, watched(), estimator)
    assert of.reference is not None
    truth = true_tracks(simulation, of.reference)
    others = [name for name in recording.tracks if name != of.reference]
    wrong = 0
    for name in others:
        poses = written(of, recording.tracks[name], name)
        off = np.linalg.norm(poses.position - truth[name].position, axis=1) > OFF
        wrong += bool((off & poses.registered).any())
    first = np.array([first_registered(of, name) for name in others])
    return Start(cpu, yardstick, first, of.wall, of.behind, of.t - of.t[0] + 1.0 / A_SECOND, wrong)


def row_of(users: int, walks: list[Start], real_time: bool) -> dict[str, Any]:
    """A line of the table; costs are medians of the walks."""
    first = np.concatenate([w.first for w in walks])
    row: dict[str, Any] = {
        "users": users,
        "n": len(walks),
        "CPU s in the first 10 s": float(np.median([w.cpu for w in walks])),
        "of the yardstick": float(np.median([w.cpu / w.yardstick for w in walks])),
        "median s until registered": float(np.median(first)),
        "95th percentile": float(np.quantile(first, 0.95, method="higher")),
        "registered and off": sum(w.wrong for w in walks),
        "p50 ms": 1e3 * float(np.median(np.concatenate([w.wall for w in walks]))),
        "longest update, ms": 1e3 * max(float(w.wall.max()) for w in walks),
    }
    if real_time:
        then = [_behind_at(w, float(w.first.max())) for w in walks]
        row |= {
            "s behind when all are registered": float(np.median(then)),
            "at most": max(then),
            "s behind, longest": max(float(w.behind.max()) for w in walks),
        }
    return row


def _behind_at(w: Start, data: float) -> float:
    return float(w.behind[np.searchsorted(w.t, data - 1e-6)]) if np.isfinite(data) else np.inf


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--users", type=int, nargs="+", default=[2, 4, 8, 16])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--real-time", action="store_true")
    options = parser.parse_args()
    rows = []
    for users in options.users:
        seeds = range(options.first_seed, options.first_seed + options.seeds)
        tasks = [Task(users, seed, options.seconds, options.real_time) for seed in seeds]
        rows.append(row_of(users, list(one_at_a_time(walk, tasks)), options.real_time))
        print(rows[-1], flush=True)
    settings = {**vars(options), "cores": os.cpu_count(), "load": os.getloadavg()}
    print(write_table("start_real_time" if options.real_time else "start", rows, settings))


if __name__ == "__main__":
    main()
