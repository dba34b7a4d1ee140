from __future__ import annotations

from dataclasses import replace
from functools import cache

import gtsam
import numpy as np
import pytest
from support.dense_step_noise import dense_step_noise
from support.solver_scenes import honest_information, recording_of, track_of

from synchronizar._core import WalkSolver
from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.estimation.segments import keyframes_of_all
from synchronizar.geometry import apply_frames, wrap_angle
from synchronizar.graph import keys
from synchronizar.graph import step_noise as noise_module
from synchronizar.graph.calibration_priors import likelihood_of_calibrations
from synchronizar.graph.em_weights import EmWeights
from synchronizar.graph.gtsam_form import GtsamForm
from synchronizar.graph.marginals import marginals, mean_curvature
from synchronizar.graph.pose_graph import PoseGraph
from synchronizar.graph.problem import Problem
from synchronizar.graph.states import BIAS, SCALE, States, antennas
from synchronizar.graph.step_noise import step_noise
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.relocalizations import repair_relocalizations
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

MODEL = Parameters()


def with_gap(recording: Recording, name: str, begin: float, end: float) -> Recording:
    """A user who is away for a while: without poses, its ranges of that time are of no use."""
    track = recording.tracks[name]
    there = (track.t < begin) | (track.t > end)
    shorter = type(track)(track.t[there], track.position[there], track.quat_xyzw[there])
    return replace(recording, tracks={**recording.tracks, name: shorter})


@cache
def graph_of(kind: str, reference: int = 0) -> PoseGraph:
    scene = Scene(users=3, seconds=14.0, seed=5, rate_hz=6.0)
    if kind == "radios":
        scene = replace(scene, static_radios=2)
    recording = simulate(scene).recording
    if kind == "gap":
        recording = with_gap(recording, "phone1", 5.0, 10.0)
    repaired = {name: repair_relocalizations(track, MODEL) for name, track in recording.tracks.items()}
    recording = replace(recording, tracks={name: of_user.track for name, of_user in repaired.items()})
    problem = Problem.of(recording, reference, MODEL)
    graph = PoseGraph(problem, keyframes_of_all(problem, repaired, 1.0))
    return graph.with_antennas_at(np.linspace(-0.02, 0.02, len(recording.users)))


kinds = pytest.mark.parametrize(("kind", "reference"), [("walks", 0), ("walks", 2), ("radios", 1), ("gap", 0)])


def states_of(graph: PoseGraph, seed: int = 0, far: float = 0.3) -> tuple[States, EmWeights]:
    """States near SLAM's own, and weights that are all different."""
    random, k = np.random.default_rng(seed), len(graph.users)
    frames = np.column_stack([random.normal(0.0, 3.0, (k, 2)), random.normal(0.0, 0.2, k), random.uniform(-3, 3, k)])
    frames[graph.reference] = 0.0
    calibration = random.normal(0.0, 1.0, (k, 3)) * [0.01, 0.05, 0.01]
    states = graph.initial_states(frames, calibration)
    for of_user in states.keyframe_poses:
        of_user[1:] += random.normal(0.0, far, of_user[1:].shape) * [1.0, 1.0, 0.2, 0.1]
    first = graph.initial_em_weights()
    weights = [random.uniform(0.5, 1.0, len(w)) for w in first.step_weight]
    return states, EmWeights(
        first.nlos_odds * random.uniform(0.5, 2.0, len(first.nlos_odds)),
        random.uniform(0.5, 1.0, len(first.nlos_odds)),
        first.range_weight * random.uniform(0.5, 2.0, len(first.nlos_odds)),
        weights,
        random.uniform(0.5, 1.0, (k + 1, 3)),
        random.uniform(0.5, 1.0, k),
        random.uniform(0.5, 1.0, k),
    )


def optimum_of(graph: PoseGraph) -> tuple[States, EmWeights]:
    """Where the true frames lead; drifted scenes' own start is near enough."""
    states, em_weights = states_of(graph, far=0.01)
    em_weights = replace(em_weights, step_weight=[np.ones_like(w) for w in em_weights.step_weight])
    for _ in range(3):
        states = graph.optimised(states, states.anchor_poses, em_weights, 1.0, 40, 1e-9)
    return states, em_weights


@kinds
def test_states_become_places_and_back(kind: str, reference: int) -> None:
    graph = graph_of(kind, reference)
    states, _ = states_of(graph)
    walks = graph.walks
    places = walks.places(states)
    back = walks.states(places, states.calibration[walks.users], states.lasting, states)
    np.testing.assert_allclose(back.anchor_poses, states.anchor_poses, atol=1e-12)
    for here, there in zip(back.keyframe_poses, states.keyframe_poses, strict=True):
        np.testing.assert_allclose(here, there, atol=1e-12)
    last = np.array([places[n - 1] for n in walks.first[1:]])
    of_graph = graph.last_poses(states)[walks.users]
    np.testing.assert_allclose(last[:, :3], of_graph[:, :3], atol=1e-12)
    np.testing.assert_allclose(wrap_angle(last[:, 3] - of_graph[:, 3]), 0.0, atol=1e-12)


@kinds
def test_residuals_are_those_of_the_antennas(kind: str, reference: int) -> None:
    graph = graph_of(kind, reference)
    states, _ = states_of(graph)
    s = graph.measurements
    q_i, q_j = (
        apply_frames(states.anchor_poses[who], antennas(states, who, ends, graph.assumed_clock))
        for who, ends in zip((s.i, s.j), graph.ends, strict=True)
    )
    bias = states.calibration[s.i, BIAS] + states.calibration[s.j, BIAS]
    expected = np.linalg.norm(q_i - q_j, axis=1) + bias - s.distance
    np.testing.assert_allclose(graph.residuals(states), expected, atol=1e-12)


@kinds
@pytest.mark.parametrize("annealing", [1.0, 3.0])
def test_the_cost_is_that_of_gtsams_factors(kind: str, reference: int, annealing: float) -> None:
    """Up to what gtsam's logarithm of a step makes of its turn."""
    graph = graph_of(kind, reference)
    states, em_weights = states_of(graph, far=1e-3)
    walks, form = graph.walks, GtsamForm(graph)
    values = form.values(states)
    # The shared calibration and the mean height are the most likely ones.
    values.update(keys.SHARED_CALIBRATION, graph.shared_calibration(states, em_weights.calibration_weight))
    values.update(keys.MEAN_HEIGHT, graph.mean_height(states.anchor_poses, em_weights.height_weight))
    expected = form.factors(states.anchor_poses, em_weights, annealing).error(values)
    noise = graph.walk_noise(states.anchor_poses, em_weights)
    at = walks.places(states), states.calibration[walks.users], states.lasting
    found = walks.solver.cost(*at, noise, graph.loss, annealing)
    assert found == pytest.approx(expected, rel=1e-6)


@kinds
@pytest.mark.parametrize("annealing", [1.0, 3.0])
def test_the_gradient_is_the_numerical_one(kind: str, reference: int, annealing: float) -> None:
    graph = graph_of(kind, reference)
    states, em_weights = states_of(graph)
    walks = graph.walks
    places, calibration = walks.places(states), states.calibration[walks.users]
    noise, solver = graph.walk_noise(states.anchor_poses + 0.1, em_weights), walks.solver
    by_place, by_calibration, _ = solver.gradient(places, calibration, states.lasting, noise, graph.loss, annealing)
    fixed = int(walks.first[walks.reference])
    assert not by_place[fixed].any()

    def numerical(at: Array, n: int, c: int, h: float) -> float:
        costs = []
        for sign in (-2, -1, 1, 2):
            before = at[n, c]
            at[n, c] += sign * h
            # The reference's first keyframe stands at SLAM's height times the scale.
            lifted = places.copy()
            lifted[fixed, 2] = np.exp(calibration[walks.reference, 0]) * walks.slam[fixed, 2]
            costs.append(solver.cost(lifted, calibration, states.lasting, noise, graph.loss, annealing))
            at[n, c] = before
        return (costs[0] - 8 * costs[1] + 8 * costs[2] - costs[3]) / (12 * h)

    random = np.random.default_rng(1)
    scale = np.abs(by_place).max()
    for n in random.permutation(len(places))[:12].tolist():
        if n != fixed:
            expected = [numerical(places, n, c, 1e-5) for c in range(4)]
            np.testing.assert_allclose(by_place[n], expected, atol=1e-7 * scale)
    expected_calibration = [[numerical(calibration, n, c, 1e-6) for c in range(3)] for n in range(len(calibration))]
    np.testing.assert_allclose(by_calibration, expected_calibration, atol=1e-6 * np.abs(by_calibration).max())


@kinds
def test_the_optimum_is_gtsams(kind: str, reference: int) -> None:
    graph = graph_of(kind, reference)
    states, em_weights = optimum_of(graph)
    form = GtsamForm(graph)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-12)
    factors = form.factors(states.anchor_poses, em_weights)
    values = gtsam.LevenbergMarquardtOptimizer(factors, form.values(states), form.ordering(), parameters).optimize()
    theirs = form.states(values, states)
    np.testing.assert_allclose(theirs.anchor_poses, states.anchor_poses, atol=2e-3)
    np.testing.assert_allclose(theirs.calibration, states.calibration, atol=1e-3)


@kinds
def test_covariances_are_those_of_the_whole_graph_in_gtsam(kind: str, reference: int) -> None:
    """A dense inverse of all variables' information, and derivatives of the last poses by finite differences."""
    graph = graph_of(kind, reference)
    states, _ = optimum_of(graph)
    graph, states, em_weights, _ = graph.run_em(states, graph.initial_em_weights(), 8)
    em_weights = replace(em_weights, range_weight=np.full(len(graph.measurements), 0.5))
    form = GtsamForm(graph)
    values, ordering = form.values(states), form.ordering()
    information = honest_information(graph, states, em_weights)
    size = np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information / np.outer(size, size)) / np.outer(size, size)

    def told(at: gtsam.Values) -> Array:
        """(k, 9): last poses, log scales, the reference's; and the devices."""
        there = form.states(at, states)
        of_reference = np.full((len(graph.users), 1), there.calibration[reference, SCALE])
        return np.column_stack([graph.last_poses(there), there.calibration[:, :1], of_reference, there.calibration])

    columns, h = [], 1e-6
    for key in [ordering.at(n) for n in range(ordering.size())]:
        for axis in np.eye(1 if chr(gtsam.symbolChr(key)) in "HZLO" else 3):
            ends = []
            for side in (h, -h):
                step = gtsam.VectorValues()
                step.insert(key, side * axis)
                ends.append(told(values.retract(step)))
            columns.append((ends[0] - ends[1]) / (2.0 * h))
    J = np.moveaxis(np.array(columns), 0, -1)
    expected = J @ covariance @ J.transpose(0, 2, 1)
    sure = marginals(graph, states, em_weights)
    for u in graph.active_users:
        deviation = np.sqrt(np.maximum(np.diag(expected[u])[:6], 1e-12))
        scale = np.outer(deviation, deviation)
        np.testing.assert_allclose(sure.poses[u] / scale, expected[u, :6, :6] / scale, atol=2e-2)
        np.testing.assert_allclose(sure.calibrations[u], np.diag(expected[u])[6:], rtol=5e-3)


@kinds
def test_what_ranges_say_of_calibrations_is_what_a_dense_matrix_of_gtsams_says(kind: str, reference: int) -> None:
    graph = graph_of(kind, reference)
    states, em_weights = optimum_of(graph)
    found = likelihood_of_calibrations(graph, states, em_weights)
    form = GtsamForm(graph)
    curvature = mean_curvature(graph, graph.height_curvature(states, em_weights))
    factors = form.factors(states.anchor_poses, em_weights, height_curvature=curvature)
    information, _ = factors.linearize(form.values(states)).hessian(form.ordering())
    ordering = [form.ordering().at(n) for n in range(form.ordering().size())]
    rows = dict(zip(ordering, keys.rows(ordering), strict=True))
    wanted = np.concatenate([np.r_[rows[keys.calibration(u)]] for u in graph.active_users])
    covariance = np.linalg.inv(information)[np.ix_(wanted, wanted)]
    # With the priors that the graph has, what is found is as sure, and most likely where the graph has it.
    own, common = graph.calibration_priors[:2]
    k, weight = len(graph.active_users), em_weights.calibration_weight
    prior = np.zeros((k, 3, k, 3))
    for q in range(3):
        prior[:, q, :, q] = np.diag(own[q] ** 2 / weight[graph.active_users, q]) + common[q] ** 2 / weight[-1, q]
    precision = found.information + np.linalg.inv(prior.reshape(3 * k, 3 * k))
    size = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(
        np.linalg.inv(precision) / np.outer(size, size), covariance / np.outer(size, size), atol=2e-2
    )
    mean = np.linalg.solve(precision, found.vector)
    assert (np.abs(mean - states.calibration[graph.active_users].ravel()) < 0.02 * size).all()


@kinds
def test_step_noise_and_its_evidence_are_those_of_a_dense_matrix(kind: str, reference: int) -> None:
    graph = graph_of(kind, reference)
    states, em_weights = optimum_of(graph)
    tried, rounds = [0.35, 1.0, 2.8], 4
    expected = dense_step_noise(graph, states, em_weights, tried, rounds)
    walks, weights, counted = graph.walks, list(em_weights.step_weight), []
    for u in walks.users:
        ordinary = noise_module._ordinary(graph, states, u)
        weights[u] = np.where(ordinary, 1.0, weights[u])
        counted += [False, *ordinary.tolist()]
    factors, evidence, determined = walks.solver.step_noise(
        walks.places(states),
        states.calibration[walks.users],
        states.lasting,
        graph.walk_noise(states.anchor_poses, replace(em_weights, step_weight=weights)),
        graph.loss,
        np.ones(len(counted), dtype=bool),
        np.array(counted),
        np.array(tried),
        1.0,
        graph.parameters.slam.drift_weight,
        rounds,
    )
    np.testing.assert_allclose(factors, [of.factors[walks.users] for of in expected], rtol=2e-3)
    # Of the evidence only differences have a meaning.
    np.testing.assert_allclose(
        evidence - evidence[0], [of.evidence - expected[0].evidence for of in expected], rtol=2e-3, atol=0.05
    )
    np.testing.assert_allclose(determined, [of.determined for of in expected], rtol=5e-3)


@kinds
def test_the_determinant_is_that_of_gtsams_matrix(kind: str, reference: int) -> None:
    """Up to what the change from frames to places adds, which is the same for any drift."""
    graph = graph_of(kind, reference)
    states, em_weights = optimum_of(graph)
    narrow = graph.with_keyframes([replace(k, step_sigma=0.2 * k.step_sigma) for k in graph.keyframes])
    found, expected = [], []
    for one in (graph, narrow):
        walks, form = one.walks, GtsamForm(one)
        curvature = mean_curvature(one, one.height_curvature(states, em_weights))
        noise = one.walk_noise(states.anchor_poses, em_weights)
        at = walks.places(states), states.calibration[walks.users], states.lasting
        found.append(walks.solver.log_determinant(*at, noise, one.loss, curvature))
        factors = form.factors(states.anchor_poses, em_weights, height_curvature=curvature)
        information, _ = factors.linearize(form.values(states)).hessian(form.ordering())
        expected.append(np.linalg.slogdet(information)[1])
    assert found[1] - found[0] == pytest.approx(expected[1] - expected[0], rel=1e-3)


def test_where_the_graph_cannot_be_solved_steps_have_their_usual_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    graph = graph_of("walks")
    states, em_weights = optimum_of(graph)
    unknown = np.full(9, np.nan)
    none = ([np.ones((len(graph.users), 2))] * 9, np.full(9, -np.inf), unknown)
    monkeypatch.setattr(noise_module, "_about", lambda *_: none)
    found = step_noise(graph, states, em_weights)
    np.testing.assert_array_equal(found.used, 1.0)
    np.testing.assert_array_equal(found.told, 1.0)


def test_of_a_long_walk_the_middle_tells_the_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    graph = graph_of("walks")
    states, em_weights = optimum_of(graph)
    whole = step_noise(graph, states, em_weights).used
    monkeypatch.setattr(noise_module, "_MOST_KEYFRAMES", 30)
    middle = step_noise(graph, states, em_weights).used
    assert not np.allclose(middle, whole, atol=1e-6)
    np.testing.assert_allclose(middle, whole, rtol=0.5)


def test_everybody_may_be_of_one_keyframe() -> None:
    """Three radios and nothing that moves but the reference: what is sought is all in the border."""
    t = np.arange(0.0, 3.0, 0.1)
    track = track_of(t, np.column_stack([np.cos(t), np.sin(t), 0.0 * t]))
    rows = [(float(time), "a", name, 2.0 + 0.1 * n) for n, name in enumerate("bcd") for time in t]
    recording = recording_of({"a": track, "b": None, "c": None, "d": None}, rows)
    repaired = {"a": repair_relocalizations(track, MODEL)}
    problem = Problem.of(recording, 0, MODEL)
    graph = PoseGraph(problem, keyframes_of_all(problem, repaired, 100.0))
    assert [len(k) for k in graph.keyframes] == [2, 1, 1, 1]
    states = graph.initial_states(np.array([[0.0] * 4, [2.0, 0, 0, 0], [0, 2.0, 0, 0], [0, -2.0, 0, 0]]))
    begun = graph.e_step(states, graph.initial_em_weights())[1]
    assert graph.run_em(states, graph.initial_em_weights(), 5).cost < begun


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"reference": 3}, "reference"),
        ({"first": np.array([0, 2, 2, 4], dtype=np.int32)}, "no keyframe"),
        ({"keyframe_i": np.array([9], dtype=np.int32)}, "not there"),
        ({"sigma": np.zeros(1)}, "sigma"),
        ({"t": np.full(4, np.nan)}, "finite"),
    ],
)
def test_bad_walks_are_refused(change: dict[str, object], fault: str) -> None:
    ends = (np.zeros((1, 3)),) * 3
    arguments: dict[str, object] = {
        "reference": 0,
        "first": np.array([0, 2, 4], dtype=np.int32),
        "t": np.arange(4.0),
        "slam": np.zeros((4, 3)),
        "keyframe_i": np.array([0], dtype=np.int32),
        "keyframe_j": np.array([3], dtype=np.int32),
        "i": ends,
        "j": ends,
        "measured": np.ones(1),
        "sigma": np.ones(1),
    }
    with pytest.raises(ValueError, match=fault):
        WalkSolver(**{**arguments, **change})  # type: ignore[arg-type]
