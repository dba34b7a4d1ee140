"""Datagrams between modules and whoever collects ranges: the table "On the network" in firmware/PROTOCOL.md."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import blake2s
from hmac import compare_digest
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from synchronizar.arrays import Mask
from synchronizar.data.ranges import SOURCES

MAGIC = b"SYNC"
VERSION = 1
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
"""One range; its fields are explained in PROTOCOL.md."""

# Magic, version, kind, count, reserved, session, address, reserved, sequence; then what is of each kind.
_BEGIN = "<4sBBBBIHHQ"
_RANGES = struct.Struct(_BEGIN + "QII")
_ORDER = struct.Struct(_BEGIN + "I")
_MAX_SIZE = _RANGES.size + MAX_RANGES * RANGE.itemsize + TAG_SIZE
_U32, _U64 = 2**32, 2**64


class WireError(ValueError):
    """A datagram that is refused, or cannot be said: the reason is one line."""


@dataclass(frozen=True)
class RangesDatagram:
    """What one module or phone tells: ranges that it measured, by one clock."""

    session: int
    reporter: int
    """Address of who measured."""
    sequence: int
    """Ever rising, over restarts too: those are counted in the upper 32 bits."""
    epoch: int
    """Which clock the times are of."""
    time_ns: int
    """By that clock; the ranges' offsets are after it."""
    dropped: int
    """How many ranges were dropped since the reporter's start because they got too old to be sent."""
    ranges: NDArray[np.void]
    """(n,) of RANGE; read-only where it was decoded."""


@dataclass(frozen=True)
class OrderDatagram:
    """What a collector tells one module."""

    session: int
    module: int
    """Its address."""
    sequence: int
    """Of the module's datagram that it answers; each can be answered once."""
    sleep_s: int
    """It is registered and may sleep so long; 0: it shall range on."""


def encode_ranges(datagram: RangesDatagram, key: bytes) -> bytes:
    """The bytes, sealed with the session's key. Raises WireError where a value is out of its bounds."""
    _check_numbers(
        (datagram.session, _U32), (datagram.sequence, _U64), (datagram.epoch, _U32), (datagram.dropped, _U32)
    )
    if datagram.ranges.dtype != RANGE or datagram.ranges.ndim != 1:
        raise WireError("the ranges are not an array of RANGE")
    _check_ranges(datagram)
    begin = _RANGES.pack(
        *(MAGIC, VERSION, RANGES, len(datagram.ranges), 0),
        *(datagram.session, datagram.reporter, 0, datagram.sequence),
        *(datagram.time_ns, datagram.epoch, datagram.dropped),
    )
    return _sealed(begin + datagram.ranges.tobytes(), key)


def decode_ranges(datagram: bytes, key: bytes) -> RangesDatagram:
    """What the bytes say. Raises WireError for whatever is not exactly such a datagram, or has another key's tag."""
    if not _RANGES.size + TAG_SIZE <= len(datagram) <= _MAX_SIZE:
        raise WireError("size")
    _check_tag(datagram, key)
    *begin, time_ns, epoch, dropped = _RANGES.unpack_from(datagram)
    count, session, reporter, sequence = _checked(begin, RANGES)
    if len(datagram) != _RANGES.size + count * RANGE.itemsize + TAG_SIZE:
        raise WireError("size")
    ranges = np.frombuffer(datagram, RANGE, count, _RANGES.size)
    said = RangesDatagram(session, reporter, sequence, epoch, time_ns, dropped, ranges)
    _check_ranges(said)
    return said


def encode_order(order: OrderDatagram, key: bytes) -> bytes:
    """The bytes, sealed with the session's key. Raises WireError where a value is out of its bounds."""
    _check_numbers((order.session, _U32), (order.sequence, _U64), (order.sleep_s, _U32))
    _check_address(order.module)
    begin = (MAGIC, VERSION, ORDER, 0, 0, order.session, order.module, 0, order.sequence)
    return _sealed(_ORDER.pack(*begin, order.sleep_s), key)


def decode_order(datagram: bytes, key: bytes) -> OrderDatagram:
    """What the bytes say. Raises WireError for whatever is not exactly such a datagram, or has another key's tag."""
    if len(datagram) != _ORDER.size + TAG_SIZE:
        raise WireError("size")
    _check_tag(datagram, key)
    *begin, sleep_s = _ORDER.unpack_from(datagram)
    count, session, module, sequence = _checked(begin, ORDER)
    if count:
        raise WireError("count")
    _check_address(module)
    return OrderDatagram(session, module, sequence, sleep_s)


class Window:
    """Which sequences of one sender have been taken: of the newest and the 63 before it."""

    def __init__(self) -> None:
        self._newest = -WINDOW
        self._taken = 0  # bit i: newest - i

    def take(self, sequence: int) -> bool:
        """True once for each sequence that is not too old; False for one that came before."""
        ahead = sequence - self._newest
        if ahead > 0:
            self._taken = (self._taken << min(ahead, WINDOW) | 1) & (_U64 - 1)
            self._newest = sequence
            return True
        bit = 1 << -ahead if -ahead < WINDOW else self._taken
        if not bit or self._taken & bit:
            return False
        self._taken |= bit
        return True


def _tag(said: bytes, key: bytes) -> bytes:
    if len(key) != KEY_SIZE:
        raise ValueError(f"a session's key has {KEY_SIZE} bytes")
    return blake2s(said, digest_size=TAG_SIZE, key=key).digest()


def _sealed(said: bytes, key: bytes) -> bytes:
    return said + _tag(said, key)


def _check_tag(datagram: bytes, key: bytes) -> None:
    if not compare_digest(_tag(datagram[:-TAG_SIZE], key), datagram[-TAG_SIZE:]):
        raise WireError("tag")


def _checked(begin: list[Any], expected_kind: int) -> tuple[int, int, int, int]:
    """Count, session, address and sequence of what both kinds begin with."""
    magic, version, kind, count, reserved_7, session, address, reserved_14, sequence = begin
    if magic != MAGIC:
        raise WireError("magic")
    if version != VERSION:
        raise WireError("version")
    if kind != expected_kind:
        raise WireError("kind")
    if reserved_7 or reserved_14:
        raise WireError("reserved")
    return count, session, address, sequence


def _check_ranges(said: RangesDatagram) -> None:
    """Raises WireError where a value is out of its bounds."""
    _check_address(said.reporter)
    if len(said.ranges) > MAX_RANGES:
        raise WireError("count")
    if not 0 <= said.time_ns <= MAX_TIME_NS:
        raise WireError("time")
    for reason, bad in _faults(said):
        if np.count_nonzero(bad):  # several times as fast as any() on so few
            raise WireError(reason)


def _faults(said: RangesDatagram) -> Iterator[tuple[str, Mask]]:
    """What may be wrong with a range, and with which it is."""
    ranges = said.ranges
    yield "reserved", ranges["reserved"] != 0
    yield "address", ranges["peer"] > LAST_ADDRESS
    yield "itself", ranges["peer"] == said.reporter
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
    """Of what is to be encoded: each number must be at least 0 and below its bound."""
    if any(not 0 <= number < bound for number, bound in numbers):
        raise WireError("number")
