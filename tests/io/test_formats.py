from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from synchronizar.data.ranges import Ranges
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.errors import InputError
from synchronizar.io import ranges_csv
from synchronizar.io.ranges_csv import read_ranges_csv, write_ranges_csv
from synchronizar.io.recording_toml import Settings, read_recording_toml, write_recording_toml
from synchronizar.io.tum import read_tum, write_tum
from synchronizar.quaternions import rotate_by_quaternions

ALICE = User("alice", antennas={"left": (0.0, 0.1, 0.0), "right": (0.0, -0.1, 0.0)})
BEACON = User("beacon", static=True)
BOB = User("bob", antennas={"top": (0.0, 0.0, 0.2)})
USERS = (ALICE, BEACON, BOB)


@pytest.fixture
def tum(tmp_path: Path) -> Path:
    return tmp_path / "alice.tum"


@pytest.fixture
def csv(tmp_path: Path) -> Path:
    return tmp_path / "ranges.csv"


@pytest.fixture
def toml(tmp_path: Path) -> Path:
    return tmp_path / "recording.toml"


# Tracks


def test_a_track_is_read_as_it_stands(tum: Path) -> None:
    tum.write_text("# t x y z qx qy qz qw\n0.5 1 2 3 0 0 0 1\n\n1e0 -4 5.5 .5 1 0 0 0 # turned\n")
    track = read_tum(tum)
    np.testing.assert_array_equal(track.t, [0.5, 1.0])
    np.testing.assert_array_equal(track.position, [[1.0, 2.0, 3.0], [-4.0, 5.5, 0.5]])
    np.testing.assert_array_equal(track.quat_xyzw, [[0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0]])


def test_poses_are_sorted_and_the_last_of_each_stamp_counts(tum: Path) -> None:
    stamps = [3, 1, 2, 1, 3, 0, 1]
    tum.write_text("".join(f"{t} {k} 0 0 0 0 0 1\n" for k, t in enumerate(stamps)))
    track = read_tum(tum)
    np.testing.assert_array_equal(track.t, [0.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(track.position[:, 0], [5.0, 6.0, 2.0, 4.0])


def test_quaternions_of_any_length_are_made_unit_ones(tum: Path) -> None:
    tum.write_text("0 0 0 0 0 0 3 4\n1 0 0 0 0 0 3e200 4e200\n2 0 0 0 0 0 3e-200 4e-200\n")
    np.testing.assert_allclose(read_tum(tum).quat_xyzw, [[0.0, 0.0, 0.6, 0.8]] * 3, rtol=1e-15)


def test_a_y_up_track_stands_upright_and_keeps_its_body_axes(tum: Path) -> None:
    # A phone at (1, 2, 3) in a y-up frame, turned by +90 degrees about that frame's y axis.
    tum.write_text("0 1 2 3 0 1 0 1\n")
    track = read_tum(tum, "y")
    np.testing.assert_allclose(track.position, [[-3.0, -1.0, 2.0]])
    # Its body x axis pointed along -z of y-up, which is x of z-up; its body y axis stays the vertical.
    np.testing.assert_allclose(
        rotate_by_quaternions(track.quat_xyzw, np.array([[1.0, 0.0, 0.0]])), [[1, 0, 0]], atol=1e-9
    )
    np.testing.assert_allclose(
        rotate_by_quaternions(track.quat_xyzw, np.array([[0.0, 1.0, 0.0]])), [[0, 0, 1]], atol=1e-9
    )


def test_stamps_since_1970_keep_their_microseconds(tum: Path) -> None:
    t = 1_700_000_000.0 + np.arange(5) * 1e-6
    write_tum(tum, Track(t, np.zeros((5, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (5, 1))))
    np.testing.assert_array_equal(read_tum(tum).t, t)


def test_a_track_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    track = Track(np.zeros(1), np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]))
    with pytest.raises(InputError, match=r"nowhere/alice\.tum: No such file or directory$"):
        write_tum(tmp_path / "nowhere/alice.tum", track)


# Ranges


def test_every_column_is_read(csv: Path) -> None:
    csv.write_text(
        "source,nlos,fp_power,rx_power,antenna_b,antenna_a,sigma,range,b,a,t\n"
        "module,1,-81.5,-79,top,right,0.1,2.5,bob,alice,1.25\n"
        ",FALSE,,,, left , ,-0.02,beacon,alice,0.75\n"
    )
    ranges = read_ranges_csv(csv, USERS)
    np.testing.assert_array_equal(ranges.t, [1.25, 0.75])
    np.testing.assert_array_equal(ranges.a, [0, 0])
    np.testing.assert_array_equal(ranges.b, [2, 1])
    np.testing.assert_array_equal(ranges.distance, [2.5, -0.02])
    np.testing.assert_array_equal(ranges.sigma, [0.1, np.nan])
    np.testing.assert_array_equal(ranges.antenna_a, [1, 0])
    np.testing.assert_array_equal(ranges.antenna_b, [0, -1])
    np.testing.assert_array_equal(ranges.rx_power, [-79.0, np.nan])
    np.testing.assert_array_equal(ranges.fp_power, [-81.5, np.nan])
    np.testing.assert_array_equal(ranges.nlos, [1.0, 0.0])
    np.testing.assert_array_equal(ranges.source, [0, -1])


def test_a_header_alone_is_no_ranges(csv: Path) -> None:
    csv.write_text("t,a,b,range\n")
    assert len(read_ranges_csv(csv, USERS)) == 0


def test_distances_that_cannot_be_are_kept_for_the_solver_to_set_aside(csv: Path) -> None:
    csv.write_text("t,a,b,range\n0,bob,beacon,nan\n0,bob,beacon,-inf\n0,bob,beacon,1e300\n0,bob,beacon,1e999\n")
    np.testing.assert_array_equal(read_ranges_csv(csv, USERS).distance, [np.nan, -np.inf, 1e300, np.inf])


def test_the_only_antenna_need_not_be_named_and_without_a_lever_arm_a_name_says_nothing(csv: Path) -> None:
    csv.write_text("t,a,b,range,antenna_a,antenna_b\n0,bob,beacon,1,,dipole\n0,beacon,bob,1,dipole,top\n")
    ranges = read_ranges_csv(csv, USERS)
    np.testing.assert_array_equal(ranges.antenna_a, [0, -1])
    np.testing.assert_array_equal(ranges.antenna_b, [-1, 0])


def test_without_antenna_columns_only_users_with_several_are_in_doubt(csv: Path) -> None:
    csv.write_text("t,a,b,range\n0,bob,beacon,1\n")
    assert read_ranges_csv(csv, USERS).antenna_a.tolist() == [0]
    csv.write_text("t,a,b,range\n0,bob,beacon,1\n0,beacon,alice,1\n")
    with pytest.raises(InputError, match=r"ranges\.csv:3: antenna_b is '': alice has the antennas left, right$"):
        read_ranges_csv(csv, USERS)


@pytest.mark.parametrize(
    ("text", "value"), [("1", 1), ("0", 0), ("1.0", 1), ("0.0", 0), ("True", 1), ("false", 0), ("", np.nan)]
)
def test_nlos_is_read_as_people_write_it(csv: Path, text: str, value: float) -> None:
    csv.write_text(f"t,a,b,range,nlos\n0,bob,beacon,1,{text}\n")
    np.testing.assert_array_equal(read_ranges_csv(csv, USERS).nlos, [value])


def test_sources_are_read_and_a_word_of_others_is_not_known(csv: Path) -> None:
    words = ["module", "overheard", "Android", "APPLE", "simulated", "", "dw3000", "-1", "0"]
    csv.write_text("t,a,b,range,source\n" + "".join(f"0,bob,beacon,1,{word}\n" for word in words))
    source = read_ranges_csv(csv, USERS).source
    np.testing.assert_array_equal(source, [0, 1, 2, 3, 4, -1, -1, -1, -1])
    assert source.dtype == np.int32


def test_without_its_column_no_source_is_known(csv: Path) -> None:
    csv.write_text("t,a,b,range\n0,bob,beacon,1\n0,beacon,bob,1\n")
    np.testing.assert_array_equal(read_ranges_csv(csv, USERS).source, [-1, -1])


def test_sources_are_written_as_words(csv: Path) -> None:
    ends = np.array([2, 2, 2], dtype=np.int32), np.array([1, 1, 1], dtype=np.int32)
    source = np.array([0, -1, 4], dtype=np.int32)
    antenna_a = np.zeros(3, dtype=np.int32)
    ranges = Ranges.of(np.array([0.0, 1.0, 2.0]), *ends, np.ones(3), antenna_a=antenna_a, source=source)
    write_ranges_csv(csv, ranges, USERS)
    assert csv.read_text() == (
        "t,a,b,range,antenna_a,source\n0.0,bob,beacon,1.0,top,module\n1.0,bob,beacon,1.0,top,\n"
        "2.0,bob,beacon,1.0,top,simulated\n"
    )
    np.testing.assert_array_equal(read_ranges_csv(csv, USERS).source, source)


@pytest.mark.parametrize("source", [-2, 5])
def test_a_source_that_nobody_knows_is_no_range(source: int) -> None:
    one = np.zeros(1, dtype=np.int32)
    with pytest.raises(ValueError, match="source"):
        Ranges.of(np.zeros(1), one, one + 1, np.ones(1), source=one + source)


def test_a_power_of_minus_infinity_is_not_known(csv: Path) -> None:
    csv.write_text("t,a,b,range,rx_power\n0,bob,beacon,1,-inf\n")
    assert np.isnan(read_ranges_csv(csv, USERS).rx_power).all()


@pytest.mark.parametrize("rows", [1, 2, 3, 4, 5, 6, 7])
def test_chunks_leave_no_seam(csv: Path, rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ranges_csv, "CHUNK_LINES", 3)
    csv.write_text("\nt,a,b,range\n" + "".join(f"{k},bob,beacon,{k}\n" for k in range(rows)))
    np.testing.assert_array_equal(read_ranges_csv(csv, USERS).distance, np.arange(rows))
    with csv.open("a") as file:
        file.write("\nx,bob,beacon,1\n")
    with pytest.raises(InputError, match=rf"ranges\.csv:{rows + 4}: t is 'x'"):
        read_ranges_csv(csv, USERS)


def test_only_columns_that_say_something_are_written(csv: Path) -> None:
    ranges = Ranges.of(
        np.array([0.1, 0.2]),
        np.array([2, 1], dtype=np.int32),
        np.array([1, 0], dtype=np.int32),
        np.array([1.5, np.nan]),
        antenna_a=np.array([0, -1], dtype=np.int32),
        antenna_b=np.array([-1, 1], dtype=np.int32),
        nlos=np.array([np.nan, 1.0]),
    )
    write_ranges_csv(csv, ranges, USERS)
    assert csv.read_text() == (
        "t,a,b,range,antenna_a,antenna_b,nlos\n0.1,bob,beacon,1.5,top,,\n0.2,beacon,alice,nan,,right,1\n"
    )


def test_a_range_that_leaves_its_antenna_open_is_not_written(csv: Path) -> None:
    one = np.zeros(1, dtype=np.int32)
    with pytest.raises(ValueError, match="which one"):
        write_ranges_csv(csv, Ranges.of(np.zeros(1), one, one + 1, np.ones(1)), USERS)


# Settings


def test_settings_are_read(toml: Path) -> None:
    toml.write_text("""
        up = "y"
        [users.alice]
        up = "z"
        height_sigma = 1
        antennas.10 = [0.13, -0.17, 0]
        [users.beacon]
        static = true
        [users.bob]
    """)
    assert read_recording_toml(toml) == Settings(
        users={
            "alice": User("alice", height_sigma=1.0, antennas={"10": (0.13, -0.17, 0.0)}),
            "beacon": User("beacon", static=True, up="y"),
            "bob": User("bob", up="y"),
        },
        up="y",
    )


def test_empty_settings_say_nothing(toml: Path) -> None:
    toml.write_text("")
    assert read_recording_toml(toml) == Settings(users={}, up="z")


def test_only_what_differs_from_the_default_is_written(toml: Path) -> None:
    users = (User("alice"), User('b "o" b', height_sigma=0.5, antennas={"0.5": (1.0, 0.0, -2e-7)}), BEACON)
    write_recording_toml(toml, users)
    assert toml.read_text() == (
        'up = "z"\n\n[users."b \\"o\\" b"]\nheight_sigma = 0.5\nantennas."0.5" = [1.0, 0.0, -2e-07]\n'
        '\n[users."beacon"]\nstatic = true\n'
    )
    assert list(read_recording_toml(toml).users.values()) == list(users[1:])
