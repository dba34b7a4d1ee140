from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.rosbridge import RANGING, StandIn, odometry, ranging, standing_in
from support.serving import run, serving

from synchronizar.cli import main
from synchronizar.convert.asked import Asked
from synchronizar.errors import InputError
from synchronizar.geometry import YawFrame
from synchronizar.live import messages as m
from synchronizar.live.client import Client
from synchronizar.ros import link, outgoing
from synchronizar.ros.bridge import Bridge, list_topics
from synchronizar.ros.link import Link
from synchronizar.ros.listening import HeardPose
from synchronizar.ros.options import BridgeOptions, RobotSettings
from synchronizar.ros.robot import Robot
from synchronizar.ros.rosbridge import Rosbridge, ServiceError

NO_TURN = (0.0, 0.0, 0.0, 1.0)
ODOMETRY = "nav_msgs/msg/Odometry"


async def until(wanted: Callable[[], Any]) -> None:
    async with asyncio.timeout(60.0):
        while not wanted():
            await asyncio.sleep(0.01)


@asynccontextmanager
async def bridging(options: BridgeOptions, told: list[str] | None = None) -> AsyncIterator[Bridge]:
    bridge = Bridge(options, (told if told is not None else []).append)
    running = asyncio.create_task(bridge.run())
    try:
        yield bridge
    finally:
        if running.done():
            running.result()
        running.cancel()
        with suppress(asyncio.CancelledError):
            await running


async def roll(stand_in: StandIn, names: list[str], ahead: float, frame: str = "odom") -> None:
    """Robots say where they are, fifty times a second, by a clock that is ahead of this machine's."""
    while True:
        for n, name in enumerate(names):
            t = time.time() + ahead
            await stand_in.say(f"/{name}/odom", odometry(t, frame, (0.1 * n, 0.0, 0.0), NO_TURN))
        await asyncio.sleep(0.02)


@asynccontextmanager
async def rolling(*robots: Any) -> AsyncIterator[None]:
    task = asyncio.create_task(roll(*robots))
    try:
        yield
    finally:
        task.cancel()


def test_robots_whose_clocks_are_wrong_are_in_the_room_at_the_right_time_and_begin_anew_in_another_frame() -> None:
    told: list[str] = []
    stand_in = StandIn({"/alice/odom": ODOMETRY, "/bob/odom": ODOMETRY, "/uwb": RANGING}, time.monotonic)

    async def test() -> None:
        async with serving() as (server, room), standing_in(stand_in) as address:
            devices = server.hosts[0].room.devices
            options = BridgeOptions(room, [(None, address)], Asked(static=["anchor"]))
            async with bridging(options, told) as bridge:
                await stand_in.until_subscribed("/alice/odom", "/bob/odom", "/uwb")
                async with rolling(stand_in, ["alice", "bob"], -1e6):
                    await until(lambda: {"alice", "bob", "anchor"} <= devices.keys())
                    await until(lambda: all(devices[name].pose for name in ("alice", "bob")))
                    for name in ("alice", "bob"):
                        pose = devices[name].pose
                        assert pose is not None
                        assert abs(pose[0] - server.hosts[0].room.now()) < 1.0
                    await stand_in.say("/uwb", ranging(time.time() - 1e6, "alice", "bob", 2.0))
                    await stand_in.say("/uwb", ranging(time.time() - 1e6, "bob", "anchor", 3.0))
                    await until(lambda: devices["alice"].ranges and devices["anchor"].ranges)
                    assert abs(devices["alice"].ranges[0] - server.hosts[0].room.now()) < 1.0
                async with rolling(stand_in, ["alice"], -1e6, "odom_after_restart"):
                    await until(lambda: devices["alice"].session == 1 and devices["alice"].pose)
                assert devices["bob"].session == 0
                assert bridge.robots["alice"].number == 1
            assert server.hosts[0].room.people.refused == {}
        assert stand_in.of("/tf") == []  # nobody is registered

    run(test)
    assert any("alice: poses are in frame 'odom_after_restart'" in sentence for sentence in told)


def levels(stand_in: StandIn) -> set[tuple[int, str]]:
    """Of diagnostics, and of whom they are."""
    statuses = [status for message in stand_in.of("/diagnostics") for status in message["status"]]
    return {(status["level"], status["hardware_id"]) for status in statuses}


def test_a_bridge_that_is_begun_anew_is_the_same_robots_and_a_name_that_is_taken_leaves_one_out() -> None:
    told: list[str] = []
    stand_in = StandIn({"/alice/odom": ODOMETRY, "/bob/odom": ODOMETRY}, time.monotonic)

    async def test() -> None:
        async with serving() as (server, room), standing_in(stand_in) as address:
            devices = server.hosts[0].room.devices
            options = BridgeOptions(room, [(None, address)])
            async with bridging(options), rolling(stand_in, ["alice"], 0.0):
                await until(lambda: "alice" in devices and devices["alice"].pose)
            owner = devices["alice"].owner
            async with await Client.join(room, ["bob"]), bridging(options, told), rolling(stand_in, ["alice"], 0.0):
                await until(lambda: devices["alice"].client is not None)
                assert devices["alice"].owner == owner
                async with rolling(stand_in, ["bob"], 0.0):
                    await until(lambda: any("left out" in sentence for sentence in told))
                    await until(lambda: (outgoing.ERROR, "bob") in levels(stand_in))
                    await until(lambda: devices["alice"].client is not None)
                assert devices["bob"].owner != owner

    run(test)


def test_a_rosbridge_that_talks_nonsense_is_heard_all_the_same() -> None:
    told: list[str] = []
    stand_in = StandIn({"/alice/odom": ODOMETRY}, time.monotonic)

    async def test() -> None:
        async with standing_in(stand_in) as address:
            rosbridge = await Rosbridge.connect(address, told.append)
            messages = rosbridge.messages()
            hearing = asyncio.create_task(anext(messages))
            await rosbridge.subscribe("/alice/odom", "nav_msgs/Odometry")
            await rosbridge.subscribe("/nowhere", "nav_msgs/Odometry")
            await stand_in.until_subscribed("/alice/odom")
            (caller,) = stand_in.callers
            for text in (
                "nonsense",
                "[]",
                '"x"',
                '{"op": 3}',
                "[" * 5000,
                '{"op": "publish", "topic": "/a", "msg": 1}',
            ):
                await stand_in.send(caller, text)
            await stand_in.send(caller, '{"op": "service_response", "id": "call_9", "result": true, "values": {}}')
            await caller.socket.send_bytes(b"\x00")
            await stand_in.say("/alice/odom", {"header": {"frame_id": "odom"}})
            assert await hearing == ("/alice/odom", {"header": {"frame_id": "odom"}})
            hearing = asyncio.create_task(anext(messages))
            stand_in.with_rosapi = False
            with pytest.raises(ServiceError, match="no_such"):
                await rosbridge.call("/no_such", {})
            hearing.cancel()
            await rosbridge.close()
            assert rosbridge.malformed.total() == 7

    run(test)
    assert any("/nowhere" in sentence for sentence in told)


def test_a_topic_that_is_silent_is_subscribed_to_again_until_it_says_something(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link, "LOOKED_EVERY_S", 0.05)
    stand_in = StandIn({"/alice/odom": ODOMETRY, "/uwb": RANGING}, time.monotonic)

    def times(topic: str) -> int:
        return sum(word["op"] == "subscribe" and word["topic"] == topic for word in stand_in.heard)

    async def test() -> None:
        async with (
            serving() as (_, room),
            standing_in(stand_in) as address,
            bridging(BridgeOptions(room, [(None, address)])),
        ):
            await until(lambda: times("/alice/odom") > 2)
            await stand_in.say("/uwb", ranging(time.time(), "alice", "bob", 2.0))
            await asyncio.sleep(0.2)
            before = times("/alice/odom"), times("/uwb")
            await until(lambda: times("/alice/odom") > before[0])
            assert times("/uwb") == before[1]

    run(test)
    assert stand_in.complaints == []


def test_rosbridge_without_rosapi_is_told_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link, "ROSAPI_WITHIN_S", 0.0)
    stand_in = StandIn({}, time.monotonic, with_rosapi=False)

    async def test() -> None:
        async with serving() as (_, room), standing_in(stand_in) as address:
            with pytest.raises(InputError, match="rosapi_node has to run"):
                await Bridge(BridgeOptions(room, [(None, address)])).run()
            with pytest.raises(InputError, match="no room with that code"):
                await Bridge(BridgeOptions(f"{room.partition('#')[0]}#WRONG", [(None, address)])).run()
            with pytest.raises(InputError, match="no rosbridge answers"):
                await Bridge(BridgeOptions(room, [(None, "ws://127.0.0.1:9")])).run()

    run(test)


def test_two_robots_of_one_name_at_two_rosbridges_need_names() -> None:
    topics = {"/odom": ODOMETRY}
    one, two = StandIn(topics, time.monotonic), StandIn(topics, time.monotonic)

    async def both() -> None:
        while True:
            for stand_in in (one, two):
                await stand_in.say("/odom", odometry(time.time(), "odom", (0.0, 0.0, 0.0), NO_TURN))
            await asyncio.sleep(0.02)

    async def test() -> None:
        async with serving() as (server, room), standing_in(one) as here, standing_in(two) as there:
            talking = asyncio.create_task(both())
            with pytest.raises(InputError, match="say --bridge NAME=URL"):
                await Bridge(BridgeOptions(room, [(None, here), (None, there)]), lambda _: None).run()
            devices = server.hosts[0].room.devices
            async with bridging(BridgeOptions(room, [("alice", here), ("bob", there)])):
                await until(lambda: {"alice", "bob"} <= devices.keys())
            talking.cancel()

    run(test)


def test_what_there_is_is_listed_as_for_a_bag() -> None:
    topics = {"/alice/odom": ODOMETRY, "/uwb": RANGING, "/cmd_vel": "geometry_msgs/msg/Twist"}
    stand_in = StandIn(topics, time.monotonic)

    async def test() -> None:
        async with standing_in(stand_in) as address, rolling(stand_in, ["alice"], 0.0):
            listed = await list_topics(BridgeOptions("http://nowhere/#X", [(None, address)]), 0.5)
        assert "/alice/odom  nav_msgs/Odometry" in listed
        assert "poses of alice" in listed
        assert "/uwb  uwb_msgs/RangeStamped  0: not read" in listed

    run(test)


def robot(name: str, frame_id: str, **settings: Any) -> Robot:
    made = Robot(name, RobotSettings(**settings), False, np.eye(3))
    made.hear(HeardPose(name, 5.0, 5.0, frame_id, (1.0, 2.0, 0.0), (1.0, 2.0, 0.0), NO_TURN, "z"))
    return made


def test_frames_are_those_of_odometry_and_have_robots_names_where_two_are_alike() -> None:
    options = BridgeOptions("http://x/#A", [(None, "ws://robot:9090")])
    one = Link(None, "ws://robot:9090", options, print, time.time)
    own, alike, other = robot("alice", "alice/odom"), robot("bob", "odom"), robot("carol", "odom")
    assert one.frame_of(own, [own, alike]) == ("alice/odom", "/tf")
    assert one.frame_of(alike, [own, alike]) == ("odom", "/tf")
    assert one.frame_of(alike, [own, alike, other]) == ("bob/odom", "/tf")
    assert one.frame_of(robot("dave", ""), []) == ("dave/odom", "/tf")
    said = robot("eve", "odom", frame="eve_odom", tf="/eve/tf")
    assert one.frame_of(said, [said, alike]) == ("eve_odom", "/eve/tf")


def told_frame(own: YawFrame, **other: Any) -> m.UserFrame:
    fields = {"state": "registered", "reason": "", "frame": 0, "covariance": None, "sigma": 0.1, "clock_offset": None}
    fields |= {"progress": 1.0, "cue": None} | other
    place = {"x": own.x, "y": own.y, "z": own.z, "yaw": own.yaw, "scale": own.scale}
    return m.UserFrame(**fields, **place, matrix=own.matrix.tolist())  # type: ignore[arg-type]


def test_tf_places_a_robot_where_it_is_though_its_odometry_measures_lengths_wrong() -> None:
    told = told_frame(YawFrame(3.0, -1.0, 0.2, 0.7, 1.03))
    at = np.array([20.0, 5.0, 0.1])
    translation, quat = outgoing.common_from_ros(told, tuple(at), tuple(at), np.eye(3))
    c, s = np.cos(0.7), np.sin(0.7)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(translation + rotation @ at, 1.03 * rotation @ at + [3.0, -1.0, 0.2], atol=1e-9)
    np.testing.assert_allclose(quat, [0.0, 0.0, np.sin(0.35), np.cos(0.35)], atol=1e-9)


def test_tf_of_optical_axes_is_of_the_frame_as_ros_has_it() -> None:
    asked = Asked(world="optical")
    options = BridgeOptions("http://x/#A", [(None, "ws://robot:9090")], asked)
    ros = (1.0, -2.0, 3.0)  # right, down, forward
    position = tuple((options.own_from_ros @ np.array(ros)).tolist())
    assert position == pytest.approx((3.0, -1.0, 2.0))
    told = told_frame(YawFrame(10.0, 0.0, 0.0, np.pi / 2.0))
    translation, (x, y, z, w) = outgoing.common_from_ros(told, ros, position, options.own_from_ros)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    np.testing.assert_allclose(turn @ np.array(ros) + translation, [10.0 + 1.0, 3.0, 2.0], atol=1e-9)


def test_a_pose_far_from_its_frame_s_origin_is_less_sure_across() -> None:
    sure = np.diag([0.01, 0.01, 0.04, 0.0025]).tolist()
    told = told_frame(YawFrame(), covariance=sure)
    of = np.array(outgoing.covariance_at(told, (10.0, 0.0, 0.0))).reshape(6, 6)
    assert of[0, 0] == pytest.approx(0.01)
    assert of[1, 1] == pytest.approx(0.01 + 100.0 * 0.0025)
    assert of[1, 5] == pytest.approx(10.0 * 0.0025)
    assert (of[2, 2], of[5, 5], of[3, 3]) == (0.04, 0.0025, 0.0)


def test_transforms_come_ten_times_a_second_and_only_of_a_frame_that_is_registered() -> None:
    one = robot("alice", "odom")
    assert one.due("common") is None
    one.told = told_frame(YawFrame(1.0), frame=1)  # of the frame before
    assert one.due("common") is None
    one.told = told_frame(YawFrame(1.0), state="ambiguous")
    assert one.due("common") is None
    one.told = told_frame(YawFrame(1.0))
    times = []
    for k in range(100):
        t = 6.0 + 0.02 * k
        one.hear(HeardPose("alice", t, t, "odom", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), NO_TURN, "z"))
        if (now := one.due("common")) is not None:
            times.append(now.stamp)
    assert np.diff(times) == pytest.approx(np.full(len(times) - 1, 0.1), abs=0.021)
    assert one.due("common") is None  # nothing new has come


def test_a_device_s_name_becomes_one_that_a_topic_may_have() -> None:
    assert outgoing.ros_name("alice") == "alice"
    assert outgoing.ros_name("bob~2") == "bob_2"
    assert outgoing.ros_name("7 Zwerge") == "_7_Zwerge"


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        (["--bridge", "robot:9090"], "no rosbridge's address"),
        (["--bridge", "ws://a:1", "--bridge", "b=ws://a:1"], "named twice"),
        (["--bridge", "a/b=ws://a:1"], "cannot be a device's name"),
        (["--world", "unity"], "right-handed"),
        (["--world", "sideways"], "names no axes"),
        (["--topic", "/odom pose"], "KEY=VALUE"),
        (["--map", "nowhere.toml"], "No such file"),
        (["--map", "MAP"], "robots.alice"),
    ],
)
def test_what_cannot_be_is_told_in_one_line(
    options: list[str], fault: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    written = tmp_path / "map.toml"
    written.write_text("[robots.alice]\nheight = 1.0\n")
    argv = ["ros", "http://127.0.0.1:9/#CODE", *(str(written) if word == "MAP" else word for word in options)]
    assert main(argv) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert fault in said.err


def test_a_map_s_robots_have_settings_of_a_recording_s_users(tmp_path: Path) -> None:
    written = tmp_path / "map.toml"
    written.write_text(
        '[robots.alice]\nheight_sigma = 0.1\nframe = "alice_odom"\n'
        "[robots.anchor]\nstatic = true\nposition = [1.0, 2.0, 3.0]\n"
        '[radios.7]\nuser = "bob"\nantenna = "top"\nlever = [0.0, 0.0, 0.3]\n'
    )
    robots = BridgeOptions("http://x/#A", [(None, "ws://a:1")], Asked(map=written, static=["base"])).robots
    assert robots["alice"] == RobotSettings({"height_sigma": 0.1}, "alice_odom")
    assert robots["anchor"].room == {"static": True, "position": [1.0, 2.0, 3.0]}
    assert robots["base"].room == {"static": True}
    assert json.loads(json.dumps(robots["bob"].room)) == {"antennas": {"top": [0.0, 0.0, 0.3]}}
