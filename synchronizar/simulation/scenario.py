"""What the simulated air is told, as text: firmware/targets/host/SCENARIO.md."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from synchronizar.arrays import Array, Indices

MOST_MODULES = 11
"""In one network: FRAME_MEMBERS of firmware/core/frame.h."""
CHANNEL, PRF_MHZ = 5, 64
ROOM_C = 23.0


@dataclass(frozen=True)
class Module:
    """One module: its clocks, its power, its antenna."""

    ppm: float
    """By how much its radio's crystal is fast."""
    board_ppm: float
    """By how much its board's is."""
    on: float
    """s: when power comes."""
    t: Array
    """(n,) s, not below 0."""
    position: Array
    """(n, 3) m: where its antenna is then."""
    off: float = float("inf")
    """s: when power goes."""
    range_bias: float = 0.0
    """m: by how much its antenna delay, which is off, makes its ranges too long."""


@dataclass(frozen=True)
class Blocked:
    """Spans in which there is no line of sight, (n,) each; those of the same two modules do not overlap."""

    a: Indices
    """Address of the one module."""
    b: Indices
    begin: Array
    """s."""
    end: Array
    extra: Array
    """m: by how much signals come later."""


@dataclass(frozen=True)
class Scenario:
    """Modules in the simulated air, their addresses being their places in the list; they range all the time."""

    seconds: float
    scheme: str
    """Who sends when: `one-to-n`, `all-pairs` or `polling`."""
    seed: int
    """Of all that is random in the air."""
    session: int
    key: bytes
    stamp_sigma: float
    """m, 1 sigma: noise of each stamp."""
    frame_loss: float
    """0 to 1: share of frames that a receiver misses."""
    modules: Sequence[Module]
    blocked: Blocked | None = None

    def text(self) -> str:
        """The file that synchronizar-air reads."""
        return "".join(f"{line}\n" for line in self._lines())

    def _lines(self) -> Iterator[str]:
        yield "air 1"
        yield f"seed {self.seed}"
        yield f"seconds {self.seconds}"
        yield f"scheme {self.scheme}"
        yield f"session {self.session}"
        yield f"key {self.key.hex()}"
        yield f"channel {CHANNEL}"
        yield f"prf {PRF_MHZ}"
        yield "range_s 0"
        yield "sleep_s 0"
        yield f"stamp_sigma {self.stamp_sigma}"
        yield f"frame_loss {self.frame_loss}"
        for address, module in enumerate(self.modules):
            yield (
                f"node {address} ppm {module.ppm} board_ppm {module.board_ppm} on {module.on} off {module.off} "
                f"antenna_delay_error {module.range_bias} temperature {ROOM_C}"
            )
            for t, (x, y, z) in zip(module.t.tolist(), module.position.tolist(), strict=True):
                yield f"at {address} {t} {x} {y} {z}"
        if self.blocked is not None:
            of = self.blocked
            columns = (column.tolist() for column in (of.a, of.b, of.begin, of.end, of.extra))
            for a, b, begin, end, extra in zip(*columns, strict=True):
                yield f"late {a} {b} {begin} {end} {extra}"
