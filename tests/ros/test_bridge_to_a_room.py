from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.rosbridge import RANGING, StandIn, odometry, ranging, standing_in
from support.serving import run, serving

from synchronizar.arrays import Array
from synchronizar.convert.asked import Asked
from synchronizar.data.recording import Recording
from synchronizar.estimation.incremental.replay import in_time
from synchronizar.live.server import Server
from synchronizar.quaternions import rotate_by_quaternions
from synchronizar.ros.bridge import Bridge
from synchronizar.ros.options import BridgeOptions
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

SPEED = 12.0
NAMES = ("phone0", "phone1", "phone2")


@pytest.fixture(scope="module")
def walked() -> Simulation:
    return simulate(Scene(users=3, seconds=40.0, seed=4, scale_sigma=0.01))


def topics_of(names: tuple[str, ...]) -> dict[str, str]:
    return {f"/{name}/odom": "nav_msgs/msg/Odometry" for name in names} | {"/uwb": RANGING}


class Player:
    """Robots that say what a recording has, at a pace of their own."""

    def __init__(self, recording: Recording) -> None:
        self.t = 0.0
        self._recording = recording
        self._frames = {user.name: f"{user.name}/odom" for user in recording.users}

    async def play(self, to: list[StandIn], at: dict[float, Callable[[], Any]] | None = None) -> None:
        """`at`: what else is done at these moments."""
        recording, waiting = self._recording, sorted((at or {}).items())
        loop = asyncio.get_running_loop()
        began, first, lost = loop.time(), None, 0.0
        for t, user, row in in_time(recording):
            self.t = t
            first = t if first is None else first
            if waiting and t >= first + waiting[0][0]:
                stopped = loop.time()
                await waiting.pop(0)[1]()
                lost += loop.time() - stopped
            if (early := began + lost + (t - first) / SPEED - loop.time()) > 0.0:
                await asyncio.sleep(early)
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


def placed_by_tf(stand_in: StandIn, recording: Recording, ahead: float) -> dict[str, tuple[Array, Array]]:
    """Of each robot stamps (n,) and places (n, 3) in the common frame, by transforms and its own odometry."""
    found: dict[str, tuple[list[float], list[Array]]] = {}
    for message in stand_in.of("/tf"):
        (of,) = message["transforms"]
        assert of["header"]["frame_id"] == "common"
        name, _, rest = of["child_frame_id"].partition("/")
        assert rest == "odom"
        t = of["header"]["stamp"]["sec"] + 1e-9 * of["header"]["stamp"]["nanosec"] - ahead
        track = recording.tracks[name]
        row = int(np.argmin(np.abs(track.t - t)))
        assert abs(track.t[row] - t) < 1e-6
        translation, rotation = (
            [of["transform"][part][x] for x in axes] for part, axes in (("translation", "xyz"), ("rotation", "xyzw"))
        )
        place = np.array(translation) + rotate_by_quaternions(np.array([rotation]), track.position[row][None])[0]
        ts, places = found.setdefault(name, ([], []))
        ts.append(t)
        places.append(place)
    return {name: (np.array(t), np.array(p)) for name, (t, p) in found.items()}


def off_truth(walked: Simulation, placed: dict[str, tuple[Array, Array]], last_s: float) -> float:
    """m, root mean square over the last seconds, by the one yaw and translation that fit best."""
    end = max(t[-1] for t, _ in placed.values())
    told, true = [], []
    for name, (t, places) in placed.items():
        truth = walked.truth[name]
        rows = np.searchsorted(truth.t, t - 1e-6)
        kept = t > end - last_s
        told.append(places[kept])
        true.append(truth.position[rows[kept]])
    a, b = np.concatenate(told), np.concatenate(true)
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


def test_robots_of_a_recording_are_placed_by_tf_where_they_truly_were(walked: Simulation, tmp_path: Path) -> None:
    told: list[str] = []
    recording = walked.recording
    player = Player(recording)
    stand_in = StandIn(topics_of(NAMES), lambda: player.t)

    async def test() -> None:
        async with serving(record=tmp_path) as (_, room), standing_in(stand_in) as address:
            bridge = Bridge(BridgeOptions(room, [(None, address)], Asked(), simulated=True), told.append)
            running = asyncio.create_task(bridge.run())
            await stand_in.until_subscribed(*topics_of(NAMES))
            await player.play([stand_in])
            await asyncio.sleep(0.5)
            await ended(running)

    run(test)
    print(told, stand_in.complaints)
    placed = placed_by_tf(stand_in, recording, 0.2)
    print({k: (len(t), t[0], t[-1]) for k, (t, _) in placed.items()})
    print(off_truth(walked, placed, 10.0))
    print(stand_in.of("/diagnostics")[-1])
    (folder,) = tmp_path.iterdir()
    rec = Recording.load(folder)
    print(
        len(rec.ranges), len(recording.ranges), {u: (len(t), len(recording.tracks[u])) for u, t in rec.tracks.items()}
    )
    assert 0
