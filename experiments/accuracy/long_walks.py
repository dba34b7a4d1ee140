"""Time and memory of the default model over the length of a recording.

`python -m experiments.accuracy.long_walks [--minutes 15 30 60] [--users 6]`: walks with tracks at 30 Hz, all pairs
ranging at 8 Hz, and SLAM that drifts by 0.01 m and 0.003 rad per root second; simulated, loaded and registered in
processes of their own, so that the peak is that of loading and registering alone.
"""

from __future__ import annotations

import argparse
import os
import resource
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple, TypeVar

import numpy as np

from experiments.common.full_oracle import last_errors, last_poses, true_tracks
from experiments.common.results import write_table
from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.estimation.register import register
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

DRIFT_M, DRIFT_RAD = 0.01, 0.003
RATE_HZ = 8.0

Result = TypeVar("Result")


class Registered(NamedTuple):
    """What became of a recording."""

    reference: str
    poses: dict[str, Array]
    """(7,) the last of each user."""
    states: list[str]
    ranges: int
    stages: dict[str, float]
    """s."""
    seconds: float
    megabytes: float
    """The process's peak."""


def write(folder: Path, minutes: float, users: int) -> dict[str, dict[str, Array]]:
    """Simulate into a folder; the true last poses in the common frame of each user that could be the reference."""
    simulation = simulate(
        Scene(
            users=users,
            seconds=60.0 * minutes,
            rate_hz=RATE_HZ,
            drift_m_per_sqrt_s=DRIFT_M,
            drift_rad_per_sqrt_s=DRIFT_RAD,
        )
    )
    simulation.recording.save(folder)
    return {name: last_poses(true_tracks(simulation, name)) for name in simulation.recording.tracks}


def solve(folder: Path) -> Registered:
    """Load and register."""
    recording = Recording.load(folder)
    began = perf_counter()
    registration = register(recording)
    seconds = perf_counter() - began
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return Registered(
        registration.reference,
        last_poses(registration.tracks(recording)),
        [str(u.state) for name, u in registration.users.items() if name != registration.reference],
        len(recording.ranges),
        dict(registration.seconds),
        seconds,
        peak,
    )


def row_of(minutes: float, users: int) -> dict[str, Any]:
    """One length."""
    with tempfile.TemporaryDirectory() as folder:
        truth = _apart(write, Path(folder), minutes, users)
        found = _apart(solve, Path(folder))
    true = truth[found.reference]
    errors = last_errors(found.poses, true, [name for name in sorted(true) if name != found.reference])
    plane = np.hypot(*errors[:, :2].T)
    return {
        "minutes": minutes,
        "users": users,
        "ranges": found.ranges,
        "seconds": found.seconds,
        "search": found.stages["initialise"],
        "solve": found.stages["solve"],
        "seconds / minute": found.seconds / minutes,
        "peak MB": found.megabytes,
        "rms xy": float(np.sqrt(np.mean(plane**2))),
        "largest xy": float(plane.max()),
        "rms z": float(np.sqrt(np.mean(errors[:, 2] ** 2))),
        "rms yaw": float(np.sqrt(np.mean(errors[:, 3] ** 2))),
        "states": " ".join(f"{found.states.count(s)} {s}" for s in sorted(set(found.states))),
    }


def _apart(work: Callable[..., Result], *arguments: object) -> Result:
    """Do it in a process of its own."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        return process.submit(work, *arguments).result()


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, nargs="+", default=[15.0, 30.0, 60.0])
    parser.add_argument("--users", type=int, default=6)
    options = parser.parse_args()
    rows = []
    for minutes in options.minutes:
        rows.append(row_of(minutes, options.users))
        print(rows[-1], flush=True)
    print(write_table("long_walks", rows, {**vars(options), "cores": os.cpu_count(), "load": os.getloadavg()}))


if __name__ == "__main__":
    main()
