"""A robot's stamps by the bridge's clock: whatever clock its own computer has, or a simulation."""

from __future__ import annotations

from math import isfinite, nan

from synchronizar.live.device_clock import DeviceClock

BACK_S = 1.0
"""s: stamps that lie further back are of a bag or a simulation that begins again, not of messages out of order."""
BACK_POSES = 5
"""So many of them in a row: a single one is a mistake."""
SAME_CLOCK_S = 1.0
"""s: a range's stamp that lies further from the poses' is by another clock, and when it came counts."""


class RobotClock:
    """Of one robot: by its poses' stamps and when they came."""

    def __init__(self, simulated: bool) -> None:
        """`simulated`: stamps are the time, whatever the bridge's clock has."""
        self.newest = nan
        """s: its newest stamp; NaN before the first."""
        self._ahead = 0.0
        self._back = 0
        self._simulated = simulated
        self._clock = DeviceClock()

    def goes_back(self, stamp: float) -> bool:
        """Whether its time begins again with this stamp: what was known of its clock is forgotten then."""
        self._back = self._back + 1 if stamp < self.newest - BACK_S else 0
        if self._back < BACK_POSES:
            return False
        self._clock, self.newest, self._back = DeviceClock(), nan, 0
        return True

    def of_pose(self, stamp: float, arrived: float) -> float:
        """When a pose was by the bridge's clock, at which it `arrived` (s); its stamp is NaN where it has none.

        NaN where nobody knows: in a simulation, whose time nothing but stamps tells, and for stamps far astray.
        """
        if not isfinite(stamp):
            return nan if self._simulated else arrived
        if self._back:
            return nan
        t = stamp if self._simulated else self._clock.hear(stamp, arrived)
        if not self._simulated and t > arrived + BACK_S:
            return nan
        if not stamp <= self.newest:
            self.newest, self._ahead = stamp, stamp - arrived
        return t

    def of_range(self, stamp: float, arrived: float) -> float:
        """When a range was, by the same clock (s); NaN where that is a simulation's and not known yet."""
        if self._simulated and not isfinite(self.newest):
            return nan
        if not isfinite(stamp) or abs(stamp - arrived - self._ahead) > SAME_CLOCK_S:
            return arrived + self._ahead if self._simulated else arrived
        return stamp if self._simulated else self._clock.convert(stamp)

    def ros_time(self, now: float) -> float:
        """By the robot's own clock (s), `now` by the bridge's: no later than its newest stamp in a simulation."""
        return self.newest if self._simulated else now + self._ahead
