"""Everybody's poses to everybody: one message, the same for all, in the common frame."""

from __future__ import annotations

from synchronizar.live import messages as m
from synchronizar.live.common_frame import CommonFrame
from synchronizar.live.member import Device
from synchronizar.live.people import People
from synchronizar.live.placing import AT_ITS_ORIGIN, OwnPose, Placing, Shown
from synchronizar.live.pose_wire import encode_rows_down

AWAY_AFTER = 300.0
"""s: who has been away for so long is left out of what is told."""


class FanOut:
    """Sends all poses of one room."""

    def __init__(self, people: People, common: CommonFrame) -> None:
        self._people, self._common = people, common
        self._placing: tuple[m.Frames, int, list[Device], Placing] | None = None
        self._sequence = 0

    def send(self, t: float) -> None:
        """As they are at `t` (s)."""
        if not self._people.clients:
            return
        self._sequence += 1
        poses = self.poses(t)
        for client in self._people.clients:
            if client.peer is None or not client.peer.send_poses(poses):
                client.outbox.latest("poses", poses)

    def poses(self, t: float) -> bytes:
        """What is sent."""
        devices, placing = self._placed()
        return encode_rows_down(self._sequence, t, placing.rows(t, [_own_pose(device, t) for device in devices]))

    def _placed(self) -> tuple[list[Device], Placing]:
        """Who is shown; made anew when frames are told, or somebody's is another one."""
        frames, version = self._common.now, self._people.version
        if self._placing is None or self._placing[0] is not frames or self._placing[1] != version:
            devices = [device for device in self._people.devices.values() if self._common.told_of(device) is not None]
            shown = [
                Shown(device.index, frames.users[device.name], device.settings.up == "y", device.settings.static)
                for device in devices
            ]
            self._placing = frames, version, devices, Placing(shown)
        return self._placing[2:]


def _own_pose(device: Device, t: float) -> OwnPose | None:
    """Its newest; None of who has been away for long."""
    if device.left_at is not None and t - device.left_at > AWAY_AFTER:
        return None
    return AT_ITS_ORIGIN if device.settings.static else device.pose
