"""Encodes and decodes datagrams between modules and collectors: the table "On the network" in firmware/PROTOCOL.md."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from hashlib import blake2s
from hmac import compare_digest
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from synchronizar.arrays import Mask
from synchronizar.data.ranges import SOURCES

MAGIC = b"SYNC"
VERSION = 2
"""What is written: the tag is of the reporter's own key."""
ROOM_KEY_VERSION = 1
"""The version before, with the same layout: its tag is of the room's key, which all members then have."""
RANGES, ORDER = 1, 2
MEASURED, DOUBTFUL, FAILED = 0, 1, 2
CLEAR, BLOCKED, SIGHT_UNKNOWN = 0, 1, 255

KEY_SIZE, TAG_SIZE = 32, 16
MAX_RANGES = 32
LAST_ADDRESS = 0xFFFD
MAX_DISTANCE_MM = 10_000_000
MAX_OFFSET_US = 10_000_000
MAX_TIME_NS = 1 << 62
WINDOW = 64
MOST_DERIVED = 256
"""Keys that are kept, of those that were derived."""

UNKNOWN_SIGMA = 2**16 - 1
UNKNOWN_POWER = -(2**15)
UNKNOWN_CLOCK = -(2**31)

RANGE: Final = np.dtype(
    [
        ("peer", "<u2"),
        ("source", "u1"),
        ("status", "u1"),
        ("distance_mm", "<i4"),
        ("offset_us", "<i4"),
        ("clock_ppb", "<i4"),
        ("sigma_mm", "<u2"),
        ("rx_power_cdbm", "<i2"),
        ("fp_power_cdbm", "<i2"),
        ("sight", "u1"),
        ("reserved", "u1"),
    ]
)
"""One range; PROTOCOL.md explains its fields."""

# Magic, version, kind, count, reserved, session, address, reserved, sequence; then the fields of each kind.
_HEADER = "<4sBBBBIHHQ"
_RANGES = struct.Struct(_HEADER + "QII")
_ORDER = struct.Struct(_HEADER + "I")
_MAX_SIZE = _RANGES.size + MAX_RANGES * RANGE.itemsize + TAG_SIZE
_U32, _U64 = 2**32, 2**64


class WireError(ValueError):
    """A datagram that is refused or cannot be encoded; the message is the reason, one line."""


@dataclass(frozen=True)
class RangesDatagram:
    """Ranges that one module or phone measured, stamped by one clock."""

    session: int
    reporter: int
    """Address of the device that measured."""
    sequence: int
    """Rises from datagram to datagram, also over restarts, which its upper 32 bits count."""
    epoch: int
    """Identifies the clock of `time_ns`."""
    time_ns: int
    """ns by that clock; each range's offset is added to it."""
    dropped: int
    """Ranges that were too old to be sent and dropped, since the reporter's start."""
    ranges: NDArray[np.void]
    """(n,) of RANGE; read-only where decoded."""


@dataclass(frozen=True)
class OrderDatagram:
    """An order from a collector to one module."""

    session: int
    module: int
    """Its address."""
    sequence: int
    """Sequence of the module's datagram that it answers; each can be answered once."""
    sleep_s: int
    """s that the module, now registered, may sleep; 0: it goes on ranging."""


class Sender(NamedTuple):
    """Who a datagram says that it is from: read before its tag is checked, to find the key and for nothing else."""

    version: int
    session: int
    address: int


KeyOf = Callable[[Sender], bytes]
"""The key of a sender's tag. Raises WireError where it has none, with the reason as message."""


def reporter_key(key: bytes, session: int, address: int) -> bytes:
    """The key of one reporter, from the room's: whoever has it can speak for that address and for nobody else."""
    _check_key(key)
    data = b"synchronizar reporter" + session.to_bytes(4, "little") + address.to_bytes(2, "little")
    return blake2s(data, digest_size=KEY_SIZE, key=key).digest()


class RoomKeys:
    """Keys of all reporters of one session, derived from the room's key. Version 1 is refused unless allowed."""

    def __init__(self, session: int, key: bytes, allow_version_1: bool = False) -> None:
        _check_key(key)
        self._session, self._key, self._allow_version_1 = session, key, allow_version_1
        self._derived: dict[int, bytes] = {}

    def of(self, address: int) -> bytes:
        """The key that the reporter with this address is given at provisioning."""
        _check_address(address)
        if address not in self._derived:
            if len(self._derived) >= MOST_DERIVED:
                self._derived.clear()  # whoever sends rubbish names any address
            self._derived[address] = reporter_key(self._key, self._session, address)
        return self._derived[address]

    def __call__(self, sender: Sender) -> bytes:
        """The key of a sender's tag. Raises WireError for other versions, sessions, and what is no address."""
        if sender.session != self._session:
            raise WireError("session")
        if sender.version == VERSION:
            return self.of(sender.address)
        if sender.version == ROOM_KEY_VERSION and self._allow_version_1:
            return self._key
        raise WireError("version")


def session_of(datagram: bytes) -> int | None:
    """The session that bytes say they are of, before anything is checked; None where they are too short to say."""
    return int.from_bytes(datagram[8:12], "little") if len(datagram) >= _ORDER.size else None


def encode_ranges(datagram: RangesDatagram, key: bytes) -> bytes:
    """Bytes of the datagram with the tag of the reporter's key. Raises WireError where a value is out of its bounds."""
    _check_numbers(
        (datagram.session, _U32), (datagram.sequence, _U64), (datagram.epoch, _U32), (datagram.dropped, _U32)
    )
    if datagram.ranges.dtype != RANGE or datagram.ranges.ndim != 1:
        raise WireError("the ranges are not an array of RANGE")
    _check_ranges(datagram)
    body = _RANGES.pack(
        *(MAGIC, VERSION, RANGES, len(datagram.ranges), 0),
        *(datagram.session, datagram.reporter, 0, datagram.sequence),
        *(datagram.time_ns, datagram.epoch, datagram.dropped),
    )
    return _tagged(body + datagram.ranges.tobytes(), key)


def decode_ranges(datagram: bytes, key_of: KeyOf) -> RangesDatagram:
    """The datagram in the bytes. Raises WireError for other bytes, a sender without a key, or another key's tag."""
    if not _RANGES.size + TAG_SIZE <= len(datagram) <= _MAX_SIZE:
        raise WireError("size")
    *header, time_ns, epoch, dropped = _RANGES.unpack_from(datagram)
    _check_magic(datagram)
    _, version, *_, session, reporter, _, _ = header
    _check_tag(datagram, key_of(Sender(version, session, reporter)))
    count, session, reporter, sequence = _checked(header, RANGES, (VERSION, ROOM_KEY_VERSION))
    if len(datagram) != _RANGES.size + count * RANGE.itemsize + TAG_SIZE:
        raise WireError("size")
    ranges = np.frombuffer(datagram, RANGE, count, _RANGES.size)
    decoded = RangesDatagram(session, reporter, sequence, epoch, time_ns, dropped, ranges)
    _check_ranges(decoded)
    return decoded


def encode_order(order: OrderDatagram, key: bytes) -> bytes:
    """Bytes of the datagram with the tag of the module's key. Raises WireError where a value is out of its bounds."""
    _check_numbers((order.session, _U32), (order.sequence, _U64), (order.sleep_s, _U32))
    _check_address(order.module)
    header = (MAGIC, VERSION, ORDER, 0, 0, order.session, order.module, 0, order.sequence)
    return _tagged(_ORDER.pack(*header, order.sleep_s), key)


def decode_order(datagram: bytes, key: bytes) -> OrderDatagram:
    """The order in the bytes. Raises WireError for other bytes, or the tag of another key."""
    if len(datagram) != _ORDER.size + TAG_SIZE:
        raise WireError("size")
    _check_tag(datagram, key)
    _check_magic(datagram)
    *header, sleep_s = _ORDER.unpack_from(datagram)
    count, session, module, sequence = _checked(header, ORDER, (VERSION,))
    if count:
        raise WireError("count")
    _check_address(module)
    return OrderDatagram(session, module, sequence, sleep_s)


class Window:
    """Replay protection: which of one sender's newest sequence and the 63 before it were taken."""

    def __init__(self, newest: int = -WINDOW) -> None:
        """`newest`: all up to it were taken."""
        self.newest = newest
        self._taken = _U64 - 1 if newest >= 0 else 0  # bit i: newest - i

    def take(self, sequence: int) -> bool:
        """Take a sequence: True once for each that is not too old, False for one that was taken before."""
        ahead = sequence - self.newest
        if ahead > 0:
            self._taken = (self._taken << min(ahead, WINDOW) | 1) & (_U64 - 1)
            self.newest = sequence
            return True
        bit = 1 << -ahead if -ahead < WINDOW else self._taken
        if not bit or self._taken & bit:
            return False
        self._taken |= bit
        return True


def _tag(body: bytes, key: bytes) -> bytes:
    """Message authentication code of TAG_SIZE bytes: keyed BLAKE2s."""
    _check_key(key)
    return blake2s(body, digest_size=TAG_SIZE, key=key).digest()


def _check_key(key: bytes) -> None:
    if len(key) != KEY_SIZE:
        raise ValueError(f"a key has {KEY_SIZE} bytes")


def _tagged(body: bytes, key: bytes) -> bytes:
    return body + _tag(body, key)


def _check_tag(datagram: bytes, key: bytes) -> None:
    if not compare_digest(_tag(datagram[:-TAG_SIZE], key), datagram[-TAG_SIZE:]):
        raise WireError("tag")


def _check_magic(datagram: bytes) -> None:
    if not datagram.startswith(MAGIC):
        raise WireError("magic")


def _checked(header: list[Any], expected_kind: int, versions: tuple[int, ...]) -> tuple[int, int, int, int]:
    """Count, session, address and sequence from the header that both kinds have."""
    _, version, kind, count, reserved_7, session, address, reserved_14, sequence = header
    if version not in versions:
        raise WireError("version")
    if kind != expected_kind:
        raise WireError("kind")
    if reserved_7 or reserved_14:
        raise WireError("reserved")
    return count, session, address, sequence


def _check_ranges(datagram: RangesDatagram) -> None:
    """Raises WireError where a value is out of its bounds."""
    _check_address(datagram.reporter)
    if len(datagram.ranges) > MAX_RANGES:
        raise WireError("count")
    if not 0 <= datagram.time_ns <= MAX_TIME_NS:
        raise WireError("time")
    for reason, bad in _faults(datagram):
        if np.count_nonzero(bad):  # several times faster than any() on so few
            raise WireError(reason)


def _faults(datagram: RangesDatagram) -> Iterator[tuple[str, Mask]]:
    """Each possible fault of a range, and which of the n ranges have it (n,)."""
    ranges = datagram.ranges
    yield "reserved", ranges["reserved"] != 0
    yield "address", ranges["peer"] > LAST_ADDRESS
    yield "itself", ranges["peer"] == datagram.reporter
    yield "source", ranges["source"] >= len(SOURCES)
    yield "status", ranges["status"] > FAILED
    yield "distance", _beyond(ranges["distance_mm"], MAX_DISTANCE_MM)
    yield "offset", _beyond(ranges["offset_us"], MAX_OFFSET_US)
    yield "sigma", ranges["sigma_mm"] == 0
    yield "sight", (ranges["sight"] > BLOCKED) & (ranges["sight"] < SIGHT_UNKNOWN)


def _beyond(column: NDArray[np.int32], most: int) -> Mask:
    return (column > most) | (column < -most)  # the absolute value of the least int32 is itself


def _check_address(address: int) -> None:
    if not 0 <= address <= LAST_ADDRESS:
        raise WireError("address")


def _check_numbers(*numbers: tuple[int, int]) -> None:
    """Raises WireError where a number is below 0 or not below its bound."""
    if any(not 0 <= number < bound for number, bound in numbers):
        raise WireError("number")
