"""One robot of the bridge: what it was heard to say, and what ROS is told of it."""

from __future__ import annotations

from math import inf, isfinite
from typing import Any, NamedTuple

from synchronizar.arrays import Array
from synchronizar.live.client import Client
from synchronizar.live.messages import UserFrame
from synchronizar.live.peer_placing import placed, told_frame
from synchronizar.ros import outgoing
from synchronizar.ros.listening import HeardPose
from synchronizar.ros.options import RobotSettings
from synchronizar.ros.robot_clock import RobotClock

OUT_EVERY_S = 0.1
"""s between transforms of one robot, by its own stamps."""
TF_AHEAD_S = 0.2
"""s by which a transform is dated ahead: who asks for the newest pose need not wait for the next one."""
SILENT_S = 2.0
"""s without a pose after which a robot's track counts as silent."""

STAMPS_BACK = "stamps went back"


class Placed(NamedTuple):
    """Where a robot is, for ROS."""

    stamp: float
    """s, by the robot's clock."""
    translation: Array
    quat_xyzw: Array
    """Of its odometry's frame in the common one."""
    pose: dict[str, Any]
    """geometry_msgs/PoseWithCovarianceStamped of itself."""


class Robot:
    """Its name, and what is known of it."""

    def __init__(self, name: str, settings: RobotSettings, simulated: bool, own_from_ros: Array) -> None:
        self.name, self.settings = name, settings
        self.clock = RobotClock(simulated)
        self.frame_id = ""
        """Of its odometry."""
        self.number = 0
        """Of its SLAM frame in the room."""
        self.told: UserFrame | None = None
        """What the room said last of its frame."""
        self.waiting: list[tuple[float, HeardPose]] = []
        """Poses from before the room knew of it."""
        self._newest: HeardPose | None = None
        self._out_at = -inf
        self._own_from_ros = own_from_ros

    def hear(self, heard: HeardPose) -> tuple[float, str | None]:
        """When a pose was by the bridge's clock (s; NaN: nobody knows), and why it is of another frame than before.

        A frame of another name is another one, and so is that of stamps that begin again. None: it is the same.
        """
        begins = STAMPS_BACK if self.clock.goes_back(heard.stamp) else None
        t = self.clock.of_pose(heard.stamp, heard.arrived)
        if not isfinite(t):
            return t, None
        if begins is None and self._newest is not None and heard.frame_id != self.frame_id:
            begins = f"poses are in frame {heard.frame_id!r}, no longer in {self.frame_id!r}"
        if begins is not None:
            self._out_at = -inf
        self._newest, self.frame_id = heard, heard.frame_id
        return t, begins

    def silent_for(self, now: float) -> float:
        """How long (s) no pose has come; infinite before the first."""
        return inf if self._newest is None else now - self._newest.arrived

    def state(self) -> str:
        """As the room tells it of its present frame."""
        told = self.told
        return "unknown" if told is None or told.frame != self.number else told.state

    def due(self, common: str) -> Placed | None:
        """Where it is, where that is news and it is registered: ten times a second by its own stamps."""
        told, heard = self.told, self._newest
        if told is None or heard is None or self.state() != "registered":
            return None
        stamp = heard.stamp if isfinite(heard.stamp) else heard.arrived
        if stamp < self._out_at + OUT_EVERY_S:
            return None
        frame = told_frame(told, heard.up, self.number)
        if frame is None:
            return None
        self._out_at = stamp
        position, quat = placed(frame, heard.position, heard.quat_xyzw)
        covariance = outgoing.covariance_at(told, heard.position)
        pose = outgoing.pose(stamp, common, position, quat, covariance)
        return Placed(stamp, *outgoing.common_from_ros(told, heard.ros, heard.position, self._own_from_ros), pose)

    def status(self, now: float, client: Client | None, refused: str | None) -> dict[str, Any]:
        """diagnostic_msgs/DiagnosticStatus."""
        told = self.told if client is not None and self.state() != "unknown" else None
        values: dict[str, Any] = {"state": self.state()}
        if told is not None:
            values |= {"cue": told.cue, "sigma": told.sigma, "progress": told.progress, "scale": told.scale}
            values |= {"clock_offset": told.clock_offset}
        if refused is not None:
            level, message = outgoing.ERROR, refused
        elif client is None:
            level, message = outgoing.ERROR, "the room cannot be reached"
        elif self.silent_for(now) > SILENT_S:
            level, message = outgoing.STALE, "its odometry is silent"
        elif told is None:
            level, message = outgoing.WARN, "the room does not know where it is"
        else:
            level = outgoing.OK if told.state == "registered" else outgoing.WARN
            message = told.reason or told.state
        return outgoing.status(self.name, level, message, values)
