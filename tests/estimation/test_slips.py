"""SLAM that slips over seconds, so that no single step betrays it: put right, and told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.solver_scenes import recording_of, track_of, true_frames

from synchronizar.arrays import Array
from synchronizar.data.jump import Jump
from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.data.track import Track
from synchronizar.estimation.register import register
from synchronizar.estimation.segments import coarse_interval, search_and_grow
from synchronizar.estimation.slips import relaid, slips
from synchronizar.geometry import apply_frames, rotation_2d
from synchronizar.graph.pose_graph import PoseGraph
from synchronizar.graph.problem import Problem
from synchronizar.graph.states import States
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.keyframes import keyframes_of
from synchronizar.preprocessing.relocalizations import repair_relocalizations
from synchronizar.quaternions import multiply_quaternions
from synchronizar.reporting.evaluate import evaluate
from synchronizar.simulation.simulate import Scene, simulate

MODEL = Parameters()
SLIP_BEGINS, SLIP_LASTS, SLIP_TURN = 18.0, 4.0, 1.75


def slipped(track: Track, turn: float) -> Track:
    """The same walk by a SLAM whose heading slips: every step from then on is turned by what it has slipped."""
    slip = turn * np.clip((track.t - SLIP_BEGINS) / SLIP_LASTS, 0.0, 1.0)
    way = np.diff(track.position, axis=0)
    for n, angle in enumerate(slip[:-1].tolist()):
        way[n, :2] = rotation_2d(angle) @ way[n, :2]
    position = track.position[0] + np.vstack([np.zeros(3), np.cumsum(way, axis=0)])
    turned = np.column_stack([np.zeros((len(slip), 2)), np.sin(0.5 * slip), np.cos(0.5 * slip)])
    return Track(track.t, position, multiply_quaternions(turned, track.quat_xyzw))


# ---- a heading that slips by 100 degrees in four seconds ----


@pytest.mark.parametrize("turn", [SLIP_TURN, -SLIP_TURN])
@pytest.mark.parametrize("seed", range(4))
def test_a_heading_that_slips_is_put_right_and_told(seed: int, turn: float) -> None:
    simulation = simulate(Scene(users=3, seconds=40.0, seed=seed))
    tracks = dict(simulation.recording.tracks)
    tracks["phone1"] = slipped(tracks["phone1"], turn)
    recording = replace(simulation.recording, tracks=tracks)

    rigid = register(recording, model="rigid")
    assert (evaluate(rigid.tracks(recording), simulation.truth, "phone0").joint_ate_xy or 0.0) > 0.5  # it matters
    registration = register(recording)
    joint = evaluate(registration.tracks(recording), simulation.truth, "phone0").joint_ate_xy
    assert joint is not None
    assert joint < 0.15

    assert registration.users["phone0"].jumps == registration.users["phone2"].jumps == ()
    jumps = registration.users["phone1"].jumps
    assert jumps
    middle = SLIP_BEGINS + 0.5 * SLIP_LASTS
    largest = max(jumps, key=lambda jump: abs(jump.turn))
    assert abs(largest.t - middle) < 3.0
    assert max(abs(jump.t - middle) for jump in jumps) < 6.0  # when a part of it began few ranges tell
    assert sum(jump.turn for jump in jumps) == pytest.approx(turn, abs=0.3)
    for jump in jumps:
        assert recording.tracks["phone1"].t[jump.pose] == jump.t


@pytest.mark.parametrize("seed", range(4))
def test_walks_without_a_slip_tell_none(seed: int) -> None:
    registration = register(simulate(Scene(users=3, seconds=40.0, seed=seed)).recording)
    assert all(user.jumps == () for user in registration.users.values())
    assert all(user.state is State.REGISTERED for user in registration.users.values())


# ---- relaid ----


@pytest.mark.parametrize("seed", range(4))
def test_walks_that_are_in_place_are_not_laid_anew(seed: int) -> None:
    recording = simulate(Scene(users=3, seconds=40.0, seed=seed)).recording
    problem = Problem.of(recording, 0, MODEL)
    assert problem.active_users == [0, 1, 2]
    keyframes = [
        keyframes_of(repair_relocalizations(t, MODEL), coarse_interval(problem), MODEL)
        for t in recording.tracks.values()
    ]
    best = search_and_grow(problem, keyframes)[0]
    assert list(relaid(best.graph, best.states)) == []


@pytest.mark.parametrize("seed", range(3))
def test_what_follows_a_slip_is_laid_where_it_was(seed: int) -> None:
    """Begun as if nothing had slipped: the likeliest of what is yielded is nearer to where phone1 was."""
    simulation = simulate(Scene(users=3, seconds=40.0, seed=seed))
    clean = simulation.recording.tracks
    recording = replace(simulation.recording, tracks={**clean, "phone1": slipped(clean["phone1"], SLIP_TURN)})
    keyframes = [keyframes_of(repair_relocalizations(track, MODEL), 2.0, MODEL) for track in recording.tracks.values()]
    graph = PoseGraph(Problem.of(recording, 0, MODEL), keyframes)
    # Every own frame begins at its first pose, so the anchor is its origin.
    walks = graph.initial_states(true_frames(simulation, "phone0"))
    truth = simulation.world_from_user["phone0"].inverse() @ simulation.world_from_user["phone1"]
    true = truth @ clean["phone1"].at(keyframes[1].t, 1.0).position

    def off(of: States) -> float:
        """How far (m) phone1's keyframes are from there, root mean square."""
        laid = apply_frames(np.broadcast_to(of.anchor_poses[1], (len(true), 4)), of.keyframe_poses[1][:, :3])
        return float(np.sqrt(((laid - true)[:, :2] ** 2).sum(axis=1).mean()))

    elsewhere = list(relaid(graph, walks))
    assert 1 <= len(elsewhere) <= 3
    assert off(walks) > 1.0
    assert off(elsewhere[0]) < 0.6 * off(walks)
    for of in elsewhere:
        np.testing.assert_array_equal(of.anchor_poses[0], 0.0)  # the reference stays where it is
        assert all(
            np.allclose(keyframe_poses[0], start[0])
            for keyframe_poses, start in zip(of.keyframe_poses, walks.keyframe_poses, strict=True)
        )


# ---- slips, on walks written by hand ----


def straight() -> tuple[Recording, PoseGraph, States]:
    """Two people who go 1 m/s along x for 12 s, ten poses a second, a keyframe each second."""
    t = np.arange(0.0, 12.05, 0.1)
    tracks: dict[str, Track | None] = {
        name: track_of(t, np.column_stack([t, np.full_like(t, y), 0.0 * t])) for name, y in (("a", 0.0), ("b", 3.0))
    }
    recording = recording_of(tracks, [(s, "a", "b", 3.0) for s in np.arange(0.5, 12.0, 0.5).tolist()])
    keyframes = [keyframes_of(repair_relocalizations(track, MODEL), 1.0, MODEL) for track in recording.tracks.values()]
    graph = PoseGraph(Problem.of(recording, 0, MODEL), keyframes)
    return recording, graph, graph.initial_states(np.array([[0.0, 0.0, 0.0, 0.0], [0.0, 3.0, 0.0, 0.0]]))


def bent(walks: States, by: Array) -> States:
    """User 1's keyframes moved by (m, 4)."""
    return walks._replace(keyframe_poses=[walks.keyframe_poses[0], walks.keyframe_poses[1] + by])


def told(by: Array, user: int = 1) -> tuple[Jump, ...]:
    recording, graph, walks = straight()
    return slips(bent(walks, by), graph, user, recording.tracks["ab"[user]])


def step_sigma() -> Array:
    """(2,) of a step in the plane (m) and of a turn (rad); all steps here are alike."""
    _, graph, _ = straight()
    sigma = graph.keyframes[1].step_sigma
    assert np.allclose(sigma, sigma[0])
    return sigma[0, [0, 2]]


def test_slam_that_is_believed_has_not_slipped() -> None:
    by = np.zeros((13, 4))
    assert told(by) == ()
    by[5:, 0] = 4.9 * step_sigma()[0]
    assert told(by) == ()
    by[5:, 0] = 5.1 * step_sigma()[0]
    assert len(told(by)) == 1
    assert told(by, user=0) == ()


def test_steps_that_follow_each_other_are_one_slip_and_others_another() -> None:
    """The 4th and 5th step, each 10 sigma of x, and the 9th, 10 sigma of y."""
    metre = step_sigma()[0]
    by = np.zeros((13, 4))
    by[4:, 0] += 10.0 * metre
    by[5:, 0] += 10.0 * metre
    by[9:, 1] += 10.0 * metre
    first, second = told(by)
    assert [first.t, second.t] == pytest.approx([5.0, 9.0])
    assert (first.pose, second.pose) == (50, 90)
    assert first.distance == pytest.approx(20.0 * metre)
    assert second.distance == pytest.approx(10.0 * metre)
    assert [first.turn, second.turn] == pytest.approx([0.0, 0.0])


def test_the_turn_is_slam_s_own_the_opposite_of_what_put_it_right() -> None:
    """At the last step, so that no later one is turned with it."""
    radian = step_sigma()[1]
    by = np.zeros((13, 4))
    by[12, 3] = 10.0 * radian
    (slip,) = told(by)
    assert slip.turn == pytest.approx(-10.0 * radian)
    assert slip.distance == pytest.approx(0.0, abs=1e-12)
    assert slip.t == pytest.approx(12.0)


def test_a_slip_in_height_is_one_too() -> None:
    by = np.zeros((13, 4))
    by[1:, 2] = 10.0 * step_sigma()[0]
    (slip,) = told(by)
    assert slip.t == pytest.approx(1.0)
    assert slip.distance == pytest.approx(10.0 * step_sigma()[0])
