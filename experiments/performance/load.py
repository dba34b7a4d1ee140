"""Time and memory to load a large recording: `python -m experiments.performance.load`."""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np

from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.data.user import User

USERS = 4
POSES_PER_USER = 250_000
RANGES = 1_000_000
SECONDS = 2500.0


def write(folder: str) -> None:
    """A recording of that size, of random walks and random ranges."""
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, SECONDS, POSES_PER_USER)
    tracks = {}
    for k in range(USERS):
        quat = rng.normal(size=(len(t), 4))
        position = 0.01 * rng.normal(size=(len(t), 3)).cumsum(axis=0)
        tracks[f"user{k}"] = Track(t, position, quat / np.linalg.norm(quat, axis=1, keepdims=True))
    a = rng.integers(0, USERS, RANGES, dtype=np.int32)
    b = (a + rng.integers(1, USERS, RANGES, dtype=np.int32)) % USERS
    ranges = Ranges.of(
        np.linspace(0.0, SECONDS, RANGES), a, b, rng.uniform(0.0, 20.0, RANGES), sigma=np.full(RANGES, 0.1)
    )
    Recording(tuple(User(name) for name in tracks), tracks, ranges).save(folder)


def load(folder: str) -> tuple[float, float]:
    """Seconds, and the process's peak memory in MB."""
    start = time.perf_counter()
    Recording.load(folder)
    seconds = time.perf_counter() - start
    return seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def main() -> None:
    """Write, then load, each in a process of its own, so that the peak is that of loading alone."""
    argparse.ArgumentParser(prog="python -m experiments.performance.load", description=__doc__).parse_args()
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(1, mp_context=get_context("spawn"), max_tasks_per_child=1) as processes,
    ):
        processes.submit(write, folder).result()
        seconds, megabytes = processes.submit(load, folder).result()
    print(f"{RANGES} ranges, {USERS * POSES_PER_USER} poses: {seconds:.2f} s, peak {megabytes:.0f} MB")


if __name__ == "__main__":
    main()
