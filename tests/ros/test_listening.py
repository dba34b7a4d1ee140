from __future__ import annotations

import asyncio
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.rosbridge import RANGING, StandIn, header, odometry, pose, ranging

from synchronizar.convert.asked import Asked
from synchronizar.convert.fields import Topic
from synchronizar.convert.mapping import mapped
from synchronizar.convert.ros_types import short_type
from synchronizar.live import messages as m
from synchronizar.ros.ends import Ends
from synchronizar.ros.listening import Heard, HeardPose, HeardRange, Listening
from synchronizar.ros.robot_clock import RobotClock
from synchronizar.ros.rosapi import Rosapi, fields_of_typedefs

NO_TURN = (0.0, 0.0, 0.0, 1.0)


def learn(listening: Listening, topics: dict[str, str]) -> list[str]:
    """What is subscribed to, of topics by their full types."""
    stand_in = StandIn(topics, lambda: 0.0)
    known = [
        Topic(name, short_type(kind), 1, fields_of_typedefs(stand_in.typedefs(kind))) for name, kind in topics.items()
    ]
    return [wanted.topic for wanted in listening.learn(known)]


def heard(
    there: dict[str, str], messages: list[tuple[str, dict[str, Any]]], rate: float = 5.0, **options: Any
) -> tuple[list[Heard], Listening, list[str]]:
    """What came of messages, so many a second, what heard it and what was told."""
    told: list[str] = []
    asked = Asked(**options)
    listening = Listening(asked, mapped(asked), "ws://robot:9090", "common", told.append)
    learn(listening, there)
    found: list[Heard] = []
    for k, (topic, message) in enumerate(messages):
        found += listening.hear(topic, 100.0 + k / rate, message)
    return found, listening, told


def poses_of(found: list[Heard]) -> list[HeardPose]:
    return [one for one in found if isinstance(one, HeardPose)]


def ranges_of(found: list[Heard]) -> list[HeardRange]:
    return [one for one in found if isinstance(one, HeardRange)]


def test_only_what_may_tell_of_robots_is_subscribed_to() -> None:
    listening = Listening(Asked(), mapped(Asked()), "ws://robot:9090", "common", print)
    topics = {
        "/alice/odom": "nav_msgs/msg/Odometry",
        "/alice/image": "sensor_msgs/msg/Image",
        "/alice/cmd_vel": "geometry_msgs/msg/Twist",
        "/vicon/alice": "geometry_msgs/msg/PoseStamped",
        "/alice/sonar": "sensor_msgs/msg/Range",
        "/uwb": RANGING,
        "/tf": "tf2_msgs/msg/TFMessage",
        "/synchronizar/alice/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    }
    assert learn(listening, topics) == ["/alice/odom", "/uwb"]
    assert learn(listening, topics | {"/bob/odom": "nav_msgs/msg/Odometry"}) == ["/bob/odom"]


@pytest.mark.parametrize("kind", ["Odometry", "PoseStamped", "PoseWithCovarianceStamped"])
def test_poses_of_each_type_are_read_and_none_is_lost_while_it_is_not_known_whose_they_are(kind: str) -> None:
    def message(t: float) -> dict[str, Any]:
        at = pose((t, 2.0, 0.5), (0.0, 0.0, 0.6, 0.8))
        if kind != "PoseStamped":
            at = {"pose": at, "covariance": [0.0] * 36}
        return {"header": header(t, "/alice/odom"), "pose": at}

    package = "nav_msgs" if kind == "Odometry" else "geometry_msgs"
    topics = {"/alice/pose": f"{package}/msg/{kind}"}
    found, _, _ = heard(topics, [("/alice/pose", message(float(k))) for k in range(1, 12)])
    poses = poses_of(found)
    assert [one.stamp for one in poses] == [float(k) for k in range(1, 12)]
    assert [one.arrived for one in poses] == pytest.approx([100.0 + 0.2 * k for k in range(11)])
    assert {(one.user, one.frame_id, one.up) for one in poses} == {("alice", "alice/odom", "z")}
    assert poses[3].position == (4.0, 2.0, 0.5)
    assert poses[3].quat_xyzw == pytest.approx((0.0, 0.0, 0.6, 0.8))


def test_of_several_tracks_of_a_robot_its_slam_counts_and_the_others_are_let_go() -> None:
    topics = {"/alice/wheel_odom": "nav_msgs/msg/Odometry", "/alice/vio/odometry": "nav_msgs/msg/Odometry"}
    messages = [
        (topic, odometry(float(k), "odom", (0.0, float(k), 0.0), NO_TURN)) for k in range(1, 20) for topic in topics
    ]
    found, listening, _ = heard(topics, messages, rate=10.0)
    assert listening.users() == {"alice": "/alice/vio/odometry"}
    assert listening.dropped == ["/alice/wheel_odom"]
    assert len(poses_of(found)) == 19


def test_a_goal_that_somebody_clicks_is_no_robot() -> None:
    topics = {"/goal": "geometry_msgs/msg/PoseStamped"}
    click = {"header": header(1.0, "map"), "pose": pose((1.0, 2.0, 0.0), NO_TURN)}
    found, listening, _ = heard(topics, [("/goal", click)] * 3, rate=0.1)
    assert found == []
    assert listening.users() == {}


def test_names_are_given_as_for_a_bag() -> None:
    topics = {"/odom": "nav_msgs/msg/Odometry"}
    messages = [("/odom", odometry(float(k), "odom", (0.0, 0.0, 0.0), NO_TURN)) for k in range(1, 9)]
    for options, name in (
        ({}, "robot"),
        ({"user": "alice"}, "alice"),
        ({"renamed": [("robot", "bob")]}, "bob"),
        ({"topics": ["/odom user=carol"]}, "carol"),
    ):
        _, listening, _ = heard(topics, messages, **options)  # type: ignore[arg-type]
        assert listening.users() == {name: "/odom"}
    found, listening, _ = heard(topics, messages, left_out=["robot"])
    assert found == []


def test_ranges_of_a_message_of_one_s_own_are_read_and_what_is_none_is_left_out() -> None:
    messages = [ranging(3.0, "7", "8", 2.5), ranging(4.0, "7", "8", 2.6), ranging(5.0, "7", "8", 0.0)]
    messages[1]["distance_m"] = None  # as rosbridge has infinities
    found, listening, _ = heard({"/uwb": RANGING}, [("/uwb", one) for one in messages])
    assert ranges_of(found) == [HeardRange(3.0, 100.0, "/uwb", "7", "8", 2.5, {})]
    assert listening.malformed == {}


def test_ranges_of_ros_s_own_type_are_between_whom_topic_and_frame_name() -> None:
    def message(distance: float | None) -> dict[str, Any]:
        fields = {"radiation_type": 0, "field_of_view": 0.1, "min_range": 0.0, "max_range": 30.0, "range": distance}
        return {"header": header(2.0, "bob"), **fields}

    found, _, _ = heard({"/alice/uwb/range": "sensor_msgs/msg/Range"}, [("/alice/uwb/range", message(4.5))])
    assert [(one.a, one.b, one.distance) for one in ranges_of(found)] == [("alice", "bob", 4.5)]


def test_a_field_map_says_what_no_name_tells(tmp_path: Path) -> None:
    written = tmp_path / "map.toml"
    written.write_text('[topics."/uwb"]\nrange = "distance_m"\na = "to_id"\nb = "from_id"\nunit = "mm"\ntime = "log"\n')
    found, _, told = heard({"/uwb": RANGING}, [("/uwb", ranging(3.0, "7", "8", 2500.0))], map=written)
    (one,) = ranges_of(found)
    assert (one.a, one.b, one.distance) == ("8", "7", 2.5)
    assert one.stamp != one.stamp
    assert any("in mm" in sentence for sentence in told)


@pytest.mark.parametrize(
    "broken",
    [
        {},
        {"header": {}, "pose": {"pose": {"position": {"x": 1.0}}}},
        {"header": {"stamp": 3}, "pose": None},
        odometry(2.0, "odom", (nan, 0.0, 0.0), NO_TURN),
        odometry(2.0, "odom", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
        odometry(2.0, "odom", (1e9, 0.0, 0.0), NO_TURN),
    ],
)
def test_a_message_that_makes_no_sense_is_counted_and_the_next_one_is_heard(broken: dict[str, Any]) -> None:
    good = [("/odom", odometry(float(k), "odom", (0.0, 0.0, 0.0), NO_TURN)) for k in range(1, 9)]
    topics = {"/odom": "nav_msgs/msg/Odometry"}
    found, listening, _ = heard(topics, [*good, ("/odom", broken), *good])
    assert len(poses_of(found)) == 16
    assert listening.malformed == {"/odom": 1}
    found, listening, _ = heard(topics, [*good[:3], ("/odom", broken), *good])  # while it is nobody's yet
    assert len(poses_of(found)) == 11
    assert listening.malformed == {"/odom": 1}


def test_a_robot_in_optical_axes_is_turned_up() -> None:
    message = odometry(1.0, "world", (1.0, -2.0, 3.0), NO_TURN)
    found, _, _ = heard({"/slam": "nav_msgs/msg/Odometry"}, [("/slam", message)] * 9, world="optical")
    one = poses_of(found)[0]
    assert one.position == (3.0, -1.0, 2.0)  # forward, left, up
    assert one.ros == (1.0, -2.0, 3.0)


def transform(t: float, parent: str, child: str, x: float) -> dict[str, Any]:
    turn = dict(zip("xyzw", NO_TURN, strict=True))
    return {
        "header": header(t, parent),
        "child_frame_id": child,
        "transform": {"translation": {"x": x, "y": 0.0, "z": 0.0}, "rotation": turn},
    }


def test_without_odometry_transforms_tell_where_a_robot_is_and_the_bridge_does_not_hear_itself() -> None:
    topics = {"/tf": "tf2_msgs/msg/TFMessage", "/tf_static": "tf2_msgs/msg/TFMessage"}
    messages: list[tuple[str, dict[str, Any]]] = [
        ("/tf_static", {"transforms": [transform(0.0, "alice/base_footprint", "alice/base_link", 0.25)]})
    ]
    for k in range(1, 40):
        moving = [transform(float(k), "alice/odom", "alice/base_footprint", float(k))]
        messages.append(("/tf", {"transforms": moving}))
        messages.append(("/tf", {"transforms": [transform(float(k), "common", "alice/odom", 50.0)]}))
    found, listening, _ = heard(topics, messages, rate=20.0)
    poses = poses_of(found)
    assert len(poses) > 15
    assert {(one.user, one.frame_id) for one in poses} == {("alice", "alice/odom")}
    for one in poses:
        assert one.position == (one.stamp + 0.25, 0.0, 0.0)
    assert listening.malformed == {}


def test_radios_are_found_by_map_by_name_and_by_number(tmp_path: Path) -> None:
    written = tmp_path / "map.toml"
    written.write_text('[radios.17]\nuser = "carol"\nantenna = "left"\nlever = [0.1, 0.0, 0.2]\n')
    asked = Asked(map=written)
    ends = Ends(asked, mapped(asked))
    _, listening, _ = heard({"/uwb": RANGING}, [("/uwb", ranging(1.0, "tag_1", "tag_2", 2.0))])
    topics = listening.ranges.values()
    here = ("robot1", "robot2", "carol")

    def measured(a: str, b: str) -> m.MeasuredRange | None:
        return ends.measured(HeardRange(7.0, 1.0, "/uwb", a, b, 2.0, {}), topics, here)

    assert measured("tag_1", "tag_2") == m.MeasuredRange(7.0, "robot1", "robot2", 2.0)
    assert measured("robot2", "17") == m.MeasuredRange(7.0, "robot2", "carol", 2.0, antenna_b="left")
    assert measured("tag_1", "unheard") is None
    assert measured("robot1", "tag_1") is None


def test_a_robot_s_clock_is_brought_to_the_bridge_s_and_ranges_with_it() -> None:
    clock = RobotClock(simulated=False)
    random = np.random.default_rng(1)
    offset, off = -1e6 - 0.37, []
    for k in range(300):
        t = 5000.0 + 0.05 * k
        arrived = t + 0.002 + random.exponential(0.01)
        off.append(clock.of_pose(t + offset, arrived) - t)
    assert np.abs(off[40:]).max() < 0.01
    assert clock.of_range(t + offset + 0.02, t + 0.03) - (t + 0.02) == pytest.approx(off[-1], abs=1e-6)
    assert clock.of_range(77.0, t + 0.03) == t + 0.03  # by another clock: when it came
    assert clock.of_range(nan, t + 0.03) == t + 0.03
    assert clock.ros_time(t) == pytest.approx(t + offset, abs=0.06)
    assert not clock.goes_back(t + offset - 0.5)  # out of order


def test_a_stamp_that_is_astray_is_left_out_and_a_bag_that_begins_again_is_noticed() -> None:
    clock = RobotClock(simulated=False)

    def heard(stamp: float, arrived: float) -> tuple[bool, float]:
        return clock.goes_back(stamp), clock.of_pose(stamp, arrived)

    for k in range(100):
        assert heard(50.0 + 0.05 * k, 1000.0 + 0.05 * k) == (False, pytest.approx(1000.0 + 0.05 * k))
    for astray in (80.0, 20.0):
        back, t = heard(astray, 1005.0)
        assert not back
        assert t != t
        assert heard(55.0, 1005.01) == (False, pytest.approx(1005.0, abs=0.02))
    stalled = [heard(55.0 + 0.05 * k, 1008.0) for k in range(1, 50)]  # three seconds late, all at once
    assert [t for _, t in stalled] == pytest.approx([1005.0 + 0.05 * k for k in range(1, 50)], abs=0.02)
    again = [heard(50.0 + 0.05 * k, 1010.0 + 0.05 * k) for k in range(8)]
    assert [back for back, _ in again] == [False] * 4 + [True] + [False] * 3
    assert [t for _, t in again[4:]] == pytest.approx([1010.2, 1010.25, 1010.3, 1010.35])


def test_in_a_simulation_stamps_are_the_time() -> None:
    clock = RobotClock(simulated=True)
    assert clock.of_range(3.0, 1e9) != clock.of_range(3.0, 1e9)
    assert clock.of_pose(3.0, 1e9) == 3.0
    assert clock.of_range(3.1, 1e9 + 0.01) == 3.1
    assert clock.of_range(nan, 1e9) == pytest.approx(3.0, abs=1e-6)
    assert clock.of_pose(nan, 1e9) != clock.of_pose(nan, 1e9)


def test_a_robot_on_a_map_is_heard_and_one_beyond_the_world_is_not() -> None:
    topics = {"/alice/odom": "nav_msgs/msg/Odometry"}
    northing = 5_300_000.0
    messages = [("/alice/odom", odometry(float(k), "map", (1.0, northing, 0.0), NO_TURN)) for k in range(1, 9)]
    found, listening, _ = heard(topics, [*messages, ("/alice/odom", odometry(9.0, "map", (1e8, 0.0, 0.0), NO_TURN))])
    assert [one.position[1] for one in poses_of(found)] == [northing] * 8
    assert listening.malformed["/alice/odom"] == 1


def test_a_ranges_sigma_has_the_unit_of_its_distance() -> None:
    topics = {"/uwb": RANGING}
    message = ranging(1.0, "alice", "bob", 2500.0) | {"sigma": 50.0}
    found, _, _ = heard(topics, [("/uwb", message)] * 3, topics=["/uwb sigma=sigma unit=mm"])
    assert [(one.distance, one.optional) for one in ranges_of(found)] == [(2.5, {"sigma": 0.05})] * 3


def test_a_transform_that_is_none_is_counted_and_the_others_of_its_message_are_heard() -> None:
    def transform(t: float, child: str, x: float) -> dict[str, Any]:
        at = {"translation": {"x": x, "y": 0.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
        return {"header": header(t, f"{child}/odom"), "child_frame_id": f"{child}/base_link", "transform": at}

    times = np.arange(1.0, 6.0, 0.1).tolist()
    messages = [("/tf", {"transforms": [transform(t, "bob", nan), transform(t, "alice", t)]}) for t in times]
    found, listening, _ = heard({"/tf": "tf2_msgs/msg/TFMessage"}, messages, rate=10.0)
    poses = poses_of(found)
    assert {one.user for one in poses} == {"alice"}
    assert len(poses) > 20
    assert listening.malformed["/tf"] == len(times)


@pytest.mark.parametrize("typedefs", [[{}], [{"type": "a/B", "fieldnames": ["x"]}], [{"type": 5}], 7, None])
def test_a_definition_that_is_none_is_not_known(typedefs: Any) -> None:
    class Answering:
        async def call(self, service: str, _: Any = None) -> dict[str, Any]:
            return {"topics": ["/a"], "types": ["a/msg/B"]} if service == "/rosapi/topics" else {"typedefs": typedefs}

    (topic,) = asyncio.run(Rosapi(Answering()).topics())  # type: ignore[arg-type]
    assert (topic.name, topic.type, topic.fields) == ("/a", "a/B", ())
