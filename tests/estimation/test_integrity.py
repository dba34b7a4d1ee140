from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.solver_scenes import frames_of, off_in_plane, offs, recording_of, track_of
from support.solver_scenes import register_rigid as register

from synchronizar.data.registration import Registration, State
from synchronizar.estimation.hypotheses import moved
from synchronizar.estimation.integrity import _beyond_in_plane
from synchronizar.geometry import YawFrame
from synchronizar.io.registration_folder import registration_json
from synchronizar.parameters import Parameters
from synchronizar.simulation.simulate import Scene, Simulation, simulate

OFF = Parameters().integrity.largest_error


def registered(scene: Scene) -> tuple[Simulation, Registration]:
    simulation = simulate(scene)
    return simulation, register(simulation.recording)


def states(registration: Registration) -> list[State]:
    return [user.state for user in registration.users.values()]


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("users", [2, 4])
def test_people_who_walk_freely_are_registered(users: int, seed: int) -> None:
    simulation, registration = registered(Scene(users=users, seed=seed))
    assert set(states(registration)) == {State.REGISTERED}
    assert registration.alternatives == ()
    assert max(offs(simulation, registration).values()) < 0.3
    for user in registration.users.values():
        assert user.reason
        assert user.unseen_direction is None


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("users", [2, 3])
def test_walkers_of_lines_are_ambiguous_and_the_truth_is_among_the_alternatives(users: int, seed: int) -> None:
    simulation, registration = registered(Scene(users=users, walk=("line",), seed=seed))
    assert states(registration) == [State.REGISTERED] + [State.AMBIGUOUS] * (users - 1)
    worst = [
        max(
            off_in_plane(simulation, registration.reference, name, frame)
            for name, frame in alternative.common_from_user.items()
        )
        for alternative in registration.alternatives
    ]
    assert len(worst) >= 2
    assert min(worst) < 0.4
    assert max(worst) > OFF
    for user in list(registration.users.values())[1:]:
        assert str(len(registration.alternatives)) in user.reason


@pytest.mark.parametrize("seed", range(4))
def test_alternatives_come_best_first_and_the_first_is_the_answer(seed: int) -> None:
    _, registration = registered(Scene(users=3, walk=("line",), late_share=0.1, seed=seed))
    costs = [alternative.cost for alternative in registration.alternatives]
    assert len(costs) >= 2
    assert costs[0] == 0.0
    assert costs == sorted(costs)
    assert costs[-1] <= Parameters().integrity.cost_excluded_nlos
    first = registration.alternatives[0].common_from_user
    assert first == {name: user.common_from_user for name, user in registration.users.items()}


def test_the_two_alternatives_of_two_lines_cost_the_same() -> None:
    _, registration = registered(Scene(walk=("line",), seed=1))
    assert [a.cost for a in registration.alternatives] == pytest.approx([0.0, 0.0], abs=0.05)


@pytest.mark.parametrize("seed", range(5))
def test_a_user_that_stands_still_has_an_unobservable_heading_and_that_is_said(seed: int) -> None:
    simulation, registration = registered(Scene(users=3, walk=("free", "still", "free"), seed=seed))
    assert states(registration)[:2] == [State.REGISTERED, State.UNOBSERVABLE]
    standing = registration.users["phone1"]
    assert "heading" in standing.reason
    assert standing.unseen_direction is not None
    assert abs(standing.unseen_direction[3]) > 0.95  # a unit vector over x, y, z, yaw
    assert np.linalg.norm(standing.unseen_direction) == pytest.approx(1.0)
    assert registration.alternatives == ()
    # Where it stands is known all the same.
    assert standing.common_from_user is not None
    true = simulation.world_from_user["phone0"].inverse() @ simulation.world_from_user["phone1"]
    assert np.hypot(standing.common_from_user.x - true.x, standing.common_from_user.y - true.y) < 0.3


@pytest.mark.parametrize("seed", range(4))
def test_of_two_users_that_stand_still_neither_has_a_heading(seed: int) -> None:
    _, registration = registered(Scene(users=3, walk=("still", "free", "still"), seed=seed))
    assert registration.reference == "phone1"
    assert states(registration) == [State.UNOBSERVABLE, State.REGISTERED, State.UNOBSERVABLE]
    for name in ("phone0", "phone2"):
        unseen = registration.users[name].unseen_direction
        assert unseen is not None
        assert abs(unseen[3]) > 0.95


def test_the_heading_of_a_device_that_lies_on_a_table_is_its_prior_s_alone() -> None:
    simulation = simulate(Scene(users=3, walk=("free", "still", "free"), seed=1))
    own = simulation.recording.tracks["phone1"]
    lying = replace(own, position=np.tile(own.position[0], (len(own), 1)))
    recording = replace(simulation.recording, tracks={**simulation.recording.tracks, "phone1": lying})
    user = register(recording).users["phone1"]
    assert user.state is State.UNOBSERVABLE
    assert "yaw" in user.prior_dominated
    assert user.covariance is not None
    assert np.sqrt(user.covariance[3, 3]) == pytest.approx(Parameters().priors.yaw_sigma, rel=1e-3)


def test_two_who_do_nothing_but_stand_know_of_each_other_s_distance_only() -> None:
    _, registration = registered(Scene(users=2, walk=("still",), seed=2))
    assert states(registration) == [State.REGISTERED, State.UNOBSERVABLE]
    other = registration.users["phone1"]
    assert "yaw" in other.prior_dominated


def test_a_user_that_stands_away_from_its_own_origin_has_an_unseen_turn_about_where_it_stands() -> None:
    """Its origin swings about its place: (y, -x, 0, 1) for a place (x, y) as it lies in the common axes."""
    simulation = simulate(Scene(users=3, walk=("free", "still", "free"), seed=1))
    own = simulation.recording.tracks["phone1"]
    away = replace(own, position=own.position + np.array([3.0, 4.0, 0.0]))
    recording = replace(simulation.recording, tracks={**simulation.recording.tracks, "phone1": away})
    standing = register(recording).users["phone1"]
    assert standing.state is State.UNOBSERVABLE
    assert standing.common_from_user is not None
    assert standing.unseen_direction is not None
    x, y, _ = YawFrame(yaw=standing.common_from_user.yaw) @ np.array([3.0, 4.0, 0.0])
    expected = np.array([y, -x, 0.0, 1.0]) / np.sqrt(26.0)
    assert abs(standing.unseen_direction @ expected) > 0.99


def test_without_any_range_nobody_is_tied_to_the_reference() -> None:
    simulation = simulate(Scene(users=3, seed=1))
    registration = register(replace(simulation.recording, ranges=simulation.recording.ranges.select(np.zeros(0, int))))
    assert states(registration) == [State.REGISTERED, State.DISCONNECTED, State.DISCONNECTED]
    for user in list(registration.users.values())[1:]:
        assert user.common_from_user is None
        assert user.covariance is None
    assert set(registration.tracks(simulation.recording)) == {"phone0"}


def test_users_whose_tracks_share_no_time_are_disconnected() -> None:
    simulation = simulate(Scene(users=3, seed=2))
    tracks = dict(simulation.recording.tracks)
    tracks["phone2"] = replace(tracks["phone2"], t=tracks["phone2"].t + 1000.0)
    registration = register(replace(simulation.recording, tracks=tracks))
    assert states(registration) == [State.REGISTERED, State.REGISTERED, State.DISCONNECTED]
    r = simulation.recording.ranges
    with_gone = (r.a == 2) | (r.b == 2)
    np.testing.assert_array_equal(registration.ranges.usable, ~with_gone)


def test_of_two_islands_the_reference_s_own_is_registered() -> None:
    simulation = simulate(Scene(users=4, seed=3))
    r = simulation.recording.ranges
    within = (r.a < 2) == (r.b < 2)
    registration = register(replace(simulation.recording, ranges=r.select(within)))
    assert states(registration)[:2] == [State.REGISTERED] * 2
    assert states(registration)[2:] == [State.DISCONNECTED] * 2
    other = register(replace(simulation.recording, ranges=r.select(within)), reference="phone3")
    assert states(other) == [State.DISCONNECTED, State.DISCONNECTED, State.REGISTERED, State.REGISTERED]
    alone = register(replace(simulation.recording, ranges=r.select((r.a < 2) & (r.b < 2))))
    np.testing.assert_array_equal(frames_of(registration)[:2], frames_of(alone)[:2])


def test_a_user_whose_ranges_are_nearly_all_wrong_is_not_called_registered() -> None:
    simulation = simulate(Scene(users=3, seed=4))
    r = simulation.recording.ranges
    random = np.random.default_rng(4)
    of_last = (r.a == 2) | (r.b == 2)
    nonsense = np.where(of_last, random.uniform(0.0, 50.0, len(r)), r.distance)
    registration = register(replace(simulation.recording, ranges=replace(r, distance=nonsense)))
    assert registration.users["phone2"].state is not State.REGISTERED


def test_a_single_range_registers_nobody() -> None:
    simulation = simulate(Scene(seed=5))
    registration = register(replace(simulation.recording, ranges=simulation.recording.ranges.select(np.array([50]))))
    assert states(registration)[1] in (State.AMBIGUOUS, State.UNOBSERVABLE)


def test_a_static_radio_has_a_place_and_no_heading() -> None:
    simulation, registration = registered(Scene(users=2, static_radios=1, height_bob=0.3, seconds=20.0, seed=6))
    radio = registration.users["radio0"]
    assert radio.static
    assert radio.covariance is not None
    assert np.isnan(radio.covariance[3]).all()
    assert np.isnan(radio.covariance[:, 3]).all()
    assert np.isfinite(radio.covariance[:3, :3]).all()
    assert "yaw" not in radio.prior_dominated
    assert offs(simulation, registration)["radio0"] < 0.3
    written = registration_json(registration)["users"]["radio0"]
    assert written["yaw"] is None
    assert written["covariance"][3] == [None] * 4


def test_a_height_that_only_the_prior_knows_is_told() -> None:
    """Level walks in the same plane: the ranges see the difference in height to second order only."""
    _, registration = registered(Scene(height_bob=0.0, height_spread=0.0, seed=7))
    assert "z" in registration.users["phone1"].prior_dominated
    _, bobbing = registered(Scene(height_bob=0.8, seconds=30.0, seed=7))
    assert bobbing.users["phone1"].prior_dominated == ()


def test_a_radio_whose_height_may_be_either_is_not_registered() -> None:
    """Walkers on the level: it is as far above as it may be below, 2 m and more apart."""
    registration = registered(Scene(users=2, static_radios=1, height_bob=0.0, height_spread=0.0, seed=8))[1]
    assert registration.users["radio0"].state in (State.AMBIGUOUS, State.UNOBSERVABLE)


def test_the_same_walk_told_for_longer_is_known_no_worse() -> None:
    simulation = simulate(Scene(seconds=40.0, seed=9))
    r = simulation.recording.ranges
    sigmas = []
    for seconds in (5.0, 10.0, 20.0, 40.0):
        covariance = register(replace(simulation.recording, ranges=r.select(r.t < seconds))).users["phone1"].covariance
        assert covariance is not None
        sigmas.append(float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1])))
    assert (np.diff(sigmas) < 0.0).all()


@given(seed=st.integers(0, 2**32 - 1), users=st.integers(1, 5))
@settings(derandomize=True, deadline=None, max_examples=40)
def test_how_far_two_placements_lie_apart_is_where_it_is_most(seed: int, users: int) -> None:
    random = np.random.default_rng(seed)
    frames, others = random.uniform(-3.0, 3.0, (2, users, 4))
    extent = random.uniform(-5.0, 5.0, (users, 6, 3))
    expected = [
        max(np.linalg.norm(YawFrame(*f.tolist()) @ p - YawFrame(*g.tolist()) @ p) for p in c)
        for f, g, c in zip(frames, others, extent, strict=True)
    ]
    np.testing.assert_allclose(moved(frames, others, extent), expected)


def test_a_user_with_a_single_range_to_a_standing_one_does_not_raise() -> None:
    still = track_of(np.arange(3.0), np.zeros((3, 3)))
    registration = register(recording_of({"a": still, "b": still}, [(1.0, "a", "b", 2.0)]))
    assert states(registration)[0] is State.REGISTERED
    assert states(registration)[1] in (State.AMBIGUOUS, State.UNOBSERVABLE)


@pytest.mark.parametrize("ratio", [0.0, 0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0])
def test_the_probability_of_an_error_in_the_plane_is_near_the_share_of_two_million(ratio: float) -> None:
    """For every ratio of the axes: from 0.83 of the share beyond the limit to 1.15 of it, chance (4 sigma) apart."""
    long = 0.3
    measurements = np.random.default_rng(0).standard_normal((2, 2_000_000)) * [[long], [ratio * long]]
    off = np.hypot(*measurements)
    for limit in long * np.array([0.0, 0.1, 0.25, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5]):
        beyond = int((off > limit).sum())
        share, chance = beyond / off.size, 4.0 * np.sqrt(beyond) / off.size
        told = _beyond_in_plane(float(limit), long, ratio * long)
        assert 0.83 * (share - chance) <= told <= min(1.15 * share + chance, 1.0)


def test_the_probability_of_an_error_in_the_plane_at_the_ends() -> None:
    """Along a line it is the normal's own, of a circle Rayleigh's; where nothing is uncertain none."""
    assert _beyond_in_plane(0.6, 0.3, 0.0) == pytest.approx(0.0455, abs=1e-4)
    assert _beyond_in_plane(0.6, 0.3, 0.3) == pytest.approx(float(np.exp(-2.0)))
    assert _beyond_in_plane(0.0, 0.3, 0.1) == 1.0
    assert _beyond_in_plane(0.6, 0.0, 0.0) == 0.0
    assert _beyond_in_plane(0.6, 0.3, 0.2) < _beyond_in_plane(0.5, 0.3, 0.2) < _beyond_in_plane(0.5, 0.4, 0.2)
