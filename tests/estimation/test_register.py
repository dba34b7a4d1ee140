from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.solver_scenes import (
    MEAN_HEIGHT,
    difference,
    frames_of,
    moved_by,
    offs,
    recording_of,
    track_of,
    true_frames,
)
from support.solver_scenes import register_rigid as register

import synchronizar as sz
from synchronizar.arrays import Array
from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration, State
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.errors import InputError
from synchronizar.geometry import YawFrame
from synchronizar.io.registration_folder import range_counts, registration_json
from synchronizar.simulation.simulate import Scene, simulate


def assert_frames_near(found: YawFrame, expected: YawFrame, tolerance: float = 1e-3) -> None:
    np.testing.assert_allclose(found.translation, expected.translation, atol=tolerance)
    assert abs(np.remainder(found.yaw - expected.yaw + np.pi, 2.0 * np.pi) - np.pi) < tolerance


# ---- how good, and how honest ----


@pytest.mark.parametrize("seed", range(20))
def test_with_two_in_five_ranges_late_nobody_of_four_is_off(seed: int) -> None:
    simulation = simulate(Scene(users=4, late_share=0.4, seed=seed))
    registration = register(simulation.recording)
    found = offs(simulation, registration)
    assert set(found) == {"phone1", "phone2", "phone3"}
    assert max(found.values()) < 0.3


def test_errors_are_as_large_as_the_covariances_say() -> None:
    squared = []
    for seed in range(60):
        simulation = simulate(Scene(users=3, seed=seed))
        registration = register(simulation.recording)
        error = difference(frames_of(registration), true_frames(simulation, registration.reference))
        plane = [0, 1, 3]
        for u, user in enumerate(registration.users.values()):
            if user.name != registration.reference:
                assert user.covariance is not None
                e = error[u, plane]
                squared.append(float(e @ np.linalg.solve(user.covariance[np.ix_(plane, plane)], e)))
    n, dof = len(squared), 3.0
    band = 2.576 * np.sqrt(2.0 * dof / n)  # 99 %: the mean of n chi-squares, normal for n this large
    assert n == 120
    assert abs(np.mean(squared) - dof) < band


@pytest.mark.parametrize("seed", range(4))
def test_late_ranges_are_told_from_honest_ones(seed: int) -> None:
    simulation = simulate(Scene(users=4, late_share=0.3, seed=seed))
    verdicts = register(simulation.recording).ranges
    assert verdicts.usable.all()
    assert (verdicts.used == ~simulation.late).mean() > 0.9
    assert verdicts.weight[simulation.late].mean() < 0.2 * verdicts.weight[~simulation.late].mean()


def test_residuals_are_measured_minus_the_distance_in_the_common_frame() -> None:
    simulation = simulate(Scene(users=3, static_radios=1, antennas=2, seed=1))
    recording = simulation.recording
    registration = register(recording)
    frames = [user.common_from_user for user in registration.users.values()]
    r = recording.ranges
    for n in (0, 7, 100, len(r) - 1):
        ends = []
        for who, antenna in ((r.a[n], r.antenna_a[n]), (r.b[n], r.antenna_b[n])):
            own, _ = recording.antenna_positions(int(who), r.t[n : n + 1], np.array([antenna]), 1.0)
            frame = frames[who]
            assert frame is not None
            ends.append(frame @ own[0])
        expected = r.distance[n] - np.linalg.norm(ends[0] - ends[1])
        assert registration.ranges.residual[n] == pytest.approx(expected, abs=0.02)  # of the best minimum, not the mean


def test_devices_with_several_antennas_are_registered_by_them() -> None:
    levers = {"0": (0.5, 0.0, 0.0), "1": (-0.5, 0.0, 0.0), "2": (0.0, 0.0, 0.5)}
    simulation = simulate(Scene(users=3, antennas=3, seed=2))
    registration = register(simulation.recording)
    assert max(offs(simulation, registration).values()) < 0.2
    # With other lever arms than it has the ranges of the first one fit worse.
    users = (replace(simulation.recording.users[0], antennas=levers), *simulation.recording.users[1:])
    wrong = register(replace(simulation.recording, users=users))
    mine = (simulation.recording.ranges.a == 0) | (simulation.recording.ranges.b == 0)
    assert np.abs(wrong.ranges.residual[mine]).mean() > 1.5 * np.abs(registration.ranges.residual[mine]).mean()


def test_a_late_joiner_is_registered_by_what_it_has_seen() -> None:
    simulation = simulate(Scene(users=4, late_joiners=1, seconds=20.0, seed=3))
    assert simulation.recording.tracks["phone3"].t[0] > 9.0
    registration = register(simulation.recording)
    assert registration.users["phone3"].state is State.REGISTERED
    assert max(offs(simulation, registration).values()) < 0.3


# ---- what must not matter ----


def renamed(recording: Recording, name_of: Mapping[str, str], swap: bool) -> Recording:
    """The same walk under other names, and each range told from the other end."""
    names = sorted(name_of.values())
    index = np.array([names.index(name_of[user.name]) for user in recording.users], dtype=np.int32)
    known = {name_of[user.name]: replace(user, name=name_of[user.name]) for user in recording.users}
    r = recording.ranges
    ranges = replace(r, a=index[r.a], b=index[r.b])
    if swap:
        ranges = replace(ranges, a=ranges.b, b=ranges.a, antenna_a=ranges.antenna_b, antenna_b=ranges.antenna_a)
    return Recording(tuple(known[name] for name in names), {name_of[n]: t for n, t in recording.tracks.items()}, ranges)


@pytest.mark.parametrize("late", [0.0, 0.3])
@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_other_names_give_the_same_frames(seed: int, swap: bool, late: float) -> None:
    recording = simulate(Scene(users=4, late_share=late, antennas=1, height_bob=0.2, seed=seed)).recording
    name_of = {"phone0": "x", "phone1": "d", "phone2": "m", "phone3": "a"}
    one, other = register(recording), register(renamed(recording, name_of, swap))
    for a in name_of:
        for b in name_of:
            assert_frames_near(other.between(name_of[a], name_of[b]), one.between(a, b), 5e-3)


@pytest.mark.parametrize("late", [0.0, 0.4])
def test_the_order_of_the_ranges_changes_nothing_at_all(late: float) -> None:
    recording = simulate(Scene(users=3, late_share=late, seed=4)).recording
    order = np.random.default_rng(0).permutation(len(recording.ranges))
    one, other = register(recording), register(replace(recording, ranges=recording.ranges.select(order)))
    np.testing.assert_array_equal(frames_of(one), frames_of(other))
    for a, b in zip(one.users.values(), other.users.values(), strict=True):
        assert a.state is b.state
        assert a.covariance is not None
        assert b.covariance is not None
        np.testing.assert_array_equal(a.covariance, b.covariance)
    np.testing.assert_array_equal(one.ranges.used[order], other.ranges.used)
    np.testing.assert_array_equal(one.ranges.residual[order], other.ranges.residual)


def test_the_same_recording_gives_the_same_answer() -> None:
    recording = simulate(Scene(users=3, late_share=0.4, seed=5)).recording
    np.testing.assert_array_equal(frames_of(register(recording)), frames_of(register(recording)))


@pytest.mark.parametrize("late", [0.0, 0.3])
@pytest.mark.parametrize("seed", range(3))
def test_where_own_frames_lie_changes_no_track_in_the_common_one(seed: int, late: float) -> None:
    recording = simulate(Scene(users=3, late_share=late, antennas=2, height_bob=0.2, seed=seed)).recording
    random = np.random.default_rng(seed)
    own_from_new = {
        name: YawFrame(random.uniform(-20.0, 20.0), random.uniform(-20.0, 20.0), yaw=random.uniform(-3.0, 3.0))
        for name in ("phone1", "phone2")
    }
    moved = moved_by(recording, own_from_new)
    one, other = register(recording), register(moved)
    before, after = one.tracks(recording), other.tracks(moved)
    for name in before:
        np.testing.assert_allclose(after[name].position, before[name].position, atol=1e-2)
        assert other.users[name].state is one.users[name].state
    # And where the reference's own frame lies moves all of it together.
    shift = YawFrame(3.0, -5.0, 0.0, 1.0)
    moved = moved_by(recording, {"phone0": shift})
    for name, track in register(moved).tracks(moved).items():
        np.testing.assert_allclose(shift @ track.position, before[name].position, atol=1e-2)


def test_tracks_with_y_up_give_the_same_answer_as_their_twins(tmp_path: Path) -> None:
    answers = []
    for up in ("z", "y"):
        simulate(Scene(users=3, antennas=2, height_bob=0.2, seed=6, up=up)).save(tmp_path / up)
        answers.append(register(Recording.load(tmp_path / up)))
    for name, user in answers[0].users.items():
        twin = answers[1].users[name]
        assert user.common_from_user is not None
        assert twin.common_from_user is not None
        assert_frames_near(twin.common_from_user, user.common_from_user)


def test_garbage_is_set_aside_and_changes_nothing() -> None:
    recording = simulate(Scene(users=3, seed=7)).recording
    r = recording.ranges
    odd = r.select(np.arange(0, 7))
    odd = replace(odd, distance=np.array([6e6, -6e6, np.nan, np.inf, -np.inf, -5.0, 2e3]))
    both = Ranges(*(np.concatenate([getattr(x, f) for x in (r, odd)]) for f in Ranges.__dataclass_fields__))
    one, other = register(recording), register(replace(recording, ranges=both))
    np.testing.assert_array_equal(frames_of(one), frames_of(other))
    assert range_counts(other.ranges)["unusable"] == 7
    assert not other.ranges.usable[-7:].any()
    assert not other.ranges.used[-7:].any()
    assert (other.ranges.weight[-7:] == 0.0).all()
    assert np.isnan(other.ranges.residual[-7:]).all()


# ---- the reference ----


def walker(seed: int, metres: float = 5.0) -> Track:
    random = np.random.default_rng(seed)
    t = np.linspace(0.0, 10.0, 101)
    xy = metres / 5.0 * np.cumsum(random.normal(0.0, 0.2, (101, 2)), axis=0)
    return track_of(t, np.column_stack([xy, np.zeros(101)]))


def ranges_between(tracks: Mapping[str, Track | None], times: Array) -> list[tuple[float, str, str, float]]:
    """Of frames that all are the common one."""
    names = sorted(tracks)

    def place(name: str, t: float) -> Array:
        track = tracks[name]
        return np.zeros(3) if track is None else track.at(np.array([t]), np.inf).position[0]

    return [
        (float(t), a, b, float(np.linalg.norm(place(a, t) - place(b, t))))
        for t in times
        for k, a in enumerate(names)
        for b in names[k + 1 :]
    ]


def all_ranging(tracks: Mapping[str, Track | None]) -> Recording:
    return recording_of(tracks, ranges_between(tracks, np.arange(0.5, 9.5, 0.2)))


def test_the_reference_is_the_first_by_name_that_moves_and_is_no_static_radio() -> None:
    barely = walker(1, metres=0.01)
    tracks = {"a": None, "b": barely, "c": walker(2), "d": walker(3)}
    assert register(all_ranging(tracks)).reference == "c"
    assert register(all_ranging(tracks), reference="d").reference == "d"
    assert register(all_ranging(tracks), reference="b").reference == "b"


def test_half_a_metre_is_what_counts_as_moving() -> None:
    t = np.linspace(0.0, 10.0, 11)
    short, long = (track_of(t, np.column_stack([t * way / 10.0, 0 * t, 0 * t])) for way in (0.49, 0.51))
    assert register(all_ranging({"a": short, "b": walker(2)})).reference == "b"
    assert register(all_ranging({"a": long, "b": walker(2)})).reference == "a"


def test_where_nobody_moves_the_first_that_is_not_static_is_the_reference() -> None:
    still = track_of(np.arange(11.0), np.zeros((11, 3)))
    registration = register(all_ranging({"a": None, "b": still, "c": still}))
    assert registration.reference == "b"


def test_the_reference_lies_where_it_is_and_is_registered() -> None:
    registration = register(all_ranging({"a": walker(1), "b": walker(2)}), reference="b")
    assert registration.users["b"].common_from_user == YawFrame()
    assert registration.users["b"].state is State.REGISTERED
    covariance = registration.users["b"].covariance
    assert covariance is not None
    assert not covariance.any()


def test_an_unknown_or_static_reference_is_refused_by_name() -> None:
    recording = all_ranging({"a": None, "b": walker(2), "c": walker(3)})
    with pytest.raises(InputError, match=r"--reference: .*'nobody'"):
        register(recording, reference="nobody")
    with pytest.raises(InputError, match="--reference: 'a' is a static radio"):
        register(recording, reference="a")


def test_radios_that_all_stand_still_have_no_common_frame() -> None:
    users = (User("a", static=True), User("b", static=True))
    none = np.zeros(0)
    nobody = np.zeros(0, dtype=np.int32)
    with pytest.raises(InputError, match="static"):
        register(Recording(users, {}, Ranges.of(none, nobody, nobody, none)))


# ---- odd recordings ----


def test_a_user_with_one_pose_is_tied_by_what_ranged_it_at_that_moment() -> None:
    tracks: dict[str, Track] = {"a": walker(1), "b": walker(2), "c": walker(3)}
    rows = ranges_between(tracks, np.arange(0.5, 9.5, 0.2))
    tracks["c"] = Track(np.array([4.1]), tracks["c"].at(np.array([4.1]), 1.0).position, np.array([MEAN_HEIGHT]))
    rows += [(4.1, a, b, d) for _, a, b, d in ranges_between(tracks, np.array([4.1])) if "c" in (a, b)]
    registration = register(recording_of(tracks, rows))
    assert registration.users["b"].state is State.REGISTERED
    assert registration.users["c"].state in (State.UNOBSERVABLE, State.AMBIGUOUS)
    assert registration.tracks(recording_of(tracks, rows))["c"].position.shape == (1, 3)


def test_a_user_whose_one_pose_nobody_ranged_is_disconnected() -> None:
    tracks: dict[str, Track] = {"a": walker(1), "b": walker(2), "c": walker(3)}
    rows = ranges_between(tracks, np.arange(0.5, 9.5, 0.2))
    tracks["c"] = Track(np.array([4.05]), np.zeros((1, 3)), np.array([MEAN_HEIGHT]))
    assert register(recording_of(tracks, rows)).users["c"].state is State.DISCONNECTED


def tiny(seed: int) -> Recording:
    """Two to five users, walking, standing, or all in one place, static radios, a few ranges per pair, some of 0 m."""
    random = np.random.default_rng([seed, 7])
    tracks: dict[str, Track | None] = {}
    common = random.uniform(-2.0, 2.0, 3) * random.integers(0, 2)
    for k in range(int(random.integers(2, 6))):
        n = int(random.integers(1, 8))
        t = np.sort(random.choice(np.arange(0.0, 10.0, 0.5), n, replace=False))
        kind = random.choice(["walk", "stand", "same", "static", "line"], p=[0.3, 0.2, 0.2, 0.1, 0.2])
        position = {
            "walk": random.uniform(-3.0, 3.0, (n, 3)),
            "stand": np.tile(random.uniform(-3.0, 3.0, 3), (n, 1)),
            "same": np.tile(common, (n, 1)),
            "line": np.outer(np.arange(n), random.uniform(-1.0, 1.0, 3)),
        }
        tracks[f"u{k}"] = None if kind == "static" and k > 0 else track_of(t, position.get(str(kind), position["same"]))
    rows = []
    names = sorted(tracks)
    for k, a in enumerate(names):
        for b in names[k + 1 :]:
            tracked = [track.t for track in (tracks[a], tracks[b]) if track is not None]
            stamps = np.concatenate(tracked or [np.arange(3.0)])
            for _ in range(int(random.integers(1, 9))):
                distance = random.choice([0.0, -0.2, float(random.uniform(0.0, 8.0)), 900.0], p=[0.25, 0.1, 0.6, 0.05])
                rows.append((float(random.choice(stamps)), a, b, float(distance)))
    return recording_of(tracks, rows)


@pytest.mark.parametrize("seed", range(60))
def test_however_little_there_is_an_answer_comes_with_nothing_but_numbers(seed: int) -> None:
    recording = tiny(seed)
    registration = register(recording)
    json.dumps(registration_json(registration), allow_nan=False)
    for user in registration.users.values():
        if user.common_from_user is None:
            assert user.state is State.DISCONNECTED
            continue
        f = user.common_from_user
        assert np.isfinite([f.x, f.y, f.z, f.yaw]).all()
        assert user.covariance is not None
        known = user.covariance[:3, :3] if user.static else user.covariance
        assert np.isfinite(known).all()
        assert np.linalg.eigvalsh(known).min() > -1e-9 * max(1.0, np.abs(known).max())
    assert np.isfinite(registration.ranges.weight).all()
    assert np.isfinite(registration.ranges.residual[registration.ranges.usable]).all()


# ---- the face ----


def test_the_package_s_face_registers_a_folder(tmp_path: Path) -> None:
    simulation = simulate(Scene(users=3, seed=8))
    simulation.save(tmp_path)
    recording = sz.Recording.load(tmp_path)
    registration: Registration = sz.register(recording)
    bob = registration.users["phone1"]
    assert bob.state is sz.State.REGISTERED
    points = np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]])
    placed = bob.common_from_user @ points
    assert placed.shape == (2, 3)
    true = simulation.world_from_user["phone0"].inverse() @ simulation.world_from_user["phone1"]
    np.testing.assert_allclose(placed[:, :2], (true @ points)[:, :2], atol=0.2)


def test_frames_between_any_two_users_compose() -> None:
    registration = register(simulate(Scene(users=4, seed=9)).recording)
    names = sorted(registration.users)
    for a in names:
        assert_frames_near(registration.between(a, a), YawFrame(), 1e-9)
        for b in names:
            assert_frames_near(registration.between(a, b).inverse(), registration.between(b, a), 1e-9)
            for c in names:
                composed = registration.between(a, b) @ registration.between(b, c)
                assert_frames_near(composed, registration.between(a, c), 1e-9)
    reference = registration.reference
    assert registration.between(reference, "phone2") == registration.users["phone2"].common_from_user


def test_there_is_no_frame_between_users_that_are_not_there_or_not_tied() -> None:
    recording = simulate(Scene(users=3, seed=9)).recording
    r = recording.ranges
    registration = register(replace(recording, ranges=r.select((r.a != 2) & (r.b != 2))))
    with pytest.raises(ValueError, match="phone2 is disconnected: "):
        registration.between("phone0", "phone2")
    with pytest.raises(KeyError):
        registration.between("phone0", "nobody")


def test_the_recording_stays_as_it_was() -> None:
    recording = simulate(Scene(users=2, seed=10)).recording
    before = recording.ranges.distance.copy(), recording.tracks["phone1"].position.copy()
    register(recording)
    np.testing.assert_array_equal(recording.ranges.distance, before[0])
    np.testing.assert_array_equal(recording.tracks["phone1"].position, before[1])


def test_a_call_that_cannot_be_meant_names_the_argument() -> None:
    recording = simulate(Scene(seconds=2.0)).recording
    with pytest.raises(ValueError, match='model: must be "full" or "rigid"'):
        register(recording, model="ridgid")
    with pytest.raises(ValueError, match="recording: must be a Recording"):
        register("walk")  # type: ignore[arg-type]
    registration = register(recording)
    with pytest.raises(KeyError, match="there is no user 'bbo'; there are phone0, phone1"):
        registration.between("phone0", "bbo")
