"""Poses and ranges as they come: checked, brought to the room's clock, and given on in their order."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from synchronizar.live import messages as m
from synchronizar.live.budget import MEASURED_A_SECOND, Budget
from synchronizar.live.checks import alike, check_distance, check_range
from synchronizar.live.given import Given
from synchronizar.live.member import Client, Device
from synchronizar.live.messages import MessageError
from synchronizar.live.people import People
from synchronizar.live.pose_wire import PoseUp, decode_poses_up
from synchronizar.live.recorder import recorded_name
from synchronizar.live.room_time import RoomTime

MOST_HELD = 512
"""Poses of a device, and ranges of a room, that wait until a device's clock is known."""
RESETS_A_SECOND, RESETS_AT_ONCE = 0.2, 20.0
"""Of one device: each new frame is a new user of the recording and of the solver."""
_OPTIONAL = ("sigma", "antenna_a", "antenna_b", "rx_power", "fp_power", "nlos", "source")


class Measuring:
    """What one room's devices measure."""

    def __init__(self, people: People, time: RoomTime, given: Given, ranged: Callable[[float, str, str], None]) -> None:
        """`ranged` hears when two devices ranged, and which."""
        self._people, self._time, self._given, self._ranged = people, time, given, ranged
        self._held_ranges: list[tuple[float, str, str, float, dict[str, Any]]] = []

    def hear_poses(self, client: Client, data: bytes) -> None:
        """Poses that a client sends."""
        people = self._people
        try:
            poses = decode_poses_up(data)
        except MessageError as error:
            return people.refuse(client, error)
        arrived = self._time.now()
        if not client.recorded and not client.allowance.measured(arrived, len(poses)):
            return people.refuse(client, _too_many())
        for pose in poses:
            try:
                if pose.user >= len(client.devices):
                    raise MessageError("user", f"this connection speaks for {len(client.devices)} devices")
                self._take_pose(client, client.devices[pose.user], pose, arrived)
            except MessageError as error:
                people.refuse(client, error)
        return None

    def hear_ranges(self, client: Client, message: m.Ranges) -> None:
        """Ranges that a client sends. Raises MessageError where all of them are refused."""
        if len(message.ranges) > m.MOST_RANGES:
            raise MessageError("size", f"a message has at most {m.MOST_RANGES} ranges")
        arrived = self._time.now()
        if not client.recorded and not client.allowance.measured(arrived, len(message.ranges)):
            raise _too_many()
        for measured in message.ranges:
            try:
                self._take_measured(client, measured, arrived)
            except MessageError as error:
                self._people.refuse(client, error)

    def reset(self, client: Client, message: m.Reset, sessions: Mapping[str, int]) -> None:
        """A device's SLAM began anew. `sessions`: how often anybody's did, as `Joining` has it."""
        device, frame = self._people.moving(client, message.user), message.frame % 256
        if frame == device.frame:
            raise MessageError("frame", "a new frame has another number than the one before")
        device.resets = device.resets or Budget(RESETS_A_SECOND, self._time.now(), RESETS_AT_ONCE)
        if not device.resets.take(self._time.now()):
            raise MessageError("rate", "too many new frames within a minute: wait")
        device.frame, device.pose = frame, None
        device.session += 1
        while alike(recorded_name(device.name, device.session)) in sessions:
            device.session += 1
        self._given.new_frame(device)
        self._people.tell_members()

    def take_range(self, t: float, a: str, b: str, distance: float, optional: dict[str, Any]) -> None:
        """A range that was checked, at `t` by the room's clock."""
        if self._waits(a, b) and len(self._held_ranges) < MOST_HELD:
            self._held_ranges.append((t, a, b, distance, optional))
        else:
            self._give_range(t, a, b, distance, optional)

    def give_held(self, t: float) -> None:
        """What waited for clocks that are known now."""
        for device in self._people.devices.values():
            if device.held and device.clock.is_known(t):
                self._give_held(device)
        if self._held_ranges:
            held, self._held_ranges = self._held_ranges, []
            for measured in held:
                self.take_range(*measured)

    def _take_pose(self, client: Client, device: Device, pose: PoseUp, arrived: float) -> None:
        if device.settings.static:
            raise MessageError("static", f"{device.name} stands still: it has no poses")
        if pose.frame != device.frame:
            raise MessageError("frame", f"a pose of frame {pose.frame}; {device.name} is in frame {device.frame}")
        t = pose.t if client.recorded else self._time.of(device, pose.t, arrived)
        if not client.recorded and not device.clock.is_known(arrived) and len(device.held) < MOST_HELD:
            device.held.append(pose)
            return
        self._give_held(device)
        self._give_pose(device, pose, t)

    def _give_held(self, device: Device) -> None:
        held, device.held = device.held, []
        for pose in held:
            if pose.frame == device.frame:
                self._give_pose(device, pose, device.clock.convert(pose.t))

    def _give_pose(self, device: Device, pose: PoseUp, t: float) -> None:
        if device.pose is None or t >= device.pose[0]:
            device.pose = t, pose.position, pose.quat_xyzw
        device.poses.append(t)
        self._given.pose(device, t, pose.position, pose.quat_xyzw)

    def _take_measured(self, client: Client, measured: m.MeasuredRange, arrived: float) -> None:
        devices = self._people.devices
        reporter = next((device for device in client.devices if device.name in (measured.a, measured.b)), None)
        if reporter is None:
            raise MessageError("user", "a client reports the ranges of its own devices only")
        if measured.a == measured.b:
            raise MessageError("value", f"{measured.a}: a range to itself")
        for name in (measured.a, measured.b):
            if name not in devices:
                raise MessageError("user", f"there is nobody called {name[: m.LONGEST_NAME]!r} in the room")
        check_range(measured, (devices[measured.a].settings.antennas, devices[measured.b].settings.antennas))
        if not client.recorded:  # a recording has what it has, and the solver judges it as `register` does
            check_distance(measured.distance)
        t = measured.t if client.recorded else self._time.of(reporter, measured.t, arrived)
        optional = {name: value for name in _OPTIONAL if (value := getattr(measured, name)) is not None}
        if "nlos" in optional:
            optional["nlos"] = float(optional["nlos"])
        self.take_range(t, measured.a, measured.b, measured.distance, optional)

    def _waits(self, a: str, b: str) -> bool:
        """Whether poses of either are held: a range is given after them."""
        return bool(self._people.devices[a].held or self._people.devices[b].held)

    def _give_range(self, t: float, a: str, b: str, distance: float, optional: dict[str, Any]) -> None:
        ends = self._people.devices[a], self._people.devices[b]
        for device in ends:
            device.ranges.append(t)
        self._ranged(t, a, b)
        self._given.range(t, *ends, distance, optional)


def _too_many() -> MessageError:
    return MessageError("rate", f"more than {MEASURED_A_SECOND} poses and ranges of a device a second: say less")
