from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
import pytest
from support.rosbridge import RANGING, StandIn, odometry, ranging, standing_in
from support.serving import run, serving

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.estimation.incremental.replay import in_time
from synchronizar.estimation.register import register
from synchronizar.live.server import Server
from synchronizar.quaternions import rotate_by_quaternions
from synchronizar.ros.bridge import Bridge
from synchronizar.ros.options import BridgeOptions
from synchronizar.ros.robot import TF_AHEAD_S
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

BEHIND_S = 1.0
"""s: how far the solver may be behind the robots."""
Doing = Callable[[], Coroutine[Any, Any, None]]
NAMES = ("phone0", "phone1", "phone2")


OURS = {"/tf", "/diagnostics", *(f"/synchronizar/{name}/pose" for name in NAMES)}


def topics_of(names: tuple[str, ...]) -> dict[str, str]:
    return {f"/{name}/odom": "nav_msgs/msg/Odometry" for name in names} | {"/uwb": RANGING}


class Player:
    """Robots that say what a recording has, as fast as the room's solver keeps up."""

    def __init__(self, recording: Recording) -> None:
        self.t = 0.0
        self._recording = recording
        self._frames = {user.name: f"{user.name}/odom" for user in recording.users}

    async def play(self, to: list[StandIn], server: Server, at: dict[float, Doing] | None = None) -> None:
        """`at`: what else is done at these moments."""
        recording, waiting = self._recording, sorted((at or {}).items())
        room, loop = server.hosts[0].room, asyncio.get_running_loop()
        began = loop.time()
        for t, user, row in in_time(recording):
            if not room.devices:  # by the wall's time, until the robots are known
                await asyncio.sleep(max(0.0, began + t - loop.time()))
            elif t // 0.1 > self.t // 0.1:
                async with asyncio.timeout(60.0):
                    while room.common.known_at < t - BEHIND_S and room.time.recorded:
                        await asyncio.sleep(0.002)
            self.t = t
            if waiting and t >= waiting[0][0]:
                await waiting.pop(0)[1]()
            topic, message = self._said(user, row, t)
            for one in to:
                await one.say(topic, message)

    def _said(self, user: int, row: int, t: float) -> tuple[str, dict[str, Any]]:
        recording = self._recording
        if user < 0:
            r = recording.ranges
            a, b = recording.users[r.a[row]].name, recording.users[r.b[row]].name
            return "/uwb", ranging(t, a, b, float(r.distance[row]))
        name = recording.users[user].name
        track = recording.tracks[name]
        return f"/{name}/odom", odometry(t, self._frames[name], track.position[row], track.quat_xyzw[row])


def seconds(header: dict[str, Any]) -> float:
    return float(header["stamp"]["sec"]) + 1e-9 * float(header["stamp"]["nanosec"])


def placed_by_tf(stand_in: StandIn, recording: Recording) -> dict[str, tuple[Array, Array]]:
    """Of each robot stamps (n,) and places (n, 3) in the common frame, by transforms and its own odometry."""
    found: dict[str, tuple[list[float], list[Array]]] = {}
    for message in stand_in.of("/tf"):
        (of,) = message["transforms"]
        assert of["header"]["frame_id"] == "common"
        name, _, rest = of["child_frame_id"].partition("/")
        assert rest == "odom"
        t, track = seconds(of["header"]) - TF_AHEAD_S, recording.tracks[name]
        row = int(np.argmin(np.abs(track.t - t)))
        assert abs(track.t[row] - t) < 1e-6
        translation = np.array([of["transform"]["translation"][x] for x in "xyz"])
        rotation = np.array([of["transform"]["rotation"][x] for x in "xyzw"])
        times, places = found.setdefault(name, ([], []))
        times.append(t)
        places.append(translation + rotate_by_quaternions(rotation[None], track.position[row][None])[0])
    return {name: (np.array(t), np.array(p)) for name, (t, p) in found.items()}


def off_truth(walked: Simulation, placed: dict[str, tuple[Array, Array]], last_s: float) -> float:
    """As `off`, over the last seconds."""
    end = max(t[-1] for t, _ in placed.values())
    told, true = [], []
    for name, (t, places) in placed.items():
        truth = walked.truth[name]
        rows = np.searchsorted(truth.t, t - 1e-6)
        told.append(places[t > end - last_s])
        true.append(truth.position[rows[t > end - last_s]])
    return off(np.concatenate(told), np.concatenate(true))


def off(a: Array, b: Array) -> float:
    """m, root mean square between places (n, 3), by the one yaw and translation that fit best."""
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    yaw = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a[:, :2] * b[:, :2]).sum())
    c, s = np.cos(yaw), np.sin(yaw)
    turned = a @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return float(np.sqrt(((turned - b) ** 2).sum(axis=1).mean()))


async def ended(task: asyncio.Task[None]) -> None:
    if task.done():
        task.result()
    task.cancel()
    with suppress(asyncio.CancelledError):
        await task


class Happened(NamedTuple):
    walked: Simulation
    stand_ins: tuple[StandIn, StandIn]
    told: list[str]
    recorded: Recording
    sessions: dict[str, int]
    """How often each robot's SLAM began anew, as the room has it."""


@pytest.fixture(scope="module")
def happened(tmp_path_factory: pytest.TempPathFactory) -> Happened:
    """Two robots at one rosbridge, one at another; each of the three connections breaks on the way."""
    folder = tmp_path_factory.mktemp("rooms")
    walked = simulate(Scene(users=3, seconds=32.0, seed=4, scale_sigma=0.01))
    player, told, sessions = Player(walked.recording), list[str](), dict[str, int]()
    two, one = (StandIn(topics_of(names), lambda: player.t) for names in (NAMES[:2], NAMES[2:]))

    async def test() -> None:
        async with serving(record=folder) as (server, room), standing_in(two) as there, standing_in(one) as here:
            options = BridgeOptions(room, [(None, there), (NAMES[2], here)], simulated=True)
            bridge = Bridge(options, told.append)
            running = asyncio.create_task(bridge.run())
            await two.until_subscribed(*two.topics.keys() - OURS)
            await one.until_subscribed(*one.topics.keys() - OURS)

            async def break_rosbridge() -> None:
                await two.hang_up()
                await two.until_subscribed("/phone0/odom", "/phone1/odom", "/uwb")

            async def break_room() -> None:
                (client,) = server.hosts[0].room.clients
                server.hosts[0].room.disconnect(client)
                client.outbox.close()
                while server.hosts[0].room.clients <= {client}:
                    await asyncio.sleep(0.01)

            await player.play([two, one], server, {12.0: break_rosbridge, 16.0: break_room})
            await asyncio.sleep(0.1)
            sessions.update({name: device.session for name, device in server.hosts[0].room.devices.items()})
            await ended(running)

    run(test)
    return Happened(walked, (two, one), told, Recording.load(next(folder.iterdir())), sessions)


def test_robots_are_placed_by_tf_where_they_truly_were(happened: Happened) -> None:
    two, one = happened.stand_ins
    placed = placed_by_tf(two, happened.walked.recording) | placed_by_tf(one, happened.walked.recording)
    assert placed.keys() == set(NAMES)
    assert off_truth(happened.walked, placed, 10.0) < 0.12
    for t, _ in placed.values():
        assert t[-1] > 31.5  # also after every connection was broken
        assert np.diff(t).min() > 0.099


def test_what_tf_says_is_what_register_says_of_the_whole_recording(happened: Happened) -> None:
    answer = register(happened.walked.recording)
    two, one = happened.stand_ins
    placed = placed_by_tf(two, happened.walked.recording) | placed_by_tf(one, happened.walked.recording)
    live, batch = [], []
    for name, (t, places) in placed.items():
        frame, track = answer.users[name].common_from_user, happened.walked.recording.tracks[name]
        assert frame is not None
        rows = np.searchsorted(track.t, t - 1e-6)
        live.append(places[t > 30.0])
        batch.append((frame @ track.position[rows])[t > 30.0])
    assert off(np.concatenate(live), np.concatenate(batch)) < 0.12


def test_each_robot_s_pose_in_the_common_frame_is_its_odometry_by_tf_and_has_a_covariance(happened: Happened) -> None:
    two, _ = happened.stand_ins
    times, places = placed_by_tf(two, happened.walked.recording)["phone0"]
    poses = two.of("/synchronizar/phone0/pose")
    assert len(poses) == len(times)
    for message, t, place in zip(poses, times, places, strict=True):
        assert message["header"]["frame_id"] == "common"
        assert seconds(message["header"]) == pytest.approx(t, abs=1e-6)
        at = message["pose"]["pose"]["position"]
        assert [at["x"], at["y"], at["z"]] == pytest.approx(place.tolist(), abs=1e-5)
        covariance = np.array(message["pose"]["covariance"]).reshape(6, 6)
        np.testing.assert_allclose(covariance, covariance.T, atol=1e-12)
        assert np.linalg.eigvalsh(covariance).min() > -1e-9
    assert 0.005 < np.sqrt(covariance[0, 0]) < 0.3


def test_robots_of_another_rosbridge_are_told_by_their_poses_alone(happened: Happened) -> None:
    _, one = happened.stand_ins
    assert {message["transforms"][0]["child_frame_id"] for message in one.of("/tf")} == {"phone2/odom"}
    others = one.of("/synchronizar/phone0/pose")
    assert others
    assert {message["header"]["frame_id"] for message in others} == {"common"}


def test_diagnostics_tell_each_robot_s_state_and_sigma(happened: Happened) -> None:
    two, _ = happened.stand_ins
    states = []
    for message in two.of("/diagnostics"):
        for status in message["status"]:
            if status["hardware_id"] == "phone1":
                values = {pair["key"]: pair["value"] for pair in status["values"]}
                states.append((status["level"], values["state"]))
    assert states[0][0] > 0
    assert states[-1] == (0, "registered")
    assert 0.0 < float(values["sigma"]) < 0.3


def test_connections_that_break_are_made_again_and_robots_stay_who_they_are(happened: Happened) -> None:
    assert any("rosbridge has ended the connection" in sentence for sentence in happened.told)
    assert any("the room is joined again" in sentence for sentence in happened.told)
    assert happened.sessions == dict.fromkeys(NAMES, 0)
    assert {user.name for user in happened.recorded.users} == set(NAMES)


def test_a_room_hears_every_pose_and_range_as_it_was_measured(happened: Happened) -> None:
    walk, recorded = happened.walked.recording, happened.recorded
    for name, track in recorded.tracks.items():
        rows = np.searchsorted(walk.tracks[name].t, track.t - 1e-6)
        np.testing.assert_allclose(track.position, walk.tracks[name].position[rows], atol=1e-8)
        assert len(track) > 0.9 * len(walk.tracks[name])
    assert set(recorded.ranges.distance.round(9)) <= set(walk.ranges.distance.round(9))
    assert len(recorded.ranges) > 0.9 * len(walk.ranges)


def test_rosbridge_has_nothing_to_complain_of(happened: Happened) -> None:
    for stand_in in happened.stand_ins:
        assert stand_in.complaints == []
