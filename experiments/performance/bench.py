"""Computing time: of a rigid registration by its parts, of the batch solve, of the live estimator's start and a room's.

`python -m experiments.performance.bench [--tables rigid batch start room] [--people 5 10 20] [--recordings FOLDER]`.

rigid: free walks with clean ranges. For each size: the search for a start (initialise), the joint solve from it to the
first minimum, the same solve with the kernel in numpy (one vectorised CustomFactor a pair, as the C++ block; both with
squared losses, from the same start), the whole of `register`'s work (with mirror images, late bursts judged,
covariances and verdicts): medians of CPU time (ms). What it tells of its own search and solve: the least of five (ms).

batch: CPU seconds of `register` with the default model; a minute of clean free walks, all pairs ranging at the paper's
rate, for so many people (50 people: 40 s), and recordings. start: as `experiments.live.start`.
room: as `experiments.live.entering`, from entering a room to being registered.

Times hang on the machine and its load: compare within one run only, or by the columns in yardsticks, a fixed
computation that is done in the same process just before.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import perf_counter, process_time
from typing import Any

import gtsam
import numpy as np

from experiments.common.cpu import cpu_seconds, yardstick_seconds
from experiments.common.live import one_at_a_time
from experiments.common.results import write_table
from experiments.live import entering, start
from synchronizar._core import RangeBlock, Squared, UserPose
from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.estimation.initialisation import joint_placements
from synchronizar.estimation.register import register
from synchronizar.graph import keys
from synchronizar.graph.gtsam_form import GtsamForm
from synchronizar.graph.problem import Problem
from synchronizar.graph.range_factors import FixedUser, RangeBlockFactor, UserKeys
from synchronizar.graph.rigid_graph import RigidGraph
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import RangeMeasurements, pairs
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

SIZES = ((2, 93), (2, 1000), (2, 10000), (4, 100), (10, 93), (10, 1000))
PEOPLE, MOST_FOR_A_MINUTE = (5, 10, 20), 20
START_PEOPLE, START_SEEDS = (2, 4, 8, 16), 3


def rigid_row(users: int, ranges: int) -> dict[str, Any]:
    """Every stage for `users` users with `ranges` ranges a pair."""
    seconds = 12.0
    recording = simulate(Scene(users=users, seconds=seconds, rate_hz=ranges / seconds, seed=1)).recording
    problem = Problem.of(recording, 0, Parameters())
    samples = problem.measurements
    lonely = RigidGraph(problem.with_measurements(samples[:0]), np.zeros((users, 3)))
    form = GtsamForm(lonely)

    def search() -> Array:
        return joint_placements(problem)[0].frames

    start = search()
    priors = form.factors(start, lonely.initial_em_weights())
    values = form.values(lonely.initial_states(start))
    ends: list[UserKeys | FixedUser] = [
        FixedUser(UserPose()),
        *(UserKeys(keys.frame(u), keys.height(u)) for u in problem.free),
    ]
    ours, numpys = gtsam.NonlinearFactorGraph(priors), gtsam.NonlinearFactorGraph(priors)
    for pair in pairs(samples):
        s = samples[pair.measurements]
        block = RangeBlock(s.p_i, s.p_j, s.distance, s.sigma, s.nlos_odds)
        ours.add(RangeBlockFactor(ends[pair.i], ends[pair.j], block, Squared()))
        numpys.add(numpy_factor(ends[pair.i], ends[pair.j], s))
    row: dict[str, Any] = {"users": users, "ranges": len(samples)}
    row["initialise"] = _ms(search)
    row["solve"] = _ms(lambda: _solve(ours, values))
    row["initialise + solve"] = row["initialise"] + row["solve"]
    row["solve, numpy kernel"] = _ms(lambda: _solve(numpys, values))
    row["numpy / C++"] = row["solve, numpy kernel"] / row["solve"]
    row["register"] = _ms(lambda: register(recording, model="rigid"))
    told = [register(recording, model="rigid").seconds for _ in range(5)]
    row["its search + solve"] = 1e3 * min(of["initialise"] + of["solve"] for of in told)
    row["in yardsticks"] = row["its search + solve"] / (1e3 * yardstick_seconds())
    return row


def batch_row(task: int | Path) -> dict[str, Any]:
    """`register` for so many people, or of a recording; all threads' CPU."""
    if isinstance(task, Path):
        name, recording = task.name, Recording.load(task)
    else:
        name, seconds = f"{task} people", 60.0 if task <= MOST_FOR_A_MINUTE else 40.0
        recording = simulate(Scene(users=task, seconds=seconds, seed=1)).recording
    yardstick, began, wall = yardstick_seconds(), cpu_seconds(), perf_counter()
    registration = register(recording)
    used = cpu_seconds() - began
    return {
        "recording": name,
        "ranges": len(recording.ranges),
        "CPU s": used,
        "in yardsticks": used / yardstick,
        "wall s": perf_counter() - wall,
        "initialise s": registration.seconds["initialise"],
        "solve s": registration.seconds["solve"],
        "registered": sum(user.state == "registered" for user in registration.users.values()),
    }


def numpy_factor(i: UserKeys | FixedUser, j: UserKeys | FixedUser, s: RangeMeasurements) -> gtsam.CustomFactor:
    """All ranges of a pair as rows, computed by numpy."""
    noise = gtsam.noiseModel.Diagonal.Sigmas(s.sigma)
    ends = [(user, p) for user, p in ((i, s.p_i), (j, s.p_j)) if isinstance(user, UserKeys)]

    def place(user: UserKeys | FixedUser, p: Array, values: gtsam.Values) -> tuple[Array, float]:
        if not isinstance(user, UserKeys):
            return p, 0.0
        pose = values.atPose2(user.frame)
        c, sn = np.cos(pose.theta()), np.sin(pose.theta())
        q = np.column_stack([pose.x() + c * p[:, 0] - sn * p[:, 1], pose.y() + sn * p[:, 0] + c * p[:, 1], p[:, 2]])
        q[:, 2] += values.atDouble(user.height)
        return q, pose.theta()

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        between = place(i, s.p_i, values)[0] - place(j, s.p_j, values)[0]
        distance = np.sqrt(np.einsum("nk,nk->n", between, between))
        if jacobians is not None:
            e = between / distance[:, None]
            for k, (user, p) in enumerate(ends):
                sign = 1.0 if user is i else -1.0
                yaw = place(user, p, values)[1]
                c, sn = np.cos(yaw), np.sin(yaw)
                body = np.column_stack([c * e[:, 0] + sn * e[:, 1], -sn * e[:, 0] + c * e[:, 1]])
                turn = body[:, 1] * p[:, 0] - body[:, 0] * p[:, 1]
                jacobians[2 * k] = sign * np.column_stack([body, turn])
                jacobians[2 * k + 1] = sign * e[:, 2:]
        return np.asarray(distance - s.distance)

    return gtsam.CustomFactor(noise, i.keys() + j.keys(), error)


def _solve(graph: gtsam.NonlinearFactorGraph, start: gtsam.Values) -> gtsam.Values:
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setAbsoluteErrorTol(1e-3)
    parameters.setRelativeErrorTol(0.0)
    return gtsam.LevenbergMarquardtOptimizer(graph, start, parameters).optimize()


def _ms(work: Callable[[], Any]) -> float:
    """The median CPU time of as many runs as half a second holds, at least three."""
    times: list[float] = []
    while len(times) < 3 or (sum(times) < 0.5 and len(times) < 200):
        begin = process_time()
        work()
        times.append(process_time() - begin)
    return 1e3 * median(times)


def main() -> None:
    """The tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    tables = ("rigid", "batch", "start", "room")
    parser.add_argument("--tables", nargs="+", choices=tables, default=tables)
    parser.add_argument("--people", type=int, nargs="*", default=list(PEOPLE))
    parser.add_argument("--recordings", type=Path, nargs="*", default=[], help="folders, for the batch table")
    options = parser.parse_args()
    settings = {"cores": os.cpu_count(), "load": os.getloadavg()}
    if "rigid" in options.tables:
        print(write_table("bench", [rigid_row(users, ranges) for users, ranges in SIZES], settings))
        print("ms")
    if "batch" in options.tables:
        rows = list(one_at_a_time(batch_row, [*options.people, *options.recordings]))
        print(write_table("bench_batch", rows, settings))
    if "start" in options.tables:
        rows = []
        for users in START_PEOPLE:
            tasks = [start.Task(users, seed, start.SECONDS, real_time=False) for seed in range(START_SEEDS)]
            rows.append(start.row_of(users, list(one_at_a_time(start.walk, tasks)), real_time=False))
        print(write_table("bench_start", rows, settings))
    if "room" in options.tables:
        print(write_table("bench_room", entering.rows_of(entering.USERS, entering.SEEDS, entering.SECONDS), settings))
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, a yardstick {1e3 * yardstick_seconds():.1f} ms")


if __name__ == "__main__":
    main()
