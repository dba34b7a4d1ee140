"""`python -m synchronizar.apps.robot JOIN`: a robot with ROS joins a room, by rosbridge."""

from __future__ import annotations

import argparse
import asyncio
import sys
from contextlib import suppress

from synchronizar.apps.bodies.body import EYES_TOPIC, RosbridgeBody
from synchronizar.apps.robot.client import RobotClient
from synchronizar.errors import InputError
from synchronizar.live.client import Client

SETTINGS = {"height_sigma": 1.0}
"""m: its radio is lower than people hold theirs, nobody has said by how much."""


async def _run(options: argparse.Namespace) -> None:
    body = await RosbridgeBody.connect(options.rosbridge, options.odometry, options.twist, camera_topic=options.camera)
    hearing = asyncio.create_task(body.hear())
    try:
        async with await Client.join(options.join, {options.name: SETTINGS}) as client:
            await RobotClient(client, options.name, body, options.see).run()
    finally:
        hearing.cancel()
        await body.close()


def main() -> int:
    """Exit status 0 when it was ended, 2 where the room or the robot cannot be reached."""
    parser = argparse.ArgumentParser(prog="python -m synchronizar.apps.robot", description="a robot joins a room")
    parser.add_argument("join", metavar="JOIN", help="the address by which phones join, as serve prints it")
    parser.add_argument("--name", default="robot", help="of the robot in the room [robot]")
    parser.add_argument("--rosbridge", metavar="URL", default="ws://127.0.0.1:9090", help="[ws://127.0.0.1:9090]")
    parser.add_argument("--odometry", metavar="TOPIC", default="/odom", help="nav_msgs/Odometry [/odom]")
    parser.add_argument("--twist", metavar="TOPIC", default="/cmd_vel", help="geometry_msgs/Twist [/cmd_vel]")
    parser.add_argument("--camera", metavar="TOPIC", help="sensor_msgs/CompressedImage: what people see by its eyes")
    parser.add_argument("--see", metavar="NAME", help=f"ask to see through NAME's eyes: views go to {EYES_TOPIC}")
    with suppress(KeyboardInterrupt):
        try:
            asyncio.run(_run(parser.parse_args()))
        except InputError as error:
            print(f"synchronizar: {error}", file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
