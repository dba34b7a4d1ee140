from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from support.live import feed

import synchronizar as sz
from synchronizar.data.recording import Recording
from synchronizar.data.user import User
from synchronizar.errors import InputError
from synchronizar.estimation.incremental.engine import Engine
from synchronizar.estimation.incremental.state_file import load, save
from synchronizar.estimation.incremental.told import registration_now
from synchronizar.parameters import Parameters
from synchronizar.simulation.simulate import Scene, simulate

SCENE = Scene(users=2, seconds=14.0, rate_hz=8.0, late_share=0.1, seed=1, antennas=1, static_radios=1)
PARAMETERS = Parameters().changed(incremental={"window": 4.0}, integrity={"proven_duration": 1.0})
BY_A_METHOD = {
    "Engine": {
        "log",
        "roster",
        "following",
        "schedule",
        "findings",
        "_judging",
        "_cueing",
        "_clock",
        "_guard",
        "_told",
    },
    "Roster": {"users", "reference", "streams"},
    "Following": {"tracking", "contradictions"},
    "Tracking": {"follower", "ranges", "slots", "weighing", "drift"},
}
"""What a part of an engine keeps in some other way than by its attributes' names."""
NOT_KEPT = {
    "Engine": {"parameters", "_searcher"},
    "Roster": {"parameters"},
    "Following": {"_roster", "_log", "members"},
    "Tracking": {"users", "streams", "parameters", "_loss", "_levers", "_survey", "_biases"},
    "RangeWeighing": {"_parameters", "_loss"},
    "SeenDrift": {"_parameters"},
    "Schedule": {"_roster", "_following"},
    "Findings": {"_roster", "_following", "_verdicts"},
    "Judging": {"_roster", "_log", "_following", "_schedule"},
    "Cueing": {"_roster", "_log", "_following"},
}
"""Made anew of what is kept, given by the caller, or another part's."""
CUTS, LATER_S = (0.05, 2.0, 6.33, 11.07, 13.3), 3.0
"""s after the begin: when one is saved, and for how long both are compared from then on."""


@cache
def recording() -> Recording:
    return simulate(SCENE).recording


def walked(until: float) -> Engine:
    engine = Engine(recording().users, 0, PARAMETERS)
    feed(engine, recording(), end=until)
    return engine


@cache
def saved(until: float) -> bytes:
    """A file's content."""
    with TemporaryDirectory() as folder:
        save(walked(until), Path(folder, "state.npz"), {})
        return Path(folder, "state.npz").read_bytes()


def assert_the_same(one: Engine, other: Engine, within: float) -> None:
    """All that both tell now."""
    ours, theirs = registration_now(one), registration_now(other)
    for name, user in ours.users.items():
        twin = theirs.users[name]
        plain = ("state", "reason", "cue", "static", "prior_dominated", "jumps")
        assert [getattr(user, key) for key in plain] == [getattr(twin, key) for key in plain]
        assert user.progress == pytest.approx(twin.progress, abs=within)
        assert (user.common_from_user is None) == (twin.common_from_user is None)
        if user.common_from_user is None or twin.common_from_user is None:
            continue
        for key in ("translation", "yaw", "scale"):
            values = [getattr(of.common_from_user, key) for of in (user, twin)]
            np.testing.assert_allclose(*values, rtol=0.0, atol=within)
        np.testing.assert_allclose(user.covariance, twin.covariance, rtol=0.0, atol=within)
        assert user.range_bias == pytest.approx(twin.range_bias, abs=within)
        assert user.calibration_sigma == pytest.approx(twin.calibration_sigma, abs=within, nan_ok=True)
        for key in ("clock_offset", "slam_noise"):
            assert getattr(user, key) == pytest.approx(getattr(twin, key), abs=within)
    for column in ("usable", "used", "weight", "residual"):
        np.testing.assert_allclose(getattr(ours.ranges, column), getattr(theirs.ranges, column), within, within)
    assert len(ours.alternatives) == len(theirs.alternatives)


def test_who_is_saved_and_loaded_says_the_same_then_and_for_ever(tmp_path: Path) -> None:
    """At five moments of one walk, and for 3 s from each."""
    engine, walking = walked(CUTS[0]), {}
    for now, then in pairwise(sorted({*CUTS, *(cut + LATER_S for cut in CUTS)})):
        if now in CUTS:
            save(engine, tmp_path / "state.npz", {"up": "y"})
            loaded, face = load(tmp_path / "state.npz", PARAMETERS, 0)
            assert face == {"up": "y"}
            assert loaded.users == engine.users
            assert_the_same(loaded, engine, 1e-9)
            walking[now + LATER_S] = loaded
        told = feed(engine, recording(), now, then)
        for loaded in walking.values():
            assert feed(loaded, recording(), now, then) == told
        if (ending := walking.pop(then, None)) is not None:
            assert list(ending.following.tracking.members) == list(engine.following.tracking.members)
            assert_the_same(ending, engine, 1e-6)
    assert not walking


def test_the_walk_that_is_cut_has_followed_people_and_marginals() -> None:
    engine = walked(13.9)
    assert set(engine.following.tracking.members) == {0, 1, 2}
    assert any(name[0] == "marginal" for name in engine.following.tracking.follower.names())  # type: ignore[index]


def test_saving_changes_nothing(tmp_path: Path) -> None:
    saved, plain = walked(6.0), walked(6.0)
    save(saved, tmp_path / "state.npz", {})
    assert feed(saved, recording(), 6.0, 9.0) == feed(plain, recording(), 6.0, 9.0)
    assert_the_same(saved, plain, 0.0)


def test_what_is_saved_twice_is_written_to_the_last_bit(tmp_path: Path) -> None:
    files = [tmp_path / "one.npz", tmp_path / "two.npz"]
    files[0].write_bytes(saved(8.0))
    save(load(files[0], PARAMETERS, 0)[0], files[1], {})
    with np.load(files[0]) as one, np.load(files[1]) as two:
        assert one.files == two.files
        for name in one.files:
            if one[name].dtype.kind == "U":
                assert one[name] == two[name]
            else:
                np.testing.assert_allclose(one[name], two[name], rtol=1e-9, atol=1e-12)


def test_nothing_that_an_engine_knows_is_left_out() -> None:
    engine = walked(1.0)
    tracking = engine.following.tracking
    followed = [engine.following, tracking, tracking.weighing, tracking.drift]
    for part in [engine, engine.roster, *followed, engine.schedule, engine.findings, engine._judging, engine._cueing]:
        name = type(part).__name__
        known = {*getattr(part, "KEPT", ()), *BY_A_METHOD.get(name, ()), *NOT_KEPT[name]}
        assert set(vars(part)) == known, name


def test_users_keep_their_settings(tmp_path: Path) -> None:
    users = (
        User("a", antennas={"left": (0.1, 0.0, 0.2)}, up="y"),
        User("b", height_sigma=0.25),
        User("c", static=True),
    )
    save(Engine(users, 1), tmp_path / "state.npz", {})
    loaded, _ = load(tmp_path / "state.npz", Parameters(), 0)
    assert (loaded.users, loaded.reference) == (users, 1)


def test_an_estimator_is_loaded_with_what_it_refused_and_the_axis_of_its_poses(tmp_path: Path) -> None:
    estimator = sz.Estimator(["a", "b"], up="y", reference="b", workers=0)
    estimator.add_range(0.0, "a", "b", None)
    estimator.advance(0.0)
    estimator.add_range(0.0, "a", "b", None)
    estimator.save(tmp_path / "state.npz")
    loaded = sz.Estimator.load(tmp_path / "state.npz", workers=0)
    assert loaded.reference == "b"
    assert loaded.refused == estimator.refused
    assert loaded.advance(0.1) == ["a and b: a range that is no number: refused, 1 time"]
    loaded.add_user("c")
    assert [user.up for user in loaded.users] == ["y", "y", "y"]


# What cannot be read or written


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04 cut off"])
def test_a_file_that_is_no_saved_state_is_told(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "state.npz"
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"state\.npz: is no saved state"):
        load(file, Parameters(), 0)


def test_a_damaged_file_is_told_wherever_the_damage_is(tmp_path: Path) -> None:
    file = tmp_path / "state.npz"
    whole, random = saved(5.0), np.random.default_rng(0)
    for at in random.integers(0, len(whole), 30).tolist():
        file.write_bytes(whole[:at])
        with pytest.raises(InputError, match="no saved state"):
            load(file, Parameters(), 0)
        turned = bytearray(whole)
        turned[at] ^= 0xFF
        file.write_bytes(bytes(turned))
        with suppress(InputError):  # a byte between the members of the archive is nobody's
            load(file, PARAMETERS, 0)


def test_an_archive_that_does_not_fit_together_is_told(tmp_path: Path) -> None:
    file = tmp_path / "state.npz"
    file.write_bytes(saved(5.0))
    with np.load(file) as archive:
        arrays = {name: archive[name] for name in archive.files}
    for name in list(arrays):
        np.savez(file, **{key: array for key, array in arrays.items() if key != name})  # type: ignore[arg-type]
        with pytest.raises(InputError, match=r"no saved state|damaged"):
            load(file, PARAMETERS, 0)
    ours = json.loads(str(arrays["header"]))["format"]
    whole = (json.dumps({"format": ours} | more) for more in ({}, {"known": ["record", "Popen", {}]}))
    for header in ("{}", "[]", "1", "{", *whole):
        np.savez(file, **(arrays | {"header": np.array(header)}))  # type: ignore[arg-type]
        with pytest.raises(InputError, match=r"no saved state|damaged"):
            load(file, PARAMETERS, 0)


def test_a_file_of_another_format_is_told_by_its_number(tmp_path: Path) -> None:
    np.savez(tmp_path / "state.npz", header=np.array('{"format": 99}'))
    with pytest.raises(InputError, match="format 99"):
        load(tmp_path / "state.npz", Parameters(), 0)


def test_no_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        load(tmp_path / "nothing.npz", Parameters(), 0)
    with pytest.raises(InputError, match="No such file"):
        save(walked(0.5), tmp_path / "no folder" / "state.npz", {})


def test_what_cannot_be_written_leaves_the_file_that_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "state.npz"
    save(walked(0.5), file, {})
    before = file.read_bytes()

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(InputError, match="No space left"):
        save(walked(0.5), file, {})
    assert file.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == ["state.npz"]


def test_settings_of_the_search_may_change_between(tmp_path: Path) -> None:
    (tmp_path / "state.npz").write_bytes(saved(8.0))
    loaded, _ = load(tmp_path / "state.npz", replace(PARAMETERS), 0)
    assert loaded.parameters == PARAMETERS
