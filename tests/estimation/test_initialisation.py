from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.solver_scenes import off_in_plane, own_points, recording_of, track_of

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.estimation.initialisation import Candidate, joint_placements, placements_in_parts
from synchronizar.geometry import YawFrame
from synchronizar.graph.problem import Problem
from synchronizar.parameters import Parameters
from synchronizar.simulation.simulate import Scene, Simulation, simulate

MODEL = Parameters()
few = settings(derandomize=True, deadline=None, max_examples=12)
seeds = st.integers(0, 2**31 - 1)


def hypotheses(recording: Recording, reference: int = 0) -> list[Candidate]:
    problem = Problem.of(recording, reference, MODEL)
    assert problem.active_users == list(range(len(recording.users)))
    return joint_placements(problem)


def farthest(simulation: Simulation, hypothesis: Candidate, reference: int = 0) -> float:
    """How far (m) from its place in the plane any point of anybody's walk is put."""
    users = simulation.recording.users
    name = users[reference].name
    return max(
        off_in_plane(simulation, name, user.name, YawFrame(*frame.tolist()))
        for user, frame in zip(users, hypothesis.frames, strict=True)
    )


def clean(users: int, seed: int, **changed: object) -> Simulation:
    return simulate(Scene(users=users, seed=seed, sigma=0.0, height_spread=0.0, **changed))  # type: ignore[arg-type]


@given(users=st.integers(2, 5), links=st.sampled_from(["all", "star", "chain"]), seed=seeds)
@few
def test_without_noise_the_best_placement_is_the_truth(users: int, links: str, seed: int) -> None:
    simulation = clean(users, seed, links=links)
    found = hypotheses(simulation.recording)
    assert min(farthest(simulation, h) for h in found) < 0.1
    assert farthest(simulation, found[0]) < 0.1


@given(users=st.integers(2, 4), links=st.sampled_from(["all", "chain"]), seed=seeds, last=st.booleans())
@few
def test_whoever_is_the_reference_everybody_is_placed_in_its_frame(
    users: int, links: str, seed: int, last: bool
) -> None:
    simulation = clean(users, seed, links=links)
    reference = users - 1 if last else users // 2
    found = hypotheses(simulation.recording, reference)
    np.testing.assert_allclose(found[0].frames[reference], 0.0, atol=1e-12)
    assert farthest(simulation, found[0], reference) < 0.1


@given(seed=seeds)
@few
def test_a_reference_that_ranges_to_one_user_only_places_all(seed: int) -> None:
    simulation = clean(4, seed, seconds=15.0)
    r = simulation.recording.ranges
    kept = (np.minimum(r.a, r.b) > 0) | (np.maximum(r.a, r.b) == 3)
    recording = replace(simulation.recording, ranges=r.select(kept))
    assert farthest(simulation, hypotheses(recording)[0]) < 0.15


@given(users=st.integers(1, 3), radios=st.integers(1, 3), seed=seeds)
@few
def test_static_radios_are_placed_and_have_no_heading(users: int, radios: int, seed: int) -> None:
    if users == 1:
        users, links = 2, "chain"
    else:
        links = "all"
    simulation = clean(users, seed, static_radios=radios, links=links)
    found = hypotheses(simulation.recording)
    assert min(farthest(simulation, h) for h in found) < 0.15


def test_one_walker_and_its_radios_are_placed() -> None:
    simulation = clean(2, 3, static_radios=3)
    r = simulation.recording.ranges
    users = simulation.recording.users
    assert [user.name for user in users] == ["phone0", "phone1", "radio0", "radio1", "radio2"]
    kept = (r.a != 1) & (r.b != 1)
    alone = replace(
        simulation.recording,
        users=(users[0], *users[2:]),
        tracks={"phone0": simulation.recording.tracks["phone0"]},
        ranges=replace(
            r.select(kept),
            a=np.maximum(r.a[kept] - 1, 0).astype(np.int32),
            b=np.maximum(r.b[kept] - 1, 0).astype(np.int32),
        ),
    )
    best = hypotheses(alone)[0]
    for user, frame in zip(alone.users, best.frames, strict=True):
        assert off_in_plane(simulation, "phone0", user.name, YawFrame(*frame.tolist())) < 0.1


def mirrored_in_the_walk_of(points: Array, line: Array) -> Array:
    """Points (n, 2) reflected in the straight line that points (m, 2) lie on."""
    middle = line.mean(axis=0)
    along = np.linalg.svd(line - middle)[2][0]
    away = points - middle
    return np.asarray(middle + 2.0 * np.outer(away @ along, along) - away)


@pytest.mark.parametrize("seed", range(6))
def test_two_who_walk_lines_are_placed_on_both_sides(seed: int) -> None:
    simulation = clean(2, seed, walk=("line",))
    found = hypotheses(simulation.recording)
    own = own_points(simulation.recording, "phone1")
    common_from_bob = simulation.world_from_user["phone0"].inverse() @ simulation.world_from_user["phone1"]
    true = (common_from_bob @ own)[:, :2]
    mirrored = mirrored_in_the_walk_of(true, own_points(simulation.recording, "phone0")[:, :2])
    for image in (true, mirrored):
        off = [np.linalg.norm((YawFrame(*h.frames[1].tolist()) @ own)[:, :2] - image, axis=1).max() for h in found]
        assert min(off) < 0.1


def test_hypotheses_come_best_first_and_none_is_hopeless() -> None:
    found = hypotheses(simulate(Scene(users=3, walk=("line",), seed=1)).recording)
    costs = [h.cost for h in found]
    assert costs == sorted(costs)
    assert costs[-1] <= costs[0] + MODEL.search.cost_alive
    assert 1 < len(found) <= MODEL.search.most_hypotheses


def test_the_reference_alone_is_one_hypothesis() -> None:
    recording = recording_of({"a": track_of(np.arange(3.0), np.zeros((3, 3)))}, [])
    (only,) = hypotheses(recording)
    np.testing.assert_array_equal(only.frames, np.zeros((1, 4)))


def test_parts_of_a_walk_whose_ranges_are_half_nlos_place_everybody_and_are_the_same_each_time() -> None:
    simulation = simulate(Scene(users=2, late_share=0.5, seed=3))
    found, again = (list(placements_in_parts(Problem.of(simulation.recording, 0, MODEL))) for _ in range(2))
    assert MODEL.search.parts < len(found) <= MODEL.search.parts * MODEL.search.most_followed
    assert min(farthest(simulation, candidate) for candidate in found) < 0.5
    for one, other in zip(found, again, strict=True):
        np.testing.assert_array_equal(one.frames, other.frames)
