"""docs/devices.md: its numbers are computed anew from the axes, its Python is run."""

from __future__ import annotations

import asyncio
import re
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import gtsam
import numpy as np
import pytest
from live.test_server import run, serving
from numpy.testing import assert_allclose
from support.paths import REPOSITORY

from synchronizar.geometry import YawFrame
from synchronizar.io.datagrams import RANGE, RangesDatagram, encode_ranges
from synchronizar.live import BlockingClient
from synchronizar.live import messages as m
from synchronizar.live.room import Room
from synchronizar.live.server import Server
from synchronizar.quaternions import inverse_quaternions, multiply_quaternions

PAGE = (REPOSITORY / "docs" / "devices.md").read_text()
CONVERSIONS, BRIDGE, GATEWAY, MODULE = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)


@pytest.fixture(autouse=True)
def own_state_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


# Columns: where x, y and z of a system point, in axes ahead, left, up; and the length of its unit in m.
AHEAD, LEFT, UP = np.eye(3)
SYSTEMS = {
    "ROS": (np.column_stack([AHEAD, LEFT, UP]), 1.0),
    "ARKit, ARCore, WebXR, OpenXR": (np.column_stack([-LEFT, UP, -AHEAD]), 1.0),
    "Unity": (np.column_stack([-LEFT, UP, AHEAD]), 1.0),
    "Unreal": (np.column_stack([AHEAD, -LEFT, UP]), 0.01),
    "a camera's optical axes, level at the start": (np.column_stack([-LEFT, -UP, AHEAD]), 1.0),
}
PLACE = np.array([2.0, 1.0, 0.5])
TURNED = np.column_stack([LEFT, -AHEAD, UP])  # by 90 degrees to the left


def rows(after: str) -> list[list[str]]:
    """Cells of the table after a place of the page."""
    table = re.search(r"^\|.*?\n\n", PAGE[PAGE.index(after) :], flags=re.DOTALL | re.MULTILINE)
    assert table is not None
    lines = table[0].strip().splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def numbers(cell: str) -> np.ndarray:
    return np.array(re.findall(r"-?[\d.]+", cell), dtype=float)


def matrix_of(quat_xyzw: Any) -> np.ndarray:
    x, y, z, w = np.asarray(quat_xyzw, dtype=float) / np.linalg.norm(quat_xyzw)
    return np.array(gtsam.Rot3.Quaternion(w, x, y, z).matrix())


def defined(code: str) -> dict[str, Any]:
    names: dict[str, Any] = {}
    exec(code, names)
    return names


def as_sent(system: list[str]) -> tuple[np.ndarray, np.ndarray, str]:
    """Position, attitude and `up` that a row of the first table sends."""
    position, quat, to_room = numbers(system[2]), numbers(system[3]), system[4]
    if (name := re.search(r"`(from_\w+)`", to_room)) is not None:
        position, quat = map(np.array, defined(CONVERSIONS)[name[1]](position, quat))
    (up,) = re.findall(r'`"([yz])"`', to_room)
    return position, quat, up


@pytest.mark.parametrize("system", rows("## One pose"), ids=lambda row: row[0])
def test_a_pose_is_what_the_axes_make_of_it(system: list[str]) -> None:
    axes, unit = SYSTEMS[system[0]]
    assert_allclose(numbers(system[2]), axes.T @ PLACE / unit, atol=1e-12)
    assert_allclose(matrix_of(numbers(system[3])), axes.T @ TURNED @ axes, atol=1e-3)
    assert np.linalg.det(axes) == pytest.approx(-1.0 if "left-handed" in system[1] else 1.0)


@pytest.mark.parametrize("system", rows("## One pose"), ids=lambda row: row[0])
def test_what_is_sent_is_the_same_pose_in_the_common_frame(system: list[str]) -> None:
    position, quat, up = as_sent(system)
    frame = YawFrame(up_b=up)  # type: ignore[arg-type]
    assert_allclose(frame @ position, PLACE, atol=1e-12)
    body = np.eye(3) if up == "z" else SYSTEMS["ARKit, ARCore, WebXR, OpenXR"][0]
    assert_allclose(matrix_of(frame.rotate_quaternions(quat)), TURNED @ body, atol=1e-3)


def test_all_systems_are_in_the_table() -> None:
    assert [row[0] for row in rows("## One pose")] == list(SYSTEMS)


def test_a_z_up_body_is_drawn_with_a_y_up_model() -> None:
    sentence = re.search(r"multiply its attitude by ([-\d., ]+) from the right", PAGE)
    assert sentence is not None
    z_up_from_y_up = matrix_of(numbers(sentence[1]))
    assert_allclose(z_up_from_y_up @ [0.0, 0.0, -1.0], AHEAD, atol=1e-12)
    assert_allclose(z_up_from_y_up @ [0.0, 1.0, 0.0], UP, atol=1e-12)


@pytest.mark.parametrize("row", rows("## What comes back"), ids=lambda row: row[0])
def test_what_comes_back_is_in_own_axes(row: list[str]) -> None:
    frame = YawFrame(1.0, 2.0, 0.5, np.pi / 2, up_b="z" if '"z"' in row[0] else "y")
    if row[1] != "as above":
        assert_allclose(numbers(row[1]).reshape(4, 4), frame.matrix, atol=1e-12)
    place = (np.linalg.inv(frame.matrix) @ [1.0, 3.0, 1.5, 1.0])[:3]
    turned = np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
    q_r = frame.rotate_quaternions(np.array([0.0, 0.0, 0.0, 1.0]))
    assert_allclose(matrix_of(q_r), frame.matrix[:3, :3], atol=1e-12)
    quat = multiply_quaternions(inverse_quaternions(q_r), turned)
    if "Unity" in row[0]:
        place, quat = map(np.array, defined(CONVERSIONS)["from_unity"](place, quat))
    assert_allclose(numbers(row[2]), place, atol=1e-12)
    assert_allclose(numbers(row[3]), quat, atol=1e-12)


def beside_a_server(blocking: Callable[[str, Server], None]) -> None:
    """Run what blocks in a thread; the server has the loop."""

    async def test() -> None:
        async with serving() as (server, address):
            await asyncio.to_thread(blocking, address, server)

    run(test)


def room_of(server: Server) -> Room:
    (room,) = server.lobby.rooms.values()
    return room


def test_the_gateway_is_refused_nothing() -> None:
    def blocking(address: str, server: Server) -> None:
        t, upright = time.time(), (0.0, 0.0, 0.0, 1.0)
        readings = [
            ("pose", "robot1", t, (0.0, 0.0, 0.0), upright),
            ("pose", "phone1", t, (0.0, 0.0, 0.0), upright),
            ("range", t, "robot1", "phone1", 2.0),
            ("range", t, "robot1", "wall", 3.0),
        ]
        assert defined(GATEWAY)["gateway"](address, readings) == {}
        devices = room_of(server).devices
        for _ in range(600):  # what they said waits until their clock is known
            if devices["wall"].ranges:
                break
            time.sleep(0.1)
        heard = {name: (len(device.poses), len(device.ranges)) for name, device in devices.items()}
        assert heard == {"robot1": (1, 2), "phone1": (1, 1), "wall": (0, 1)}

    beside_a_server(blocking)


def test_a_module_that_is_provisioned_is_believed() -> None:
    def blocking(address: str, server: Server) -> None:
        with BlockingClient.join(address, ["alice", "bob"]) as client:
            client.say_message(m.Module("bob", 8))
            line = defined(MODULE)["provision"](client, "alice", 7, "127.0.0.1")
            said, session, number, key, *rest = line.split()
            assert (said, number, rest) == ("provision", "7", ['"SSID"', '"PASSWORD"', "127.0.0.1"])
            measured = np.zeros(1, RANGE)
            measured["peer"], measured["distance_mm"], measured["sigma_mm"] = 8, 4720, 100
            told = RangesDatagram(int(session), 7, 1, 5, 1_000_000_000, 0, measured)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio:
                assert client.welcome.udp_port is not None
                radio.sendto(encode_ranges(told, bytes.fromhex(key)), ("127.0.0.1", client.welcome.udp_port))
            receiver = room_of(server).modules.receiver
            client.until(lambda _: 7 in receiver.reporters or len(receiver.refused) > 0, 60.0)
            assert receiver.refused == {}

    beside_a_server(blocking)


class FakeNode:
    """What the bridge uses of a ROS node; its clock is an hour behind."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.subscribed: dict[str, Callable[[Any], None]] = {}
        self.timed: list[Callable[[], None]] = []

    def get_clock(self) -> Any:
        stamp = SimpleNamespace(nanoseconds=round((time.time() - 3600.0) * 1e9), to_msg=lambda: "now")
        return SimpleNamespace(now=lambda: stamp)

    def create_subscription(self, kind: Any, topic: str, heard: Callable[[Any], None], depth: int) -> None:
        assert (kind, depth) == ("Odometry", 50)
        self.subscribed[topic] = heard

    def create_timer(self, every: float, what: Callable[[], None]) -> None:
        assert every == 0.1
        self.timed.append(what)


def transform_stamped() -> SimpleNamespace:
    translation = SimpleNamespace(x=0.0, y=0.0, z=0.0)
    transform = SimpleNamespace(translation=translation, rotation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0))
    return SimpleNamespace(header=SimpleNamespace(stamp=None, frame_id=""), child_frame_id="", transform=transform)


def test_the_bridge_sends_odometry_and_broadcasts_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[Any] = []
    fakes = {
        "rclpy": {},
        "rclpy.node": {"Node": FakeNode},
        "geometry_msgs.msg": {"TransformStamped": transform_stamped},
        "nav_msgs.msg": {"Odometry": "Odometry"},
        "tf2_ros": {"TransformBroadcaster": lambda _: SimpleNamespace(sendTransform=sent.append)},
    }
    for name, members in fakes.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)

    def blocking(address: str, server: Server) -> None:
        bridge = defined(BRIDGE)["Bridge"](address, ["robot1", "robot2"])
        with bridge.client as client:
            stamp = bridge.get_clock().now().nanoseconds
            header = SimpleNamespace(stamp=SimpleNamespace(sec=stamp // 10**9, nanosec=stamp % 10**9))
            position = SimpleNamespace(x=1.0, y=2.0, z=3.0)
            pose = SimpleNamespace(position=position, orientation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0))
            message = SimpleNamespace(header=header, pose=SimpleNamespace(pose=pose))
            bridge.subscribed["/robot2/odom"](message)
            device = room_of(server).devices["robot2"]
            client.until(lambda _: device.pose is not None, 60.0)  # which waits until the device's clock is known
            assert device.pose is not None
            assert device.pose[1] == (1.0, 2.0, 3.0)
            assert client.refused == {}

            frame = YawFrame(1.0, 2.0, 0.5, np.pi / 2)
            told = m.UserFrame(
                *("registered", "", 0, frame.matrix.tolist(), frame.x, frame.y, frame.z, frame.yaw, 1.0, None, 0.1),
                *(0.0, 1.0, None),
            )
            unknown = m.UserFrame(*("unobservable", "", 0, None, None, None, None, None, 1.0), *(None,) * 5)
            known = m.Frames(1, 0.0, "robot1", {"robot1": unknown, "robot2": told})
            bridge.client = SimpleNamespace(frames=known)
            (timer,) = bridge.timed
            timer()
        (transform,) = sent
        assert (transform.header.frame_id, transform.child_frame_id) == ("common", "robot2/odom")
        place, turn = transform.transform.translation, transform.transform.rotation
        assert_allclose([place.x, place.y, place.z], frame.translation)
        assert_allclose(matrix_of([turn.x, turn.y, turn.z, turn.w]), frame.matrix[:3, :3], atol=1e-12)

    beside_a_server(blocking)
