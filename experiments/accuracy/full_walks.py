"""Accuracy of the default model on simulated walks, against maximum likelihood that knows the noise and NLOS ranges.

`python -m experiments.accuracy.full_walks [--seeds 50] [--users 2 3 4] [--quick]` simulates walks, registers each with
the default model, and compares every user's last pose in the common frame (the reference's at its first pose) with that
of maximum likelihood, which starts at the truth, knows how noisy everything is and which ranges are late. Scenes: clean
walks of 12 s, also beside the rigid model; a minute with drift, scale, biases, clocks and a jump each, the radios'
biases usual or large; the same with 40 % of the ranges late; the same with one radio that adds 0.9 m. A wrong basin is
a user that is off by more than 0.6 m where maximum likelihood is not, and 0.3 m from it. Tables go to
experiments/results/ too.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from experiments.common.full_oracle import last_errors, last_poses, oracle, true_tracks
from experiments.common.results import write_table
from experiments.common.walks import on_all_cores
from synchronizar.arrays import Array
from synchronizar.data.registration import State
from synchronizar.estimation.register import register
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

OFF = 0.6
ELSEWHERE = 0.3
ODD_BIAS = 0.9

CLEAN: dict[str, Any] = {"seconds": 12.0}
WRONG: dict[str, Any] = {
    "seconds": 60.0,
    "drift_m_per_sqrt_s": 0.02,
    "drift_rad_per_sqrt_s": 0.01,
    "scale_sigma": 0.1,
    "bias_sigma": 0.05,
    "clock_offset_sigma": 0.1,
    "jumps": 1,
    "jump_m": 0.5,
    "jump_rad": 0.2,
}
LATE: dict[str, Any] = {"late_share": 0.4, "late_burst_s": 1.0}
SCENES: dict[str, dict[str, Any]] = {
    "clean": CLEAN,
    "wrong": WRONG,
    "wrong, bias 0.3": WRONG | {"bias_sigma": 0.3},
    "wrong, late": WRONG | LATE,
    "wrong, late, bias 0.3": WRONG | LATE | {"bias_sigma": 0.3},
    "wrong, odd radio": WRONG,
    "wrong, late, odd radio": WRONG | LATE,
}


class Task(NamedTuple):
    """One walk."""

    name: str
    """Of the scene."""
    users: int
    seed: int


class Walk(NamedTuple):
    """The users of a walk but the reference: errors (k - 1, 4) of their last poses in x, y, z (m), yaw (rad)."""

    task: Task
    full: Array
    best: Array
    """Of maximum likelihood."""
    rigid: Array | None
    """Of the rigid model, where nothing is wrong."""
    states: list[State]
    seconds: float


def simulation_of(task: Task) -> Simulation:
    """A walk of a scene; for an odd radio, one user's ranges (drawn by seed) are longer still."""
    simulation = simulate(Scene(users=task.users, seed=task.seed, **SCENES[task.name]))
    if not task.name.endswith("odd radio"):
        return simulation
    odd = task.seed % task.users
    name, ranges = simulation.recording.users[odd].name, simulation.recording.ranges
    with_it = (ranges.a == odd) | (ranges.b == odd)
    longer = replace(ranges, distance=ranges.distance + ODD_BIAS * with_it)
    return replace(
        simulation,
        recording=replace(simulation.recording, ranges=longer),
        range_bias={**simulation.range_bias, name: simulation.range_bias[name] + ODD_BIAS},
    )


def walk(task: Task) -> Walk:
    """Register one walk."""
    simulation = simulation_of(task)
    recording = simulation.recording
    began = perf_counter()
    registration = register(recording)
    seconds = perf_counter() - began
    reference = registration.reference
    truth = last_poses(true_tracks(simulation, reference))
    others = [user.name for user in recording.users if user.name != reference]
    rigid = None
    if task.name == "clean":
        tracks = register(recording, reference, model="rigid").tracks(recording)
        rigid = last_errors(last_poses(tracks), truth, others)
    return Walk(
        task,
        last_errors(last_poses(registration.tracks(recording)), truth, others),
        last_errors(last_poses(oracle(simulation, reference)), truth, others),
        rigid,
        [registration.users[name].state for name in others],
        seconds,
    )


def main() -> None:
    """The tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--users", type=int, nargs="+", help="by default 2, 3, 4, and of clean walks 6 too")
    parser.add_argument("--scenes", nargs="+", choices=list(SCENES), default=list(SCENES))
    parser.add_argument("--quick", action="store_true", help="6 seeds")
    options = parser.parse_args()
    rows = []
    for name in options.scenes:
        for users in options.users or ([2, 3, 4, 6] if name == "clean" else [2, 3, 4]):
            tasks = [Task(name, users, seed) for seed in range(6 if options.quick else options.seeds)]
            walks = list(on_all_cores(walk, tasks))
            rows.append(_row(name, users, walks))
            print(f"{name}, {users} users: {rows[-1]}", flush=True)
            for w in walks:
                _tell_wrong(w)
    for clean in (True, False):
        mine = [row for row in rows if (row["scene"] == "clean") is clean]
        if mine:
            print()
            print(write_table("full_walks_clean" if clean else "full_walks", mine, vars(options)))


def wrong_basins(w: Walk) -> list[int]:
    """Which users are off where maximum likelihood is not; one without a placement is off."""
    off, off_best, between = (np.linalg.norm(e[:, :3], axis=1) for e in (w.full, w.best, w.full - w.best))
    wrong = ~((off <= OFF) | (between <= ELSEWHERE)) & (off_best <= OFF)
    return [int(u) for u in np.flatnonzero(wrong)]


def _tell_wrong(w: Walk) -> None:
    for u in wrong_basins(w):
        ours, best = np.round(w.full[u], 2).tolist(), np.round(w.best[u], 2).tolist()
        print(f"wrong basin: {w.task}, user {u} of the others, {w.states[u]}: {ours}, maximum likelihood {best}")


def _row(name: str, users: int, walks: list[Walk]) -> dict[str, Any]:
    full, best = (np.concatenate([getattr(w, what) for w in walks]) for what in ("full", "best"))
    states = [state for w in walks for state in w.states]
    there = np.isfinite(full[:, 0])
    row: dict[str, Any] = {"scene": name, "users": users, "n": len(full)}
    row |= {"xy": _rms(full[there, :2]), "z": _rms(full[there, 2:3]), "yaw": _rms(full[there, 3:])}
    row |= {f"{what} / ml": row[what] / _rms(best[:, columns]) for what, columns in _COLUMNS.items()}
    if name == "clean":
        rigid = np.concatenate([w.rigid for w in walks if w.rigid is not None])
        row |= {f"{what} / rigid": row[what] / _rms(rigid[:, columns]) for what, columns in _COLUMNS.items()}
    plane, plane_best = np.hypot(*full[there, :2].T), np.hypot(*best[:, :2].T)
    row |= {"median xy": float(np.median(plane)), "median / ml": float(np.median(plane) / np.median(plane_best))}
    row |= {"largest xy": float(plane.max()), "ml largest": float(plane_best.max())}
    wrong = [(w, u) for w in walks for u in wrong_basins(w)]
    row |= {"wrong basins": len(wrong), "said registered": sum(w.states[u] is State.REGISTERED for w, u in wrong)}
    row |= {str(state): states.count(state) for state in State}
    row["seconds"] = float(np.median([w.seconds for w in walks]))
    return row


_COLUMNS = {"xy": slice(0, 2), "z": slice(2, 3), "yaw": slice(3, 4)}


def _rms(errors: Array) -> float:
    """Root of the mean square length of errors (n, d)."""
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


if __name__ == "__main__":
    main()
