"""What moves: a simulated robot, or a real one by rosbridge. Both take twists and have odometry."""

from __future__ import annotations

import base64
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, NamedTuple, Protocol

from synchronizar.apps.bodies import camera
from synchronizar.apps.bodies.drive import Drive, Ground, Twist
from synchronizar.apps.stills import View, shrunk
from synchronizar.live.messages import Quaternion, Vector
from synchronizar.quaternions import yaw_quaternion
from synchronizar.ros.rosbridge import Rosbridge

_STEP_S = 0.01
EYES_TOPIC = "/synchronizar/eyes"
"""What somebody sees, for the robot's own programs; `frame_id` says who."""
_TWIST, _IMAGE = "geometry_msgs/Twist", "sensor_msgs/CompressedImage"
USUAL_HALF = 0.47
"""m: half the height at 1 m of what a camera shows whose field nobody has told: 50 degrees."""


class Odometry(NamedTuple):
    """Of a robot, x forwards and z up, in its own frame."""

    t: float
    """s, by this program's clock."""
    position: Vector
    quat_xyzw: Quaternion


class Body(Protocol):
    """A robot that can be driven."""

    def odometry(self) -> Odometry | None:
        """The newest; None before the first."""

    async def command(self, twist: Twist) -> None:
        """What it shall do from now on, until it is told again."""

    def see(self, at: Ground | None, people: Mapping[str, tuple[float, float]]) -> View | None:
        """What its camera sees; None without one. A simulated one has to be told where it is, and who else is."""

    async def show(self, name: str, view: View) -> None:
        """What somebody sees, through whose eyes it looks."""

    async def close(self) -> None:
        """Nothing more is commanded."""


class SimulatedBody:
    """A robot of arithmetic, by some clock."""

    def __init__(self, drive: Drive, clock: Callable[[], float] = time.time) -> None:
        self.drive = drive
        self.shown: dict[str, View] = {}
        """What others see, by their names."""
        self._clock, self._t = clock, clock()

    def odometry(self) -> Odometry:
        """Goes on to now, and says where that is."""
        now = self._clock()
        while self._t + _STEP_S <= now:
            self.drive.step(_STEP_S)
            self._t += _STEP_S
        x, y, heading = self.drive.odometry
        qx, qy, qz, qw = yaw_quaternion(heading).tolist()
        return Odometry(self._t, (x, y, 0.0), (qx, qy, qz, qw))

    async def command(self, twist: Twist) -> None:
        """From now on."""
        self.drive.command(twist)

    def see(self, at: Ground | None, people: Mapping[str, tuple[float, float]]) -> View | None:
        """Drawn; nothing while it does not know where it is."""
        return None if at is None else camera.view(at, people)

    async def show(self, name: str, view: View) -> None:
        """It is kept."""
        self.shown[name] = view

    async def close(self) -> None:
        """It stands where it is."""


class RosbridgeBody:
    """A robot with ROS, by rosbridge's WebSocket: nav_msgs/Odometry comes, geometry_msgs/Twist goes.

    Pictures of its camera come, and others' views go, as sensor_msgs/CompressedImage.
    """

    def __init__(self, rosbridge: Rosbridge, odometry_topic: str, twist_topic: str, clock: Callable[[], float]) -> None:
        self._rosbridge, self._clock = rosbridge, clock
        self._odometry_topic, self._twist_topic = odometry_topic, twist_topic
        self._newest: Odometry | None = None
        self._view: View | None = None

    @classmethod
    async def connect(
        cls,
        address: str,
        odometry_topic: str = "/odom",
        twist_topic: str = "/cmd_vel",
        clock: Callable[[], float] = time.time,
        camera_topic: str | None = None,
    ) -> RosbridgeBody:
        """`address`: ws://robot:9090. `camera_topic`: of JPEG or PNG pictures.

        Raises InputError where nobody answers there.
        """
        rosbridge = await Rosbridge.connect(address)
        await rosbridge.advertise(twist_topic, _TWIST)
        await rosbridge.advertise(EYES_TOPIC, _IMAGE)
        await rosbridge.subscribe(odometry_topic, "nav_msgs/Odometry")
        if camera_topic is not None:
            # A picture now and then is enough, and a whole stream of them is more than rosbridge can do.
            await rosbridge.subscribe(camera_topic, _IMAGE, every_ms=500)
        return cls(rosbridge, odometry_topic, twist_topic, clock)

    async def hear(self) -> None:
        """Take odometry as it comes, until the connection ends."""
        async for topic, message in self._rosbridge.messages():
            with suppress(KeyError, TypeError, ValueError, OSError):
                self.take(topic, message)

    def take(self, topic: str, message: Any) -> None:
        """What a topic says. Raises KeyError, TypeError, ValueError, OSError where it is something else."""
        if topic != self._odometry_topic:
            jpeg, aspect = shrunk(base64.b64decode(message["data"], validate=True))
            self._view = View(jpeg, USUAL_HALF, aspect)
            return
        pose = message["pose"]["pose"]
        p, q = pose["position"], pose["orientation"]
        position = float(p["x"]), float(p["y"]), float(p["z"])
        quat = float(q["x"]), float(q["y"]), float(q["z"]), float(q["w"])
        # Its stamp is by the robot's own clock; what came is as old as the network is slow.
        self._newest = Odometry(self._clock(), position, quat)

    def odometry(self) -> Odometry | None:
        """The newest."""
        return self._newest

    async def command(self, twist: Twist) -> None:
        """Raises ConnectionError where rosbridge has gone."""
        zero = {"x": 0.0, "y": 0.0, "z": 0.0}
        message = {"linear": zero | {"x": twist.linear}, "angular": zero | {"z": twist.angular}}
        await self._rosbridge.publish(self._twist_topic, _TWIST, message)

    def see(self, at: Ground | None, people: Mapping[str, tuple[float, float]]) -> View | None:  # noqa: ARG002
        """The camera's newest picture."""
        return self._view

    async def show(self, name: str, view: View) -> None:
        """To whatever of the robot's programs wants it."""
        stamped = {"frame_id": name, "stamp": {"sec": int(self._clock()), "nanosec": 0}}
        message = {"header": stamped, "format": "jpeg", "data": base64.b64encode(view.jpeg).decode()}
        await self._rosbridge.publish(EYES_TOPIC, _IMAGE, message)

    async def close(self) -> None:
        """The robot stops: its last command is none."""
        with suppress(ConnectionError):
            await self.command(Twist(0.0, 0.0))
        await self._rosbridge.close()
