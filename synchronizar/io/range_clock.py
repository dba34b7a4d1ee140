"""One range clock, fitted to all datagrams: stamps of all networks' clocks converted to the receiver's clock.

Every network of modules has its own clock, and starts a new one (another epoch) when its coordinator restarts or two
networks merge. A datagram arrives later than its newest range was measured, and the delay has a lower bound. So the
receiver's time is a straight line over an epoch's time: of all lines with no datagram below them the one with the least
sum of delays (Moon, Skelly, Towsley: Estimation and removal of clock skew from network delay measurements, INFOCOM
1999). A line has no jumps, and its slope is the skew of the two crystals. `live_clock` does the same as datagrams come.

Two errors remain: the least delay itself, some milliseconds, constant within an epoch, which the solver's clock offsets
absorb; and changes of the skew, 0.5 ms where it changes by 1 ppm within an hour.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from synchronizar.arrays import Array

MAX_SKEW = 1e-4
"""Two clocks do not drift apart faster: a UWB radio's is off by 20 ppm (IEEE 802.15.4), a computer's by 80 at most."""
_THIRDS = 60
"""Steps of the ternary search for the skew, each of which removes a third of the bracket: to 1e-14."""


class Below(NamedTuple):
    """A line below all of some points, with the least sum of heights above it."""

    skew: float
    """Its slope."""
    height: float
    """Its value at x = 0."""


class _Line(NamedTuple):
    """Receiver's time (s) as a line over an epoch's: `offset` s at `base_ns`, rising by (1 + skew) s a second."""

    base_ns: int
    offset: float
    skew: float

    def seconds(self, time_ns: NDArray[np.int64]) -> Array:
        """(n,) s by the receiver's clock, of times (n,) ns by the epoch's."""
        since = 1e-9 * (time_ns - self.base_ns).astype(float)
        return since + self.skew * since + self.offset


class RangeClock:
    """Converts times of every epoch to the receiver's clock.

    Fitted to n datagrams: the epoch (n,) of each, the time (n,) of its newest range by that epoch's clock (ns), and its
    arrival (n,) by the receiver's clock (s).
    """

    def __init__(self, epoch: NDArray[np.uint32], newest_ns: NDArray[np.int64], arrived: Array) -> None:
        self._lines = {
            of: _line_below(newest_ns[epoch == of], arrived[epoch == of]) for of in np.unique(epoch).tolist()
        }

    def seconds(self, epoch: NDArray[np.uint32], time_ns: NDArray[np.int64]) -> Array:
        """(n,) s by the receiver's clock, of times (n,) ns in epochs (n,) that the datagrams were of."""
        seconds = np.empty(len(epoch))
        for of in np.unique(epoch).tolist():
            seconds[epoch == of] = self._lines[of].seconds(time_ns[epoch == of])
        return seconds


def _line_below(time_ns: NDArray[np.int64], arrived: Array) -> _Line:
    """The line below all (n,) arrivals with the least sum of delays."""
    base_ns = int(time_ns[0]) + round(float(np.mean(time_ns - time_ns[0])))
    x = 1e-9 * (time_ns - base_ns).astype(float)
    line = line_below(x, arrived - x)
    return _Line(base_ns, line.height, line.skew)


def line_below(x: Array, y: Array) -> Below:
    """The line below all (n,) points with the least sum of y above it, its slope within MAX_SKEW."""
    middle = float(x.mean())
    x = x - middle

    def height(skew: float) -> float:
        """Height, at the mean x, of the highest line of that skew below all points; concave in skew."""
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
    return Below(skew, height(skew) - skew * middle)
