"""Text formats become recordings: units, stamps, axes and names as each format has them."""

from __future__ import annotations

import codecs
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.bags import walk

from synchronizar.cli import main
from synchronizar.convert.asked import Asked
from synchronizar.convert.formats import format_named
from synchronizar.convert.imported import Imported
from synchronizar.convert.importing import parts_of
from synchronizar.convert.stillness import moves
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.errors import InputError
from synchronizar.progress import unheard

HALF = np.sqrt(0.5)
EUROC = "#timestamp, p_RS_R_x [m], p_y, p_z, q_RS_w [], q_x, q_y, q_z\n1403636580838555648,1,2,3,0.6,0.8,0,0,9,9\n"
KITTI = "1 0 0 0.5 0 1 0 -1.5 0 0 1 2\n" * 2
ARKIT = "# ARKit\n98765432100000 1 0 0 0.1 0 1 0 1.4 0 0 1 -0.3\n98765465400000 1 0 0 0.2 0 1 0 1.4 0 0 1 -0.4\n"
ARCORE = "# t qx qy qz qw x y z\n98765432100000 0 0.6 0 0.8 0.1 1.4 -0.3\n98765465400000 0 0.6 0 0.8 0.2 1.4 -0.4\n"
LEC = "1700000000.25 DIST,2,AN0,022e,7.94,8.03,0.00,3.44,AN1,9280,7.95,0.00,2.50,5.68,POS,6.95,5.37,-1.97,52\n"
LES = "dwm> les\n1700000000.5 022E[7.94,8.03,0.00]=3.38 9280[7.95,0.00,2.50]=5.49 le_us=3082 est[6.97,5.17,-1.77,53]\n"
POZYX = "0x6951: 1200 ms, 2045 mm, -81 dBm\n0x6952: 1300 ms, 3045 mm, -82 dBm\n"
NODES = """role: 2
id: 3
local_time: 12345
system_time: 5500
nodes:
  -
    role: 2
    id: 7
    dis: 2.25
    fp_rssi: -80.5
    rx_rssi: -79.0
  -
    role: 2
    id: 8
    dis: 0.0
---
"""
NODES_CSV = """%time,field.id,field.nodes0.id,field.nodes0.dis,field.nodes0.fp_rssi,field.nodes0.rx_rssi
1700000000250000000,3,7,2.25,-80.5,-79.0
"""
PYFG = """VERTEX_SE2 1.0 A0 5 5 1.5
VERTEX_SE2 2.0 A1 5 6 1.5
VERTEX_SE2 1.0 B0 0 0 0
VERTEX_SE2 2.0 B1 1 0 0
VERTEX_XY L0 2 3
EDGE_SE2 2.0 A0 A1 1 0 0.5 0.01 0 0 0.01 0 0.01
EDGE_SE2 2.0 B0 B1 2 0 0 0.01 0 0 0.01 0 0.01
EDGE_RANGE 1.1 A0 B0 7.5 0.04
EDGE_RANGE 2.1 A1 L0 4.5 0.04
"""
PYFG_3D = """VERTEX_SE3:QUAT 1.0 A0 0 0 0 0 0.70710678 0 0.70710678
VERTEX_SE3:QUAT 2.0 A1 0 0 -1 0 0.70710678 0 0.70710678
EDGE_SE3:QUAT 2.0 A0 A1 1 0 0 0 0 0 1 0.1
"""
SAMPLES = {
    "euroc": EUROC,
    "phone": ARKIT,
    "dwm1001": LEC,
    "pozyx": POZYX,
    "nooploop": NODES,
    "pyfg": PYFG,
    "tum": "1.0 0 0 0 0 0 0 1\n1.1 1 0 0 0 0 0 1\n",
    "csv": "t,x,y,z,qx,qy,qz,qw\n1,0,0,0,0,0,0,1\n2,1,0,0,0,0,0,1\n",
}


def read(tmp_path: Path, text: str, name: str = "alice.txt", **asked: Any) -> Imported:
    """What the format that is recognised reads."""
    file = tmp_path / name
    file.write_text(text)
    parts, _ = parts_of(file, None)
    imported: Imported = parts[0].format.reading().read(file, Asked(**asked), unheard)
    return imported


def test_euroc_stamps_are_nanoseconds_and_its_quaternions_have_w_first(tmp_path: Path) -> None:
    rows = read(tmp_path, EUROC).tracks["alice"]
    np.testing.assert_allclose(rows, [[1403636580.838555648, 1, 2, 3, 0.8, 0, 0, 0.6]])


def test_a_euroc_folder_names_the_user_and_every_device_has_one(tmp_path: Path) -> None:
    for user in ("alice", "bob"):
        folder = tmp_path / "set" / user / "mav0" / "state_groundtruth_estimate0"
        folder.mkdir(parents=True)
        (folder / "data.csv").write_text(EUROC)
    assert main(["convert", str(tmp_path / "set"), str(tmp_path / "walk")]) == 0
    assert {file.stem for file in (tmp_path / "walk/tracks").iterdir()} == {"alice", "bob"}


def test_kitti_poses_are_turned_from_a_cameras_axes_and_need_times(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has no times: put times.txt"):
        read(tmp_path, KITTI)
    (tmp_path / "times.txt").write_text("0.0\n0.1\n")
    rows = read(tmp_path, KITTI).tracks["alice"]
    # x right, y down, z forward: 2 m forward, 0.5 m to the right, 1.5 m up.
    np.testing.assert_allclose(rows, [[0.1 * k, 2, -0.5, 1.5, 0, 0, 0, 1] for k in range(2)], atol=1e-12)


def test_an_arkit_matrix_and_an_arcore_quaternion_stay_y_up(tmp_path: Path) -> None:
    kit = read(tmp_path, ARKIT)
    np.testing.assert_allclose(kit.tracks["alice"][0], [98765.4321, 0.1, 1.4, -0.3, 0, 0, 0, 1])
    assert kit.users["alice"].up == "y"
    core = read(tmp_path, ARCORE, "bob.txt")
    np.testing.assert_allclose(core.tracks["bob"][0], [98765.4321, 0.1, 1.4, -0.3, 0, 0.6, 0, 0.8])
    assert core.users["bob"].up == "y"


def test_dwm1001_lines_of_both_commands_give_ranges_and_the_anchors_places(tmp_path: Path) -> None:
    both = read(tmp_path, LEC + LES)
    assert (both.ranges.a, both.ranges.b) == (["alice"] * 4, ["022E", "9280"] * 2)
    assert list(both.ranges.distance) == [3.44, 5.68, 3.38, 5.49]
    assert list(both.ranges.t) == [1700000000.25] * 2 + [1700000000.5] * 2
    assert both.users["022E"].static
    assert both.users["9280"].position == (7.95, 0.0, 2.5)
    assert not both.truth


def test_anchors_that_nobody_placed_are_not_taken_for_surveyed(tmp_path: Path) -> None:
    """A DWM1001 whose place was not entered says that it is at the origin."""
    text = "1.5 AAAA[0.00,0.00,0.00]=3.38 BBBB[0.00,0.00,0.00]=5.49 CCCC[4.00,0.00,2.00]=2.5\n"
    imported = read(tmp_path, text)
    assert [imported.users[name].position for name in ("AAAA", "BBBB", "CCCC")] == [None, None, (4.0, 0.0, 2.0)]
    assert any(note.startswith("AAAA, BBBB: told to be at one and the same place") for note in imported.notes)


def test_pozyx_says_where_its_anchors_are_in_millimetres(tmp_path: Path) -> None:
    anchors = "ANCHOR,0x6951,X: 0, Y: 4000, Z: 2500\nANCHOR,0x6952,1500,-20,2500\nANCHOR,0x6999,X: 1, Y: 1, Z: 1\n"
    users = read(tmp_path, anchors + POZYX).users
    assert {name: user.position for name, user in users.items()} == {
        "0x6951": (0.0, 4.0, 2.5),
        "0x6952": (1.5, -0.02, 2.5),
    }


@pytest.mark.parametrize(
    ("prior", "sigma"),
    [
        ("VERTEX_XY:PRIOR 1.0 L0 2.5 3 0.01 0 0.04", 0.025**0.5),
        ("VERTEX_XYZ:PRIOR 1.0 L0 2.5 3 0 9e-4 0 0 9e-4 0 9e-4", 0.03),
    ],
)
def test_a_landmark_with_a_prior_was_surveyed_and_stands_so_in_the_recording(
    tmp_path: Path, prior: str, sigma: float
) -> None:
    user = read(tmp_path, f"{PYFG}{prior}\n", "g.pyfg").users["L0"]
    assert user.position == (2.5, 3.0, 0.0)
    assert user.position_sigma == pytest.approx(sigma)
    assert read(tmp_path, PYFG, "g.pyfg").users["L0"].position is None
    (tmp_path / "g.pyfg").write_text(f"{PYFG}{prior}\n")
    assert main(["convert", str(tmp_path / "g.pyfg"), str(tmp_path / "out")]) == 0
    assert "position = [2.5, 3.0, 0.0]" in (tmp_path / "out/recording.toml").read_text()


def test_a_map_says_where_a_radio_was_surveyed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "g.pyfg").write_text(PYFG)
    told, out = tmp_path / "map.toml", tmp_path / "out"
    told.write_text("[radios.L0]\nposition = [1, 2, 3]\nposition_sigma = 0.5\n")
    assert main(["convert", str(tmp_path / "g.pyfg"), str(out), "--map", str(told)]) == 0
    user = next(user for user in Recording.load(out).users if user.name == "L0")
    assert (user.position, user.position_sigma) == ((1.0, 2.0, 3.0), 0.5)
    for wrong in ("position = [1, 2]", "position_sigma = 0.5", "position = [1, 2, 3]\nlever = [0, 0, 0]", "place = 1"):
        told.write_text(f"[radios.L0]\n{wrong}\n")
        assert main(["convert", str(tmp_path / "g.pyfg"), str(tmp_path / "no"), "--map", str(told)]) == 2
        assert "radios.L0" in capsys.readouterr().err


def test_a_log_without_times_says_what_to_do(tmp_path: Path) -> None:
    bare = LEC.partition(" ")[2]
    with pytest.raises(InputError, match="has no time: log a stamp before each line, or say --rate"):
        read(tmp_path, bare)
    assert list(read(tmp_path, bare * 3, rate=10.0).ranges.t)[::2] == pytest.approx([0.0, 0.1, 0.2])


@pytest.mark.parametrize(
    ("stamp", "t"),
    [("1700000000250", 1700000000.25), ("2023-11-14T22:13:20.25Z", 1700000000.25), ("00:01:02.5", 62.5)],
)
def test_a_line_may_be_stamped_in_many_ways(tmp_path: Path, stamp: str, t: float) -> None:
    assert read(tmp_path, f"{stamp} {LEC.partition(' ')[2]}").ranges.t[0] == pytest.approx(t, abs=1e-6)


def test_pozyx_lines_are_milliseconds_and_millimetres(tmp_path: Path) -> None:
    rows = read(tmp_path, POZYX).ranges
    assert (list(rows.t), list(rows.distance), list(rows.rx_power)) == ([1.2, 1.3], [2.045, 3.045], [-81, -82])
    assert rows.b == ["0x6951", "0x6952"]


@pytest.mark.parametrize(("text", "t"), [(NODES, 5.5), (NODES_CSV, 1700000000.25)])
def test_nooploop_frames_give_the_ranges_that_were_measured(tmp_path: Path, text: str, t: float) -> None:
    rows = read(tmp_path, text).ranges
    assert (rows.a, rows.b, list(rows.distance)) == (["3"], ["7"], [2.25])
    assert (list(rows.rx_power), list(rows.fp_power), rows.t[0]) == ([-79.0], [-80.5], pytest.approx(t))


def test_a_graphs_odometry_is_added_up_and_its_vertices_are_the_truth(tmp_path: Path) -> None:
    graph = read(tmp_path, PYFG, "g.pyfg")
    np.testing.assert_allclose(graph.tracks["A"][:, :4], [[1, 0, 0, 0], [2, 1, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(graph.tracks["A"][1, 4:], [0, 0, np.sin(0.25), np.cos(0.25)], atol=1e-12)
    np.testing.assert_allclose(graph.truth["B"][:, :4], [[1, 0, 0, 0], [2, 1, 0, 0]])
    np.testing.assert_allclose(graph.truth["L0"][0, 1:4], [2, 3, 0])
    rows = graph.ranges
    assert (rows.a, rows.b, list(rows.distance), list(rows.t)) == (["A", "A"], ["B", "L0"], [7.5, 4.5], [1.0, 2.0])
    assert list(read(tmp_path, PYFG, "g.pyfg", sigma=True).ranges.sigma) == pytest.approx([0.2, 0.2])


def test_a_graph_in_space_begins_with_its_true_tilt(tmp_path: Path) -> None:
    """Pitched by 90 degrees, one metre ahead is one metre down."""
    rows = read(tmp_path, PYFG_3D, "g.pyfg").tracks["A"]
    np.testing.assert_allclose(rows[1], [2, 0, 0, -1, 0, HALF, 0, HALF], atol=1e-7)


def test_a_table_has_its_units_in_its_header_or_in_options(tmp_path: Path) -> None:
    text = "stamp_ms,from_id,to_id,distance_mm\n1700000000250,7,8,2250\n"
    rows = read(tmp_path, text, "ranges.csv").ranges
    assert (rows.a, rows.b, list(rows.t), list(rows.distance)) == (["7"], ["8"], [1700000000.25], [2.25])
    poses = "time;px;py;pz;yaw\n0;1000;0;0;90\n1;2000;0;0;180\n"
    asked = {"length_unit": "mm", "angle_unit": "deg"}
    rows = read(tmp_path, poses, "bob.csv", **asked).tracks["bob"]
    np.testing.assert_allclose(rows, [[0, 1, 0, 0, 0, 0, HALF, HALF], [1, 2, 0, 0, 0, 0, 1, 0]], atol=1e-12)


def test_numbers_have_a_decimal_comma_where_semicolons_separate_them(tmp_path: Path) -> None:
    rows = read(tmp_path, "t;a;b;range\n1,5;ann;bob;2,25\n2.5;ann;bob;3\n", "ranges.csv").ranges
    assert (list(rows.t), list(rows.distance)) == ([1.5, 2.5], [2.25, 3.0])


def test_a_table_of_several_devices_and_columns_of_other_names(tmp_path: Path) -> None:
    text = "when\twho\teast\tnorth\theight\n0\ta\t1\t2\t3\n0\tb\t4\t5\t6\n1\ta\t7\t8\t9\n"
    columns = [("t", "when"), ("user", "who"), ("x", "east"), ("y", "north"), ("z", "height")]
    file = tmp_path / "all.tsv"
    file.write_text(text)
    imported = format_named("csv").reading().read(file, Asked(columns=columns), unheard)
    np.testing.assert_allclose(imported.tracks["a"][:, :4], [[0, 1, 2, 3], [1, 7, 8, 9]])
    np.testing.assert_allclose(imported.tracks["b"][:, :4], [[0, 4, 5, 6]])


@pytest.mark.parametrize(
    ("world", "place", "up"),
    [
        ("ros", [1, 2, 3], "z"),
        ("arkit", [1, 2, 3], "y"),
        ("optical", [3, -1, -2], "z"),
        ("ned", [1, -2, -3], "z"),
        ("unity", [3, -1, 2], "z"),
        ("flu", [1, 2, 3], "z"),
    ],
)
def test_axes_by_name_turn_positions(tmp_path: Path, world: str, place: list[float], up: str) -> None:
    imported = read(tmp_path, "1.0 1 2 3 0 0 0 1\n", world=world)
    np.testing.assert_allclose(imported.tracks["alice"][0, 1:4], place, atol=1e-12)
    assert imported.users["alice"].up == up


def test_an_optical_body_looks_forward_along_its_x_axis_after_it_was_turned(tmp_path: Path) -> None:
    """In a level camera's own frame the camera has no rotation, and neither has the device that carries it."""
    imported = read(tmp_path, "1.0 1 2 3 0 0 0 1\n", world="optical", body="optical")
    np.testing.assert_allclose(imported.tracks["alice"][0, 4:], [0, 0, 0, 1], atol=1e-12)


def test_files_of_several_formats_in_a_folder_are_one_recording(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    for user, y in (("alice", 0), ("bob", 1)):
        lines = [f"{1700000000 + 0.1 * k} {0.1 * k} {y} 0 0 0 0 1\n" for k in range(20)]
        (folder / f"{user}.tum").write_text("".join(lines))
    (folder / "ranges.csv").write_text("t,a,b,range\n1700000000.5,alice,bob,1.0\n")
    (folder / "notes.md").write_text("hello\n")
    assert main(["convert", str(folder), str(tmp_path / "walk")]) == 0
    assert (tmp_path / "walk/ranges.csv").read_text().splitlines()[1] == "1700000000.5,alice,bob,1.0"


def test_a_recording_is_added_to_and_never_overwritten_unasked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    track, ranges, out = tmp_path / "alice.tum", tmp_path / "alice.log", tmp_path / "walk"
    track.write_text("".join(f"{1700000000 + 0.1 * k} {0.1 * k} 0 0 0 0 0 1\n" for k in range(20)))
    ranges.write_text(LEC)
    assert main(["convert", str(track), str(out)]) == 0
    capsys.readouterr()
    assert main(["convert", str(ranges), str(out)]) == 2
    assert "--force replaces it, --add adds to it" in capsys.readouterr().err
    assert main(["convert", str(ranges), str(out), "--add"]) == 0
    assert len((out / "tracks/alice.tum").read_text().splitlines()) == 20
    assert len((out / "ranges.csv").read_text().splitlines()) == 3
    assert sorted(p.name for p in tmp_path.iterdir()) == ["alice.log", "alice.tum", "walk"]


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("a.csv", EUROC + "1403636580838555649,1,2\n", r"a.csv:3: a line has 8 numbers"),
        ("a.pyfg", PYFG + "EDGE_RANGE 3 A9 B0 1 1\n", r"a.pyfg:10: a range of 'A9', which is no vertex"),
        ("a.pyfg", "VERTEX_SE2 1.0 A0 5 five 1\n", r"a.pyfg:1: 'five' is no number"),
        ("a.log", LEC.replace("3.44", "3.4x"), r"a.log:1: DIST,2 needs 2 anchors"),
        ("a.csv", "t,x,y,z\n1,2,three,4\n", r"a.csv:2: y is 'three': it must be a number"),
        ("a.txt", "once upon a time\n", r"a.txt: is of no format that is known: say --from"),
        ("a.txt", "", r"a.txt: is empty"),
        (
            "a.csv",
            codecs.BOM_UTF16_LE + "t,x,y,z\n1,2,3,4\n".encode("utf-16-le"),
            r"a.csv: is text in UTF-16: save it as UTF-8",
        ),
        ("a.csv", "t,a,b,range\n1,José,b,4\n".encode("latin-1"), "a.csv: 'Jos\ufffd' cannot be a user's name"),
    ],
)
def test_bad_input_is_one_line_with_place_and_fault(
    tmp_path: Path, name: str, text: str | bytes, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    assert main(["convert", str(tmp_path / name), str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert told in err
    assert err.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", SAMPLES)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_broken_text_is_read_or_refused_by_an_input_error(tmp_path: Path, name: str, data: st.DataObject) -> None:
    text = SAMPLES[name]
    begin = data.draw(st.integers(0, len(text)))
    end = data.draw(st.integers(begin, min(begin + 8, len(text))))
    put = data.draw(
        st.text(st.sampled_from("0123456789.,-+eE \n\t#:[]=nanifABxyµ\0"), max_size=6) | st.text(max_size=3)
    )
    file = tmp_path / "alice.txt"
    file.write_text(text[:begin] + put + text[end:], encoding="utf-8", errors="surrogatepass")
    with suppress(InputError):
        imported = format_named(name).reading().read(file, Asked(), unheard)
        assert imported.tracks or len(imported.ranges)


def test_what_convert_writes_as_mcap_it_reads_again(tmp_path: Path) -> None:
    pytest.importorskip("mcap", reason="the extra `mcap` is not installed")
    folder, out = tmp_path / "walk", tmp_path / "again"
    ways = {name: (way[:, 0], way[:, 1:4], way[:, 4:]) for name, way in (("a", walk()), ("b", walk(phase=1.0)))}
    Recording.from_arrays(ways, [(1000.5, "a", "b", 1.25), (1000.75, "b", "a", 1.5)]).save(folder)
    assert main(["convert", str(folder), str(tmp_path / "walk.mcap")]) == 0
    assert main(["convert", str(tmp_path / "walk.mcap"), str(out)]) == 0
    written, read_again = Recording.load(folder), Recording.load(out)
    assert [user.name for user in read_again.users] == [user.name for user in written.users]
    for name, track in written.tracks.items():
        np.testing.assert_allclose(read_again.tracks[name].t, track.t, atol=1e-6)
        np.testing.assert_allclose(read_again.tracks[name].position, track.position, atol=1e-6)
    np.testing.assert_allclose(read_again.ranges.distance, written.ranges.distance)
    np.testing.assert_allclose(read_again.ranges.t, written.ranges.t, atol=1e-6)


def test_a_radio_that_rides_along_is_found_to_move_and_one_on_the_wall_to_stand() -> None:
    t = np.arange(0.0, 30.0, 0.1)
    place = np.column_stack([3.0 * np.sin(0.3 * t), 2.0 * np.sin(0.6 * t), np.zeros_like(t)])
    track = Track(t, place, np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))
    noise = np.random.default_rng(5).normal(0.0, 0.1, len(t))
    wall = np.linalg.norm(place - [4.0, 3.0, 1.5], axis=1) + 0.4 + noise
    rider = np.linalg.norm(place - np.column_stack([2.0 * np.cos(0.5 * t), 3.0 * np.sin(0.2 * t), 0 * t]), axis=1)
    assert moves({"alice": (track, t, wall)}) is False
    assert moves({"alice": (track, t, rider + noise)}) is True
    assert moves({"alice": (track, t[:5], wall[:5])}) is None


def test_times_that_were_read_with_their_poses_are_not_told_to_be_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    for name, text in (("alice.txt", KITTI), ("times.txt", "0\n0.1\n"), ("readme.txt", "in the hall\n")):
        (folder / name).write_text(text)
    assert main(["convert", str(folder), str(tmp_path / "walk")]) == 0
    assert "and left out: readme.txt\n" in capsys.readouterr().out


def test_a_track_that_says_nan_where_it_was_lost_is_known_for_one(tmp_path: Path) -> None:
    rows = read(tmp_path, "1 0 0 0 0 0 0 1\n2 nan nan nan nan nan nan nan\n3 1 0 0 0 0 0 1\n").tracks["alice"]
    assert np.isnan(rows[:, 1]).tolist() == [False, True, False]


def test_times_of_the_day_go_on_past_midnight(tmp_path: Path) -> None:
    lines = [LEC.replace("1700000000.25", stamp) for stamp in ("23:59:59.5", "00:00:00.5", "00:00:01.5")]
    assert read(tmp_path, "".join(lines)).ranges.t.tolist()[::2] == [86399.5, 86400.5, 86401.5]


@pytest.mark.parametrize(("header", "sigma"), [("range_mm,sigma", 0.05), ("range_mm,sigma_m", 50.0)])
def test_a_tables_sigma_has_its_own_unit_or_that_of_its_ranges(tmp_path: Path, header: str, sigma: float) -> None:
    ranges = read(tmp_path, f"t,a,b,{header}\n1,x,y,2500,50\n", sigma=True).ranges
    assert (list(ranges.distance), list(ranges.sigma)) == ([2.5], [sigma])
