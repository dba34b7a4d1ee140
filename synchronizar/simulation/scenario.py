"""Scenarios of the simulated air, written as text: firmware/targets/host/SCENARIO.md."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from synchronizar.arrays import Array, Indices
from synchronizar.io.datagrams import RoomKeys

MOST_MODULES = 11
"""Modules in one network: FRAME_MEMBERS of firmware/core/frame.h."""
CHANNEL, PRF_MHZ = 5, 64
ROOM_C = 23.0


@dataclass(frozen=True)
class Module:
    """One module: its crystals, when it is on, its positions and its antenna delay."""

    ppm: float
    """Relative rate error of its radio's crystal; positive is fast."""
    board_ppm: float
    """The same of its board's crystal."""
    on: float
    """s: when it is switched on."""
    t: Array
    """(n,) s, at least 0."""
    position: Array
    """(n, 3) m: positions of its antenna at these times."""
    off: float = float("inf")
    """s: when it is switched off."""
    range_bias: float = 0.0
    """m: bias of its ranges from a wrong antenna delay."""


@dataclass(frozen=True)
class Blocked:
    """n NLOS spans as columns (n,); those of the same two modules do not overlap."""

    a: Indices
    """Address of one module."""
    b: Indices
    """Address of the other."""
    begin: Array
    """s."""
    end: Array
    """s."""
    extra: Array
    """m: extra length of the signals."""


@dataclass(frozen=True)
class Scenario:
    """Modules in the simulated air, addressed by their index in `modules`; they range all the time."""

    seconds: float
    scheme: str
    """Which module sends when: `one-to-n`, `all-pairs` or `polling`."""
    seed: int
    """Seed of all randomness in the air."""
    session: int
    key: bytes
    """The room's, from which each module has its own."""
    stamp_sigma: float
    """m: 1 sigma of each stamp's noise."""
    frame_loss: float
    """Share of frames that a receiver misses, 0 to 1."""
    modules: Sequence[Module]
    blocked: Blocked | None = None

    def keys(self) -> RoomKeys:
        """Keys of the modules."""
        return RoomKeys(self.session, self.key)

    def text(self) -> str:
        """The text that synchronizar-air reads."""
        return "".join(f"{line}\n" for line in self._lines())

    def _lines(self) -> Iterator[str]:
        yield "air 1"
        yield f"seed {self.seed}"
        yield f"seconds {self.seconds}"
        yield f"scheme {self.scheme}"
        yield f"session {self.session}"
        yield f"channel {CHANNEL}"
        yield f"prf {PRF_MHZ}"
        yield "range_s 0"
        yield "sleep_s 0"
        yield f"stamp_sigma {self.stamp_sigma}"
        yield f"frame_loss {self.frame_loss}"
        keys = self.keys()
        for address, module in enumerate(self.modules):
            yield (
                f"node {address} ppm {module.ppm} board_ppm {module.board_ppm} on {module.on} off {module.off} "
                f"antenna_delay_error {module.range_bias} temperature {ROOM_C}"
            )
            yield f"key {address} {keys.of(address).hex()}"
            for t, (x, y, z) in zip(module.t.tolist(), module.position.tolist(), strict=True):
                yield f"at {address} {t} {x} {y} {z}"
        if self.blocked is not None:
            of = self.blocked
            columns = (column.tolist() for column in (of.a, of.b, of.begin, of.end, of.extra))
            for a, b, begin, end, extra in zip(*columns, strict=True):
                yield f"late {a} {b} {begin} {end} {extra}"
