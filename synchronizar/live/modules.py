"""Devices' modules: whose is at which address, what their datagrams tell, and their orders to sleep or range on."""

from __future__ import annotations

from collections import Counter
from hashlib import blake2s
from typing import Any

from synchronizar.io.datagrams import OrderDatagram, RangesDatagram, RoomKeys, encode_order
from synchronizar.io.receiver import Receiver
from synchronizar.live import messages as m
from synchronizar.live.budget import MEASURED_A_SECOND, Budget
from synchronizar.live.checks import check_distance
from synchronizar.live.measuring import Measuring
from synchronizar.live.member import Client
from synchronizar.live.messages import MessageError
from synchronizar.live.module_ranges import ModuleRange, measured_ranges
from synchronizar.live.people import People
from synchronizar.live.room_time import RoomTime, check_moment
from synchronizar.live.roster import Roster
from synchronizar.live.sleeping import Sleeping

MOST_ADDRESSES_OF_ONE = 8
"""Addresses that one device's module may have had."""
_LAST_ADDRESS = 0xFFFD


class Modules:
    """All modules of one room."""

    def __init__(
        self,
        key: bytes,
        allow_version_1: bool,
        people: People,
        time: RoomTime,
        measuring: Measuring,
        sleeping: Sleeping,
    ) -> None:
        """`key`: the room's, from which modules' keys are derived."""
        self.session = int.from_bytes(blake2s(key, digest_size=4, person=b"session").digest(), "little")
        """The number that the room's datagrams carry."""
        self.keys = RoomKeys(self.session, key, allow_version_1)
        self.receiver = Receiver(self.keys)
        self.users: dict[int, str] = {}
        """Whose module has which address."""
        self.given: dict[int, str] = {}
        """Whose module ever had which: its key is known there, and so the address is nobody else's any more."""
        self.refused: Counter[str] = Counter()
        self._people, self._time, self._measuring, self._sleeping = people, time, measuring, sleeping
        self._budgets: dict[int, Budget] = {}

    def restore(self, roster: Roster) -> None:
        """As they were; what they have told already is not heard again."""
        self.users, self.given = dict(roster.modules), roster.modules | roster.given
        self.receiver.go_on(roster.sequences)

    def take(self, client: Client, message: m.Module, udp_port: int | None) -> None:
        """A device's module has an address: tell it its key."""
        device = self._people.own(client, message.user)
        if not 0 <= message.address <= _LAST_ADDRESS:
            raise MessageError("address", f"a module's address is 0 to {_LAST_ADDRESS}")
        owner = self.given.get(message.address)
        if owner not in (None, device.name):
            raise MessageError("address", f"address {message.address} is the module of {owner}: give it another one")
        if owner is None and sum(name == device.name for name in self.given.values()) >= MOST_ADDRESSES_OF_ONE:
            raise MessageError("address", f"{device.name} has had {MOST_ADDRESSES_OF_ONE} addresses: use one of them")
        self.users = {a: name for a, name in self.users.items() if name != device.name}
        self.users[message.address] = self.given[message.address] = device.name
        self._people.version += 1
        key = self.keys.of(message.address).hex()
        client.outbox.put(m.encode(m.ModuleKey(device.name, message.address, self.session, key, udp_port)))

    def hear(self, data: bytes, arrived: float) -> RangesDatagram | None:
        """A datagram that arrived at `arrived` (s, room's clock); None where it is refused."""
        if self._time.recorded:
            self.refused["time"] += 1  # modules range now, and the room is at a recording's time
            return None
        taken = self.receiver.take(data, arrived)
        if taken is None:
            return None
        if not self._budget_of(taken.datagram.reporter).take(arrived, 1 + len(taken.datagram.ranges)):
            self.refused["rate"] += 1
            return None
        for stamped in taken.stamped:
            for measured in measured_ranges(stamped):
                try:
                    self._take_range(measured, arrived)
                except MessageError as error:
                    self.refused[error.reason] += 1
        return taken.datagram

    def orders_for(self, heard: RangesDatagram, now: float) -> list[bytes]:
        """What a module is told in answer to a datagram."""
        user = self.users.get(heard.reporter)
        sleep_s = None if user is None else self._sleeping.answer(now, user)
        if sleep_s is None:
            return []
        order = OrderDatagram(self.session, heard.reporter, heard.sequence, sleep_s)
        return [encode_order(order, self.keys.of(heard.reporter))]

    def _take_range(self, measured: ModuleRange, arrived: float) -> None:
        a, b = self.users.get(measured.reporter), self.users.get(measured.peer)
        if a is None or b is None:
            raise MessageError("peer", "nobody's module has that address")
        check_moment(a, measured.t, arrived)
        check_distance(measured.distance)
        self._measuring.take_range(measured.t, a, b, measured.distance, self._with_antennas(a, b, measured.optional))

    def _budget_of(self, reporter: int) -> Budget:
        """How much a module may still tell; it has shown that it is that module."""
        if reporter not in self._budgets:
            self._budgets[reporter] = Budget(MEASURED_A_SECOND, self._time.now())
        return self._budgets[reporter]

    def _with_antennas(self, a: str, b: str, optional: dict[str, Any]) -> dict[str, Any]:
        """A module is the first antenna that its device declares."""
        for end, name in (("antenna_a", a), ("antenna_b", b)):
            if antennas := self._people.devices[name].settings.antennas:
                optional[end] = next(iter(antennas))
        return optional
