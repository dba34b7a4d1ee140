from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from support.nlos_chain import chain_of_pair
from support.solver_scenes import pair_bending

from synchronizar._core import mixture_terms
from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.geometry import YawFrame, apply_frames, wrap_angle
from synchronizar.graph.em_weights import EmWeights
from synchronizar.graph.gtsam_form import GtsamForm
from synchronizar.graph.marginals import marginals
from synchronizar.graph.pose_graph import LocalOptimum, PoseGraph
from synchronizar.graph.priors import calibration_dof, calibration_sigmas, nlos_mixture
from synchronizar.graph.problem import Problem
from synchronizar.graph.states import BIAS, CLOCK, SCALE, States, common_track
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.keyframes import STATIC_KEYFRAME, keyframes_of
from synchronizar.preprocessing.range_measurements import pairs, range_measurements
from synchronizar.preprocessing.relocalizations import repair_relocalizations
from synchronizar.simulation.simulate import Scene, Simulation, simulate

CLEAN = Scene(users=3, seconds=12.0, rate_hz=8.0, sigma=0.0, antennas=1)
NOISY = replace(
    CLEAN,
    sigma=0.1,
    late_share=0.1,
    bias_sigma=0.05,
    clock_offset_sigma=0.05,
    scale_sigma=0.05,
    drift_m_per_sqrt_s=0.01,
    drift_rad_per_sqrt_s=0.005,
)
MODEL = Parameters()


def graph_of(
    recording: Recording, model: Parameters = MODEL, active_users: tuple[int, ...] | None = None, interval: float = 1.0
) -> PoseGraph:
    measurements = range_measurements(recording, model)
    everybody = list(range(len(recording.users)) if active_users is None else active_users)
    measurements = measurements[np.isin(measurements.i, everybody) & np.isin(measurements.j, everybody)]
    keyframes = [
        STATIC_KEYFRAME
        if u.static
        else keyframes_of(repair_relocalizations(recording.tracks[u.name], model), interval, model)
        for u in recording.users
    ]
    return PoseGraph(Problem(recording, measurements, everybody, 0, model), keyframes)


def true_frames(simulation: Simulation, graph: PoseGraph) -> Array:
    """(k, 4): where the anchors lie, the common frame being the reference's anchor; for SLAM that does not drift."""
    world_from_user = [simulation.world_from_user[u.name] for u in simulation.recording.users]
    anchors = np.array([f @ k.anchor for f, k in zip(world_from_user, graph.keyframes, strict=True)])
    yaw = np.array([f.yaw for f in world_from_user])
    common = YawFrame(yaw=-yaw[0]) @ (anchors - anchors[0])
    return np.column_stack([common, wrap_angle(yaw - yaw[0])])


def elsewhere(states: States, seed: int, turn: float = 0.02) -> States:
    """Other walks not far away, the gauge kept."""
    random = np.random.default_rng(seed)
    frames = states.anchor_poses + random.normal(0.0, 0.1, states.anchor_poses.shape)
    frames[0] = states.anchor_poses[0]
    keyframe_poses = [
        of_user + random.normal(0.0, [0.03, 0.03, 0.03, turn], of_user.shape) for of_user in states.keyframe_poses
    ]
    for moved, of_user in zip(keyframe_poses, states.keyframe_poses, strict=True):
        moved[0] = of_user[0]
    return States(frames, keyframe_poses, states.calibration + random.normal(0.0, 0.01, states.calibration.shape))


def assert_same(found: States, expected: States, within: float = 1e-12) -> None:
    np.testing.assert_allclose(found.anchor_poses[:, :3], expected.anchor_poses[:, :3], atol=within)
    np.testing.assert_allclose(wrap_angle(found.anchor_poses[:, 3] - expected.anchor_poses[:, 3]), 0.0, atol=within)
    np.testing.assert_allclose(found.calibration, expected.calibration, atol=within)
    for a, b in zip(found.keyframe_poses, expected.keyframe_poses, strict=True):
        np.testing.assert_allclose(a[:, :3], b[:, :3], atol=within)
        np.testing.assert_allclose(wrap_angle(a[:, 3] - b[:, 3]), 0.0, atol=within)


def keys_of(holder: gtsam.Values | gtsam.NonlinearFactor) -> list[int]:
    return list(holder.keys())


# ---- what is predicted ----


def test_at_the_truth_ranges_are_what_they_are() -> None:
    """Scales, biases and clocks included: residuals are what interpolating between poses leaves."""
    scene = replace(CLEAN, bias_sigma=0.1, clock_offset_sigma=0.05, scale_sigma=0.1)
    simulation = simulate(scene)
    graph = graph_of(simulation.recording)
    names = [u.name for u in simulation.recording.users]
    scale = np.log([simulation.world_from_user[name].scale for name in names])
    device = np.array(
        [[s, simulation.range_bias[n], simulation.clock_offset[n]] for s, n in zip(scale, names, strict=True)]
    )
    states = graph.initial_states(true_frames(simulation, graph), device)
    # Read at a clock of 0 and moved on at the velocity there: good to an acceleration's worth, 3 m/s^2 (0.15 s)^2 / 2.
    assert np.abs(graph.residuals(states)).max() < 0.06
    assert np.abs(graph.residuals(states)).mean() < 0.01
    without = graph.residuals(states._replace(calibration=np.zeros((3, 3))))
    assert np.abs(without).mean() > 0.05


def test_flattened_samples_have_the_same_residuals() -> None:
    graph = graph_of(simulate(NOISY).recording)
    states = elsewhere(graph.initial_states(np.random.default_rng(1).normal(0.0, 2.0, (3, 4))), 2)
    flat = graph.to_rigid_ranges(states)
    q_i, q_j = apply_frames(states.anchor_poses[flat.i], flat.p_i), apply_frames(states.anchor_poses[flat.j], flat.p_j)
    found = np.linalg.norm(q_i - q_j, axis=1) - flat.distance
    np.testing.assert_allclose(found, graph.residuals(states), atol=1e-12)
    np.testing.assert_allclose(flat.sigma, np.hypot(graph.measurements.sigma, MODEL.ranges.multipath_sigma))


# ---- the cost ----


def prior_cost(graph: PoseGraph, states: States) -> float:
    """Of devices of a kind and of origins about a level that nobody knows: Gaussians with what is shared taken out."""
    m, count = graph.parameters, len(graph.active_users)
    cost = 0.0
    sigmas = (
        (m.devices.scale_sigma, m.devices.scale_common_sigma),
        (m.devices.bias_sigma, m.devices.bias_common_sigma),
        (m.devices.clock_sigma, m.devices.clock_common_sigma),
    )
    for column, (own, common) in zip(states.calibration[graph.active_users].T, sigmas, strict=True):
        covariance = own**2 * np.eye(count) + common**2
        cost += 0.5 * column @ np.linalg.solve(covariance, column)
    return float(cost) + height_cost(graph, states)


def height_cost(graph: PoseGraph, states: States) -> float:
    heights, sigma = states.anchor_poses[graph.free, 2], graph.parameters.priors.height_sigma
    # Two origins lie one height_sigma apart.
    from_level = np.full(len(heights), sigma / np.sqrt(2.0))
    covariance = np.diag(from_level**2) + sigma**2 / 2.0
    return float(0.5 * heights @ np.linalg.solve(covariance, heights))


def straying(graph: PoseGraph, states: States, user: int) -> float:
    """Squared sigmas by which a device strays from the height at which it is most likely carried."""
    information = graph.keyframes[user].level_information
    heights = np.exp(states.calibration[user, 0]) * states.keyframe_poses[user][:, 2]
    return float(information @ (heights - np.average(heights, weights=information)) ** 2)


def step_errors(graph: PoseGraph, states: States, user: int) -> Array:
    """(m - 1, 4) sigmas: x, y, heading by gtsam's own difference of two poses, and height."""
    out, keyframes = [], graph.keyframes[user]
    poses = [gtsam.Pose2(x, y, yaw) for x, y, _, yaw in states.keyframe_poses[user].tolist()]
    for n, (plane, up, turn) in enumerate(keyframes.step_sigma.tolist()):
        x, y, z = keyframes.place[n + 1] - keyframes.place[n]
        level = gtsam.Pose2(x, y, 0.0).localCoordinates(poses[n].between(poses[n + 1]))
        height = states.keyframe_poses[user][n + 1, 2] - states.keyframe_poses[user][n, 2] - z
        out.append([*(level / [plane, plane, turn]), height / up])
    return np.array(out)


@pytest.mark.parametrize("annealing", [1.0, 3.0])
def test_the_graphs_error_is_the_sum_of_its_parts(annealing: float) -> None:
    graph = graph_of(simulate(NOISY).recording)
    random = np.random.default_rng(5)
    states = elsewhere(graph.initial_states(random.normal(0.0, 2.0, (3, 4)) * [[0.0], [1.0], [1.0]]), 3)
    em_weights = EmWeights(
        random.uniform(0.05, 1.0, len(graph.measurements)),
        random.uniform(0.0, 1.0, len(graph.measurements)),
        random.uniform(0.1, 1.0, len(graph.measurements)),
        [random.uniform(0.3, 1.5, len(k.step_sigma)) for k in graph.keyframes],
        np.ones((4, 3)),
        np.ones(3),
        random.uniform(0.1, 1.0, 3),
    )
    found = GtsamForm(graph).factors(states.anchor_poses, em_weights, annealing).error(GtsamForm(graph).values(states))
    whitened = graph.residuals(states) / graph.sigma / annealing
    ranges = annealing**2 * mixture_terms(whitened, graph.sigma, em_weights.nlos_odds, nlos_mixture(MODEL))[0]
    slam = [0.5 * float(em_weights.step_weight[u] @ (step_errors(graph, states, u) ** 2).sum(axis=1)) for u in range(3)]
    worth = em_weights.own_probability * em_weights.range_weight
    level = [0.5 * float(em_weights.level_weight[u]) * straying(graph, states, u) for u in range(3)]
    expected = float(worth @ ranges) + sum(slam) + sum(level) + prior_cost(graph, states)
    assert found == pytest.approx(expected, rel=1e-10)


def test_the_judged_cost_is_that_of_bursts_of_students_steps_and_of_the_priors() -> None:
    graph = graph_of(simulate(NOISY).recording)
    states = elsewhere(
        graph.initial_states(np.random.default_rng(6).normal(0.0, 2.0, (3, 4)) * [[0.0], [1.0], [1.0]]), 3, turn=0.0
    )
    before = graph.initial_em_weights()
    em_weights, cost = graph.e_step(states, before)
    s, whitened, expected = graph.measurements, graph.residuals(states) / graph.sigma, 0.0
    for pair in pairs(s):
        k = pair.measurements
        worth = float(before.range_weight[k].mean())
        columns = s.t[k], s.distance[k], whitened[k], graph.sigma[k], s.nlos_odds[k]
        odds, foreign, chain = chain_of_pair(columns, worth, MODEL)
        np.testing.assert_allclose(em_weights.nlos_odds[k], odds, rtol=1e-6)
        np.testing.assert_allclose(em_weights.own_probability[k], np.maximum(1.0 - foreign, 1e-9), rtol=1e-6)
        expected += chain * worth
    f = MODEL.slam.drift_dof + 4.0
    for u in range(3):
        # Without a turn gtsam's difference of two poses is the plain one.
        squares = (step_errors(graph, states, u) ** 2).sum(axis=1)
        np.testing.assert_allclose(em_weights.step_weight[u], f / (f + squares), rtol=1e-10)
        expected += 0.5 * f * np.log1p(squares / f).sum()
    own, common = calibration_sigmas(MODEL)
    kind = states.calibration.sum(axis=0) / own**2 / (3.0 / own**2 + 1.0 / common**2)
    squares = np.vstack([((states.calibration - kind) / own) ** 2, (kind / common) ** 2])
    tails = calibration_dof(MODEL) + 1.0
    np.testing.assert_allclose(em_weights.calibration_weight, tails / (tails + squares), rtol=1e-10)
    expected += (0.5 * tails * np.log1p(squares / tails)).sum()
    heights = states.anchor_poses[:, 2]
    np.testing.assert_array_equal(em_weights.height_weight, np.ones(3))
    expected += ((heights - heights.mean()) ** 2).sum() / MODEL.priors.height_sigma**2
    for u in range(3):
        t = graph.keyframes[u].t
        tail = MODEL.priors.level_dof + (t[-1] - t[0]) / MODEL.priors.level_duration
        square = straying(graph, states, u)
        assert em_weights.level_weight[u] == pytest.approx(tail / (tail + square), rel=1e-10)
        expected += 0.5 * tail * np.log1p(square / tail)
    assert cost == pytest.approx(expected, rel=1e-10)
    np.testing.assert_array_equal(em_weights.range_weight, before.range_weight)


def test_students_steps_are_a_mixture_of_gaussian_ones() -> None:
    """The weights make the Gaussian's slope that of Student's t: for a step s sigmas off, w s = d/ds of the cost."""
    graph = graph_of(simulate(CLEAN).recording)
    states = graph.initial_states(np.zeros((3, 4)))
    keyframes, h = graph.keyframes[1], 1e-5

    def cost(sigmas: float) -> tuple[float, float]:
        keyframe_poses = [of_user.copy() for of_user in states.keyframe_poses]
        keyframe_poses[1][3:, 0] += sigmas * keyframes.step_sigma[2, 0]
        em_weights, cost = graph.e_step(states._replace(keyframe_poses=keyframe_poses), graph.initial_em_weights())
        ranges = graph.measurements
        for pair in pairs(ranges):
            k = pair.measurements
            whitened = graph.residuals(states._replace(keyframe_poses=keyframe_poses))[k] / graph.sigma[k]
            columns = ranges.t[k], ranges.distance[k], whitened, graph.sigma[k], ranges.nlos_odds[k]
            worth = float(graph.initial_em_weights().range_weight[k].mean())
            cost -= worth * chain_of_pair(columns, worth, MODEL)[2]
        return cost, float(em_weights.step_weight[1][2])

    for sigmas in (0.5, 3.0, 10.0):
        slope = (cost(sigmas + h)[0] - cost(sigmas - h)[0]) / (2.0 * h)
        assert cost(sigmas)[1] * sigmas == pytest.approx(slope, rel=1e-4)


# ---- keys and values ----


def test_walks_and_values_are_the_same_numbers() -> None:
    graph = graph_of(simulate(NOISY).recording)
    random = np.random.default_rng(7)
    states = elsewhere(graph.initial_states(random.normal(0.0, 2.0, (3, 4))), 8, turn=2.0)
    nothing = graph.initial_states(np.full((3, 4), 9.0))
    nothing.anchor_poses[0] = states.anchor_poses[0]
    assert_same(GtsamForm(graph).states(GtsamForm(graph).values(states), nothing), states)


def test_a_clock_for_which_antennas_were_read_anew_is_not_lost() -> None:
    recording = simulate(CLEAN).recording
    graph = graph_of(recording)
    device = np.zeros((3, 3))
    device[:, CLOCK] = 0.2, -0.1, 0.3
    states = graph.initial_states(np.zeros((3, 4)), device)
    graph = graph.with_antennas_at(device[:, CLOCK])
    assert_same(
        GtsamForm(graph).states(GtsamForm(graph).values(states), graph.initial_states(np.zeros((3, 4)))), states
    )
    # The prior is still that of the whole offset.
    em_weights = graph.initial_em_weights()
    other = graph_of(recording)
    ranges = [
        float(
            em_weights.range_weight
            @ mixture_terms(g.residuals(states) / g.sigma, g.sigma, em_weights.nlos_odds, nlos_mixture(MODEL))[0]
        )
        for g in (graph, other)
    ]
    costs = [
        GtsamForm(g).factors(states.anchor_poses, em_weights).error(GtsamForm(g).values(states)) for g in (graph, other)
    ]
    assert costs[0] - ranges[0] == pytest.approx(costs[1] - ranges[1], abs=1e-9)


def test_an_optimum_has_a_graph_of_its_own_with_antennas_at_its_clocks() -> None:
    graph = graph_of(simulate(CLEAN).recording)
    device = np.zeros((3, 3))
    device[:, CLOCK] = 0.2, -0.1, 0.3
    begun = graph.initial_states(np.zeros((3, 4)), device)
    before = graph.residuals(begun)
    found = graph.run_em(begun, graph.initial_em_weights(), 1)
    np.testing.assert_array_equal(graph.residuals(begun), before)
    read = graph.with_antennas_at(device[:, CLOCK])
    np.testing.assert_array_equal(found.graph.residuals(begun), read.residuals(begun))
    assert np.abs(read.residuals(begun) - before).max() > 0.01  # m: moved on along velocities, not read


def test_the_gauge_is_held_and_nothing_else() -> None:
    graph = graph_of(simulate(replace(CLEAN, static_radios=1)).recording)
    states = graph.initial_states(np.zeros((4, 4)))
    keys = {(chr(gtsam.symbolChr(k)), gtsam.symbolIndex(k)) for k in keys_of(GtsamForm(graph).values(states))}
    frames = {(kind, u) for kind in "FH" for u in (1, 2, 3)}
    devices = {("D", u) for u in range(4)} | {("K", 0), ("L", 0)}
    assert {key for key in keys if key[0] in "FHDKL"} == frames | devices
    steps = sum(len(k) - 1 for k in graph.keyframes)
    assert len([key for key in keys if key[0] == "X"]) == len([key for key in keys if key[0] == "Z"]) == steps
    for u in range(4):
        held, free = GtsamForm(graph).keys(u, 0), GtsamForm(graph).keys(u, 1)
        assert (held.pose, held.local_height) == (None, None)
        assert (held.frame is None) == (held.height is None) == (u == 0)
        assert held.held_frame == (0.0, 0.0, 0.0, 0.0)
        np.testing.assert_array_equal(held.held_local, [0.0, 0.0, 0.0, graph.keyframes[u].place[0, 2]])
        assert None not in (free.pose, free.local_height)
    # Every variable is in a factor and in the order of elimination, and no factor knows another.
    factors = GtsamForm(graph).factors(states.anchor_poses, graph.initial_em_weights())
    ordering = GtsamForm(graph).ordering()
    ordered = [ordering.at(n) for n in range(ordering.size())]
    in_factors = {key for n in range(factors.size()) for key in keys_of(factors.at(n))}
    assert set(keys_of(GtsamForm(graph).values(states))) == in_factors == set(ordered)
    assert len(ordered) == len(set(ordered))


def test_who_is_not_placed_has_no_keys_and_stays_where_he_was() -> None:
    graph = graph_of(simulate(CLEAN).recording, active_users=(0, 2))
    states = graph.initial_states(np.array([[0.0, 0.0, 0.0, 0.0], [np.nan] * 4, [1.0, 2.0, 0.1, 0.5]]))
    users = {gtsam.symbolIndex(k) for k in keys_of(GtsamForm(graph).values(states)) if chr(gtsam.symbolChr(k)) in "FHD"}
    assert users == {0, 2}
    graph, optimum, em_weights, _ = graph.run_em(states, graph.initial_em_weights(), 2)
    assert np.isnan(optimum.anchor_poses[1]).all()
    np.testing.assert_array_equal(optimum.keyframe_poses[1], states.keyframe_poses[1])
    sure = marginals(graph, optimum, em_weights)
    assert np.isnan(sure.poses[1]).all()
    assert np.isnan(sure.calibrations[1]).all()
    assert np.isfinite(sure.poses[[0, 2]]).all()
    assert np.isfinite(sure.calibrations[[0, 2]]).all()


# ---- minima ----


def optimum(graph: PoseGraph, frames: Array) -> LocalOptimum:
    """From SLAM laid there, range weights measured on the residuals."""
    found = graph.run_em(graph.initial_states(frames), graph.initial_em_weights(), 4)
    for _ in range(2):
        graph, states, em_weights, _ = found
        found = graph.run_em(states, graph.with_range_weights(states, em_weights), 6)
    return found


@pytest.mark.parametrize("seed", range(3))
def test_from_the_truth_without_noise_nothing_moves(seed: int) -> None:
    """On level walks, for heights that differ are drawn together by their prior."""
    simulation = simulate(replace(CLEAN, seed=seed, antennas=0, height_spread=0.0, height_bob=0.0))
    graph = graph_of(simulation.recording)
    truth = graph.initial_states(true_frames(simulation, graph))
    states = optimum(graph, truth.anchor_poses).states
    assert np.abs(states.anchor_poses[:, :2] - truth.anchor_poses[:, :2]).max() < 0.01
    assert np.abs(wrap_angle(states.anchor_poses[:, 3] - truth.anchor_poses[:, 3])).max() < 0.005
    assert np.abs(states.anchor_poses[:, 2]).max() < 0.01
    assert np.abs(states.calibration).max() < 0.005
    assert max(np.abs(a - b).max() for a, b in zip(states.keyframe_poses, truth.keyframe_poses, strict=True)) < 0.01


def test_what_is_settled_costs_no_more_than_what_it_began_with() -> None:
    simulation = simulate(NOISY)
    graph = graph_of(simulation.recording)
    begun = graph.initial_states(true_frames(simulation, graph))
    _, before = graph.e_step(begun, graph.initial_em_weights())
    graph, states, em_weights, cost = graph.run_em(begun, graph.initial_em_weights(), 5)
    assert cost < before
    assert graph.e_step(states, em_weights)[1] == pytest.approx(cost)
    # The quadratic model promises no more, and there is nothing left to gain.
    form = GtsamForm(graph)
    linear = form.factors(begun.anchor_poses, em_weights).linearize(form.values(states))
    information, slope = linear.hessian(form.ordering())
    assert 0.5 * slope @ np.linalg.solve(information, slope) < 0.1
    _, again, _, same = graph.run_em(states, em_weights, 5)
    assert same == pytest.approx(cost, abs=0.1)
    assert np.abs(again.anchor_poses - states.anchor_poses).max() < 0.05


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("column", "planted", "informed"), [(SCALE, 0.12, 0.025), (BIAS, 0.1, 0.03), (CLOCK, 0.1, 0.025)]
)
def test_what_is_wrong_with_a_device_is_found(seed: int, column: int, planted: float, informed: float) -> None:
    """Of the second of three users; `informed`: it is known better than the prior knows it."""
    simulation = simulate(replace(CLEAN, seed=seed, seconds=20.0, sigma=0.05))
    recording, tracks = simulation.recording, dict(simulation.recording.tracks)
    name, ranges = recording.users[1].name, recording.ranges
    track = tracks[name]
    if column == SCALE:
        tracks[name] = replace(track, position=track.position * np.exp(-planted))
    elif column == CLOCK:
        tracks[name] = replace(track, t=track.t + planted)
    else:
        mine = (ranges.a == 1) | (ranges.b == 1)
        ranges = replace(ranges, distance=ranges.distance + np.where(mine, planted, 0.0))
    frames = true_frames(simulation, graph_of(recording))
    graph = graph_of(replace(recording, tracks=tracks, ranges=ranges))
    graph, states, em_weights, _ = optimum(graph, frames)
    sigma = np.sqrt(marginals(graph, states, em_weights).calibrations)
    expected = np.zeros((3, 3))
    expected[1, column] = planted
    assert (np.abs(states.calibration - expected) < 3.0 * sigma).all()
    assert sigma[1, column] < informed
    assert states.calibration[1, column] > 0.7 * planted


@pytest.mark.parametrize("seed", range(3))
def test_a_heading_that_drifted_is_put_right(seed: int) -> None:
    """The second user's SLAM turned by 0.01 rad a second, 0.2 rad in all."""
    simulation = simulate(replace(CLEAN, seed=seed, seconds=20.0, sigma=0.05))
    recording = simulation.recording
    name = recording.users[1].name
    track = recording.tracks[name]
    yaw = 0.01 * (track.t - track.t[0])
    turned = np.array(
        [YawFrame(yaw=float(a)) @ way for a, way in zip(yaw[:-1], np.diff(track.position, axis=0), strict=True)]
    )
    position = track.position[0] + np.vstack([np.zeros(3), np.cumsum(turned, axis=0)])
    quat = np.array([YawFrame(yaw=a).rotate_quaternions(q) for a, q in zip(yaw.tolist(), track.quat_xyzw, strict=True)])
    bent = replace(recording, tracks={**recording.tracks, name: Track(track.t, position, quat)})
    frames = true_frames(simulation, graph_of(recording))
    graph = graph_of(bent)
    graph, states, em_weights, _ = optimum(graph, frames)

    place = YawFrame(*frames[1]) @ (track.position[-1] - graph.keyframes[1].anchor)
    expected = np.array([*place, frames[1, 3] - yaw[-1]])
    error = graph.last_poses(states)[1] - expected
    error[3] = wrap_angle(float(error[3]))
    covariance = marginals(graph, states, em_weights).poses[1, :4, :4]
    assert error @ np.linalg.solve(covariance, error) < 18.5  # 99.9 % of four degrees of freedom
    assert abs(error[3]) < 0.5 * yaw[-1]
    found, _ = common_track(states, 1, graph.keyframes[1], bent.tracks[name])
    true = YawFrame(*frames[1]) @ (track.position - graph.keyframes[1].anchor)
    slam = YawFrame(*frames[1]) @ (position - graph.keyframes[1].anchor)
    off, off_before = (np.linalg.norm((p - true)[:, :2], axis=1) for p in (found.position, slam))
    assert off.mean() < 0.5 * off_before.mean()


def test_worse_ranges_are_worth_less_where_they_are_measured() -> None:
    simulation = simulate(replace(CLEAN, sigma=0.05))
    graph = graph_of(simulation.recording)
    states = graph.initial_states(true_frames(simulation, graph))
    measured = graph.with_range_weights(states, graph.initial_em_weights())
    off = replace(graph.measurements, distance=graph.measurements.distance + 0.4 * np.sin(graph.measurements.t))
    graph = PoseGraph(graph.problem.with_measurements(off), graph.keyframes)
    worse = graph.with_range_weights(states, graph.initial_em_weights())
    assert worse.range_weight.mean() < 0.3 * measured.range_weight.mean()
    np.testing.assert_array_equal(worse.nlos_odds, graph.initial_em_weights().nlos_odds)


# ---- how sure ----


def test_the_bending_of_ranges_is_that_of_rigid_walks() -> None:
    simulation = simulate(NOISY)
    graph = graph_of(simulation.recording)
    graph, states, em_weights, _ = graph.run_em(
        graph.initial_states(true_frames(simulation, graph)), graph.initial_em_weights(), 3
    )
    em_weights = replace(em_weights, range_weight=np.full(len(graph.measurements), 0.5))
    height_curvature = graph.height_curvature(states, em_weights)
    for pair, expected in pair_bending(graph, states, em_weights):
        assert height_curvature[pair.measurements].sum() == pytest.approx(expected, rel=1e-9)


def test_many_keyframes_know_no_more_of_a_height_than_few() -> None:
    """Two walkers on one level, SLAM that does not drift: what noise bends in each block must not add up."""
    firm = MODEL.changed(slam={"drift_m_per_sqrt_s": 1e-4, "drift_m_per_sqrt_m": 1e-4})
    level = replace(CLEAN, users=2, seconds=30.0, sigma=0.1, height_spread=0.0, height_bob=0.0)
    ratios = []
    for seed in range(5):
        simulation = simulate(replace(level, seed=seed))
        sigma = []
        for interval in (0.5, 30.0):
            graph = graph_of(simulation.recording, firm, interval=interval)
            graph, states, em_weights, _ = graph.run_em(
                graph.initial_states(true_frames(simulation, graph)), graph.initial_em_weights(), 5
            )
            sigma.append(float(np.sqrt(marginals(graph, states, em_weights).relative[1, 2, 2])))
        ratios.append(sigma[0] / sigma[1])
    np.testing.assert_allclose(ratios, 1.0, atol=0.1)


def test_the_last_pose_lies_where_the_track_ends() -> None:
    simulation = simulate(NOISY)
    graph = graph_of(simulation.recording)
    states = elsewhere(graph.initial_states(np.random.default_rng(1).normal(0.0, 2.0, (3, 4))), 2)
    for u, user in enumerate(simulation.recording.users):
        track, yaw = common_track(states, u, graph.keyframes[u], simulation.recording.tracks[user.name])
        np.testing.assert_allclose(graph.last_poses(states)[u, :3], track.position[-1], atol=1e-12)
        assert wrap_angle(float(graph.last_poses(states)[u, 3] - yaw[-1])) == pytest.approx(0.0, abs=1e-12)
