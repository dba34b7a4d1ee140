"""Following: how accurate everybody is along whole walks, each pose as it was told at its own moment.

`python -m experiments.live.following [--users 2 4 10] [--late 0 0.2 0.4] [--seeds 4] [--seconds 90] [--devices]`: free
walks of a given share of late ranges, all pairs at the paper's rate, devices right or (`--devices`) drawn from the
model as `experiments.accuracy.consistency` draws them, fed to an `Estimator` of one thread. The error in the plane of
poses that were told while their user was registered: beside the truth with the reference's told poses laid onto its
own, as `evaluate` does it (`transfer xy`), in the common frame (`common xy`), and from 20 s on. The frames' normalised
errors squared in x, y and yaw, over 3: 1 is right, where devices drift more is due to the common frame. When each user
was registered, and how long updates took; their CPU as multiples of a fixed computation in the same process too.
`--batch` sets `register` with all ranges beside it.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from experiments.accuracy import consistency
from experiments.common.cpu import cpu_seconds, yardstick_seconds
from experiments.common.full_oracle import true_frames_along, true_tracks
from experiments.common.live import OFF, Told, estimator_of, fed, first_registered, one_at_a_time, told, written
from experiments.common.results import write_table
from synchronizar.arrays import Array
from synchronizar.estimation.register import register
from synchronizar.geometry import difference
from synchronizar.reporting.evaluate import Matched, align
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

SECONDS = 90.0
SETTLED_S = 20.0
"""From then on users are followed rather than found."""
PLANE = [0, 1, 3]
"""x, y and yaw of a frame."""


class Task(NamedTuple):
    """One walk."""

    users: int
    late: float
    seed: int
    seconds: float
    devices: bool
    batch: bool


class Followed(NamedTuple):
    """What became of it: squares of errors (m) in the plane, of poses of all users but the reference."""

    transfer: Array
    common: Array
    settled: Array
    """Those of `common` after 20 s."""
    batch: Array
    """Of the batch solution's poses, as `common`."""
    normalised: Array
    """(n,) squares in x, y and yaw, over 3, at each update."""
    first: list[float]
    wall: Array
    yardsticks: float
    """CPU of the walk in fixed computations, a second of data."""
    wrong: int
    """Users that were ever registered and off."""


def scene_of(task: Task) -> Scene:
    """The walk's scene."""
    clean = Scene(users=task.users, seconds=task.seconds, seed=task.seed, late_share=task.late)
    if not task.devices:
        return clean
    drawn = consistency.scene_of(consistency.Task(task.users, task.seconds, task.seed))
    return replace(drawn, late_share=task.late)


def walk(task: Task) -> Followed:
    """Follow one."""
    simulation = simulate(scene_of(task))
    recording = simulation.recording
    yardstick, began = yardstick_seconds(), cpu_seconds()
    estimator = estimator_of(recording)
    of = told(recording, fed(recording, estimator), estimator)
    used = (cpu_seconds() - began) / yardstick / task.seconds
    return judged(simulation, of, used, task.batch)


def judged(simulation: Simulation, of: Told, used: float = 0.0, with_batch: bool = False) -> Followed:
    """What was told beside the truth."""
    recording = simulation.recording
    assert of.reference is not None
    truth = true_tracks(simulation, of.reference)
    poses = {name: written(of, recording.tracks[name], name) for name in recording.tracks}
    own = poses[of.reference]
    there = own.registered & np.isfinite(own.position[:, 0])
    aligned = align([Matched(own.position[there], truth[of.reference].position[there])])
    others = [name for name in recording.tracks if name != of.reference]
    transfer, common, settled, batch, normalised = [], [], [], [], []
    wrong = 0
    for name in others:
        p, true = poses[name], truth[name].position
        there = p.registered & np.isfinite(p.position[:, 0])
        error = p.position[there] - true[there]
        wrong += bool((np.linalg.norm(error, axis=1) > OFF).any())
        transfer.append(_plane(aligned @ p.position[there] - true[there]))
        common.append(_plane(error))
        settled.append(common[-1][p.t[there] - of.t[0] > SETTLED_S])
        normalised.append(_normalised(simulation, of, name))
    if with_batch:
        tracks = register(recording, of.reference).tracks(recording)
        batch = [_plane(tracks[name].position - truth[name].position) for name in others if name in tracks]
    first = [first_registered(of, name) for name in others]
    t, c, s, b, n = (np.concatenate(p or [np.zeros(0)]) for p in (transfer, common, settled, batch, normalised))
    return Followed(t, c, s, b, n, first, of.wall, used, wrong)


def _plane(errors: Array) -> Array:
    """(n,) squares (m) of errors (n, 3) in the plane."""
    return np.asarray((errors[:, :2] ** 2).sum(axis=1))


def _normalised(simulation: Simulation, of: Told, name: str) -> Array:
    """(n,) squares over 3 of a user's frame errors in x, y and yaw, at each update at which it was registered."""
    said = of.users[name]
    at = np.flatnonzero(said.registered & np.isfinite(said.covariance[:, 0, 0]) & np.isfinite(said.frame[:, 0]))
    true = true_frames_along(simulation, of.reference or name, name)
    last = np.searchsorted(simulation.recording.tracks[name].t, of.t[at]) - 1
    error = difference(said.frame[at, :4], true[last])[:, PLANE]
    covariance = said.covariance[at][:, PLANE][:, :, PLANE]
    return np.asarray(np.einsum("nk,nk->n", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0]) / 3.0)


def row_of(users: int, late: float, walks: list[Followed]) -> dict[str, Any]:
    """A line of the table; all users' poses together."""
    first, wall = (np.concatenate([getattr(w, what) for w in walks]) for what in ("first", "wall"))
    row: dict[str, Any] = {"users": users, "late": late, "n": len(walks)}
    row |= {f"{what} xy": _rms([getattr(w, what) for w in walks]) for what in ("transfer", "common", "settled")}
    if any(len(w.batch) for w in walks):
        row["batch xy"] = _rms([w.batch for w in walks])
    row |= {
        "of the seeds": " ".join(f"{_rms([w.transfer]):.3f}" for w in walks),
        "normalised error": float(np.concatenate([w.normalised for w in walks]).mean()),
        "registered and off": sum(w.wrong for w in walks),
        "median s until registered": float(np.median(first)),
        "p50 ms": 1e3 * float(np.median(wall)),
        "p99 ms": 1e3 * float(np.quantile(wall, 0.99)),
        "longest, ms": 1e3 * float(wall.max()),
        "yardsticks a second": float(np.median([w.yardsticks for w in walks])),
    }
    return row


def _rms(squares: list[Array]) -> float:
    joined = np.concatenate(squares)
    return float(np.sqrt(joined.mean())) if len(joined) else np.nan


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--users", type=int, nargs="+", default=[2, 4, 10])
    parser.add_argument("--late", type=float, nargs="+", default=[0.0, 0.2, 0.4])
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--devices", action="store_true", help="drawn from the model")
    parser.add_argument("--batch", action="store_true")
    options = parser.parse_args()
    rows = []
    for late in options.late:
        for users in options.users:
            tasks = [
                Task(users, late, seed, options.seconds, options.devices, options.batch)
                for seed in range(options.seeds)
            ]
            rows.append(row_of(users, late, list(one_at_a_time(walk, tasks))))
            print(rows[-1], flush=True)
    name = "following_devices" if options.devices else "following"
    print(write_table(name, rows, {**vars(options), "cores": os.cpu_count(), "load": os.getloadavg()}))


if __name__ == "__main__":
    main()
