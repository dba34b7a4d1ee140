"""A robot in a room, with modules in the air: it registers as people do, and then is the mirror image of one of them.

`python -m experiments.apps.robot [--seconds 90] [--seed 1] [--late-share 0.2]`: a server with the application, two
phones whose SLAM drifts, and a simulated robot whose odometry does; ranges by the firmware in the simulated air, over
UDP. As soon as all are registered the first person asks to be mirrored, and walks on. Judged by the truth: how far the
robot is off the true image (m, in the plane) and its heading (degrees), and how near it came to anybody. In parts: what
the registration is off by (the error by the truth less that by the room's frames), how old news is (the goal beside
the image of where the room's frames have the person by now), and what steering leaves (the robot beside its goal);
besides, off the image in that mirror which fits the whole run best: all that who watches can see. An image is free
where it is nowhere within the distance that the robot keeps from people, which it cannot go to else.
"""

from __future__ import annotations

import argparse
import asyncio
import time
from contextlib import AsyncExitStack
from math import degrees
from typing import Any

import numpy as np

from experiments.common.markdown import markdown
from experiments.live.room import STAMP_SIGMA, Walkers, block, carry, listen, module_key, own_axes, place_at, up_of
from experiments.live.walkers import server
from synchronizar.apps.bodies.body import SimulatedBody
from synchronizar.apps.bodies.drive import Drive, Ground, Twist
from synchronizar.apps.robot.__main__ import SETTINGS
from synchronizar.apps.robot.client import RobotClient
from synchronizar.apps.robot.mirror import Mirror, mirror_between
from synchronizar.arrays import Array
from synchronizar.geometry import frame_between, rotation_2d, wrap_angle
from synchronizar.live import messages as m
from synchronizar.live.client import Client
from synchronizar.live.peer_placing import placed, told_frame
from synchronizar.live.stage import Player, heading_of
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
JUDGED_AFTER_S, ASKED_EVERY_S = 4.0, 1.0
FREE_M = 1.3
"""m from everybody, about: nearer it does not go."""
OFF, OFF_HEADING, FREE = "off the image, m", "off its heading, degrees", "free"
WATCHED = "off the image in the best mirror, m"


async def run(simulation: Simulation, address: str, udp_port: int, seed: int) -> dict[str, Any]:
    """Where everybody was in truth, while the robot mirrored."""
    names = [user.name for user in simulation.recording.users]
    out: dict[str, Any] = {"registered": None, "images": [], "places": [], "nearest": float("inf"), "way": 0.0}
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
        began, mirror, asked_again = time.time(), None, 0.0
        while (t := time.time() - began) < simulation.scene.seconds:
            await walkers.go_on(began, t)
            air.place(keys[ROBOT].address, t, np.array([drive.truth.x, drive.truth.y, RADIO_M]))
            before = drive.truth
            body.odometry()
            out["way"] += float(np.hypot(drive.truth.x - before.x, drive.truth.y - before.y))
            people = [_ground(simulation, name, t) for name in names]
            out["nearest"] = min(out["nearest"], *(np.hypot(p.x - drive.truth.x, p.y - drive.truth.y) for p in people))
            frames = clients[names[0]].frames.users
            if robot.pilot.mirror is not None and mirror is None:
                out["mirrors"], mirror = t, mirror_between(people[0], drive.truth)
            elif mirror is None and len(frames) == len(keys) and all(f.state == "registered" for f in frames.values()):
                out["registered"] = out["registered"] or t
                if t >= asked_again:  # as a person touches the button again where nothing comes of it
                    asked_again = t + ASKED_EVERY_S
                    await clients[names[0]].say_message(m.Say("mirror", {"robot": ROBOT}, m.APP))
            if mirror is None:
                await body.command(OPERATOR)
            elif t - out["mirrors"] > JUDGED_AFTER_S and robot.pilot.mirror is not None:
                person = _by_the_room(simulation, clients[names[0]], names[0], t)
                out["images"].append(
                    _beside(mirror, people, drive.truth) | _parts(mirror, people[0], person, robot, drive.truth)
                )
                out["places"].append((people[0], drive.truth))
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


def _by_the_room(simulation: Simulation, client: Client, name: str, t: float) -> Ground:
    """Where the room's frames have somebody at a moment, in the common frame, without any delay."""
    position, quat = own_axes(simulation, name)
    row = int(np.searchsorted(simulation.recording.tracks[name].t, t).clip(0, len(position) - 1))
    up = up_of(simulation, name)
    frame = told_frame(client.frames.users.get(name), up, client.members[name].frame)
    assert frame is not None
    (x, y, z), turned = placed(frame, position[row], quat[row])
    return Ground(x, y, heading_of(Player(name, (x, y, z), turned, up).forward))


def _beside(mirror: Mirror, people: list[Ground], robot: Ground) -> dict[str, float]:
    image = mirror.image(people[0])
    return {
        OFF: float(np.hypot(image.x - robot.x, image.y - robot.y)),
        OFF_HEADING: abs(degrees(wrap_angle(image.heading - robot.heading))),
        FREE: float(min(np.hypot(image.x - p.x, image.y - p.y) for p in people) > FREE_M),
    }


def _parts(mirror: Mirror, true: Ground, person: Ground, robot: RobotClient, stands: Ground) -> dict[str, float]:
    """`true`, `person`: in truth, and by the room. `stands`: the robot, in truth."""
    pilot = robot.pilot
    if pilot.mirror is None or robot.at is None or pilot.goal is None:
        return {}
    image, seen, goal, at = mirror.image(true), pilot.mirror.image(person), pilot.goal, robot.at
    off = rotation_2d(-mirror.direction) @ [image.x - stands.x, image.y - stands.y]
    by_room = rotation_2d(-pilot.mirror.direction) @ [seen.x - at.x, seen.y - at.y]
    return {
        "of that registration": float(np.hypot(*(off - by_room))),
        "of that news": float(np.hypot(seen.x - goal.x, seen.y - goal.y)),
        "of that steering": float(np.hypot(goal.x - at.x, goal.y - at.y)),
    }


def _fitted(places: list[tuple[Ground, Ground]]) -> Array:
    """(n,) m: the robot off the image in the mirror that fits best."""
    people = np.array([[p.x, -p.y, 0.0] for p, _ in places])
    robots = np.array([[r.x, r.y, 0.0] for _, r in places])
    fit = frame_between(robots, people, np.full(len(places), 1.0 / len(places)))
    return np.asarray(np.linalg.norm(fit @ people - robots, axis=1))


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
    print(f"all registered after {out['registered']} s; the robot went {out['way']:.1f} m; refused {out['refused']}")
    print(f"nearest to anybody {out['nearest']:.2f} m")
    if out["images"]:
        fitted = _fitted(out["places"])
        images = [image | {WATCHED: float(off)} for image, off in zip(out["images"], fitted, strict=True)]
        print(markdown([_row("all", images), _row("image free", [image for image in images if image[FREE]])]))


def _row(name: str, images: list[dict[str, float]]) -> dict[str, object]:
    row: dict[str, object] = {"": name, "ticks": len(images)}
    for of in (OFF, "of that registration", "of that news", "of that steering", WATCHED, OFF_HEADING):
        values = [image[of] for image in images if of in image]
        row[of] = "{:.2f}, {:.2f}".format(*np.percentile(values, [50, 95])) if values else ""
    return row


if __name__ == "__main__":
    main()
