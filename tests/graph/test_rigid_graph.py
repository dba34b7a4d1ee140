from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.nlos_chain import chain_of_pair
from support.reference_kernel import loss_value
from support.solver_scenes import difference, distances, frames_of, recording_of, rigid_graph, track_of, true_frames
from support.solver_scenes import register_rigid as register

from synchronizar._core import NlosMixture
from synchronizar.arrays import Array
from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.user import User
from synchronizar.graph import keys
from synchronizar.graph.gtsam_form import GtsamForm
from synchronizar.graph.priors import height_sigma_of
from synchronizar.graph.problem import Problem
from synchronizar.graph.rigid_graph import RigidGraph
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import RangeMeasurements, pairs, range_measurements
from synchronizar.simulation.simulate import Scene, Simulation, simulate

MODEL = Parameters()
SQUARED = MODEL.changed(ranges={"nlos_share": 0.0, "short_share": 0.0})  # nothing is ever late: the losses are squares


def test_squared_is_what_the_loss_becomes_where_nothing_is_late() -> None:
    recording = simulate(Scene(seed=1)).recording
    measurements, graph = rigid_graph(recording, model=SQUARED)
    frames = np.array([[0.0, 0.0, 0.0, 0.0], [1.0, 2.0, 0.0, 0.5]])
    e = (distances(measurements, frames) - measurements.distance) / measurements.sigma
    assert graph.cost(frames) == pytest.approx(0.5 * float(e @ e))


def height_prior(frames: Array, sigma: Array) -> float:
    """Half the squared distances to the likeliest level, each over its variance: sigma^2 / 2."""
    weight = 2.0 / sigma**2
    level = weight @ frames[:, 2] / weight.sum()
    return float(0.5 * weight @ (frames[:, 2] - level) ** 2)


def noisy(frames: Array, seed: int) -> Array:
    """Everybody but the first a little displaced."""
    out = frames + np.random.default_rng(seed).normal(0.0, [0.1, 0.1, 0.2, 0.05], frames.shape)
    out[0] = 0.0
    return np.asarray(out)


@pytest.mark.parametrize("seed", range(3))
def test_the_cost_is_the_sum_of_the_losses_and_of_the_heights_about_their_level(seed: int) -> None:
    simulation = simulate(Scene(users=3, static_radios=1, seconds=6.0, late_share=0.3, power=True, seed=seed))
    measurements, graph = rigid_graph(simulation.recording)
    frames = noisy(true_frames(simulation, "phone0"), seed)
    late = NlosMixture(MODEL.ranges.detour_scale, MODEL.ranges.short_share / (1.0 - MODEL.ranges.short_share))
    e = (distances(measurements, frames) - measurements.distance) / measurements.sigma
    losses = [loss_value(late, *x)[0] for x in zip(e, measurements.sigma, measurements.nlos_odds, strict=True)]
    expected = sum(losses) + height_prior(frames, np.array([0.15, 0.15, 0.15, 3.0]))
    assert graph.cost(frames) == pytest.approx(expected, rel=1e-9)
    # What the optimiser lowers is the same.
    values = GtsamForm(graph).values(graph.initial_states(frames))
    factors = GtsamForm(graph).factors(frames, graph.initial_em_weights())
    assert factors.error(values) == pytest.approx(expected, rel=1e-9)


def covariances(graph: RigidGraph, frames: Array) -> Array:
    """(k, 4, 4) of x, y, z, yaw beside the reference."""
    return graph.covariances(frames, graph.measurements.nlos_odds)


def numerical_covariance(graph: RigidGraph, frames: Array) -> Array:
    """(3 k', 4, 4): the inverse of the cost's Hessian over x, y, z, yaw of all users that are free, block by block."""
    h = 1e-4
    free = np.array(graph.free)
    n = 4 * len(free)

    def cost(step: Array) -> float:
        moved = frames.copy()
        moved[free] += step.reshape(-1, 4)
        return graph.cost(moved)

    hessian = np.zeros((n, n))
    steps = h * np.eye(n)
    for a in range(n):
        for b in range(a, n):
            corners = [cost(s * steps[a] + r * steps[b]) * s * r for s in (1, -1) for r in (1, -1)]
            hessian[a, b] = hessian[b, a] = sum(corners) / (4.0 * h * h)
    covariance = np.linalg.inv(hessian)
    return np.array([covariance[4 * k : 4 * k + 4, 4 * k : 4 * k + 4] for k in range(len(free))])


@pytest.mark.parametrize("reference", [0, 1])
@pytest.mark.parametrize("seed", [2, 3])
def test_covariances_are_those_of_x_y_z_in_the_common_axes_and_yaw(seed: int, reference: int) -> None:
    simulation = simulate(Scene(users=3, seconds=5.0, sigma=0.0, height_bob=0.2, seed=seed))
    _, graph = rigid_graph(simulation.recording, reference, SQUARED)
    frames = true_frames(simulation, f"phone{reference}")
    found = covariances(graph, frames)
    expected = numerical_covariance(graph, frames)
    for u, covariance in zip(graph.free, expected, strict=True):
        sigma = np.sqrt(np.diag(covariance))
        np.testing.assert_allclose(found[u] / np.outer(sigma, sigma), covariance / np.outer(sigma, sigma), atol=5e-3)


def most_likely(graph: RigidGraph, frames: Array) -> Array:
    states = graph.initial_states(frames)
    return graph.optimised(states, frames, graph.initial_em_weights(), 1.0, 20, 1e-6).anchor_poses


def redrawn(measurements: RangeMeasurements, frames: Array, noise: Array) -> RangeMeasurements:
    return replace(measurements, distance=distances(measurements, frames) + noise)


def test_estimates_from_400_redraws_of_the_noise_scatter_as_the_covariance_says() -> None:
    simulation = simulate(Scene(users=3, seconds=6.0, height_bob=0.15, seed=5))
    measurements, graph = rigid_graph(simulation.recording, model=SQUARED)
    frames = true_frames(simulation, "phone0")
    frames[:, 2] = 0.0  # where the prior has them, so that it pulls to no side
    true = distances(measurements, frames)
    random = np.random.default_rng(0)
    errors = []
    for _ in range(400):
        drawn = replace(measurements, distance=true + random.normal(0.0, 0.1, len(measurements)))
        of_draw = RigidGraph(graph.problem.with_measurements(drawn), np.zeros((3, 3)))
        errors.append(difference(most_likely(of_draw, frames), frames))
    clean = RigidGraph(graph.problem.with_measurements(replace(measurements, distance=true)), np.zeros((3, 3)))
    expected = covariances(clean, frames)
    plane = [0, 1, 3]
    for u in (1, 2):
        found = np.cov(np.array(errors)[:, u, plane].T)
        whiten = np.linalg.inv(np.linalg.cholesky(expected[u][np.ix_(plane, plane)]))
        ratios = np.linalg.eigvalsh(whiten @ found @ whiten.T)
        # Marchenko and Pastur: (1 +- sqrt(3 / 400))^2 is 0.83 to 1.18.
        assert ratios.min() > 0.78
        assert ratios.max() < 1.24


def lonely(*users: User, active_users: list[int] | None = None, reference: int = 0) -> RigidGraph:
    """Users that know of each other only what is known of anybody."""
    recording = Recording(users, {}, Ranges.of(np.zeros(0), np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0)))
    active_users = active_users or list(range(len(users)))
    problem = Problem(recording, range_measurements(recording, MODEL), active_users, reference, MODEL)
    return RigidGraph(problem, np.zeros((len(users), 3)))


def test_before_any_range_two_equal_devices_lie_one_height_sigma_apart() -> None:
    graph = lonely(User("a", static=True, height_sigma=0.15), User("b", static=True, height_sigma=0.15))
    covariance = covariances(graph, np.zeros((2, 4)))[1]
    np.testing.assert_allclose(np.diag(covariance), graph.prior_variances(1))
    assert covariance[2, 2] == pytest.approx(0.15**2)
    assert covariance[3, 3] == pytest.approx(MODEL.priors.yaw_sigma**2)
    assert covariance[0, 0] == pytest.approx(MODEL.priors.place_sigma**2)


def test_before_any_range_all_users_have_their_prior_variances_and_share_one_prior_of_headings() -> None:
    graph = lonely(*(User(name, True, sigma) for name, sigma in zip("abcd", (0.15, 0.5, None, 0.01), strict=True)))
    found = covariances(graph, np.zeros((4, 4)))
    for u, sigma in ((1, 0.5), (2, MODEL.priors.static_height_sigma), (3, 0.01)):
        variances = np.diag(found[u])
        np.testing.assert_allclose(variances[:3], graph.prior_variances(u)[:3])
        assert variances[3] == pytest.approx(3.0 * MODEL.priors.yaw_sigma**2)
        assert found[u][2, 2] == pytest.approx(0.5 * (0.15**2 + sigma**2))
    assert height_sigma_of(User("d", True, 0.01), MODEL) == 0.01
    assert height_sigma_of(User("d"), MODEL) == MODEL.priors.height_sigma


def test_the_reference_is_exact_and_who_is_not_placed_has_no_covariance() -> None:
    graph = lonely(*(User(name, static=True) for name in "abc"), active_users=[0, 2], reference=2)
    found = covariances(graph, np.zeros((3, 4)))
    np.testing.assert_array_equal(found[2], 0.0)
    assert np.isnan(found[1]).all()
    assert np.isfinite(found[0]).all()


@pytest.mark.parametrize("seed", range(4))
def test_who_is_the_reference_changes_no_frame_relative_to_another(seed: int) -> None:
    recording = simulate(Scene(users=3, static_radios=1, seconds=12.0, height_bob=0.2, seed=seed)).recording
    answers = [register(recording, reference=name) for name in ("phone0", "phone1", "phone2")]
    for a in ("phone0", "phone1", "phone2"):
        for b in ("phone0", "phone1", "phone2", "radio0"):
            frames = [answer.between(a, b) for answer in answers]
            for f in frames[1:]:
                np.testing.assert_allclose(f.translation, frames[0].translation, atol=1e-3)
                turned = np.remainder(f.yaw - frames[0].yaw + np.pi, 2.0 * np.pi) - np.pi
                assert abs(turned) < 1e-3 or b == "radio0"


def late_walk(seed: int) -> Simulation:
    return simulate(Scene(users=3, seconds=12.0, late_share=0.3, late_burst_s=2.0, seed=seed))


def test_bursts_cost_what_each_pair_s_chain_and_the_heights_cost() -> None:
    simulation = late_walk(1)
    measurements, graph = rigid_graph(simulation.recording)
    frames = noisy(true_frames(simulation, "phone0"), 1)
    e = (distances(measurements, frames) - measurements.distance) / measurements.sigma
    chains = 0.0
    for pair in pairs(measurements):
        s = pair.measurements
        columns = measurements.t[s], measurements.distance[s], e[s], measurements.sigma[s], measurements.nlos_odds[s]
        chains += chain_of_pair(columns, 1.0, MODEL)[2]
    _, cost = graph.e_step(graph.initial_states(frames), graph.initial_em_weights())
    assert cost == pytest.approx(chains + height_prior(frames, np.full(3, MODEL.priors.height_sigma)), rel=1e-9)


def test_ranges_within_a_burst_become_suspicious_and_the_others_trusted() -> None:
    simulation = late_walk(2)
    measurements, graph = rigid_graph(simulation.recording)
    states = graph.initial_states(true_frames(simulation, "phone0"))
    prior = graph.initial_em_weights()
    judged, _ = graph.e_step(states, prior)
    (_, before), (_, after) = (graph.inlier_probability(states, weights) for weights in (prior, judged))
    late = simulation.late[measurements.row]
    assert after[late].mean() < before[late].mean()
    assert after[~late].mean() > before[~late].mean()


def test_judging_bursts_twice_at_the_same_place_changes_nothing() -> None:
    simulation = late_walk(3)
    _, graph = rigid_graph(simulation.recording)
    states = graph.initial_states(true_frames(simulation, "phone0"))
    once, cost = graph.e_step(states, graph.initial_em_weights())
    twice, again = graph.e_step(states, once)
    assert again == cost
    np.testing.assert_array_equal(once.nlos_odds, twice.nlos_odds)


def test_residuals_are_predicted_minus_measured_in_the_order_of_the_measurements() -> None:
    simulation = late_walk(4)
    measurements, graph = rigid_graph(simulation.recording)
    frames = noisy(true_frames(simulation, "phone0"), 4)
    residuals = graph.residuals(graph.initial_states(frames))
    np.testing.assert_allclose(residuals, distances(measurements, frames) - measurements.distance, atol=1e-9)


def test_frames_about_anchors_leave_the_residuals_as_they_are_about_the_origins() -> None:
    simulation = late_walk(5)
    _, graph = rigid_graph(simulation.recording)
    frames, anchors = true_frames(simulation, "phone0"), np.array([[3.0, -1.0, 0.0], [7.0, 2.0, 0.0], [-4.0, 5.0, 0.0]])
    about = RigidGraph(graph.problem, anchors)
    c, s = np.cos(frames[:, 3]), np.sin(frames[:, 3])
    moved = frames.copy()  # each anchor in the common frame, whose origin is then the reference's anchor
    moved[:, 0] += c * anchors[:, 0] - s * anchors[:, 1] - anchors[0, 0]
    moved[:, 1] += s * anchors[:, 0] + c * anchors[:, 1] - anchors[0, 1]
    expected = graph.residuals(graph.initial_states(frames))
    np.testing.assert_allclose(about.residuals(about.initial_states(moved)), expected, atol=1e-9)
    np.testing.assert_array_equal(about.last_poses(about.initial_states(moved)), moved)


def test_states_and_values_are_each_other_s_inverse() -> None:
    graph = lonely(*(User(name, static=True) for name in "abc"))
    frames = np.array([[0.0, 0.0, 0.0, 0.0], [1.0, -2.0, 0.3, 3.0], [5.0, 0.5, -0.1, -3.0]])
    states = graph.initial_states(frames)
    form = GtsamForm(graph)
    values = form.values(states)
    elsewhere = graph.initial_states(np.zeros((3, 4)))
    np.testing.assert_allclose(form.states(values, elsewhere).anchor_poses, frames)
    assert values.atDouble(keys.height(1)) == 0.3
    assert values.size() == 5  # frames, heights, and the height that all lie about: nothing of a device


def test_who_has_come_to_a_known_optimum_is_followed_no_further() -> None:
    simulation = late_walk(6)
    _, graph = rigid_graph(simulation.recording)
    start = graph.initial_states(noisy(true_frames(simulation, "phone0"), 6))
    begun = graph.run_em(start, graph.initial_em_weights(), 0)
    once = graph.run_em(start, graph.initial_em_weights(), 1)
    found = graph.run_em(start, graph.initial_em_weights(), 10, known=[once.frames])
    np.testing.assert_array_equal(found.states.anchor_poses, once.states.anchor_poses)
    assert found.cost == begun.cost  # that of the known optimum is not looked at again
    found = graph.run_em(start, graph.initial_em_weights(), 10, hopeless=once.cost - 1.0)
    np.testing.assert_array_equal(found.states.anchor_poses, once.states.anchor_poses)
    assert found.cost == once.cost


def test_an_image_that_leads_to_a_known_optimum_is_none() -> None:
    _, graph = rigid_graph(late_walk(6).recording)
    start = graph.initial_states(noisy(true_frames(late_walk(6), "phone0"), 6))
    found = graph.run_em(start, graph.initial_em_weights(), 10)
    assert graph.image(start, found.em_weights, [found.frames]) is None
    there = graph.image(start, found.em_weights, [])
    assert there is not None
    odds = found.em_weights.nlos_odds
    assert graph.cost(there.anchor_poses, odds) == pytest.approx(graph.cost(found.frames, odds), abs=0.02)


def test_a_cost_is_summed_no_further_than_is_asked() -> None:
    simulation = late_walk(6)
    _, graph = rigid_graph(simulation.recording)
    frames = noisy(true_frames(simulation, "phone0"), 6)
    whole = graph.cost(frames)
    assert graph.cost(frames, most=whole + 1.0) == whole
    assert 0.1 * whole < graph.cost(frames, most=0.1 * whole) <= whole


def test_the_odds_are_those_of_each_pair_s_chain() -> None:
    simulation = late_walk(6)
    measurements, graph = rigid_graph(simulation.recording)
    frames = noisy(true_frames(simulation, "phone0"), 6)
    weights, cost = graph.e_step(graph.initial_states(frames), graph.initial_em_weights())
    e = (distances(measurements, frames) - measurements.distance) / measurements.sigma
    expected = height_prior(frames, np.sqrt(2.0) * graph.height_sigma)
    for pair in pairs(measurements):
        s = measurements[pair.measurements]
        odds, _, chain = chain_of_pair((s.t, s.distance, e[pair.measurements], s.sigma, s.nlos_odds), 1.0, MODEL)
        np.testing.assert_allclose(weights.nlos_odds[pair.measurements], odds, rtol=1e-5)
        expected += chain
    assert cost == pytest.approx(expected)


def test_the_reference_alone_makes_an_empty_graph() -> None:
    recording = recording_of({"a": track_of(np.arange(3.0), np.zeros((3, 3)))}, [])
    answer = register(recording)
    np.testing.assert_array_equal(frames_of(answer), np.zeros((1, 4)))
