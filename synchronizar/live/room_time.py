"""A room's time: its own clock's, or a recording's; and devices' stamps by it."""

from __future__ import annotations

from collections.abc import Callable

from synchronizar.live import messages as m
from synchronizar.live.checks import check_stamp
from synchronizar.live.member import Client, Device
from synchronizar.live.messages import MessageError

FROM_THE_FUTURE = 0.5
"""s: a stamp further ahead of the room's clock is refused."""
TOO_OLD = 10.0
"""s: a pose or range that is older is refused."""
LONGEST_ROUND_TRIP = 60.0


class RoomTime:
    """What time it is in a room (s)."""

    def __init__(self, now: Callable[[], float]) -> None:
        """`now`: the room's clock."""
        self.now = now
        self.recorded: bool | None = None
        """Whether time is a recording's; None until a device comes."""
        self.begun: Callable[[bool], None] | None = None
        """Hears whether time is a recording's, when the first device comes."""
        self._recorded_t: float | None = None

    def __call__(self) -> float:
        """The clock's, or a recording's."""
        return self._recorded_t if self.recorded and self._recorded_t is not None else self.now()

    def begin(self, recorded: bool) -> None:
        """A device comes, the first one or a later one."""
        if self.recorded is None:
            self.recorded = recorded
            if self.begun is not None:
                self.begun(recorded)

    def go_on(self, t: float) -> None:
        """A recording has come to `t`. Raises MessageError where that is no later moment."""
        check_stamp(t)
        if self._recorded_t is not None and t < self._recorded_t:
            raise MessageError("time", "a recording's time goes forwards")
        self._recorded_t = t

    def of(self, device: Device, stamp: float, arrived: float) -> float:
        """A device's stamp by the room's clock. Raises MessageError where it may not be of then."""
        t = device.clock.hear(stamp, arrived)
        check_moment(device.name, t, arrived)
        return t

    def answer(self, client: Client, ping: m.Ping) -> None:
        """Tell what time it is, and take what is told of the devices' clocks."""
        check_stamp(ping.t)
        if ping.offset is not None:
            check_stamp(ping.offset)
        if ping.round_trip is not None and not 0.0 <= ping.round_trip < LONGEST_ROUND_TRIP:
            raise MessageError("value", "a round trip is a positive number of s")
        arrived = self.now()
        for device in client.devices:
            device.round_trip = ping.round_trip
            if client.recorded:
                continue
            if ping.offset is None:
                device.clock.asked(arrived)
            else:
                device.clock.offer(ping.offset, ping.round_trip)
            device.clock.hear(ping.t, arrived)
        client.outbox.put(m.encode(m.Pong(ping.t, arrived, bool(self.recorded))))


def need_recorded(client: Client) -> None:
    """Raises MessageError of who has no recorded time."""
    if not client.recorded:
        raise MessageError("time", "only a client that joined with recorded time says what time it is")


def check_moment(name: str, t: float, arrived: float) -> None:
    """Whether something of a device may be of then, by the room's clock; what is no number may not."""
    if not t <= arrived + FROM_THE_FUTURE:
        raise MessageError("future", f"{name}: a stamp {t - arrived:.1f} s ahead of the room's clock")
    if not t >= arrived - TOO_OLD:
        raise MessageError("old", f"{name}: a stamp {arrived - t:.1f} s behind the room's clock")
