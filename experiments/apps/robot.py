"""A robot in a room, with modules in the air: it registers as people do, and then is the mirror image of one of them.

`python -m experiments.apps.robot [--seconds 90] [--seed 1] [--late-share 0.2]`: a server with the application, two
phones whose SLAM drifts, and a simulated robot whose odometry does; ranges by the firmware in the simulated air, over
UDP. As soon as all are registered the first person asks to be mirrored, and walks on. Judged by the truth: how far the
robot is off the true image (m, in the plane) and its heading (degrees), and how near it came to anybody.
"""

from __future__ import annotations

import argparse
import asyncio
import time
from contextlib import AsyncExitStack
from math import degrees
from typing import Any

import numpy as np

from experiments.live.room import STAMP_SIGMA, Walkers, block, carry, listen, module_key, place_at, up_of
from experiments.live.walkers import server
from synchronizar.apps.robot.__main__ import SETTINGS
from synchronizar.apps.robot.body import SimulatedBody
from synchronizar.apps.robot.client import RobotClient
from synchronizar.apps.robot.drive import Drive, Ground, Twist
from synchronizar.apps.robot.mirror import Mirror, mirror_between
from synchronizar.geometry import wrap_angle
from synchronizar.live import messages as m
from synchronizar.live.client import Client
from synchronizar.quaternions import yaw_of_quaternions
from synchronizar.simulation.live_air import LiveAir
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

ROBOT = "robot"
RADIO_M = 0.35
"""m above the floor: the robot's radio."""
STARTS = Ground(3.5, 3.5, -2.4)
OPERATOR = Twist(0.35, 0.45)
"""How somebody drives it until it is registered: in a circle, as people walk in."""
TICK_S = 1.0 / 30.0
JUDGED_AFTER_S = 4.0


async def run(simulation: Simulation, address: str, udp_port: int, seed: int) -> dict[str, Any]:
    """Where everybody was in truth, while the robot mirrored."""
    names = [user.name for user in simulation.recording.users]
    out: dict[str, Any] = {"registered": None, "images": [], "nearest": float("inf"), "way": 0.0}
    async with AsyncExitStack() as stack:
        clients = {
            name: await stack.enter_async_context(await Client.join(address, [name], up=up_of(simulation, name)))
            for name in names
        }
        clients[ROBOT] = await stack.enter_async_context(await Client.join(address, {ROBOT: SETTINGS}))
        keys = {name: await module_key(client, name, n) for n, (name, client) in enumerate(clients.items())}
        air = stack.enter_context(LiveAir(next(iter(keys.values())).session, udp_port, seed, stamp_sigma=STAMP_SIGMA))
        carry(air, keys, seed)
        block(air, simulation, keys)
        walkers = Walkers(simulation, clients, keys, air)
        drive = Drive(STARTS, seed)
        body = SimulatedBody(drive)
        robot = RobotClient(clients[ROBOT], ROBOT, body)
        tasks = [asyncio.create_task(listen(clients[name])) for name in names]
        tasks.append(asyncio.create_task(robot.run()))
        began, mirror = time.time(), None
        while (t := time.time() - began) < simulation.scene.seconds:
            await walkers.go_on(began, t)
            air.place(keys[ROBOT].address, t, np.array([drive.truth.x, drive.truth.y, RADIO_M]))
            before = drive.truth
            body.odometry()
            out["way"] += float(np.hypot(drive.truth.x - before.x, drive.truth.y - before.y))
            people = [_ground(simulation, name, t) for name in names]
            out["nearest"] = min(out["nearest"], *(np.hypot(p.x - drive.truth.x, p.y - drive.truth.y) for p in people))
            frames = clients[names[0]].frames.users
            if mirror is None and len(frames) == len(keys) and all(f.state == "registered" for f in frames.values()):
                out["registered"], mirror = t, mirror_between(people[0], drive.truth)
                await clients[names[0]].say_message(m.Say("mirror", {"robot": ROBOT}, m.APP))
            elif mirror is None:
                await body.command(OPERATOR)
            elif t - out["registered"] > JUDGED_AFTER_S:
                out["images"].append(_beside(mirror, people[0], drive.truth))
            await asyncio.sleep(TICK_S)
        for task in tasks:
            task.cancel()
        out["refused"] = dict(clients[ROBOT].refused)
    return out


def _ground(simulation: Simulation, name: str, t: float) -> Ground:
    track = simulation.truth[name]
    row = int(np.searchsorted(track.t, t).clip(0, len(track.t) - 1))
    x, y, _ = place_at(track, t).tolist()
    return Ground(x, y, float(yaw_of_quaternions(track.quat_xyzw[row : row + 1])[0]))


def _beside(mirror: Mirror, person: Ground, robot: Ground) -> tuple[float, float]:
    image = mirror.image(person)
    away = float(np.hypot(image.x - robot.x, image.y - robot.y))
    return away, abs(degrees(wrap_angle(image.heading - robot.heading)))


def main() -> None:
    """Walk, and say how it was."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=90.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--late-share", type=float, default=0.2)
    options = parser.parse_args()
    scene = Scene(
        users=2,
        seconds=options.seconds,
        seed=options.seed,
        late_share=options.late_share,
        speed=0.5,
        drift_m_per_sqrt_s=0.005,
        drift_rad_per_sqrt_s=0.002,
        up="y",
    )
    simulation = simulate(scene)
    with server("--no-tls", "--app", "robot") as where:
        out = asyncio.run(run(simulation, where["join"], where["udp_port"], options.seed))
    images = np.array(out["images"])
    print(f"all registered after {out['registered']} s; the robot went {out['way']:.1f} m; refused {out['refused']}")
    print(f"nearest to anybody {out['nearest']:.2f} m")
    if len(images):
        for name, column in zip(("off the image, m", "off its heading, degrees"), images.T, strict=True):
            print(f"{name:24} median {np.median(column):.2f}, p95 {np.percentile(column, 95):.2f}")


if __name__ == "__main__":
    main()
