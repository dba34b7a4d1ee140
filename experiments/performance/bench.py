"""Computing time of a registration, with the C++ kernel and with the same kernel in numpy.

`python -m experiments.performance.bench`: free walks with clean ranges, rigid model. For each size: the search for a
start (initialise), the joint solve from it to the first minimum, the same solve with the kernel in numpy (one
vectorised CustomFactor a pair, as the C++ block; both with squared losses, from the same start), and the whole of
`register`'s work (with mirror images, late bursts judged, covariances and verdicts). Medians, ms; compare within one
run only.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from statistics import median
from time import perf_counter
from typing import Any

import gtsam
import numpy as np

from experiments.common.results import write_table
from synchronizar._core import RangeBlock, Squared, UserPose
from synchronizar.arrays import Array
from synchronizar.estimation.initialisation import joint_placements
from synchronizar.estimation.register import register
from synchronizar.graph import keys
from synchronizar.graph.problem import Problem
from synchronizar.graph.range_factors import FixedUser, RangeBlockFactor, UserKeys
from synchronizar.graph.rigid_graph import RigidGraph
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import RangeMeasurements, pairs
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

SIZES = ((2, 100), (2, 1000), (2, 10000), (4, 100), (10, 100), (10, 1000))


def row_of(users: int, ranges: int) -> dict[str, Any]:
    """Every stage for `users` users with `ranges` ranges a pair."""
    seconds = 12.0
    recording = simulate(Scene(users=users, seconds=seconds, rate_hz=ranges / seconds, seed=1)).recording
    problem = Problem.of(recording, 0, Parameters())
    samples = problem.measurements
    lonely = RigidGraph(problem.with_measurements(samples[:0]), np.zeros((users, 3)))

    def search() -> Array:
        return joint_placements(problem)[0].frames

    start = search()
    priors = lonely.factors(start, lonely.initial_em_weights())
    values = lonely.values(lonely.initial_states(start))
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
    return row


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
    """The median of as many runs as half a second holds, at least three."""
    times: list[float] = []
    while len(times) < 3 or (sum(times) < 0.5 and len(times) < 200):
        begin = perf_counter()
        work()
        times.append(perf_counter() - begin)
    return 1e3 * median(times)


def main() -> None:
    """The table."""
    rows = [row_of(users, ranges) for users, ranges in SIZES]
    print(write_table("bench", rows, {"cores": os.cpu_count(), "load": os.getloadavg()}))
    print(f"ms; {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
