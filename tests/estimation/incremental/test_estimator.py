"""The Estimator's face: users by name, values as devices give them, answers in the batch solve's types."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import synchronizar as sz
from synchronizar.data.in_time import in_time
from synchronizar.data.recording import Recording
from synchronizar.geometry import Up
from synchronizar.simulation.simulate import Scene, simulate

NOBODY_TURNED = [0.0, 0.0, 0.0, 1.0]


def feed(estimator: sz.Estimator, recording: Recording, up: Up = "z") -> list[str]:
    """Everything in its order, in the axes of devices whose frames have `up` upwards; what `advance` told."""
    own = sz.YawFrame(up_a=up)
    names, events, told = [user.name for user in recording.users], [], -1.0
    ranges = recording.ranges
    for t, user, row in in_time(recording):
        if user < 0:
            estimator.add_range(t, names[ranges.a[row]], names[ranges.b[row]], ranges.distance[row])
        else:
            track = recording.tracks[names[user]]
            position, quat = own @ track.position[row], own.rotate_quaternions(track.quat_xyzw[row])
            estimator.add_pose(names[user], t, position.tolist(), tuple(quat.tolist()))
        if t - told > 0.1:
            told = t
            events += estimator.advance(t)
    return events


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate(Scene(seed=1, sigma=0.05)).recording


@pytest.fixture(scope="module")
def walked(recording: Recording) -> tuple[sz.Estimator, list[str]]:
    estimator = sz.Estimator(["phone1", "phone0"], up="y", workers=0)
    return estimator, feed(estimator, recording, "y")


def test_before_anything_came_everybody_is_listed_and_disconnected() -> None:
    now = sz.Estimator(["bob", "alice"]).registration()
    assert now.reference is None
    assert list(now.users) == ["alice", "bob"]
    for user in now.users.values():
        assert user.state is sz.State.DISCONNECTED
        assert user.common_from_user is None
        assert user.progress == 0.0


def test_what_is_known_has_the_types_and_axes_of_the_batch_solve(
    walked: tuple[sz.Estimator, list[str]], recording: Recording
) -> None:
    now, batch = walked[0].registration(), sz.register(recording)
    assert isinstance(now, sz.Registration)
    assert now.reference == "phone0"
    assert now.users["phone1"].state is sz.State.REGISTERED
    assert now.users["phone1"].progress == 1.0
    assert now.users["phone1"].covariance is not None
    y_up = sz.YawFrame(up_a="y")
    points = recording.tracks["phone1"].position[::40]
    found = now.between("phone0", "phone1") @ (y_up @ points)
    np.testing.assert_allclose(found, y_up @ (batch.between("phone0", "phone1") @ points), atol=0.3)


def test_events_name_users(walked: tuple[sz.Estimator, list[str]]) -> None:
    assert any(event.startswith("phone1: registered") for event in walked[1])


def test_the_reference_is_the_first_by_name_that_moves() -> None:
    estimator = sz.Estimator(["a", "b"])
    estimator.add_pose("a", 0.0, [0, 0, 0], NOBODY_TURNED)
    estimator.add_pose("b", 0.0, [0, 0, 0], NOBODY_TURNED)
    estimator.advance(0.0)
    assert estimator.reference is None
    estimator.add_pose("b", 1.0, [0.6, 0, 0], NOBODY_TURNED)
    estimator.advance(1.0)
    assert estimator.reference == "b"
    estimator.add_pose("a", 2.0, [5, 0, 0], NOBODY_TURNED)
    estimator.advance(2.0)
    assert estimator.reference == "b"


def test_a_saved_estimator_is_loaded_as_it_was(walked: tuple[sz.Estimator, list[str]], tmp_path: Path) -> None:
    walked[0].save(tmp_path / "state.npz")
    loaded = sz.Estimator.load(tmp_path / "state.npz")
    assert loaded.users == walked[0].users
    now = loaded.registration()
    assert now.users["phone1"].state is sz.State.REGISTERED
    assert now.users["phone1"].common_from_user.up_b == "y"  # type: ignore[union-attr]
    with pytest.raises(sz.InputError, match="nothing to save"):
        sz.Estimator(["a"]).save(tmp_path / "other.npz")


def two() -> sz.Estimator:
    return sz.Estimator(
        {"a": {"antennas": {"left": [0, 0, 0], "right": [0, 0.1, 0]}}, "b": {}, "post": {"static": True}}
    )


Call = Callable[[sz.Estimator], object]
WRONG: dict[str, tuple[Call, str]] = {
    "a pose of nobody": (lambda e: e.add_pose("eve", 0, [0, 0, 0], NOBODY_TURNED), "user: there is no user 'eve'"),
    "a pose of a static radio": (lambda e: e.add_pose("post", 0, [0, 0, 0], NOBODY_TURNED), "user: 'post' is static"),
    "a user by its index": (lambda e: e.add_pose(0, 0, [0, 0, 0], NOBODY_TURNED), "user: there is no user 0"),  # type: ignore[arg-type]
    "a flat position": (lambda e: e.add_pose("a", 0, [0, 0], NOBODY_TURNED), r"position: must have shape \(3,\)"),
    "a position of words": (lambda e: e.add_pose("a", 0, "abc", NOBODY_TURNED), "position: must be 3 numbers"),
    "a short quaternion": (lambda e: e.add_pose("a", 0, [0, 0, 0], [0, 0, 1]), r"quat_xyzw: must have shape \(4,\)"),
    "a stamp that is a word": (lambda e: e.add_pose("a", "now", [0, 0, 0], NOBODY_TURNED), "t: 'now' is no number"),  # type: ignore[arg-type]
    "a range to nobody": (lambda e: e.add_range(0, "a", "eve", 1.0, antenna_a="left"), "b: there is no user 'eve'"),
    "a distance that is a word": (lambda e: e.add_range(0, "b", "post", "far"), "distance: 'far' is no number"),  # type: ignore[arg-type]
    "an unknown column": (lambda e: e.add_range(0, "b", "post", 1.0, mood=3.0), "mood: there is no such column"),
    "an unknown antenna": (lambda e: e.add_range(0, "a", "b", 1.0, antenna_a="top"), "antenna_a: a has the antennas"),
    "no antenna of several": (lambda e: e.add_range(0, "a", "b", 1.0), "antenna_a: a has the antennas left, right"),
    "an unknown source": (lambda e: e.add_range(0, "b", "post", 1.0, source="guess"), "source: 'guess' is none of"),
    "a time that is none": (lambda e: e.advance(float("nan")), "t: nan is no time"),
    "one string of users": (lambda _: sz.Estimator("ab"), "users: must be several names"),
    "an unknown axis": (lambda _: sz.Estimator(["a"], up="x"), 'up: must be "z" or "y"'),  # type: ignore[arg-type]
    "an unknown setting": (lambda _: sz.Estimator({"a": {"colour": 1}}), "users: 'a' has no setting 'colour'"),
    "a height_sigma of 0": (lambda _: sz.Estimator({"a": {"height_sigma": 0}}), "users: 'a': a height_sigma"),
    "nobody that moves": (lambda _: sz.Estimator({"a": {"static": True}}), "users: somebody must move"),
    "a reference of nobody": (lambda _: sz.Estimator(["a"], reference="b"), "reference: there is no user 'b'"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_call_that_cannot_be_meant_is_a_value_error_naming_the_argument(name: str) -> None:
    call, fault = WRONG[name]
    estimator = two()
    with pytest.raises(ValueError, match=fault):
        call(estimator)
    assert not estimator.refused


REFUSED: dict[str, tuple[Call, str]] = {
    "a position of NaN": (lambda e: e.add_pose("a", 0, [0, np.nan, 0], NOBODY_TURNED), "a: a pose that is not finite"),
    "an infinite stamp": (lambda e: e.add_pose("a", np.inf, [0, 0, 0], NOBODY_TURNED), "a: a pose that is not finite"),
    "a zero quaternion": (lambda e: e.add_pose("a", 0, [0, 0, 0], [0, 0, 0, 0]), "a: a quaternion of length 0"),
    "a range of None": (lambda e: e.add_range(0, "b", "post", None), "b and post: a range that is no number"),
    "a range of NaN": (lambda e: e.add_range(0, "b", "post", np.nan), "b and post: a range that is no number"),
    "a range to itself": (lambda e: e.add_range(0, "b", "b", 1.0), "b: a range to itself"),
    "a negative sigma": (lambda e: e.add_range(0, "b", "post", 1.0, sigma=-0.1), "b and post: a sigma that is not"),
    "an nlos of 0.5": (lambda e: e.add_range(0, "b", "post", 1.0, nlos=0.5), "b and post: an nlos that is neither"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_value_that_no_device_can_mean_is_refused_counted_and_told_once(name: str) -> None:
    call, what = REFUSED[name]
    estimator = two()
    call(estimator)
    call(estimator)
    assert sum(estimator.refused.values()) == 2
    (event,) = estimator.advance(1.0)
    assert event.startswith(what)
    assert event.endswith("refused, 2 times")
    assert estimator.advance(1.1) == []


# ---- while people walk ----


def test_two_runs_without_a_process_are_the_same_to_the_last_byte(recording: Recording, tmp_path: Path) -> None:
    files = []
    for run in ("one", "two"):
        estimator = sz.Estimator(["phone0", "phone1"], workers=0)
        feed(estimator, recording)
        estimator.save(tmp_path / f"{run}.npz")
        with np.load(tmp_path / f"{run}.npz") as archive:
            files.append({name: archive[name].tobytes() for name in archive.files})
    assert files[0] == files[1]


def test_an_estimator_that_is_loaded_goes_on_as_the_saved_one(recording: Recording, tmp_path: Path) -> None:
    half = 0.5 * float(recording.ranges.t[-1])
    saved = sz.Estimator(["phone0", "phone1"], workers=0)
    feed(saved, until(recording, half))
    saved.save(tmp_path / "state.npz")
    loaded = sz.Estimator.load(tmp_path / "state.npz", workers=0)
    rest = since(recording, half)
    assert feed(loaded, rest) == feed(saved, rest)
    ours, theirs = (each.registration().users["phone1"] for each in (loaded, saved))
    assert ours.state is theirs.state
    assert ours.common_from_user is not None
    assert theirs.common_from_user is not None
    np.testing.assert_allclose(ours.common_from_user.translation, theirs.common_from_user.translation, atol=1e-6)


def until(recording: Recording, end: float) -> Recording:
    return part(recording, -np.inf, end)


def since(recording: Recording, begin: float) -> Recording:
    return part(recording, begin, np.inf)


def part(recording: Recording, begin: float, end: float) -> Recording:
    """What came in a stretch of time."""
    tracks = {}
    for name, track in recording.tracks.items():
        kept = (track.t >= begin) & (track.t < end)
        tracks[name] = replace(track, t=track.t[kept], position=track.position[kept], quat_xyzw=track.quat_xyzw[kept])
    r = recording.ranges
    return replace(recording, tracks=tracks, ranges=r.select((r.t >= begin) & (r.t < end)))


def test_a_user_is_added_by_name_before_and_after_the_reference_is_chosen() -> None:
    estimator = sz.Estimator(["bob", "eve"], up="y", workers=0)
    estimator.add_user("alice", height_sigma=0.2)
    assert [user.name for user in estimator.users] == ["bob", "eve", "alice"]
    assert estimator.users[2].up == "y"
    for x in (0.0, 0.4, 0.8):
        estimator.add_pose("eve", x, [x, 0, 0], NOBODY_TURNED)
    estimator.advance(0.8)
    assert estimator.reference == "eve"
    estimator.add_user("post", static=True)
    estimator.add_range(0.9, "post", "alice", 2.0)
    estimator.add_pose("alice", 0.9, [0, 0, 0], NOBODY_TURNED)
    assert estimator.advance(1.0) == []
    now = estimator.registration()
    assert set(now.users) == {"bob", "eve", "alice", "post"}
    assert now.users["post"].static
    for name, fault in (("alice", "there is a user 'alice' already"), ("x", "no setting 'colour'")):
        settings = {"colour": 1} if name == "x" else {}
        with pytest.raises(ValueError, match=fault):
            estimator.add_user(name, **settings)
    assert len(estimator.users) == 4


@pytest.mark.parametrize("call", ["lost_tracking", "new_session"])
def test_a_user_who_says_that_its_slam_began_anew_is_not_registered_until_it_is_found(
    recording: Recording, call: str
) -> None:
    estimator = sz.Estimator(["phone0", "phone1"], workers=0)
    feed(estimator, recording)
    assert estimator.registration().users["phone1"].state is sz.State.REGISTERED
    getattr(estimator, call)("phone1")
    end = float(recording.ranges.t[-1])
    (event,) = estimator.advance(end)
    assert event.startswith("phone1: unobservable: its SLAM")
    user = estimator.registration().users["phone1"]
    assert user.state is sz.State.UNOBSERVABLE
    assert user.common_from_user is None
    for name, fault in (("nobody", "user: there is no user"),):
        with pytest.raises(ValueError, match=fault):
            getattr(estimator, call)(name)
    with pytest.raises(ValueError, match="user: 'post' is static"):
        getattr(two(), call)("post")


def test_one_range_stamped_a_day_ahead_changes_nothing_that_is_told(recording: Recording) -> None:
    plain, strayed = (sz.Estimator(["phone0", "phone1"], workers=0) for _ in range(2))
    feed(plain, recording)
    for n, piece in enumerate((until(recording, 4.0), since(recording, 4.0))):
        feed(strayed, piece)
        if n == 0:
            strayed.add_range(86400.0, "phone0", "phone1", 3.0)
    ours, theirs = plain.registration(), strayed.registration()
    assert [user.state for user in ours.users.values()] == [user.state for user in theirs.users.values()]
    frames = [each.users["phone1"].common_from_user for each in (ours, theirs)]
    np.testing.assert_allclose(frames[0].translation, frames[1].translation, atol=0.05)  # type: ignore[union-attr]


@pytest.mark.parametrize("workers", [2, -1, "many"])
def test_so_many_processes_there_cannot_be(workers: int) -> None:
    with pytest.raises(ValueError, match="workers: must be 0, 1 or None"):
        sz.Estimator(["a"], workers=workers)


def test_what_came_long_ago_is_forgotten_though_nobody_is_ever_registered() -> None:
    """Two people who stand still: nothing tells where the other one is."""
    estimator = sz.Estimator(["alice", "bob"], workers=0, reference="alice")
    random = np.random.default_rng(0)
    for tick in range(300):
        t = 0.5 * tick
        for user in ("alice", "bob"):
            estimator.add_pose(user, t, [0.01 * np.sin(t), 0.01 * np.cos(3.0 * t), 0.0], [0.0, 0.0, 0.0, 1.0])
        estimator.add_range(t, "alice", "bob", 3.0 + 0.1 * random.standard_normal())
        estimator.advance(t)
    assert estimator.registration().users["bob"].state is sz.State.UNOBSERVABLE
    assert len(estimator.registration().ranges.usable) < 260


def test_time_goes_on_though_no_range_has_come() -> None:
    estimator = sz.Estimator(["alice", "bob"], workers=0)
    for n in range(20):
        for user in ("alice", "bob"):
            estimator.add_pose(user, 0.1 * n, (0.1 * n, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        assert estimator.advance(0.1 * n) is not None
