"""Errors of ranges that last, as variables of the walk solver."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.common.walks import true_frames
from synchronizar.arrays import Array
from synchronizar.estimation.segments import keyframes_of_all
from synchronizar.graph.em_weights import EmWeights
from synchronizar.graph.pose_graph import PoseGraph
from synchronizar.graph.problem import Problem
from synchronizar.graph.states import States
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.relocalizations import repair_relocalizations
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

SIGMAS = 0.05, 0.2


def graphs() -> tuple[PoseGraph, PoseGraph, States, EmWeights]:
    """A graph, the same with lasting errors, states at which none of its variables is 0, and its weights."""
    scene = Scene(users=3, seconds=9.0, seed=5, rate_hz=4.0, static_radios=1)
    simulation = simulate(scene)
    recording, model = simulation.recording, Parameters().changed(ranges={"nlos_share": 1e-9, "short_share": 1e-12})
    repaired = {name: repair_relocalizations(track, model) for name, track in recording.tracks.items()}
    problem = Problem.of(recording, 0, model)
    plain = PoseGraph(problem, keyframes_of_all(problem, repaired, 1.0))
    graph, random, k = plain.with_lasting_errors(1.0, 0.5), np.random.default_rng(3), len(recording.users)
    states = graph.initial_states(true_frames(simulation, recording.users[0].name), random.normal(0.0, 0.01, (k, 3)))
    for of_user in states.keyframe_poses:
        of_user[1:] += random.normal(0.0, 0.05, of_user[1:].shape)
    states = states._replace(lasting=random.normal(0.0, 0.1, len(graph.lasting_sigma)))
    return plain, graph, states, graph.initial_em_weights()


def cost(graph: PoseGraph, states: States, em_weights: EmWeights, sigma: float) -> float:
    at = graph.walks.places(states), states.calibration, graph.lasting_of(states)
    return graph.walks.solver.cost(
        *at, with_sigma(graph, sigma).walk_noise(states.anchor_poses, em_weights), graph.loss
    )


def with_sigma(graph: PoseGraph, sigma: float) -> PoseGraph:
    out = graph.with_held_as_usual(graph.held_as_usual)
    out.lasting_sigma = np.full_like(graph.lasting_sigma, sigma)
    return out


def test_a_lasting_error_makes_a_range_longer() -> None:
    plain, graph, states, _ = graphs()
    assert graph.lasting is not None
    longer = graph.residuals(states) - plain.residuals(states)
    np.testing.assert_allclose(longer, states.lasting[graph.lasting.of_range], atol=1e-12)


def test_lasting_errors_cost_what_a_dense_covariance_makes_of_them() -> None:
    """A first-order autoregression has the covariance sigma^2 times the product of the correlations in between."""
    _, graph, states, em_weights = graphs()
    assert graph.lasting is not None
    v, sigma = len(graph.lasting), 0.2
    covariance = np.eye(v)
    for row in range(v):
        at, product = row, 1.0
        while graph.lasting.follows[at] >= 0:
            product *= graph.lasting.decay[at]
            at = int(graph.lasting.follows[at])
            covariance[row, at] = covariance[at, row] = product
    expected = 0.5 * states.lasting @ np.linalg.solve(sigma**2 * covariance, states.lasting)
    wide = cost(graph, states, em_weights, 1e9)
    assert cost(graph, states, em_weights, sigma) - wide == pytest.approx(expected, rel=1e-9)
    one = with_sigma(graph, sigma)
    assert one.e_step(states, em_weights)[1] - with_sigma(graph, 1e9).e_step(states, em_weights)[1] == pytest.approx(
        expected, rel=1e-9
    )
    assert 2.0 * np.log(one.lasting_steps).sum() == pytest.approx(np.linalg.slogdet(sigma**2 * covariance)[1], rel=1e-9)


def gradient(
    graph: PoseGraph, at: tuple[Array, Array, Array], em_weights: EmWeights, about: Array
) -> tuple[Array, Array, Array]:
    return graph.walks.solver.gradient(*at, graph.walk_noise(about, em_weights), graph.loss)


def test_the_gradient_by_lasting_errors_is_the_numerical_one() -> None:
    _, graph, states, em_weights = graphs()
    graph = with_sigma(graph, 0.1)
    at = graph.walks.places(states), states.calibration, states.lasting
    found = gradient(graph, at, em_weights, states.anchor_poses)[2]
    h, expected = 1e-6, []
    for n in range(len(states.lasting)):
        step = h * (np.arange(len(states.lasting)) == n)
        ends = [cost(graph, states._replace(lasting=states.lasting + side * step), em_weights, 0.1) for side in (1, -1)]
        expected.append((ends[0] - ends[1]) / (2.0 * h))
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-3)


def test_the_optimum_has_no_gradient() -> None:
    _, graph, states, em_weights = graphs()
    start = gradient(
        graph, (graph.walks.places(states), states.calibration, states.lasting), em_weights, states.anchor_poses
    )
    there = graph.optimised(states, states.anchor_poses, em_weights, 1.0, 200, 1e-10)
    at = graph.walks.places(there), there.calibration, there.lasting
    end = gradient(graph, at, em_weights, states.anchor_poses)
    assert np.abs(there.lasting).max() > 0.01
    for before, after in zip(start, end, strict=True):
        assert np.abs(after).max() < 1e-3 * np.abs(before).max()


def test_the_determinant_grows_with_what_lasting_errors_may_be_as_that_of_a_dense_matrix_does() -> None:
    """The dense one is of the numerical derivatives of the gradient by all that is free."""
    _, graph, states, em_weights = graphs()
    there = graph.optimised(states, states.anchor_poses, em_weights, 1.0, 200, 1e-10)
    solver, places = graph.walks.solver, graph.walks.places(there)
    free = np.ones((len(places), 4), dtype=bool)
    free[graph.walks.first[graph.walks.reference]] = False
    found, expected = [], []
    for sigma in SIGMAS:
        one = with_sigma(graph, sigma)
        noise = one.walk_noise(states.anchor_poses, em_weights)
        at = places, there.calibration, there.lasting
        found.append(solver.log_determinant(*at, noise, graph.loss, graph.height_curvature(there, em_weights)))
        rows = []
        for table, which in (
            (0, free),
            (1, np.ones_like(there.calibration, bool)),
            (2, np.ones(len(there.lasting), bool)),
        ):
            for index in np.argwhere(which):
                ends = []
                for side in (1e-6, -1e-6):
                    moved = [part.copy() for part in at]
                    moved[table][tuple(index)] += side
                    first = int(graph.walks.first[graph.walks.reference])
                    moved[0][first, 2] = np.exp(moved[1][graph.walks.reference, 0]) * graph.walks.slam[first, 2]
                    of_places, *others = solver.gradient(*moved, noise, graph.loss)
                    ends.append(np.concatenate([of_places[free], *(part.ravel() for part in others)]))
                rows.append((ends[0] - ends[1]) / 2e-6)
        expected.append(np.linalg.slogdet(np.array(rows))[1])
    assert found[1] - found[0] == pytest.approx(expected[1] - expected[0], rel=2e-2)
    assert abs(found[1] - found[0]) > 10.0
