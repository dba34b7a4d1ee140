from __future__ import annotations

import tempfile
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.broken import write_good
from support.paths import SHARED

from synchronizar.arrays import Indices
from synchronizar.data.ranges import SOURCES, Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.errors import InputError

REAL = SHARED / "recordings"

lengths = st.floats(-1e5, 1e5)
names = st.text(st.characters(codec="utf-8", categories=("L", "N", "P", "S", "Zs")), min_size=1, max_size=8).filter(
    lambda s: s.isprintable() and s == s.strip() and s[0] != "." and not set(s) & set("/\\")
)


@st.composite
def users(draw: st.DrawFn) -> tuple[User, ...]:
    out = []
    for name in sorted(draw(st.sets(names, min_size=1, max_size=4))):
        static = draw(st.booleans())
        levers = st.dictionaries(names, st.tuples(lengths, lengths, lengths), max_size=0 if static else 3)
        out.append(User(name, static, draw(st.none() | st.floats(1e-3, 1e3)), draw(levers)))
    return tuple(out)


@st.composite
def tracks(draw: st.DrawFn) -> Track:
    n = draw(st.integers(1, 5))
    steps = draw(arrays(float, (n,), elements=st.floats(1e-3, 1e3)))
    quat = draw(arrays(float, (n, 4), elements=st.floats(-1.0, 1.0)))
    quat[:, 3] += np.where(np.linalg.norm(quat, axis=1) < 0.1, 1.0, 0.0)
    position = draw(arrays(float, (n, 3), elements=lengths))
    start = draw(st.floats(-1e9, 2e9))
    return Track(start + np.cumsum(steps), position, quat / np.linalg.norm(quat, axis=1, keepdims=True))


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    who = draw(users())
    n = draw(st.integers(0, 6)) if len(who) > 1 else 0

    def column(elements: st.SearchStrategy[float]) -> np.ndarray:
        return draw(arrays(float, (n,), elements=elements))

    a = draw(arrays(np.int32, (n,), elements=st.integers(0, len(who) - 1)))
    b = (a + draw(arrays(np.int32, (n,), elements=st.integers(1, max(1, len(who) - 1))))) % len(who)

    def antennas(ends: Indices) -> Indices:
        return np.array(
            [draw(st.integers(0, len(who[u].antennas) - 1)) if who[u].antennas else -1 for u in ends], dtype=np.int32
        )

    unknown = st.just(np.nan)
    ranges = Ranges(
        t=column(st.floats(-1e9, 2e9)),
        a=a,
        b=b.astype(np.int32),
        distance=column(st.floats()),
        sigma=column(unknown | st.floats(1e-3, 1e3)),
        antenna_a=antennas(a),
        antenna_b=antennas(b),
        rx_power=column(unknown | st.floats(-200.0, 50.0)),
        fp_power=column(unknown | st.floats(-200.0, 50.0)),
        nlos=column(unknown | st.sampled_from([0.0, 1.0])),
        source=draw(arrays(np.int32, (n,), elements=st.integers(-1, len(SOURCES) - 1))),
    )
    return Recording(who, {user.name: draw(tracks()) for user in who if not user.static}, ranges)


def assert_same(actual: Recording, expected: Recording) -> None:
    """Ranges and users to the last digit, tracks to a nanosecond and a nanometre."""
    assert actual.users == expected.users
    assert [list(user.antennas) for user in actual.users] == [list(user.antennas) for user in expected.users]
    for f in fields(Ranges):
        np.testing.assert_array_equal(getattr(actual.ranges, f.name), getattr(expected.ranges, f.name))
        assert getattr(actual.ranges, f.name).dtype == getattr(expected.ranges, f.name).dtype
    assert actual.tracks.keys() == expected.tracks.keys()
    for name, track in expected.tracks.items():
        for f in fields(Track):
            np.testing.assert_allclose(getattr(actual.tracks[name], f.name), getattr(track, f.name), rtol=0, atol=2e-9)


@settings(max_examples=150, deadline=None)
@given(recordings())
def test_what_is_saved_loads_the_same(recording: Recording) -> None:
    with tempfile.TemporaryDirectory() as folder:
        recording.save(Path(folder) / "deep/walk")
        assert_same(Recording.load(Path(folder) / "deep/walk"), recording)


@pytest.mark.parametrize(
    ("name", "users", "ranges"),
    [
        ("vub_exp2", 2, 2200),
        ("vub_exp4", 2, 2200),
        ("tiers5_cora", 5, 7789),
        ("tiers_case4_k7", 7, 22166),
        ("miluv_hist", 3, 1052),
        ("cmu_scott", 9, 5346),
    ],
)
def test_a_real_recording_loads_and_survives_saving(name: str, users: int, ranges: int, tmp_path: Path) -> None:
    if not (REAL / name).is_dir():
        pytest.skip("the real recordings are not part of the repository")
    recording = Recording.load(REAL / name)
    assert (len(recording.users), len(recording.ranges)) == (users, ranges)
    recording.save(tmp_path)
    assert_same(Recording.load(tmp_path), recording)


def test_a_recording_of_static_radios_needs_no_tracks(tmp_path: Path) -> None:
    (tmp_path / "recording.toml").write_text("[users.b]\nstatic = true\n[users.a]\nstatic = true\n")
    (tmp_path / "ranges.csv").write_text("t,a,b,range\n0,b,a,3\n")
    recording = Recording.load(tmp_path)
    assert recording.users == (User("a", static=True), User("b", static=True))
    assert recording.tracks == {}


def test_each_user_may_have_its_own_vertical(tmp_path: Path) -> None:
    write_good(tmp_path / "walk")
    (tmp_path / "walk/recording.toml").write_text('up = "y"\n[users.bob]\nup = "z"\n[users.beacon]\nstatic = true\n')
    plain = Recording.load(tmp_path / "walk")
    (tmp_path / "walk/recording.toml").write_text("[users.beacon]\nstatic = true\n")
    z_up = Recording.load(tmp_path / "walk")
    x, y, z = z_up.tracks["alice"].position.T
    np.testing.assert_array_equal(plain.tracks["alice"].position, np.column_stack([-z, -x, y]))
    np.testing.assert_array_equal(plain.tracks["bob"].position, z_up.tracks["bob"].position)


def test_loading_reads_no_truth_and_saving_writes_none(tmp_path: Path) -> None:
    write_good(tmp_path / "walk")
    (tmp_path / "walk/truth").mkdir()
    (tmp_path / "walk/truth/alice.tum").write_bytes(b"\xff")
    Recording.load(tmp_path / "walk").save(tmp_path / "walk")
    assert (tmp_path / "walk/truth/alice.tum").read_bytes() == b"\xff"
    Recording.load(tmp_path / "walk").save(tmp_path / "new")
    assert not (tmp_path / "new/truth").exists()


def test_saving_does_not_mix_two_recordings(tmp_path: Path) -> None:
    write_good(tmp_path / "walk")
    recording = Recording.load(tmp_path / "walk")
    (tmp_path / "walk/tracks/carol.tum").write_text("0 0 0 0 0 0 0 1\n")
    with pytest.raises(InputError, match=r"carol\.tum: stands in the way"):
        recording.save(tmp_path / "walk")


def test_a_folder_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    write_good(tmp_path / "walk")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"file/tracks: Not a directory$"):
        Recording.load(tmp_path / "walk").save(tmp_path / "file")


def test_a_user_whose_name_leads_elsewhere_is_not_saved(tmp_path: Path) -> None:
    none = np.zeros(0, dtype=np.int32)
    recording = Recording((User("../x", static=True),), {}, Ranges.of(np.zeros(0), none, none, np.zeros(0)))
    with pytest.raises(InputError, match="cannot be the name of a file"):
        recording.save(tmp_path / "walk")


@pytest.fixture
def turning() -> Recording:
    """Alice stands at (1, 2, 3) and has turned by +90 degrees; her left antenna is 1 m along her body's x axis."""
    half = np.sqrt(0.5)
    track = Track(np.array([0.0, 1.0]), np.array([[1.0, 2.0, 3.0]] * 2), np.array([[0.0, 0.0, half, half]] * 2))
    zero = np.zeros(2, dtype=np.int32)
    ranges = Ranges.of(np.array([0.5, 2.0]), zero, zero + 1, np.ones(2), antenna_a=zero)
    alice = User("alice", antennas={"left": (1.0, 0.0, 0.0), "right": (-1.0, 0.0, 0.5)})
    return Recording((alice, User("beacon", static=True)), {"alice": track}, ranges)


def test_an_antenna_is_where_the_attitude_carries_it(turning: Recording) -> None:
    antenna = np.array([0, 1, -1, 0], dtype=np.int32)
    position, known = turning.antenna_positions(0, np.array([0.5, 0.5, 0.5, 2.0]), antenna, max_gap=2.0)
    np.testing.assert_array_equal(known, [True, True, True, False])
    np.testing.assert_allclose(position[:3], [[1.0, 3.0, 3.0], [1.0, 1.0, 3.5], [1.0, 2.0, 3.0]], atol=1e-12)


def test_a_static_radio_is_always_at_its_origin(turning: Recording) -> None:
    position, known = turning.antenna_positions(1, np.array([-1e9, 1e9]), np.array([-1, -1], dtype=np.int32), 0.1)
    np.testing.assert_array_equal(position, np.zeros((2, 3)))
    assert known.all()


def test_a_user_is_found_by_name(turning: Recording) -> None:
    assert turning.index("beacon") == 1
    with pytest.raises(KeyError):
        turning.index("eve")


def test_what_contradicts_itself_is_no_recording(turning: Recording) -> None:
    alice, beacon = turning.users
    with pytest.raises(ValueError, match="sorted"):
        replace(turning, users=(beacon, alice))
    with pytest.raises(ValueError, match="needs a track"):
        replace(turning, tracks={})
    with pytest.raises(ValueError, match="needs a track"):
        replace(turning, tracks={**turning.tracks, "beacon": turning.tracks["alice"]})
    with pytest.raises(ValueError, match="a user that is not there"):
        replace(turning, ranges=replace(turning.ranges, b=np.array([1, 2], dtype=np.int32)))
    with pytest.raises(ValueError, match="an antenna that its user does not have"):
        replace(turning, ranges=replace(turning.ranges, antenna_a=np.array([0, 2], dtype=np.int32)))
    with pytest.raises(ValueError, match="an antenna that its user does not have"):
        replace(turning, ranges=replace(turning.ranges, antenna_b=np.array([-1, 0], dtype=np.int32)))
