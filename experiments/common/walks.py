"""Shared by experiments on simulated walks: truth, maximum likelihood started at it, and the Cramer-Rao bound."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from multiprocessing import Pool
from typing import NamedTuple, TypeVar

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.registration import State
from synchronizar.estimation.register import register
from synchronizar.geometry import difference
from synchronizar.graph.problem import Problem
from synchronizar.graph.rigid_graph import RigidGraph
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import range_measurements
from synchronizar.simulation.simulate import Simulation

Task = TypeVar("Task")
Result = TypeVar("Result")


def true_frames(simulation: Simulation, reference: str) -> Array:
    """(k, 4) x, y, z, yaw: the true `common_from_user` of every user, the common frame being the reference's."""
    common_from_world = simulation.world_from_user[reference].inverse()
    frames = [common_from_world @ simulation.world_from_user[u.name] for u in simulation.recording.users]
    return np.array([[f.x, f.y, f.z, f.yaw] for f in frames])


class Oracle(NamedTuple):
    """What can be known at best: late ranges left out, because the oracle knows which they are."""

    error: Array
    """(k, 4) of maximum likelihood, started at the truth, under the same model and priors."""
    bound: Array
    """(k, 4) 1 sigma by the Cramer-Rao bound (with the priors, so that of van Trees), at the truth."""


def line_of_sight(simulation: Simulation, reference: str, model: Parameters) -> RigidGraph:
    """The graph of rigid walks on the ranges that are not late, all of which are taken for honest."""
    recording, k = simulation.recording, len(simulation.recording.users)
    samples = range_measurements(recording, model)
    samples = samples[np.flatnonzero(~simulation.late[samples.row]).astype(np.int32)]
    samples = replace(samples, nlos_odds=np.zeros(len(samples)))
    squared = model.changed(ranges={"nlos_share": 0.0, "short_share": 0.0})
    problem = Problem(recording, samples, list(range(k)), recording.index(reference), squared)
    return RigidGraph(problem, np.zeros((k, 3)))


def most_likely(graph: RigidGraph, start: Array) -> Array:
    """(k, 4): the frames of maximum likelihood next to a start (k, 4)."""
    weights = graph.initial_em_weights()
    states = graph.initial_states(start)
    return graph.optimised(states, start, weights, annealing=1.0, iterations=200, gain=1e-9).anchor_poses


def oracle(simulation: Simulation, reference: str, model: Parameters) -> Oracle:
    """Gaussian maximum likelihood from the truth's start on the ranges that are not late."""
    rigid = line_of_sight(simulation, reference, model)
    truth = true_frames(simulation, reference)
    samples, problem = rigid.measurements, rigid.problem
    # The information that the ranges have by themselves: that of ranges without noise, at the truth.
    distance = samples.distance + rigid.residuals(rigid.initial_states(truth))
    ideal = RigidGraph(problem.with_measurements(replace(samples, distance=distance)), np.zeros((len(truth), 3)))
    variances = np.diagonal(ideal.covariances(truth, samples.nlos_odds), axis1=1, axis2=2)
    return Oracle(difference(most_likely(rigid, truth), truth), np.sqrt(variances))


class Beside(NamedTuple):
    """The users of a walk but the reference, beside the best that could be done."""

    ours: Array
    """(k - 1, 4) errors of x, y, z, yaw."""
    best: Array
    """(k - 1, 4) those of the oracle."""
    bound: Array
    """(k - 1, 4) 1 sigma by the bound."""
    registered: list[bool]


def beside_oracle(simulation: Simulation) -> Beside:
    """Register a walk with the rigid model and set it beside the oracle."""
    registration = register(simulation.recording, model="rigid")
    truth = true_frames(simulation, registration.reference)
    best = oracle(simulation, registration.reference, Parameters())
    others = [u for u in registration.users.values() if u.name != registration.reference]
    which = [simulation.recording.index(u.name) for u in others]
    placed = [u.common_from_user for u in others]
    ours = np.array([[f.x, f.y, f.z, f.yaw] if f is not None else [np.nan] * 4 for f in placed])
    registered = [u.state is State.REGISTERED for u in others]
    return Beside(difference(ours, truth[which]), best.error[which], best.bound[which], registered)


def on_all_cores(work: Callable[[Task], Result], tasks: Iterable[Task], at_once: int = 4) -> Iterator[Result]:
    """The results of independent tasks, in their order; `at_once` are handed to a core together."""
    with Pool() as pool:
        yield from pool.imap(work, tasks, chunksize=at_once)
