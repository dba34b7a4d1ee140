"""Frames of Nooploop LinkTrack modules as their serial port sends them (NLink): which hold ranges, and what they say.

A frame begins with 0x55 and its function mark; all numbers are little-endian. Those of a fixed length have it from the
mark, the others have theirs in the two bytes behind it. The last byte is the sum of all before it, but that of an
anchor frame, which is 0xee.

| mark | frame | ranges |
|---|---|---|
| 0x00 | AnchorFrame0 | of up to 30 tags to anchors 0 to 7, uint16 cm |
| 0x01 | TagFrame0 | of this tag to anchors 0 to 7, int24 mm |
| 0x04 | NodeFrame2 | of this node to those in reach, int24 mm, with powers in -0.5 dBm |
| 0x05, 0x08 | NodeFrame3, NodeFrame5 | the same |
| 0x07 | AoA NodeFrame0 | the same, with an angle |
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

HEADER = 0x55
_ANCHOR_FRAME, _TAG_FRAME = 0x00, 0x01
_FIXED = {_ANCHOR_FRAME: 896, _TAG_FRAME: 128}
"""Lengths of frames that do not say it."""
_WITHOUT_RANGES = (0x02, 0x03, 0x06, 0x09)
"""Frames of a length of their own that have none: they are passed over whole."""
_ANCHOR_TAIL = 0xEE
_ANCHOR_ROLE = 1
_ANCHORS = 8
_TAGS = 30
_NOBODY = 0xFF


class _Layout(NamedTuple):
    """Where things are in a frame of nodes."""

    fixed: int
    """Bytes before its nodes, of which the last is their number."""
    id_bytes: int
    system_time: int
    node: int
    """Bytes of a node: role, id, distance, ..."""
    powers: int
    """Of a node, where its two powers are."""


_LAYOUTS = {
    0x04: _Layout(fixed=119, id_bytes=1, system_time=6, node=13, powers=5),
    0x05: _Layout(fixed=21, id_bytes=1, system_time=10, node=7, powers=5),
    0x07: _Layout(fixed=21, id_bytes=1, system_time=10, node=11, powers=7),
    0x08: _Layout(fixed=24, id_bytes=4, system_time=13, node=10, powers=8),
}
MARKS = (*_FIXED, *_LAYOUTS, *_WITHOUT_RANGES)


class FrameRange(NamedTuple):
    """A range of a frame."""

    t: float
    """s: the network's time since its modules were switched on."""
    a: str
    b: str
    distance: float
    """m."""
    fp_power: float
    """dBm; NaN where the frame has none."""
    rx_power: float


class Frames:
    """What a stream of bytes holds, one frame after the other."""

    def __init__(self, data: bytes) -> None:
        self._data, self._sums = data, _sums(data)
        self.count = 0
        """Whole frames, so far."""
        self.skipped = 0
        """Bytes that belong to none."""

    def ranges(self) -> Iterator[tuple[int, list[FrameRange]]]:
        """The ranges of each frame that has some, and where it ends."""
        at = 0
        while at < len(self._data):
            size = _size(self._data, self._sums, at)
            if not size:
                # A byte that is lost or wrong ends a frame early: the next one begins wherever the next header is.
                begin = self._data.find(HEADER, at + 1)
                begin = len(self._data) if begin < 0 else begin
                self.skipped += begin - at
                at = begin
                continue
            self.count += 1
            found = _ranges(self._data[at : at + size])
            at += size
            if found:
                yield at, found


def begins_with_frames(head: bytes) -> bool:
    """Whether the first bytes of a file hold a whole frame."""
    begin, sums = head.find(HEADER), _sums(head)
    while begin >= 0:
        if _size(head, sums, begin):
            return True
        begin = head.find(HEADER, begin + 1)
    return False


def _sums(data: bytes) -> NDArray[np.uint8]:
    """(n + 1,) sums modulo 256 of the first bytes, of all of which a frame's is a difference.

    Adding up each frame anew would take hours where a file of a few MB has a header at every byte.
    """
    return np.concatenate([np.zeros(1, np.uint8), np.cumsum(np.frombuffer(data, np.uint8), dtype=np.uint8)])


def _size(data: bytes, sums: NDArray[np.uint8], at: int) -> int:
    """Bytes of the frame that begins here; 0 where none does."""
    if at + 4 > len(data) or data[at] != HEADER or data[at + 1] not in MARKS:
        return 0
    mark = data[at + 1]
    size = _FIXED.get(mark) or int.from_bytes(data[at + 2 : at + 4], "little")
    if size < 5 or at + size > len(data):
        return 0
    tail = _ANCHOR_TAIL if mark == _ANCHOR_FRAME else int(sums[at + size - 1]) - int(sums[at]) & 0xFF
    if data[at + size - 1] != tail:
        return 0
    layout = _LAYOUTS.get(mark)
    if layout is not None and (size <= layout.fixed or size != _with_nodes(layout, data[at + layout.fixed - 1])):
        return 0
    return size


def _with_nodes(layout: _Layout, nodes: int) -> int:
    return layout.fixed + nodes * layout.node + 1


def _ranges(frame: bytes) -> list[FrameRange]:
    mark = frame[1]
    if mark == _ANCHOR_FRAME:
        return _of_anchor_frame(frame)
    if mark == _TAG_FRAME:
        t = 1e-3 * _unsigned(frame, 112, 4)
        distances = [1e-3 * _signed(frame, 22 + 3 * k, 3) for k in range(_ANCHORS)]
        return _to_anchors(t, str(frame[2]), distances)
    layout = _LAYOUTS.get(mark)
    return [] if layout is None else _of_nodes(frame, layout)


def _of_nodes(frame: bytes, layout: _Layout) -> list[FrameRange]:
    me = _name(frame[4], _unsigned(frame, 5, layout.id_bytes))
    t = 1e-3 * _unsigned(frame, layout.system_time, 4)
    found = []
    for k in range(frame[layout.fixed - 1]):
        at = layout.fixed + k * layout.node
        other = _name(frame[at], _unsigned(frame, at + 1, layout.id_bytes))
        distance = 1e-3 * _signed(frame, at + 1 + layout.id_bytes, 3)
        fp, rx = (-0.5 * frame[at + layout.powers + n] for n in range(2))
        found.append(FrameRange(t, me, other, distance, fp, rx))
    return found


def _of_anchor_frame(frame: bytes) -> list[FrameRange]:
    t = 1e-3 * _unsigned(frame, 889, 4)
    found = []
    for k in range(_TAGS):
        at = 2 + 27 * k
        if frame[at] != _NOBODY:
            distances = [0.01 * _unsigned(frame, at + 11 + 2 * n, 2) for n in range(_ANCHORS)]
            found += _to_anchors(t, str(frame[at]), distances)
    return found


def _to_anchors(t: float, tag: str, distances: list[float]) -> list[FrameRange]:
    nan = float("nan")
    return [FrameRange(t, tag, _name(_ANCHOR_ROLE, k), distance, nan, nan) for k, distance in enumerate(distances)]


def _name(role: int, number: int) -> str:
    """Anchors count from 0 as the rest does."""
    return f"anchor{number}" if role == _ANCHOR_ROLE else str(number)


def _unsigned(frame: bytes, at: int, size: int) -> int:
    return int.from_bytes(frame[at : at + size], "little")


def _signed(frame: bytes, at: int, size: int) -> int:
    return int.from_bytes(frame[at : at + size], "little", signed=True)
