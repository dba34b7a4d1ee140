"""Whose place is doubted: it was corrected by more than what had been told of it allows.

Who was told to be sure and was not may not be sure now: their modules range again, whoever slept, until they have been
undoubted for a while.
"""

from __future__ import annotations

from collections.abc import Container

import numpy as np

from synchronizar.arrays import Array
from synchronizar.geometry import YawFrame
from synchronizar.live.member import Device
from synchronizar.live.messages import UserFrame
from synchronizar.live.smoothing import DriftAlarm, Placing


class Doubts:
    """Looks at everybody's frame, as it is told, by the rule that pages go by."""

    def __init__(self) -> None:
        self._alarms: dict[str, tuple[int, DriftAlarm]] = {}

    def look(self, t: float, device: Device, told: UserFrame) -> bool:
        """Whether what is told of a device's frame at `t` (s) contradicts what was told before."""
        frame, alarm = self._alarms.get(device.name, (told.frame, None))
        if alarm is None or frame != told.frame:
            alarm = DriftAlarm()
            self._alarms[device.name] = told.frame, alarm
        placing, covariance = _placing(told), _covariance(told)
        if told.state != "registered" or placing is None or covariance is None:
            alarm.forget()
            return False
        at = YawFrame(up_b=device.settings.up) @ ((0.0, 0.0, 0.0) if device.pose is None else device.pose[1])
        return alarm.solved(t, placing, covariance, at) is not None

    def keep(self, names: Container[str]) -> None:
        """All others have left."""
        self._alarms = {name: known for name, known in self._alarms.items() if name in names}


def _placing(told: UserFrame) -> Placing | None:
    if told.x is None or told.y is None or told.z is None or told.yaw is None:
        return None
    return Placing(told.x, told.y, told.z, told.yaw, told.scale)


def _covariance(told: UserFrame) -> Array | None:
    """Where all of it is known."""
    if told.covariance is None or any(value is None for row in told.covariance for value in row):
        return None
    return np.array(told.covariance, dtype=float)
