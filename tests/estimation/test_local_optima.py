"""Once an optimum is known: how large errors in line of sight are, and where users may be besides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from synchronizar.arrays import Array
from synchronizar.estimation.comparing import nlos_share, not_excluded
from synchronizar.estimation.measured_weights import with_measured_weights
from synchronizar.estimation.mirror_images import reflections
from synchronizar.estimation.other_optima import other_places
from synchronizar.geometry import YawFrame, wrap_angle
from synchronizar.graph.pose_graph import LocalOptimum, PoseGraph
from synchronizar.graph.problem import Problem
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.keyframes import keyframes_of
from synchronizar.preprocessing.relocalizations import repair_relocalizations
from synchronizar.simulation.simulate import Scene, Simulation, simulate

MODEL = Parameters()
WALK = Scene(users=3, seconds=10.0)


def graph_of(simulation: Simulation, told_sigma: float = 0.1) -> PoseGraph:
    recording = simulation.recording
    problem = Problem.of(recording, 0, MODEL)
    sigma = np.full(len(problem.measurements), told_sigma)
    problem = problem.with_measurements(replace(problem.measurements, sigma=sigma))
    tracks = [repair_relocalizations(recording.tracks[user.name], MODEL) for user in recording.users]
    return PoseGraph(problem, [keyframes_of(track, 1.0, MODEL) for track in tracks])


def true_frames(simulation: Simulation, graph: PoseGraph) -> Array:
    """(k, 4): where the anchors lie, the common frame being the reference's anchor; for SLAM that does not drift."""
    world_from_user = [simulation.world_from_user[u.name] for u in simulation.recording.users]
    anchors = np.array([f @ k.anchor for f, k in zip(world_from_user, graph.keyframes, strict=True)])
    yaw = np.array([f.yaw for f in world_from_user])
    common = YawFrame(yaw=-yaw[0]) @ (anchors - anchors[0])
    return np.column_stack([common, wrap_angle(yaw - yaw[0])])


def from_frames(graph: PoseGraph, frames: Array, rounds: int) -> LocalOptimum:
    return graph.run_em(graph.initial_states(frames), graph.initial_em_weights(), rounds)


def at_truth(simulation: Simulation, told_sigma: float = 0.1) -> LocalOptimum:
    graph = graph_of(simulation, told_sigma)
    return from_frames(graph, true_frames(simulation, graph), 4)


def sigma_of(optimum: LocalOptimum) -> float:
    return float(np.sqrt((optimum.graph.sigma**2).mean()))


@pytest.mark.parametrize("seed", range(2))
def test_where_no_range_seems_nlos_errors_are_as_large_as_their_noise(seed: int) -> None:
    found = with_measured_weights(at_truth(simulate(replace(WALK, seed=seed))))
    np.testing.assert_allclose(found.graph.sigma, 0.1)
    assert nlos_share(found) < 0.02


@pytest.mark.parametrize("seed", range(2))
def test_short_detours_are_not_taken_for_errors_in_line_of_sight(seed: int) -> None:
    simulation = simulate(replace(WALK, seed=seed, late_share=0.3, late_mean=0.5))
    found = with_measured_weights(at_truth(simulation))
    assert sigma_of(found) < 0.12
    _, inlier = found.graph.inlier_probability(found.states, found.em_weights)
    late = simulation.late[found.graph.measurements.row]
    assert (inlier[late] > 0.5).mean() < 0.25
    assert (inlier[~late] < 0.5).mean() < 0.05


def test_errors_of_either_sign_that_are_larger_than_noise_are_not_taken_for_nlos() -> None:
    """Noise of 0.17 m, of which the recording says 0.1 m: as large as with the model's reflections.

    In one walk of some fifty two ranges seem NLOS, and the others as good as it says.
    """
    found = [with_measured_weights(at_truth(simulate(replace(WALK, seed=seed, sigma=0.17)))) for seed in range(6)]
    assert sum(0.135 < sigma_of(optimum) < 0.181 for optimum in found) >= 5
    assert max(nlos_share(optimum) for optimum in found) < 0.05


@pytest.mark.parametrize(("late_share", "low", "high"), [(0.0, 0.8, 1.25), (0.4, 0.0, 0.7)])
def test_errors_that_are_larger_than_noise_count_for_less_where_many_ranges_are_nlos(
    late_share: float, low: float, high: float
) -> None:
    ratios = []
    for seed in range(5):
        simulation = simulate(replace(WALK, seed=seed, sigma=0.17, late_share=late_share))
        told, untold = with_measured_weights(at_truth(simulation, 0.17)), with_measured_weights(at_truth(simulation))
        information = [float((o.em_weights.range_weight / o.graph.sigma**2).mean()) for o in (told, untold)]
        ratios.append(information[1] / information[0])
    assert low < np.median(ratios) < high


@pytest.mark.parametrize("seed", range(3))
def test_one_user_that_is_elsewhere_is_found_again_beside_the_others(seed: int) -> None:
    """Left where it is 2 m off, with its NLOS ranges, by optima that hold the others where they are."""
    simulation = simulate(replace(WALK, users=4, seed=seed, late_share=0.2))
    graph = graph_of(simulation)
    best = with_measured_weights(from_frames(graph, true_frames(simulation, graph), 4))
    moved = best.states.anchor_poses.copy()
    moved[2] += [1.5, -1.5, 0.0, 2.0]
    astray = best.states._replace(anchor_poses=moved)
    em_weights, cost = best.graph.e_step(astray, best.em_weights)
    found = other_places(LocalOptimum(best.graph, astray, em_weights, cost))
    off = [
        np.linalg.norm(other.states.anchor_poses[1:, :3] - best.states.anchor_poses[1:, :3], axis=1) for other in found
    ]
    assert min(o.max() for o in off) < 0.05
    assert min(other.cost for other in found) < best.cost + 1.0


LINES = Scene(users=4, walk=("line",), seconds=12.0, drift_m_per_sqrt_s=0.02, drift_rad_per_sqrt_s=0.01)


def either_side_of_the_line(graph: PoseGraph, frames: Array) -> tuple[LocalOptimum, LocalOptimum]:
    """The optima at frames, and where the others are reflected in the first one's line."""
    graph = graph.with_reflections(there=False)
    begin = replace(graph.initial_em_weights(), range_weight=np.ones(len(graph.measurements)))
    image = reflections(graph.measurements, frames, 0)[0]
    truth, other = (graph.run_em(graph.initial_states(f), begin, 10) for f in (frames, image))
    return truth, other


def by_chance(one: LocalOptimum, other: LocalOptimum) -> float:
    """1 sigma of the difference of two costs, by the definition in `not_excluded`."""
    e = [s.graph.inlier_probability(s.states, s.em_weights)[0] * s.graph.residuals(s.states) for s in (one, other)]
    return float(np.linalg.norm((e[1] - e[0]) / one.graph.sigma))


@pytest.mark.parametrize("seed", [1, 2])
def test_what_tells_the_sides_of_straight_walks_apart_is_as_large_as_the_noise_makes_it(seed: int) -> None:
    """Noise is drawn anew, SLAM's drift stays: the costs of the truth and its mirror image differ by a unit normal."""
    simulation = simulate(replace(LINES, seed=seed))
    graph = graph_of(simulation)
    measurements = graph.measurements
    places = np.array([simulation.truth[u.name].at(measurements.t, 1.0).position for u in simulation.recording.users])
    n = np.arange(len(measurements))
    true_distance = np.linalg.norm(places[measurements.i, n] - places[measurements.j, n], axis=1)
    frames = true_frames(simulation, graph)
    random, z = np.random.default_rng(seed), []
    for _ in range(40):
        drawn = true_distance + 0.1 * random.standard_normal(len(n))
        problem = graph.problem.with_measurements(replace(measurements, distance=drawn))
        truth, image = either_side_of_the_line(PoseGraph(problem, graph.keyframes), frames)
        z.append((image.cost - truth.cost) / by_chance(truth, image))
    assert abs(np.mean(z)) < 0.6
    assert 0.7 < np.std(z) < 1.4


def test_an_optimum_is_excluded_by_its_cost_only_beyond_what_noise_explains() -> None:
    simulation = simulate(replace(LINES, seed=1))
    graph = graph_of(simulation)
    truth, image = either_side_of_the_line(graph, true_frames(simulation, graph))
    most = MODEL.integrity.cost_excluded_sigmas * by_chance(truth, image)
    assert most > MODEL.integrity.cost_excluded
    near, far = image._replace(cost=truth.cost + 0.99 * most), image._replace(cost=truth.cost + 1.01 * most)
    assert not_excluded(truth, [near, far]) == [near]
    same = truth._replace(cost=truth.cost + 1.01 * MODEL.integrity.cost_excluded)
    assert not_excluded(truth, [same]) == []
