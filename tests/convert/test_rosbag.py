"""Bags of ROS 1 and 2 become recordings: topics, names, stamps, units, transforms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.paths import SHARED

pytest.importorskip("rosbags", reason="the extra `ros` is not installed")

from support.bags import header, path_message, pose_message, range_message, store_with, transforms, walk, write_bag

from synchronizar.cli import main
from synchronizar.convert import mcap, rosbag
from synchronizar.convert.asked import Asked
from synchronizar.convert.imported import Imported
from synchronizar.data.recording import Recording
from synchronizar.errors import InputError
from synchronizar.progress import unheard

ODOMETRY, STAMPED = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
RANGE = "sensor_msgs/msg/Range"
NODES = {"uwb_msgs/msg/Node": "uint8 id\nfloat32 dis\nfloat32 rx_rssi", "uwb_msgs/msg/Nodes": "uint8 id\nNode[] nodes"}
PAIR = {"uwb_msgs/msg/Pair": "std_msgs/Header header\nuint16 from_id\nuint16 to_id\nuint32 range\nfloat32 std"}


def read(path: Path, **asked: Any) -> Imported:
    return rosbag.read(path, Asked(**asked), unheard)


def two_walks(store: Any, name: str = ODOMETRY, topic: str = "/tb{}/odom", log: float = 0.0) -> list[Any]:
    """Poses of tb1 and tb2, logged `log` s after their own stamps."""
    return [
        (topic.format(k), name, row[0] + log, pose_message(store, name, row[0], row[1:].tolist()))
        for k in (1, 2)
        for row in walk(phase=k)
    ]


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
@pytest.mark.parametrize("name", [ODOMETRY, STAMPED, "geometry_msgs/msg/PoseWithCovarianceStamped"])
def test_poses_and_ranges_of_every_kind_of_bag_come_as_they_were_written(tmp_path: Path, kind: str, name: str) -> None:
    store = store_with({}, 1 if kind == "ros1" else 2)
    ranges = [("/uwb/tb1/tb2/range", RANGE, 1000.05 + k, range_message(store, 1000.05 + k, 2.5 + k)) for k in range(2)]
    bag = write_bag(tmp_path / "walk.bag", kind, store, sorted([*two_walks(store, name), *ranges], key=lambda m: m[2]))
    imported = read(bag)
    assert set(imported.tracks) == {"tb1", "tb2"}
    for k in (1, 2):
        np.testing.assert_allclose(imported.tracks[f"tb{k}"], walk(phase=k), rtol=0, atol=1e-6)
    rows = imported.ranges
    assert (rows.a, rows.b, list(rows.distance)) == (["tb1"] * 2, ["tb2"] * 2, [2.5, 3.5])
    np.testing.assert_allclose(rows.t, [1000.05, 1001.05])


def test_a_file_of_a_bag_alone_is_read_too(tmp_path: Path) -> None:
    store = store_with({}, 2)
    bag = write_bag(tmp_path / "walk", "mcap", store, two_walks(store))
    imported = mcap.read(next(bag.glob("*.mcap")), Asked(), unheard)
    np.testing.assert_allclose(imported.tracks["tb2"], walk(phase=2), rtol=0, atol=1e-6)
    bag = write_bag(tmp_path / "other", "sqlite3", store, two_walks(store))
    imported = read(next(bag.glob("*.db3")))
    np.testing.assert_allclose(imported.tracks["tb1"], walk(phase=1), rtol=0, atol=1e-6)


def test_a_file_that_was_looked_into_is_closed(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    store = store_with({}, 2)
    read(next(write_bag(tmp_path / "walk", "sqlite3", store, two_walks(store)).glob("*.db3")))
    assert ResourceWarning not in {warning.category for warning in recwarn}


def test_several_ranges_in_a_message_are_of_who_sends_and_of_each_item(tmp_path: Path) -> None:
    store = store_with(dict(reversed(NODES.items())) | NODES, 1)
    node, nodes = store.types["uwb_msgs/msg/Node"], store.types["uwb_msgs/msg/Nodes"]
    several = nodes(id=1, nodes=[node(id=2, dis=3.25, rx_rssi=-80.0), node(id=7, dis=0.0, rx_rssi=-90.0)])
    messages = [*two_walks(store), ("/nodes", "uwb_msgs/msg/Nodes", 1000.5, several)]
    rows = (imported := read(write_bag(tmp_path / "a.bag", "ros1", store, messages))).ranges
    assert (rows.a, rows.b, list(rows.distance), list(rows.rx_power)) == (["tb1"], ["tb2"], [3.25], [-80.0])
    assert any("distances of 0" in note for note in imported.notes)


def test_integers_are_millimetres_and_ids_are_those_of_devices_with_the_same_number(tmp_path: Path) -> None:
    store = store_with(PAIR, 2)
    pair = store.types["uwb_msgs/msg/Pair"](header=header(store, 1000.5), from_id=2, to_id=1, range=4321, std=0.1)
    messages = [*two_walks(store), ("/uwb", "uwb_msgs/msg/Pair", 1000.5, pair)]
    bag = write_bag(tmp_path / "a", "sqlite3", store, messages)
    imported = read(bag)
    assert (imported.ranges.a, imported.ranges.b) == (["tb2"], ["tb1"])
    assert list(imported.ranges.distance) == pytest.approx([4.321])
    assert any("taken to be in mm" in note for note in imported.notes)
    assert list(read(bag, range_unit="cm").ranges.distance) == pytest.approx([43.21])
    assert list(read(bag, topics=["/uwb sigma=std"]).ranges.sigma) == pytest.approx([1e-4])


def test_a_map_says_whose_radios_are_and_where_their_antennas(tmp_path: Path) -> None:
    store = store_with(PAIR, 1)
    of = store.types["uwb_msgs/msg/Pair"]
    pairs = [
        of(header=header(store, 1000.0 + 0.1 * k), from_id=10, to_id=20 + k % 2, range=4000, std=0.1) for k in range(9)
    ]
    messages = [("/uwb", "uwb_msgs/msg/Pair", 1000.0 + 0.1 * k, pair) for k, pair in enumerate(pairs)]
    bag = write_bag(tmp_path / "a.bag", "ros1", store, [*two_walks(store), *messages])
    (tmp_path / "map.toml").write_text(
        '[radios]\n10 = "tb1"\n[radios.20]\nuser = "tb2"\nantenna = "left"\nlever = [0.1, 0.2, 0]\n'
        '[radios.21]\nuser = "tb2"\nantenna = "right"\nlever = [0.1, -0.2, 0]\n'
    )
    out = tmp_path / "walk"
    assert main(["convert", str(bag), str(out), "--map", str(tmp_path / "map.toml")]) == 0
    assert 'antennas."right" = [0.1, -0.2, 0.0]' in (out / "recording.toml").read_text()
    lines = (out / "ranges.csv").read_text().splitlines()
    assert lines[0] == "t,a,b,range,antenna_b"
    assert [line.split(",")[1:] for line in lines[1:3]] == [
        ["tb1", "tb2", "4.0", "left"],
        ["tb1", "tb2", "4.0", "right"],
    ]


def test_own_stamps_count_even_where_all_were_logged_months_later(tmp_path: Path) -> None:
    store = store_with({}, 2)
    later = 5_000_000.0
    ranges = [("/uwb/tb1/tb2", RANGE, 1000.5 + later, range_message(store, 1000.5, 2.5))]
    imported = read(write_bag(tmp_path / "a", "sqlite3", store, [*two_walks(store, log=later), *ranges]))
    assert imported.tracks["tb1"][0, 0] == pytest.approx(1000.0)
    assert list(imported.ranges.t) == pytest.approx([1000.5])


@pytest.mark.parametrize("stamp", [0.0, 12.5])
def test_ranges_without_stamps_or_by_a_radios_own_clock_have_the_time_of_the_log(tmp_path: Path, stamp: float) -> None:
    store = store_with({}, 2)
    ranges = [("/uwb/tb1/tb2", RANGE, 1010.5, range_message(store, stamp, 2.5))]
    bag = write_bag(tmp_path / "a", "sqlite3", store, [*two_walks(store, log=10.0), *ranges])
    imported = read(bag)
    assert list(imported.ranges.t) == pytest.approx([1000.5])
    assert any("/uwb/tb1/tb2: no stamps of their own" in note for note in imported.notes)
    assert list(read(bag, stamps="log").ranges.t) == pytest.approx([1010.5])
    assert list(read(bag, stamps="header").ranges.t) == pytest.approx([stamp])


def test_motion_capture_is_the_truth_and_a_track_only_where_there_is_no_odometry(tmp_path: Path) -> None:
    store = store_with({}, 2)
    mocap = two_walks(store, STAMPED, "/vrpn_client_node/tb{}/pose")
    both = read(write_bag(tmp_path / "a", "sqlite3", store, [*mocap, *two_walks(store, log=0.01)]))
    assert set(both.truth) == set(both.tracks) == {"tb1", "tb2"}
    assert "/tb1/odom is tb1's track" in both.notes
    alone = read(write_bag(tmp_path / "b", "sqlite3", store, mocap))
    assert set(alone.truth) == set(alone.tracks) == {"tb1", "tb2"}


def test_a_device_without_poses_has_what_its_transforms_add_up_to(tmp_path: Path) -> None:
    store = store_with({}, 2)
    quarter = [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]
    messages = [
        ("/tf_static", "tf2_msgs/msg/TFMessage", 1000.0,
         transforms(store, 0.0, [("tb1/base_footprint", "tb1/base_link", [0, 0, 0.2, 0, 0, 0, 1])])),
    ]  # fmt: skip
    for k in range(5):
        edges = [("tb1/odom", "tb1/base_footprint", [0.1 * k, 0, 0, *quarter])]
        messages.append(("/tf", "tf2_msgs/msg/TFMessage", 1000.0 + k, transforms(store, 1000.0 + k, edges)))
    imported = read(write_bag(tmp_path / "a", "sqlite3", store, messages))
    expected = [[1000.0 + k, 0.1 * k, 0.0, 0.2, *quarter] for k in range(5)]
    np.testing.assert_allclose(imported.tracks["tb1"], expected, atol=1e-9)


def test_a_list_tells_each_topic_and_the_fields_of_those_that_are_not_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = store_with({"my_msgs/msg/Odd": "float32 how_far\nuint8 whom"}, 2)
    odd = store.types["my_msgs/msg/Odd"](how_far=2.5, whom=2)
    bag = write_bag(tmp_path / "a", "mcap", store, [*two_walks(store), ("/odd", "my_msgs/msg/Odd", 1001.0, odd)])
    assert main(["convert", str(bag), "--list"]) == 0
    told = capsys.readouterr().out
    assert "/tb1/odom  nav_msgs/Odometry  20: poses of tb1" in told
    assert "fields: how_far, whom" in told
    said = "/odd range=how_far a=tb1 b=whom unit=m"
    rows = read(bag, topics=[said]).ranges
    assert (rows.a, rows.b, list(rows.distance)) == (["tb1"], ["tb2"], [2.5])


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
@pytest.mark.parametrize("share", [0.2, 0.6, 0.95])
def test_a_bag_that_is_cut_off_is_one_clear_line_and_nothing_is_written(
    tmp_path: Path, kind: str, share: float, capsys: pytest.CaptureFixture[str]
) -> None:
    store = store_with({}, 1 if kind == "ros1" else 2)
    bag = write_bag(tmp_path / "a.bag", kind, store, two_walks(store))
    file = bag if bag.is_file() else next(f for f in bag.iterdir() if f.suffix in (".db3", ".mcap"))
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    assert main(["convert", str(bag), str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "a.bag: " in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("kind", ["ros1", "sqlite3"])
@pytest.mark.parametrize("window", [15, 1000])
def test_a_path_that_grows_or_moves_along_is_a_track_as_it_was_told_last(
    tmp_path: Path, kind: str, window: int
) -> None:
    """Each message is 0.5 m beside the one before; only the last 15 poses, or all, are in it."""
    store = store_with({}, 1 if kind == "ros1" else 2)
    rows = walk(n=60)
    messages = []
    for k in range(60):
        told = rows[max(0, k + 1 - window) : k + 1].copy()
        told[:, 2] += 0.5 * k
        messages.append(("/tb1/vins/path", "nav_msgs/msg/Path", rows[k, 0], path_message(store, rows[k, 0], told)))
    track = read(write_bag(tmp_path / "a", kind, store, messages)).tracks["tb1"]
    np.testing.assert_allclose(track[:, 0], rows[:, 0], atol=1e-6)
    begin = 60 - min(window, 60)
    np.testing.assert_allclose(track[begin:, 2], rows[begin:, 2] + 0.5 * 59, atol=1e-6)
    assert (np.abs(track[:, 1] - rows[:, 1]) < 1e-6).all()


def test_a_path_is_taken_where_there_is_nothing_else_and_a_plan_never(tmp_path: Path) -> None:
    store = store_with({}, 2)
    rows = walk(phase=5)
    path = ("/tb1/path", "nav_msgs/msg/Path", 1002.5, path_message(store, 1002.5, rows))
    plan = ("/tb1/plan", "nav_msgs/msg/Path", 1002.5, path_message(store, 1002.5, rows))
    goal = ("/tb1/goal_pose", STAMPED, 1002.5, pose_message(store, STAMPED, 1002.5, rows[0, 1:].tolist()))
    both = read(write_bag(tmp_path / "a", "sqlite3", store, [*two_walks(store), path, plan, goal]))
    assert set(both.tracks) == {"tb1", "tb2"}
    assert "/tb1/odom is tb1's track (and not /tb1/path)" in both.notes
    unstamped = ("/tb1/path", "nav_msgs/msg/Path", 1002.5, path_message(store, 1002.5, rows, stamped=False))
    bag = write_bag(tmp_path / "b", "sqlite3", store, [unstamped, plan, goal])
    alone = read(bag)
    assert not alone.tracks
    assert "/tb1/path is left out: the poses in its messages have no stamps of their own" in alone.notes


def test_a_topic_that_is_not_there_is_named(tmp_path: Path) -> None:
    store = store_with({}, 2)
    bag = write_bag(tmp_path / "a", "sqlite3", store, two_walks(store))
    with pytest.raises(InputError, match="has no topic '/uwb'"):
        read(bag, topics=["/uwb range=dis a=tb1 b=tb2"])


def test_the_real_bag_has_as_many_ranges_as_the_recording_made_by_hand() -> None:
    bag, made = SHARED / "foreign/tiers_case4_bag", SHARED / "recordings/tiers_case4_k7/ranges.csv"
    if not bag.exists() or not made.exists():
        pytest.skip("the real bag does not stand beside this checkout")
    rows = read(bag, left_out=["n_8"]).ranges
    others = sum("n_8" not in pair for pair in zip(rows.a, rows.b, strict=True))
    assert others == len(made.read_text().splitlines()) - 1


def test_radios_that_measure_in_one_devices_topic_are_its_own_whatever_their_numbers(tmp_path: Path) -> None:
    """Numbers count from 0 here, names from 1."""
    store = store_with(PAIR, 2)
    of = store.types["uwb_msgs/msg/Pair"]
    messages = two_walks(store)
    for k in (1, 2):
        pair = of(header=header(store, 1000.5), from_id=k - 1, to_id=2 - k, range=2500, std=0.1)
        messages.append((f"/tb{k}/uwb", "uwb_msgs/msg/Pair", 1000.5, pair))
    rows = read(write_bag(tmp_path / "a", "sqlite3", store, messages)).ranges
    assert (rows.a, rows.b) == (["tb1", "tb2"], ["tb2", "tb1"])


def test_a_frame_says_with_whom_where_the_topic_does_not(tmp_path: Path) -> None:
    store = store_with({}, 2)
    ranges = [("/tb1/uwb", RANGE, 1000.5, range_message(store, 1000.5, 2.5, frame)) for frame in ("tb2", "anchor_3")]
    rows = read(write_bag(tmp_path / "a", "sqlite3", store, [*two_walks(store), *ranges])).ranges
    assert (rows.a, rows.b) == (["tb1", "tb1"], ["tb2", "anchor_3"])


def test_a_distance_to_the_ground_is_no_range_between_devices(tmp_path: Path) -> None:
    store = store_with({}, 2)
    down = [("/tb1/altimeter/down", RANGE, 1000.5, range_message(store, 1000.5, 1.5))]
    assert len(read(write_bag(tmp_path / "a", "sqlite3", store, [*two_walks(store), *down])).ranges) == 0


ANCHOR = {"dwm_msgs/msg/Anchor": "std_msgs/Header header\nstring id\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 distance"}
RESPONDER = {
    "drv_msgs/msg/UwbRange": "std_msgs/Header header\nuint8 requester_id\nuint8 responder_id\nfloat32 distance\n"
    "geometry_msgs/Point responder_location"
}


def test_messages_that_say_where_an_anchor_is_survey_it(tmp_path: Path) -> None:
    store = store_with(ANCHOR, 2)
    of = store.types["dwm_msgs/msg/Anchor"]
    anchors = [("A1", 1.0, 2.0, 2.5), ("A2", 4.0, 2.0, 2.5)]
    messages = [
        ("/tb1/anchors", "dwm_msgs/msg/Anchor", 1000.5,
         of(header=header(store, 1000.5), id=name, x=x, y=y, z=z, distance=3.0)) for name, x, y, z in anchors
    ]  # fmt: skip
    imported = read(write_bag(tmp_path / "a", "sqlite3", store, [*two_walks(store), *messages]))
    assert (imported.ranges.a, imported.ranges.b) == (["tb1", "tb1"], ["A1", "A2"])
    assert {name: imported.users[name].position for name, *_ in anchors} == {n: (x, y, z) for n, x, y, z in anchors}


def test_a_place_that_is_not_known_is_none(tmp_path: Path) -> None:
    """Drivers have 99999 where nobody said it."""
    store = store_with(RESPONDER, 1)
    of, point = store.types["drv_msgs/msg/UwbRange"], store.types["geometry_msgs/msg/Point"]
    messages = []
    for other, x in ((2, 99999.0), (100, 99999.0), (101, 4.0)):
        said = of(
            header=header(store, 1000.5),
            requester_id=1,
            responder_id=other,
            distance=2.5,
            responder_location=point(x=x, y=x, z=x),
        )
        messages.append(("/uwb", "drv_msgs/msg/UwbRange", 1000.5, said))
    bag = write_bag(tmp_path / "a.bag", "ros1", store, [*two_walks(store), *messages])
    out = tmp_path / "out"
    assert main(["convert", str(bag), str(out)]) == 0
    users = {user.name: user.position for user in Recording.load(out).users}
    assert users == {"tb1": None, "tb2": None, "100": None, "101": (4.0, 4.0, 4.0)}


@pytest.mark.filterwarnings("error")
def test_a_transform_that_is_no_number_is_left_out_of_a_track(tmp_path: Path) -> None:
    store = store_with({}, 2)
    rows = walk()
    rows[5, 4:] = np.nan
    messages = [
        ("/tf", "tf2_msgs/msg/TFMessage", t, transforms(store, t, [("tb1/odom", "tb1/base_link", row)]))
        for t, row in zip(rows[:, 0].tolist(), rows[:, 1:].tolist(), strict=True)
    ]
    imported = read(write_bag(tmp_path / "a", "sqlite3", store, messages))
    np.testing.assert_allclose(imported.tracks["tb1"][:, 1:4], np.delete(rows, 5, axis=0)[:, 1:4], atol=1e-6)
