"""The full model: SLAM that drifts, jumps and has a wrong scale, clocks that are off, radios with a bias."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from support.paths import SHARED
from support.solver_scenes import frames_of, off_in_plane, offs, recording_of, track_of

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration, State
from synchronizar.data.track import Track
from synchronizar.estimation.register import register
from synchronizar.io.registration_folder import registration_json
from synchronizar.parameters import Parameters
from synchronizar.reporting.evaluate import evaluate
from synchronizar.simulation.simulate import Scene, Simulation, simulate

MODEL = Parameters()


def joint_ate_xy(registration: Registration, simulation: Simulation, recording: Recording | None = None) -> float:
    """m; the recording is the simulation's own unless it is told."""
    tracks = registration.tracks(recording or simulation.recording)
    joint = evaluate(tracks, simulation.truth, registration.reference).joint_ate_xy
    assert joint is not None
    return joint


def states(registration: Registration) -> list[State]:
    return [user.state for user in registration.users.values()]


# ---- where nothing is wrong nothing is lost ----


@pytest.mark.parametrize(("users", "late"), [(4, 0.0), (6, 0.0), (3, 0.3), (3, 0.5)])
def test_where_devices_are_right_the_answer_is_about_as_good_as_that_of_the_model_which_trusts_them(
    users: int, late: float
) -> None:
    squares = np.zeros((2, 3))
    for seed in range(3):
        simulation = simulate(Scene(users=users, seconds=12.0 if late == 0.0 else 20.0, late_share=late, seed=seed))
        for n, model in enumerate(("full", "rigid")):
            squares[n, seed] = joint_ate_xy(register(simulation.recording, model=model), simulation) ** 2
    full, rigid = np.sqrt(squares.mean(axis=1))
    assert full < 1.35 * rigid


def test_among_half_nlos_a_bent_walk_gives_way_to_the_one_that_slam_tells() -> None:
    """Two people whose late ranges pass for others where one of the walks bends by half a metre."""
    simulation = simulate(Scene(users=2, seconds=20.0, seed=8011, late_share=0.5))
    assert joint_ate_xy(register(simulation.recording), simulation) < 0.1


def test_biases_are_not_taken_for_noise_of_the_ranges_among_nlos() -> None:
    """Weights that are measured on errors explain all of them, and those of 0.3 m biases are systematic."""
    wrong = Scene(
        users=4,
        seconds=60.0,
        seed=1,
        drift_m_per_sqrt_s=0.02,
        drift_rad_per_sqrt_s=0.01,
        scale_sigma=0.1,
        bias_sigma=0.3,
        clock_offset_sigma=0.1,
        late_share=0.4,
    )
    simulation = simulate(wrong)
    for name, user in register(simulation.recording).users.items():
        assert user.range_bias == pytest.approx(simulation.range_bias[name], abs=0.1)


# ---- what is wrong with devices is told ----


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("users", "radios"), [(2, 0), (3, 1), (4, 0)])
def test_scale_bias_and_clock_are_told_within_their_sigmas(users: int, radios: int, seed: int) -> None:
    scene = Scene(users=users, static_radios=radios, seconds=20.0, seed=seed)
    planted = replace(scene, scale_sigma=0.07, bias_sigma=0.05, clock_offset_sigma=0.07)
    simulation = simulate(planted)
    registration = register(simulation.recording)
    for name, user in registration.users.items():
        sigma, frame = user.calibration_sigma, user.common_from_user
        assert sigma is not None
        assert frame is not None
        assert abs(user.range_bias - simulation.range_bias[name]) < 4.0 * sigma.range_bias
        assert sigma.range_bias < np.hypot(MODEL.devices.bias_sigma, MODEL.devices.bias_common_sigma)
        if user.static:
            continue
        assert abs(frame.scale - simulation.world_from_user[name].scale) < 4.0 * sigma.scale
        assert user.clock_offset is not None
        assert abs(user.clock_offset - simulation.clock_offset[name]) < 4.0 * sigma.clock_offset
        assert sigma.scale < 0.03  # much less than the prior's: the ranges told it
        assert sigma.clock_offset < 0.8 * np.hypot(MODEL.devices.clock_sigma, MODEL.devices.clock_common_sigma)
    assert joint_ate_xy(registration, simulation) < 0.1


def test_sigmas_of_devices_are_as_large_as_the_errors() -> None:
    """The mean square of errors in sigmas, of 3 x 3 x 8 numbers, is 1 but for chance and the model's caution."""
    squares = []
    for seed in range(8):
        simulation = simulate(
            Scene(users=3, scale_sigma=0.05, bias_sigma=0.03, clock_offset_sigma=0.05, seconds=16.0, seed=100 + seed)
        )
        for name, user in register(simulation.recording).users.items():
            assert user.common_from_user is not None
            assert user.clock_offset is not None
            assert user.calibration_sigma is not None
            found = (user.common_from_user.scale, user.range_bias, user.clock_offset)
            scale = simulation.world_from_user[name].scale
            true = (scale, simulation.range_bias[name], simulation.clock_offset[name])
            squares.append(((np.array(found) - true) / user.calibration_sigma) ** 2)
    assert len(squares) == 24
    assert 0.2 < np.mean(squares) < 2.0


def test_all_users_at_once_are_as_sure_as_each_by_itself_and_hang_together() -> None:
    simulation = simulate(Scene(users=3, static_radios=1, seconds=20.0, drift_m_per_sqrt_s=0.02, seed=1))
    registration = register(simulation.recording)
    joint, users = registration.joint_covariance, list(registration.users.values())
    assert joint is not None
    assert not registration.alternatives
    for n, user in enumerate(users):
        assert user.covariance is not None
        np.testing.assert_allclose(joint[n, :, n], user.covariance, rtol=1e-3, atol=1e-7)
    known = [4 * n + axis for n, user in enumerate(users) for axis in range(3 if user.static else 4)]
    flat = joint.reshape(16, 16)
    assert np.isnan(np.delete(flat, known, axis=0)).all()
    variances, _ = np.linalg.eigh(flat[np.ix_(known, known)])
    assert variances.min() > 0.0
    # What the reference's own drift does to the common frame is common to all.
    walkers = [n for n, user in enumerate(users) if not user.static and user.name != registration.reference]
    a, b = (joint[n, 3] for n in walkers)
    assert a[walkers[1], 3] / np.sqrt(a[walkers[0], 3] * b[walkers[1], 3]) > 0.3


def test_the_rigid_model_does_not_tell_how_errors_hang_together() -> None:
    assert register(simulate(Scene()).recording, model="rigid").joint_covariance is None


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("users", [2, 3, 4])
def test_where_slam_drifts_tracks_are_nearer_to_the_truth_than_the_rigid_model_s(users: int, seed: int) -> None:
    scene = Scene(users=users, seconds=36.0, drift_m_per_sqrt_s=0.03, drift_rad_per_sqrt_s=0.02, seed=seed)
    simulation = simulate(scene)
    full, rigid = (joint_ate_xy(register(simulation.recording, model=k), simulation) for k in ("full", "rigid"))
    assert full < rigid
    assert full < 0.21


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("users", [2, 4])
def test_jumps_are_told_and_tracks_stay_in_place(users: int, seed: int) -> None:
    simulation = simulate(Scene(users=users, seconds=24.0, jumps=1, jump_m=0.5, jump_rad=0.2, seed=seed))
    registration = register(simulation.recording)
    for name, user in registration.users.items():
        track = simulation.recording.tracks[name]
        ways = np.linalg.norm(np.diff(track.position, axis=0), axis=1)
        after = int(np.argmax(ways)) + 1  # 0.5 m in a thirtieth of a second: nobody else goes 15 m/s
        (jump,) = user.jumps
        assert jump.pose == after
        assert jump.t == track.t[after]
        assert jump.distance == pytest.approx(0.5, abs=0.1)
        assert abs(jump.turn) == pytest.approx(0.2, abs=0.1)
        assert user.common_track is not None
        assert np.linalg.norm(np.diff(user.common_track.position, axis=0), axis=1).max() < 0.2
    off = joint_ate_xy(registration, simulation)
    assert off < 0.1
    assert joint_ate_xy(register(simulation.recording, model="rigid"), simulation) > 2.0 * off


def biased(recording: Recording, user: int, bias: float) -> Recording:
    r = recording.ranges
    return replace(recording, ranges=replace(r, distance=r.distance + bias * ((r.a == user) | (r.b == user))))


@pytest.mark.parametrize("seed", range(4))
def test_one_radio_that_is_far_off_moves_nobody_and_is_told(seed: int) -> None:
    """0.9 m, 15 times what is usual."""
    simulation = simulate(Scene(users=4, seconds=20.0, seed=seed))
    recording = biased(simulation.recording, 1, 0.9)
    registration = register(recording)
    clean, moved = register(simulation.recording).tracks(simulation.recording), registration.tracks(recording)
    for name, track in clean.items():
        assert np.linalg.norm(track.position - moved[name].position, axis=1).max() < 0.3
    biases = [user.range_bias for user in registration.users.values()]
    assert biases == pytest.approx([0.0, 0.9, 0.0, 0.0], abs=0.1)
    assert joint_ate_xy(registration, simulation, recording) < 0.1


@pytest.mark.parametrize("seed", range(6))
def test_whoever_a_radio_that_is_far_off_moves_among_three_is_not_registered(seed: int) -> None:
    simulation = simulate(Scene(users=3, seconds=24.0, seed=seed))
    registration = register(biased(simulation.recording, 1, 0.9))
    for name, off in offs(simulation, registration).items():
        assert off < 0.4 or registration.users[name].state is not State.REGISTERED


@pytest.mark.parametrize("seed", [3, 5, 8])
def test_what_drift_bends_straight_walks_by_does_not_tell_them_from_their_mirror_images(seed: int) -> None:
    scene = Scene(users=5, walk=("line",), seconds=12.0, drift_m_per_sqrt_s=0.02, drift_rad_per_sqrt_s=0.01, seed=seed)
    simulation = simulate(scene)
    registration = register(simulation.recording)
    for name, off in offs(simulation, registration).items():
        assert off < 0.6 or registration.users[name].state is not State.REGISTERED


@pytest.mark.parametrize("seed", [1, 7])
def test_a_height_that_its_prior_excludes_is_told_unless_the_recording_allows_it(seed: int) -> None:
    simulation = simulate(Scene(users=3, seconds=30.0, height_spread=1.2, height_bob=0.3, seed=seed))
    recording = simulation.recording
    rise = {n: simulation.world_from_user[n].z - simulation.world_from_user["phone0"].z for n in simulation.truth}
    high = max(rise, key=lambda n: abs(rise[n]))
    assert abs(rise[high]) > 1.2
    surprised = register(recording).users[high]
    assert surprised.state is State.UNOBSERVABLE
    assert "height_sigma" in surprised.reason
    told = tuple(replace(user, height_sigma=1.5) for user in recording.users)
    allowed = register(replace(recording, users=told)).users[high]
    assert allowed.state is State.REGISTERED
    assert allowed.common_from_user is not None
    assert abs(allowed.common_from_user.z - rise[high]) < 0.3


def test_a_height_that_drift_and_biases_could_take_up_is_found_all_the_same() -> None:
    """In this walk the optimum that a search leads to is 6.3 in log likelihood below the one at the true heights."""
    scene = Scene(users=5, seconds=12.0, drift_m_per_sqrt_s=0.02, drift_rad_per_sqrt_s=0.01, seed=20187)
    simulation = simulate(replace(scene, scale_sigma=0.05, bias_sigma=0.05, clock_offset_sigma=0.05))
    registration = register(simulation.recording)
    assert max(offs(simulation, registration).values()) < 0.3


@pytest.mark.skipif(not (SHARED / "cases").is_dir(), reason=f"{SHARED} is not there")
@pytest.mark.parametrize(("case", "low", "below"), [("room", "room", 1.3), ("robot_person_0.6", "bot", 0.6)])
@pytest.mark.parametrize("seconds", [10.0, 15.0])
def test_what_a_height_explains_is_not_taken_for_noise_of_the_ranges(
    case: str, low: str, below: float, seconds: float
) -> None:
    """With weights of ranges as small as such noise asks for, the prior held the height, for 20 s of either walk."""
    whole = Recording.load(SHARED / "cases" / case)
    ranges = whole.ranges.select(whole.ranges.t < whole.ranges.t.min() + seconds)
    user = register(replace(whole, ranges=ranges)).users[low]
    assert user.state is not State.REGISTERED
    assert "height_sigma" in user.reason
    assert user.common_from_user is not None
    assert abs(user.common_from_user.z + below) < 0.5


# ---- the contract ----

WRONG = {"scale_sigma": 0.05, "bias_sigma": 0.05, "clock_offset_sigma": 0.05, "drift_m_per_sqrt_s": 0.02, "jumps": 1}
SCENES = [
    Scene(users=3, seconds=20.0),
    Scene(users=3, static_radios=2, antennas=2, seconds=16.0, **WRONG),  # type: ignore[arg-type]
    Scene(users=4, seconds=16.0, late_joiners=1, drift_rad_per_sqrt_s=0.01, **WRONG),  # type: ignore[arg-type]
    Scene(users=2, walk=("line",)),
    Scene(users=2, walk=("free", "still"), height_bob=0.0, **WRONG),  # type: ignore[arg-type]
]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("scene", SCENES)
def test_the_frame_told_holds_at_the_last_pose_and_every_number_is_one(scene: Scene, seed: int) -> None:
    recording = simulate(replace(scene, seed=seed)).recording
    registration = register(recording)
    assert (registration.model, registration.method) == ("full", "joint")
    tracks = registration.tracks(recording)
    for name, user in registration.users.items():
        frame, covariance = user.common_from_user, user.covariance
        assert frame is not None
        assert covariance is not None
        assert user.reason
        if user.static:
            assert (user.clock_offset, frame.scale, user.jumps, user.common_track) == (None, 1.0, (), None)
            assert np.isnan(covariance[3]).all()
            assert np.isnan(covariance[:, 3]).all()
            assert "yaw" not in user.prior_dominated
            covariance = covariance[:3, :3]
        else:
            own = recording.tracks[name]
            np.testing.assert_array_equal(tracks[name].t, own.t)
            c, s = np.cos(frame.yaw), np.sin(frame.yaw)
            turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            expected = turn @ (frame.scale * own.position[-1]) + [frame.x, frame.y, frame.z]
            np.testing.assert_allclose(tracks[name].position[-1], expected, atol=1e-6)
            alike = np.abs(frame.rotate_quaternions(own.quat_xyzw[-1:]) @ tracks[name].quat_xyzw[-1])
            np.testing.assert_allclose(alike, 1.0, atol=1e-9)
        np.testing.assert_allclose(covariance, covariance.T, atol=1e-9)
        assert np.linalg.eigvalsh(covariance)[0] > 0.0
    json.dumps(registration_json(registration), allow_nan=False)


@pytest.mark.parametrize("seed", range(3))
def test_the_frame_told_holds_at_the_last_pose_where_minima_are_mixed(seed: int) -> None:
    recording = simulate(Scene(users=3, late_share=0.3, seed=seed)).recording
    registration = register(recording)
    for name, track in registration.tracks(recording).items():
        frame = registration.users[name].common_from_user
        assert frame is not None
        np.testing.assert_allclose(frame @ recording.tracks[name].position[-1], track.position[-1], atol=1e-6)


@pytest.mark.parametrize("reference", ["phone0", "phone2"])
def test_the_common_frame_is_the_reference_s_own_at_its_first_pose(reference: str) -> None:
    # One optimum: where two are mixed, the reference's track lies as their mean has its end.
    simulation = simulate(Scene(users=3, drift_m_per_sqrt_s=0.02, seconds=16.0, seed=3))
    recording = simulation.recording
    registration = register(recording, reference=reference)
    assert registration.reference == reference
    first = registration.tracks(recording)[reference]
    np.testing.assert_allclose(first.position[0], recording.tracks[reference].position[0], atol=1e-9)
    np.testing.assert_allclose(first.quat_xyzw[0], recording.tracks[reference].quat_xyzw[0], atol=1e-9)
    assert registration.users[reference].state is State.REGISTERED
    # Who is taken for the reference changes the frame, not where people are to one another.
    other = register(recording).between("phone0", "phone1")
    assert registration.between("phone0", "phone1").x == pytest.approx(other.x, abs=0.02)
    assert registration.between("phone0", "phone1").y == pytest.approx(other.y, abs=0.02)


def test_the_seconds_are_told_by_what_they_were_spent_on() -> None:
    seconds = register(simulate(Scene()).recording).seconds
    assert set(seconds) == {"load", "initialise", "solve"}
    assert all(s >= 0.0 for s in seconds.values())


# ---- what must not matter ----


def assert_same(one: Registration, other: Registration) -> None:
    """To the last bit, but for the time it took."""
    np.testing.assert_array_equal(frames_of(one), frames_of(other))
    for a, b in zip(one.users.values(), other.users.values(), strict=True):
        assert (a.state, a.reason, a.range_bias, a.clock_offset) == (b.state, b.reason, b.range_bias, b.clock_offset)
        np.testing.assert_array_equal(a.covariance, b.covariance)
        if a.common_track is not None and b.common_track is not None:
            np.testing.assert_array_equal(a.common_track.position, b.common_track.position)
    np.testing.assert_array_equal(one.ranges.weight, other.ranges.weight)
    np.testing.assert_array_equal(one.ranges.used, other.ranges.used)
    np.testing.assert_array_equal(one.ranges.residual, other.ranges.residual)


@pytest.mark.parametrize("late", [0.0, 0.3])
def test_the_same_recording_has_the_same_answer_twice(late: float) -> None:
    recording = simulate(Scene(users=3, late_share=late, seconds=16.0, seed=3)).recording
    assert_same(register(recording), register(recording))


@pytest.mark.parametrize("late", [0.0, 0.3])
@pytest.mark.parametrize("share", [1.0, 0.5])
def test_from_which_end_a_range_is_told_changes_nothing(share: float, late: float) -> None:
    recording = simulate(Scene(users=3, antennas=2, late_share=late, seconds=16.0, seed=4)).recording
    r = recording.ranges
    swap = np.random.default_rng(0).random(len(r)) < share
    ends = {
        "a": np.where(swap, r.b, r.a),
        "b": np.where(swap, r.a, r.b),
        "antenna_a": np.where(swap, r.antenna_b, r.antenna_a),
        "antenna_b": np.where(swap, r.antenna_a, r.antenna_b),
    }
    assert_same(register(recording), register(replace(recording, ranges=replace(r, **ends))))


# ---- what cannot be told ----


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("users", [2, 3])
def test_the_truth_is_among_the_alternatives_of_walkers_of_lines(users: int, seed: int) -> None:
    """Two lines can be mirrored: two placements, metres apart, of which one is true."""
    simulation = simulate(Scene(users=users, walk=("line",), seed=seed))
    registration = register(simulation.recording)
    ref, *others = registration.users
    assert registration.reference == ref
    assert registration.users[ref].state is State.REGISTERED
    for name in others:
        assert registration.users[name].state in (State.AMBIGUOUS, State.UNOBSERVABLE)
    worst = []
    for alternative in registration.alternatives:
        assert set(alternative.common_from_user) == {ref, *others}
        ref_from_common = alternative.common_from_user[ref].inverse()
        frames = {name: ref_from_common @ alternative.common_from_user[name] for name in others}
        worst.append(max(off_in_plane(simulation, ref, name, frame) for name, frame in frames.items()))
    assert len(worst) >= 2
    assert min(worst) < 0.3
    assert max(worst) > MODEL.integrity.largest_error
    costs = [alternative.cost for alternative in registration.alternatives]
    assert costs[0] == 0.0
    assert costs == sorted(costs)
    assert max(costs) < MODEL.integrity.cost_excluded
    best = registration.alternatives[0].common_from_user
    assert all(best[name] == user.common_from_user for name, user in registration.users.items())


def test_three_walkers_of_lines_are_called_ambiguous() -> None:
    registration = register(simulate(Scene(users=3, walk=("line",), seed=0)).recording)
    assert states(registration) == [State.REGISTERED, State.AMBIGUOUS, State.AMBIGUOUS]
    assert "2 joint placements" in registration.users["phone1"].reason


def test_people_who_walk_freely_have_no_alternatives() -> None:
    registration = register(simulate(Scene(users=3, seconds=20.0, seed=5)).recording)
    assert registration.alternatives == ()
    assert set(states(registration)) == {State.REGISTERED}


# ---- odd recordings ----


def walker(seed: int) -> Track:
    """10 s at walking pace along a random smooth course about a place of its own."""
    random = np.random.default_rng(seed)
    t = np.linspace(0.0, 10.0, 101)
    phase, place = random.uniform(0.0, 2.0 * np.pi, 2), random.uniform(-2.0, 2.0, 2)
    x, y = (1.5 * np.sin(w * t + p) + c for w, p, c in zip((0.7, 0.9), phase, place, strict=True))
    return track_of(t, np.column_stack([x, y, 0.0 * t]))


def ranged(tracks: Mapping[str, Track | None], a: str, b: str) -> list[tuple[float, str, str, float]]:
    """Exact ranges, five a second, of frames that all are the common one; a static radio at (1, 2, 2)."""
    times = np.arange(0.5, 9.5, 0.2)
    far = np.array([1.0, 2.0, 2.0])

    def places(name: str) -> Array:
        track = tracks[name]
        return np.tile(far, (len(times), 1)) if track is None else track.at(times, 1.0).position

    distance = np.linalg.norm(places(a) - places(b), axis=1)
    return [(t, a, b, d) for t, d in zip(times.tolist(), distance.tolist(), strict=True)]


def test_who_is_not_tied_to_the_reference_is_disconnected() -> None:
    tracks = {name: walker(k) for k, name in enumerate("abcd")}
    recording = recording_of(tracks, ranged(tracks, "a", "b") + ranged(tracks, "c", "d"))
    registration = register(recording)
    assert states(registration)[2:] == [State.DISCONNECTED] * 2
    for name in "cd":
        user = registration.users[name]
        told = (user.common_from_user, user.covariance, user.common_track, user.calibration_sigma)
        assert told == (None,) * 4
        assert "no chain of ranges" in user.reason
    assert set(registration.tracks(recording)) == {"a", "b"}
    np.testing.assert_array_equal(registration.ranges.usable, recording.ranges.a == 0)
    with pytest.raises(ValueError, match="c is disconnected"):
        registration.between("a", "c")
    assert states(register(recording, reference="d"))[:2] == [State.DISCONNECTED] * 2


def test_with_no_range_at_all_there_is_the_reference_alone() -> None:
    tracks = {"a": walker(1), "b": walker(2)}
    registration = register(recording_of(tracks, []))
    assert states(registration) == [State.REGISTERED, State.DISCONNECTED]
    assert registration.alternatives == ()
    assert registration.ranges.used.shape == (0,)
    track = registration.tracks(recording_of(tracks, []))["a"]
    np.testing.assert_allclose(track.position, tracks["a"].position, atol=1e-9)
    assert set(registration.users["a"].prior_dominated) >= {"scale", "range_bias", "clock_offset"}


def test_one_user_alone_is_the_reference_where_its_slam_says() -> None:
    tracks = {"a": walker(1)}
    registration = register(recording_of(tracks, []))
    assert states(registration) == [State.REGISTERED]
    np.testing.assert_allclose(registration.tracks(recording_of(tracks, []))["a"].position, tracks["a"].position)


def test_a_user_with_one_pose_has_a_place_and_a_heading_nobody_knows() -> None:
    tracks = {"a": walker(1), "b": walker(2), "c": walker(3)}
    rows = ranged(tracks, "a", "b")
    at = tracks["c"].at(np.array([4.1]), 1.0).position
    rows += [(4.1, n, "c", float(np.linalg.norm(tracks[n].at(np.array([4.1]), 1.0).position - at))) for n in "ab"]
    recording = recording_of({**tracks, "c": track_of(np.array([4.1]), at)}, rows)
    registration = register(recording)
    assert registration.users["c"].state in (State.UNOBSERVABLE, State.AMBIGUOUS)
    assert "yaw" in registration.users["c"].prior_dominated
    assert registration.users["c"].jumps == ()
    assert registration.tracks(recording)["c"].position.shape == (1, 3)


def test_a_radio_that_one_walker_alone_has_ranged_is_placed_or_said_not_to_be() -> None:
    tracks: dict[str, Track | None] = {"a": walker(1), "b": walker(2), "d": None}
    registration = register(recording_of(tracks, ranged(tracks, "a", "b") + ranged(tracks, "a", "d")))
    radio = registration.users["d"]
    assert radio.common_from_user is not None
    assert radio.common_from_user.scale == 1.0
    off = np.hypot(radio.common_from_user.x - 1.0, radio.common_from_user.y - 2.0)
    assert off < MODEL.integrity.largest_error or radio.state is not State.REGISTERED
    assert radio.covariance is not None
    assert np.linalg.eigvalsh(radio.covariance[:3, :3])[0] > 0.0


STILL = track_of(np.linspace(0.0, 10.0, 101), np.zeros((101, 3)))


def all_ranged(tracks: Mapping[str, Track | None]) -> Recording:
    names = sorted(tracks)
    return recording_of(
        tracks, [row for k, a in enumerate(names) for b in names[k + 1 :] for row in ranged(tracks, a, b)]
    )


def test_a_device_that_stands_still_does_not_tell_its_heading_scale_and_clock() -> None:
    """What it has in common with the others they tell; by how much it differs nobody does.

    The others have no fault, so it probably has none either.
    """
    registration = register(all_ranged({"a": walker(1), "b": walker(2), "c": STILL}))
    still = registration.users["c"]
    assert {"yaw", "clock_offset"} <= set(still.prior_dominated)
    assert still.state is State.UNOBSERVABLE
    assert "heading" in still.reason
    assert still.unseen_direction is not None
    assert np.linalg.norm(still.unseen_direction) == pytest.approx(1.0)
    assert abs(still.unseen_direction[3]) > 0.9
    assert still.clock_offset is not None  # a device all the same: it has a clock
    assert still.calibration_sigma is not None
    for sigma in (registration.users[name].calibration_sigma for name in "ab"):
        assert sigma is not None
        assert still.calibration_sigma.scale > 1.5 * sigma.scale
    assert not {"yaw", "scale", "clock_offset"} & set(registration.users["b"].prior_dominated)


def test_no_heading_beside_a_reference_that_stands_still_is_known() -> None:
    """All others may turn about it together, however many they are."""
    tracks = {"a": walker(1), "b": walker(2), "c": walker(3), "d": STILL}
    registration = register(all_ranged(tracks), reference="d")
    for name in "abc":
        assert registration.users[name].state is State.UNOBSERVABLE
        assert "yaw" in registration.users[name].prior_dominated
