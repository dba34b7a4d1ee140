from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from support.solver_scenes import honest_information

from synchronizar.arrays import Array
from synchronizar.cooperative import finish
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.geometry import YawFrame, wrap_angle
from synchronizar.graph import keys
from synchronizar.graph.marginal_prior import MarginalPrior
from synchronizar.graph.marginals import errors_of, marginalized, marginals
from synchronizar.graph.pose_graph import LocalOptimum, PoseGraph
from synchronizar.graph.problem import Problem
from synchronizar.graph.states import States
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.keyframes import keyframes_of
from synchronizar.preprocessing.range_measurements import range_measurements
from synchronizar.preprocessing.relocalizations import repair_relocalizations
from synchronizar.simulation.simulate import Scene, Simulation, simulate

SCENE = Scene(
    users=3,
    seconds=16.0,
    rate_hz=8.0,
    sigma=0.1,
    bias_sigma=0.05,
    scale_sigma=0.05,
    drift_m_per_sqrt_s=0.01,
    drift_rad_per_sqrt_s=0.005,
)
MODEL = Parameters()
HALF = 8.0  # s
NO_CLOCK = np.zeros(3)


def some(users: list[int], reference: int, seed: int = 0) -> MarginalPrior:
    """A Gaussian that no walk made, each variable of another size."""
    random = np.random.default_rng(seed)
    frames = np.full((3, 4), np.nan)
    frames[users] = random.normal(0.0, 1.0, (len(users), 4))
    frames[reference] = 0.0
    n = 4 * (len(users) - 1) + 3 * len(users)
    root = random.normal(size=(n, n)) * random.uniform(0.01, 0.5, (n, 1))
    return MarginalPrior(users, reference, frames, random.normal(0.0, 0.05, (3, 3)), root @ root.T)


def values_at(marginal_prior: MarginalPrior, away: Array, assumed_clock: Array) -> gtsam.Values:
    """Gtsam's values at the carried mean plus `away`, in the order of the covariance."""
    values, row = gtsam.Values(), 0
    for u in marginal_prior.free:
        (x, y, z, yaw), (dx, dy, turn, dz) = marginal_prior.frames[u], away[row : row + 4]
        values.insert(keys.frame(u), gtsam.Pose2(x + dx, y + dy, yaw + turn))
        values.insert(keys.height(u), z + dz)
        row += 4
    for u in marginal_prior.users:
        values.insert(
            keys.calibration(u),
            marginal_prior.calibration[u] + away[row : row + 3] - np.array([0.0, 0.0, assumed_clock[u]]),
        )
        row += 3
    return values


# ---- the factor ----


@pytest.mark.parametrize("users", [[0, 1, 2], [0, 2], [1, 2]])
@pytest.mark.parametrize("clock", [0.0, 0.3])
def test_its_error_is_half_the_mahalanobis_distance(users: list[int], clock: float) -> None:
    marginal_prior = some(users, users[-1])
    assumed = clock * np.array([1.0, -2.0, 0.5])
    away = np.random.default_rng(1).normal(0.0, 0.1, len(marginal_prior.covariance))
    found = marginal_prior.factor(assumed).error(values_at(marginal_prior, away, assumed))
    assert found == pytest.approx(0.5 * away @ np.linalg.solve(marginal_prior.covariance, away), rel=1e-8)
    assert marginal_prior.factor(assumed).error(values_at(marginal_prior, 0.0 * away, assumed)) == pytest.approx(
        0.0, abs=1e-18
    )


def test_a_heading_is_as_far_from_another_as_the_shorter_way() -> None:
    marginal_prior = some([0, 1], 0)
    marginal_prior.frames[1, 3] = np.pi - 0.01
    away = np.zeros(len(marginal_prior.covariance))
    away[2] = 0.03  # beyond pi: gtsam has it near -pi
    found = marginal_prior.factor(NO_CLOCK).error(values_at(marginal_prior, away, NO_CLOCK))
    assert found == pytest.approx(0.5 * away @ np.linalg.solve(marginal_prior.covariance, away), rel=1e-8)


def test_its_jacobians_are_those_of_gtsams_tangents() -> None:
    marginal_prior = some([0, 1, 2], 1)
    assumed = np.array([0.1, 0.2, -0.1])
    values = values_at(
        marginal_prior, np.random.default_rng(2).normal(0.0, 0.2, len(marginal_prior.covariance)), assumed
    )
    factor, h = marginal_prior.factor(assumed), 1e-6
    linear = factor.linearize(values)
    A, b = linear.jacobian()
    sizes = [3 if chr(gtsam.symbolChr(key)) in "FD" else 1 for key in marginal_prior.keys()]  # noqa: SIM118
    assert list(linear.keys()) == list(factor.keys()) == marginal_prior.keys()
    columns = []
    for key, size in zip(marginal_prior.keys(), sizes, strict=True):
        for n in range(size):
            ends = []
            for side in (h, -h):
                step = gtsam.VectorValues()
                step.insert(key, side * np.eye(size)[n])
                ends.append(-factor.linearize(values.retract(step)).jacobian()[1])
            columns.append((ends[0] - ends[1]) / (2.0 * h))
    np.testing.assert_allclose(A, np.array(columns).T, rtol=1e-6, atol=1e-6 * np.abs(A).max())
    assert factor.error(values) == pytest.approx(0.5 * b @ b)


def test_what_is_known_next_to_perfectly_leaves_the_factor_finite() -> None:
    """Two heights that are one to a micrometre: their covariance is as good as singular."""
    marginal_prior = some([0, 1, 2], 0)
    covariance = np.diag(np.full(len(marginal_prior.covariance), 0.01))
    covariance[3, 7] = covariance[7, 3] = 0.01 - 1e-14
    marginal_prior = marginal_prior._replace(covariance=covariance)
    together = np.zeros(len(covariance))
    together[[3, 7]] = 0.1
    found = marginal_prior.factor(NO_CLOCK).error(values_at(marginal_prior, together, NO_CLOCK))
    assert found == pytest.approx(0.5 * 0.1**2 / 0.01, rel=1e-6)


# ---- who is left out ----


def test_leaving_somebody_out_is_to_marginalise() -> None:
    marginal_prior = some([0, 1, 2], 0)
    left = marginal_prior.without({1})
    # x, y, yaw, height of user 1, of user 2; then devices of users 0, 1, 2.
    rows = [4, 5, 6, 7, 8, 9, 10, 14, 15, 16]
    np.testing.assert_array_equal(left.covariance, marginal_prior.covariance[np.ix_(rows, rows)])
    assert left.users == [0, 2]
    assert left.keys() == [keys.frame(2), keys.height(2), keys.calibration(0), keys.calibration(2)]
    assert np.isnan(left.frames[1]).all()
    np.testing.assert_array_equal(left.frames[[0, 2]], marginal_prior.frames[[0, 2]])
    assert np.isfinite(marginal_prior.frames).all()


def test_its_factor_without_somebody_is_the_least_over_where_that_user_could_be() -> None:
    """The marginal of a Gaussian has the least of the joint cost over what is left out."""
    marginal_prior, away = some([0, 1, 2], 0), np.random.default_rng(4).normal(0.0, 0.1, 17)
    rows, out = np.array([4, 5, 6, 7, 8, 9, 10, 14, 15, 16]), np.array([0, 1, 2, 3, 11, 12, 13])
    information = np.linalg.inv(marginal_prior.covariance)
    away[out] = -np.linalg.solve(information[np.ix_(out, out)], information[np.ix_(out, rows)] @ away[rows])
    left = marginal_prior.without({1})
    found = left.factor(NO_CLOCK).error(values_at(left, away[rows], NO_CLOCK))
    assert found == pytest.approx(0.5 * away @ information @ away, rel=1e-6)


def test_leaving_nobody_out_changes_nothing() -> None:
    marginal_prior = some([0, 2], 2)
    same = marginal_prior.without(set())
    assert (same.users, same.reference) == (marginal_prior.users, marginal_prior.reference)
    np.testing.assert_array_equal(same.covariance, marginal_prior.covariance)
    np.testing.assert_array_equal(same.frames, marginal_prior.frames)


# ---- beside somebody else ----


@pytest.mark.parametrize("to", [0, 2])
def test_beside_another_user_everything_is_as_seen_from_there(to: int) -> None:
    """Frames composed one by one, and the covariance by finite differences."""
    marginal_prior = some([0, 1, 2], 1)
    found = marginal_prior.beside(to)
    n = len(marginal_prior.covariance)

    def told(away: Array) -> Array:
        """(n,) x, y, yaw, height beside the new reference, and devices; `away` from the old means."""
        frames, row = marginal_prior.frames.copy(), 0
        for u in marginal_prior.free:
            frames[u] += away[row : row + 4][[0, 1, 3, 2]]
            row += 4
        inverse = YawFrame(*frames[to]).inverse()
        others = [inverse @ YawFrame(*frames[u]) for u in range(3) if u != to]
        return np.concatenate(
            [*([f.x, f.y, f.yaw, f.z] for f in others), marginal_prior.calibration.ravel() + away[row:]]
        )

    mean, h = told(np.zeros(n)), 1e-6
    J = np.array([(told(h * axis) - told(-h * axis)) / (2.0 * h) for axis in np.eye(n)]).T
    assert (found.reference, found.users) == (to, [0, 1, 2])
    np.testing.assert_allclose(found.frames[to], 0.0, atol=1e-12)
    np.testing.assert_allclose(found.frames[found.free][:, [0, 1, 3, 2]].ravel(), mean[:8], atol=1e-12)
    np.testing.assert_array_equal(found.calibration, marginal_prior.calibration)
    np.testing.assert_allclose(found.covariance, J @ marginal_prior.covariance @ J.T, atol=1e-7)


def test_beside_somebody_else_and_back_is_what_it_was() -> None:
    marginal_prior = some([0, 1, 2], 1)
    back = marginal_prior.beside(2).beside(1)
    np.testing.assert_allclose(back.frames, marginal_prior.frames, atol=1e-12)
    np.testing.assert_allclose(back.covariance, marginal_prior.covariance, atol=1e-10)


# ---- what is carried from a graph ----


def cut(recording: Recording, begin: float, end: float) -> Recording:
    """From each track's last pose at `begin` to that at `end`, and the ranges that both devices have poses for."""
    tracks = {}
    for name, t in recording.tracks.items():
        first, last = (max(int(np.searchsorted(t.t, at, side="right")) - 1, 0) for at in (begin, end))
        tracks[name] = Track(t.t[first : last + 1], t.position[first : last + 1], t.quat_xyzw[first : last + 1])
    first_pose = max(t.t[0] for t in tracks.values())
    last_pose = min(t.t[-1] for t in tracks.values())
    inside = (recording.ranges.t > first_pose) & (recording.ranges.t <= last_pose)
    return replace(recording, tracks=tracks, ranges=recording.ranges.select(inside))


def graph_of(recording: Recording, marginal_prior: MarginalPrior | None = None) -> PoseGraph:
    keyframes = [
        keyframes_of(repair_relocalizations(recording.tracks[u.name], MODEL), 1.0, MODEL) for u in recording.users
    ]
    return PoseGraph(
        Problem(recording, range_measurements(recording, MODEL), [0, 1, 2], 0, MODEL), keyframes, marginal_prior
    )


def true_frames(simulation: Simulation, graph: PoseGraph) -> Array:
    """(k, 4): where the anchors lie beside the reference's, near enough to start from."""
    world_from_user = [simulation.world_from_user[u.name] for u in simulation.recording.users]
    anchors = np.array([f @ k.anchor for f, k in zip(world_from_user, graph.keyframes, strict=True)])
    yaw = np.array([f.yaw for f in world_from_user])
    return np.column_stack([YawFrame(yaw=-yaw[0]) @ (anchors - anchors[0]), wrap_angle(yaw - yaw[0])])


def solved(graph: PoseGraph, states: States) -> LocalOptimum:
    return graph.run_em(states, graph.initial_em_weights(), 12)


def beside_the_reference(graph: PoseGraph, states: States) -> Array:
    """(k, 4): last poses as seen from the reference's, in its axes."""
    x, y, z, yaw = graph.last_poses(states)[0].tolist()
    inverse = YawFrame(x, y, z, yaw).inverse()
    others = [inverse @ YawFrame(*pose) for pose in graph.last_poses(states)]
    return np.array([[f.x, f.y, f.z, f.yaw] for f in others])


def in_axes_of_the_reference(covariance: Array, reference: Array) -> Array:
    """A covariance (4, 4) of x, y, z, yaw in common axes, turned; `reference` (4,) is the reference's pose."""
    turn = np.eye(4)
    c, s = np.cos(reference[3]), np.sin(reference[3])
    turn[:2, :2] = [[c, s], [-s, c]]
    return np.asarray(turn @ covariance @ turn.T)


def own_heights(graph: PoseGraph) -> Array:
    """(k,) m: SLAM's own heights at the last keyframes, where it never jumped."""
    return np.array([k.place[-1, 2] for k in graph.keyframes])


@pytest.mark.parametrize("seed", range(3))
def test_two_halves_of_a_walk_end_where_the_whole_does_and_as_sure(seed: int) -> None:
    simulation = simulate(replace(SCENE, seed=seed))
    recording = simulation.recording
    whole = graph_of(recording)
    whole, expected, em_weights, _ = solved(whole, whole.initial_states(true_frames(simulation, whole)))
    sure = marginals(whole, expected, em_weights)

    first = graph_of(cut(recording, -np.inf, HALF))
    first, states, of_first, _ = solved(first, first.initial_states(true_frames(simulation, first)))
    marginal_prior = marginalized(first, states, finish(errors_of(first, states, of_first)), own_heights(first))
    second = graph_of(cut(recording, HALF, np.inf), marginal_prior)
    assert len(first.measurements) + len(second.measurements) > 0.97 * len(whole.measurements)
    second, found, of_second, _ = solved(
        second, second.initial_states(marginal_prior.frames, marginal_prior.calibration)
    )
    found_sure = marginals(second, found, of_second)
    by_itself = graph_of(cut(recording, HALF, np.inf))
    by_itself, states, of_second, _ = solved(by_itself, by_itself.initial_states(marginal_prior.frames))
    by_itself_sure = marginals(by_itself, states, of_second)

    away = beside_the_reference(second, found) - beside_the_reference(whole, expected)
    for u in (1, 2):
        P = in_axes_of_the_reference(sure.relative[u], whole.last_poses(expected)[0])
        P_found = in_axes_of_the_reference(found_sure.relative[u], second.last_poses(found)[0])
        assert (np.abs(away[u]) < 0.3 * np.sqrt(np.diag(P))).all()
        # Sigmas in the directions where they differ most.
        ratios = np.sqrt(np.linalg.eigvals(np.linalg.solve(P, P_found)).real)
        assert 0.85 < ratios.min() < ratios.max() < 1.1
        # What was carried is worth something: the second half by itself knows less of the plane.
        assert np.linalg.det(by_itself_sure.relative[u, :2, :2]) > 1.5 * np.linalg.det(P[:2, :2])
    assert (np.abs(found.calibration - expected.calibration) < 0.2 * np.sqrt(sure.calibrations)).all()
    np.testing.assert_allclose(np.sqrt(found_sure.calibrations), np.sqrt(sure.calibrations), rtol=0.1)


def test_its_covariance_is_that_of_the_whole_graph() -> None:
    """A dense inverse of all variables' information, and what is carried by finite differences."""
    simulation = simulate(replace(SCENE, seconds=6.0, clock_offset_sigma=0.05))
    graph = graph_of(simulation.recording)
    graph, states, em_weights, _ = graph.run_em(
        graph.initial_states(true_frames(simulation, graph)), graph.initial_em_weights(), 4
    )
    em_weights = replace(em_weights, range_weight=np.full(len(graph.measurements), 0.5))
    marginal_prior = marginalized(graph, states, finish(errors_of(graph, states, em_weights)), own_heights(graph))
    values, ordering = graph.values(states), graph.ordering()
    information = honest_information(graph, states, em_weights)
    size = np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information / np.outer(size, size)) / np.outer(size, size)
    slam_above = np.array([k.place[-1, 2] for k in graph.keyframes])

    def told(at: gtsam.Values) -> Array:
        """(17,) x, y, yaw and height of the last keyframes' own anchors beside the reference's; devices."""
        there = graph.states(at, states)
        beside = beside_the_reference(graph, there)
        above = np.exp(there.calibration[:, 0]) * slam_above
        beside[:, 2] += above[0] - above
        return np.concatenate([beside[1:, [0, 1, 3, 2]].ravel(), there.calibration.ravel()])

    mean = told(values)
    np.testing.assert_allclose(mean[:8].reshape(2, 4), marginal_prior.frames[1:][:, [0, 1, 3, 2]], atol=1e-12)
    np.testing.assert_array_equal(marginal_prior.frames[0], np.zeros(4))
    np.testing.assert_allclose(mean[8:].reshape(3, 3), marginal_prior.calibration, atol=1e-12)
    columns, h = [], 1e-6
    for key in [ordering.at(n) for n in range(ordering.size())]:
        dimension = 1 if chr(gtsam.symbolChr(key)) in "HZL" else 3
        for n in range(dimension):
            ends = []
            for side in (h, -h):
                step = gtsam.VectorValues()
                step.insert(key, side * np.eye(dimension)[n])
                ends.append(told(values.retract(step)))
            columns.append((ends[0] - ends[1]) / (2.0 * h))
    J = np.array(columns).T
    expected = J @ covariance @ J.T
    deviation = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        marginal_prior.covariance / np.outer(deviation, deviation), expected / np.outer(deviation, deviation), atol=2e-3
    )


def test_clocks_that_may_have_drifted_are_known_less_and_nothing_else_is() -> None:
    simulation = simulate(SCENE)
    graph = graph_of(simulation.recording)
    graph, states, em_weights, _ = graph.run_em(
        graph.initial_states(true_frames(simulation, graph)), graph.initial_em_weights(), 4
    )
    marginal_prior = marginalized(graph, states, finish(errors_of(graph, states, em_weights)), own_heights(graph))
    more = marginal_prior.aged(4e-6).covariance - marginal_prior.covariance
    clocks = [2 * 4 + 3 * u + 2 for u in range(3)]
    np.testing.assert_allclose(np.diag(more)[clocks], 4e-6, rtol=1e-6)
    more[clocks, clocks] = 0.0
    np.testing.assert_array_equal(more, np.zeros_like(more))
