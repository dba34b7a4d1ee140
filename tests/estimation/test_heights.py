"""Devices that are not held as usual: on a robot, on a stand, by somebody who sits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from synchronizar.arrays import Array
from synchronizar.data.registration import Registration, State
from synchronizar.estimation.register import register
from synchronizar.graph.marginals import _sigma_of_quartic
from synchronizar.graph.pose_graph import PoseGraph
from synchronizar.graph.problem import Problem
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.keyframes import keyframes_of
from synchronizar.preprocessing.relocalizations import repair_relocalizations
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

MODEL = Parameters()


@pytest.mark.parametrize(("spread", "seed"), [(0.4, 0), (0.4, 26), (0.8, 14), (0.8, 25), (0.8, 40)])
def test_where_devices_lie_far_apart_nobody_is_registered_at_a_wrong_height(spread: float, seed: int) -> None:
    """With heights' prior as Student's t, somebody was registered 0.8 to 1.3 m off in each of these."""
    simulation = simulate(Scene(users=3, seconds=12.0, height_spread=spread, seed=seed))
    registration = register(simulation.recording)
    to_common = simulation.world_from_user[registration.reference].inverse()
    for name, user in registration.users.items():
        if user.state is State.REGISTERED and user.common_from_user is not None:
            assert abs(user.common_from_user.z - (to_common @ simulation.world_from_user[name]).z) < 0.4


def graph_of_three() -> PoseGraph:
    recording = simulate(Scene(users=3, seconds=3.0, seed=1)).recording
    tracks = [repair_relocalizations(recording.tracks[user.name], MODEL) for user in recording.users]
    return PoseGraph(Problem.of(recording, 0, MODEL), [keyframes_of(track, 1.0, MODEL) for track in tracks])


def test_the_cost_of_heights_is_that_of_a_normal_distribution_about_a_level_that_nobody_knows() -> None:
    """What a device costs that is held otherwise: the density of the two differences, computed by itself."""
    graph, share = graph_of_three(), MODEL.priors.usual_height_share
    frames = np.zeros((3, 4))
    frames[1:, 2] = 0.2, -0.7
    differences = np.array([[-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]])

    def density(usual: Array) -> float:
        sigma = np.where(usual, MODEL.priors.height_sigma, MODEL.priors.other_height_sigma) / np.sqrt(2.0)
        covariance = differences @ np.diag(sigma**2) @ differences.T
        off = differences @ frames[:, 2]
        prior = np.where(usual, share, 1.0 - share).prod()
        return float(np.log(prior) - 0.5 * (off @ np.linalg.solve(covariance, off) + np.linalg.slogdet(covariance)[1]))

    usual = np.ones(3, dtype=bool)
    for otherwise in ([2], [0], [1, 2]):
        held = usual.copy()
        held[otherwise] = False
        gain = graph.height_weights(frames)[1] - graph.with_held_as_usual(held).height_weights(frames)[1]
        assert gain == pytest.approx(density(held) - density(usual), rel=1e-9)


def test_a_pinned_height_is_kept_while_all_else_is_at_its_best() -> None:
    graph = graph_of_three()
    states, em_weights = graph.initial_states(np.zeros((3, 4))), graph.initial_em_weights()
    heights = np.array([0.0, 0.4, 0.0])
    begin = states._replace(anchor_poses=np.column_stack([states.anchor_poses[:, :2], heights, np.zeros(3)]))
    pinned = graph.with_pinned_heights(heights, [1])
    there = pinned.optimised(begin, states.anchor_poses, em_weights, 1.0, 20, 1e-6)
    assert there.anchor_poses[1, 2] == pytest.approx(0.4, abs=0.01)
    assert np.abs(there.anchor_poses[2, :2]).max() > 0.1  # who is free has moved


@pytest.mark.parametrize(
    "cost",
    [
        lambda x: 0.5 * (x / 0.5) ** 2,
        lambda x: 0.5 * (x / 0.5) ** 2 + 20.0 * x**4,
        lambda x: 0.5 * (x / 0.5) ** 2 + 2.0 * x**3 + 20.0 * x**4,
    ],
)
def test_a_heights_spread_is_that_of_the_quartic_through_its_costs(cost: Callable[[float], float]) -> None:
    found = _sigma_of_quartic(0.5, 0.6, cost(0.6), cost(-0.6))
    square = quad(lambda x: x**2 * np.exp(-cost(x)), -2.4, 2.4)[0] / quad(lambda x: np.exp(-cost(x)), -2.4, 2.4)[0]
    assert found == pytest.approx(np.sqrt(square), rel=0.01)


@pytest.mark.parametrize(("users", "seed"), [(6, 3), (6, 12), (5, 8)])
def test_where_many_devices_are_held_otherwise_each_is_registered_at_its_height(users: int, seed: int) -> None:
    """Of six who was a little beside the others was contradicted; of five two were taken for slips of their SLAM."""
    simulation = simulate(Scene(users=users, seconds=12.0, height_spread=0.8, seed=seed))
    registration = register(simulation.recording)
    to_common = simulation.world_from_user[registration.reference].inverse()
    for name, user in registration.users.items():
        assert user.state is State.REGISTERED
        assert user.common_from_user is not None
        assert abs(user.common_from_user.z - (to_common @ simulation.world_from_user[name]).z) < 0.15


def last_height(registration: Registration, name: str) -> float:
    """m above the reference."""
    tracks = [registration.users[who].common_track for who in (name, registration.reference)]
    own, reference = (track.position[-1, 2] for track in tracks if track is not None)
    return float(own - reference)


def test_whose_slam_drifts_in_height_stays_as_high_as_one_is_on_one_floor() -> None:
    """Beside a model that does not know that people stay on one floor."""
    free = MODEL.changed(priors={"level_sigma": 100.0})
    off: dict[str, list[float]] = {"level": [], "free": []}
    drift = {"drift_m_per_sqrt_s": 0.04, "drift_rad_per_sqrt_s": 0.02}
    for seed in range(8):
        simulation = simulate(Scene(users=2, seconds=60.0, seed=seed, **drift))
        true = simulation.truth["phone1"].position[-1, 2] - simulation.truth["phone0"].position[-1, 2]
        for which, parameters in (("level", MODEL), ("free", free)):
            registration = register(simulation.recording, reference="phone0", parameters=parameters)
            off[which].append(last_height(registration, "phone1") - true)
    assert np.linalg.norm(off["level"]) < 0.8 * np.linalg.norm(off["free"])


@pytest.mark.parametrize("rises", [0.8, 1.5])
def test_who_walks_up_a_ramp_is_not_held_to_one_height(rises: float) -> None:
    simulation = simulate(Scene(users=3, seconds=40.0, seed=2, drift_m_per_sqrt_s=0.02, drift_rad_per_sqrt_s=0.01))
    recording, truth = simulation.recording, dict(simulation.truth)
    tracks = dict(recording.tracks)
    for of in (tracks, truth):
        track = of["phone1"]
        up = np.outer((track.t - track.t[0]) / 40.0, [0.0, 0.0, rises])
        of["phone1"] = replace(track, position=track.position + up)
    ranges, random = recording.ranges, np.random.default_rng(0)
    places = {name: truth[name].at(ranges.t, np.inf).position for name in truth}
    names = [user.name for user in recording.users]
    ends = [np.array([places[names[u]][n] for n, u in enumerate(of)]) for of in (ranges.a, ranges.b)]
    distance = np.linalg.norm(ends[0] - ends[1], axis=1) + random.normal(0.0, 0.1, len(ranges))
    there = replace(recording, tracks=tracks, ranges=replace(ranges, distance=distance))
    registration = register(there, reference="phone0")
    true = truth["phone1"].position[-1, 2] - truth["phone0"].position[-1, 2]
    assert abs(last_height(registration, "phone1") - true) < 0.15
