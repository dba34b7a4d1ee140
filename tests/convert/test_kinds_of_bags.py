"""Bags as people have them: messages of known drivers, names in many places, compressed files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="the extra `ros` is not installed")

from support.bags import header, pose_message, range_message, store_with, transforms, walk, write_bag

from synchronizar.cli import main
from synchronizar.convert import rosbag
from synchronizar.convert.asked import Asked
from synchronizar.convert.imported import Imported
from synchronizar.progress import unheard

ODOMETRY, RANGE = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Range"
FRAMES, FRAME = "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/TransformStamped"
T = 1000.5


def read(path: Path, **asked: Any) -> Imported:
    return rosbag.read(path, Asked(**asked), unheard)


def walks(store: Any, topic: str = "/robot{}/odom", name: str = ODOMETRY) -> list[Any]:
    return [
        (topic.format(k), name, row[0], pose_message(store, name, row[0], row[1:].tolist()))
        for k in (1, 2)
        for row in walk(phase=k)
    ]


def zeros(n: int) -> np.ndarray:
    return np.zeros(n, dtype=np.float32)


# What the drivers' own .msg files say, as far as it matters, and one message of each.

LINKTRACK = {
    "nlink_parser/msg/LinktrackNode2": "uint8 role\nuint8 id\nfloat32 dis\nfloat32 fp_rssi\nfloat32 rx_rssi",
    "nlink_parser/msg/LinktrackNodeframe2": "uint8 role\nuint8 id\nuint32 local_time\nuint32 system_time\n"
    "float32[3] pos_3d\nfloat32[4] quaternion\nLinktrackNode2[] nodes",
}
GTEC = {"gtec_msgs/msg/Ranging": "int16 anchorId\nint16 tagId\nint32 range\nint32 seq\nfloat64 errorEstimation"}
POZYX = {
    "gtec_msgs/msg/PozyxRanging": "int32 originId\nint16 originType\nint32 destinationId\nint16 destinationType\n"
    "int32 range\nint32 ts\nfloat64 rxPower"
}
LISTS = {"uwb_imu/msg/UWB": "std_msgs/Header header\nstring tag_id\nfloat32[] dists\nint32[] anchor_ids"}
SWARM = {
    "swarm/msg/UwbRange": "std_msgs/Header header\nstring src_id\nstring dst_id\nfloat64 distance_3d\n"
    "float64 distance_2d\nfloat32 rssi"
}
DWM = {
    "localizer/msg/Anchor": "std_msgs/Header header\nstring id\nfloat64 x\nfloat64 y\nfloat64 z\n"
    "float64 distanceFromTag"
}
DECAWAVE = {
    "decawave/msg/Anchor": "std_msgs/Header header\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 distance",
    "decawave/msg/AnchorArray": "std_msgs/Header header\nAnchor[] anchors",
}
NUMBER = "std_msgs/msg/Float32"


def linktrack(store: Any) -> Any:
    node = store.types["nlink_parser/msg/LinktrackNode2"](role=0, id=2, dis=2.5, fp_rssi=-80.5, rx_rssi=-79.0)
    frame = store.types["nlink_parser/msg/LinktrackNodeframe2"]
    return frame(role=0, id=1, local_time=1, system_time=9, pos_3d=zeros(3), quaternion=zeros(4), nodes=[node])


def decawave(store: Any) -> Any:
    of = store.types["decawave/msg/Anchor"]
    anchors = [of(header=header(store, T, f"an{k}"), x=float(k), y=2.0, z=1.0, distance=2.5) for k in (3, 4)]
    return store.types["decawave/msg/AnchorArray"](header=header(store, T), anchors=anchors)


CASES: dict[str, tuple[dict[str, str], str, str, Callable[[Any], Any], list[tuple[str, str]]]] = {
    "linktrack": (LINKTRACK, "/nlink_linktrack_nodeframe2", "nlink_parser/msg/LinktrackNodeframe2", linktrack,
                  [("robot1", "robot2")]),
    "gtec": (GTEC, "/gtec/toa/ranging", "gtec_msgs/msg/Ranging",
             lambda s: s.types["gtec_msgs/msg/Ranging"](anchorId=10, tagId=1, range=2500, seq=1, errorEstimation=0.1),
             [("robot1", "10")]),
    "pozyx": (POZYX, "/pozyx", "gtec_msgs/msg/PozyxRanging",
              lambda s: s.types["gtec_msgs/msg/PozyxRanging"](originId=1, originType=0, destinationId=2,
                                                               destinationType=1, range=2500, ts=1, rxPower=-80.0),
              [("robot1", "robot2")]),
    "lists": (LISTS, "/uwb_data", "uwb_imu/msg/UWB",
              lambda s: s.types["uwb_imu/msg/UWB"](header=header(s, T), tag_id="1", dists=zeros(2) + 2.5,
                                                   anchor_ids=np.array([50, 60], np.int32)),
              [("robot1", "50"), ("robot1", "60")]),
    "swarm": (SWARM, "/uwb/range", "swarm/msg/UwbRange",
              lambda s: s.types["swarm/msg/UwbRange"](header=header(s, T), src_id="robot1", dst_id="robot2",
                                                      distance_3d=2.5, distance_2d=2.0, rssi=-80.0),
              [("robot1", "robot2")]),
    "dwm": (DWM, "/robot1/anchor0", "localizer/msg/Anchor",
            lambda s: s.types["localizer/msg/Anchor"](header=header(s, T), id="0A", x=1.0, y=2.0, z=1.0,
                                                      distanceFromTag=2.5),
            [("robot1", "0A")]),
    "decawave": (DECAWAVE, "/robot1/anchors", "decawave/msg/AnchorArray", decawave,
                 [("robot1", "an3"), ("robot1", "an4")]),
    "number": ({}, "/uwb/range_1_2", NUMBER, lambda s: s.types[NUMBER](data=2.5), [("robot1", "robot2")]),
    "named": ({}, "/robot1/uwb/distance_to_robot2", NUMBER, lambda s: s.types[NUMBER](data=2.5),
              [("robot1", "robot2")]),
    "frame": ({}, "/robot1/uwb/range", RANGE, lambda s: range_message(s, T, 2.5, "robot2"), [("robot1", "robot2")]),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("kind", ["ros1", "sqlite3"])
def test_ranges_of_known_drivers_are_found_with_whom_they_are(tmp_path: Path, case: str, kind: str) -> None:
    definitions, topic, name, made, pairs = CASES[case]
    store = store_with(definitions, 1 if kind == "ros1" else 2)
    bag = write_bag(tmp_path / "a.bag", kind, store, [*walks(store), (topic, name, T, made(store))])
    rows = read(bag).ranges
    assert list(zip(rows.a, rows.b, strict=True)) == pairs
    assert list(rows.distance) == pytest.approx([2.5] * len(pairs))
    assert list(rows.t) == pytest.approx([T] * len(pairs))


def test_places_of_decawaves_anchors_are_taken_with_their_ranges(tmp_path: Path) -> None:
    store = store_with(DECAWAVE, 2)
    bag = write_bag(
        tmp_path / "a", "sqlite3", store,
        [*walks(store), ("/robot1/anchors", "decawave/msg/AnchorArray", T, decawave(store))],
    )  # fmt: skip
    users = read(bag).users
    assert (users["an3"].position, users["an4"].position) == ((3.0, 2.0, 1.0), (4.0, 2.0, 1.0))


@pytest.mark.parametrize(
    ("definitions", "topic", "name", "values", "told"),
    [
        ({}, "/uwb/distance", NUMBER, {"data": 2.5}, "--topic '/uwb/distance range=data a=WHO b=WHO'"),
        ({"odd/msg/Odd": "float64 rt1\nfloat64 rt2"}, "/uwb", "odd/msg/Odd", {"rt1": 2.5, "rt2": 3.5},
         "no topic of ranges is known: if /uwb has some, say --topic"),
    ],
)  # fmt: skip
def test_what_may_be_ranges_and_does_not_say_whose_names_the_option_that_does(
    tmp_path: Path, definitions: dict[str, str], topic: str, name: str, values: dict[str, Any], told: str
) -> None:
    store = store_with(definitions, 2)
    messages = [*walks(store), (topic, name, T, store.types[name](**values))]
    bag = write_bag(tmp_path / "a", "sqlite3", store, messages)
    assert sum(told in note for note in read(bag).notes) == 1
    field = next(iter(values))
    rows = read(bag, topics=[f"{topic} range={field} a=robot1 b=robot2"]).ranges
    assert (rows.a, rows.b, list(rows.distance)) == (["robot1"], ["robot2"], [2.5])


def test_a_list_of_bare_numbers_is_read_where_it_is_said_whose_they_are(tmp_path: Path) -> None:
    name = "std_msgs/msg/Float32MultiArray"
    store = store_with({}, 2)
    layout = store.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    value = store.types[name](layout=layout, data=np.array([2.5, 3.5], np.float32))
    bag = write_bag(tmp_path / "a", "sqlite3", store, [*walks(store), ("/robot1/uwb/ranges", name, T, value)])
    assert not len(read(bag).ranges)
    rows = read(bag, topics=["/robot1/uwb/ranges range=data[] a=robot1 b=#"]).ranges
    assert (rows.a, list(rows.distance)) == (["robot1", "robot1"], [2.5, 3.5])


@pytest.mark.parametrize(
    ("topic", "frames", "users"),
    [
        ("/tf", ("robot{}/odom", "robot{}/base_link"), {"robot1", "robot2"}),
        ("/robot{}/tf", ("odom", "base_link"), {"robot1", "robot2"}),
        ("/tf", ("world", "drone{}"), {"drone1", "drone2"}),
        ("/tf", ("map", "tb3_{}_base_footprint"), {"tb3_1", "tb3_2"}),
    ],
)
def test_devices_are_found_in_transforms_wherever_their_names_are(
    tmp_path: Path, topic: str, frames: tuple[str, str], users: set[str]
) -> None:
    store = store_with({}, 2)
    messages = []
    for k in (1, 2):
        for row in walk(phase=k):
            edge = (frames[0].format(k), frames[1].format(k), row[1:].tolist())
            messages.append((topic.format(k), FRAMES, row[0], transforms(store, row[0], [edge])))
    tracks = read(write_bag(tmp_path / "a", "sqlite3", store, messages)).tracks
    assert set(tracks) == users
    np.testing.assert_allclose(tracks[max(users)], walk(phase=2), rtol=0, atol=1e-6)


def test_vicons_transforms_are_the_truth_of_those_who_have_odometry(tmp_path: Path) -> None:
    store = store_with({}, 2)
    mocap = []
    for k in (1, 2):
        for row in walk(phase=k):
            name = f"vicon/robot{k}/robot{k}"
            message = transforms(store, row[0], [("world", name, row[1:].tolist())]).transforms[0]
            mocap.append((f"/{name}", FRAME, row[0], message))
    imported = read(write_bag(tmp_path / "a", "sqlite3", store, [*walks(store), *mocap]))
    assert set(imported.truth) == set(imported.tracks) == {"robot1", "robot2"}
    np.testing.assert_allclose(imported.truth["robot2"], walk(phase=2), rtol=0, atol=1e-6)


@pytest.mark.parametrize("kind", ["bz2", "lz4", "zstd file", "zstd message"])
def test_compressed_bags_are_read_as_they_are(tmp_path: Path, kind: str) -> None:
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import CompressionFormat, CompressionMode
    from rosbags.rosbag2 import Writer as Writer2

    one = kind in ("bz2", "lz4")
    store, path = store_with({}, 1 if one else 2), tmp_path / "a.bag"
    writer: Any = Writer1(path) if one else Writer2(path, version=9)
    if one:
        writer.set_compression(Writer1.CompressionFormat[kind.upper()])
    else:
        mode = CompressionMode.FILE if kind == "zstd file" else CompressionMode.MESSAGE
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for topic, name, logged, message in walks(store):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=store)
            serialize = store.serialize_ros1 if one else store.serialize_cdr
            writer.write(connections[topic], round(1e9 * logged), serialize(message, name))
    np.testing.assert_allclose(read(path).tracks["robot2"], walk(phase=2), rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("walk.bag", b"#ROSBAG V2.0\n" + bytes(50)),
        ("walk.db3", b"SQLite format 3\0" + bytes(500)),
        ("walk.mcap", b"\x89MCAP0\r\n" + bytes(50)),
        ("walk.bag", b"#ROSBAG V1.2\n" + b"x" * 50),
        ("walk.bag.active", bytes(100)),
        ("photo.jpg", b"\xff\xd8\xff\xe0" + bytes(range(256))),
        ("walk.zip", b"PK\x03\x04" + bytes(200)),
    ],
)
def test_a_file_that_is_none_of_these_is_one_clear_line(
    tmp_path: Path, name: str, data: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_bytes(data)
    assert main(["convert", str(tmp_path / name), str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert f"{name}: " in err
    assert not (tmp_path / "out").exists()
