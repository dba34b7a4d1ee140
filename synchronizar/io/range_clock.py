"""One range clock out of the clocks that datagrams tell times by.

Every network of modules has a clock of its own, and begins a new one (another epoch) when its coordinator restarts or
two networks merge. All are brought to the clock of whoever received the datagrams: what comes in is later than what was
measured, by a delay that is never below some least one. So each epoch's clock is compared with the receiver's by the
straight line that no datagram lies below and that is highest amid them: of all such lines the one with the least sum of
delays (Moon, Skelly, Towsley: Estimation and removal of clock skew from network delay measurements, INFOCOM 1999). A
line has no jump, and follows crystals that are off.

What is left: the least delay itself, some milliseconds that are the same in all of an epoch and that a solver's clock
offsets take up; and a skew that changes, by 1 ppm over an hour 0.5 ms.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from synchronizar.arrays import Array

MAX_SKEW = 1e-4
"""Two clocks do not drift apart faster: a UWB radio's is off by 20 ppm (IEEE 802.15.4), a computer's by 80 at most."""
_THIRDS = 60
"""How often the bracket around the skew loses a third of itself: to 1e-14."""


class _Line(NamedTuple):
    """The receiver's clock is at `offset` s, and goes (1 + skew) s a second, when the epoch's is at `base_ns`."""

    base_ns: int
    offset: float
    skew: float

    def seconds(self, time_ns: NDArray[np.int64]) -> Array:
        """(n,) s by the receiver's clock."""
        since = 1e-9 * (time_ns - self.base_ns).astype(float)
        return since + self.skew * since + self.offset


class RangeClock:
    """The receiver's clock, seen from every epoch.

    Made of (n,) datagrams: the epoch of each, the time of its newest range by that epoch's clock (ns), and when it came
    in by the receiver's (s).
    """

    def __init__(self, epoch: NDArray[np.uint32], newest_ns: NDArray[np.int64], arrived: Array) -> None:
        self._lines = {
            of: _line_below(newest_ns[epoch == of], arrived[epoch == of]) for of in np.unique(epoch).tolist()
        }

    def seconds(self, epoch: NDArray[np.uint32], time_ns: NDArray[np.int64]) -> Array:
        """(n,) s by the receiver's clock of times in any epoch that the datagrams were of."""
        seconds = np.empty(len(epoch))
        for of in np.unique(epoch).tolist():
            seconds[epoch == of] = self._lines[of].seconds(time_ns[epoch == of])
        return seconds


def _line_below(time_ns: NDArray[np.int64], arrived: Array) -> _Line:
    base_ns = int(time_ns[0]) + round(float(np.mean(time_ns - time_ns[0])))
    x = 1e-9 * (time_ns - base_ns).astype(float)
    y = arrived - x

    def height(skew: float) -> float:
        """Of the highest line with that skew, amid the datagrams: concave in skew."""
        return float((y - skew * x).min())

    least, most = -MAX_SKEW, MAX_SKEW
    for _ in range(_THIRDS):
        third = (most - least) / 3.0
        below, above = height(least + third), height(most - third)
        if below <= above:
            least += third
        if above <= below:
            most -= third
    skew = 0.5 * (least + most)
    return _Line(base_ns, height(skew), skew)
