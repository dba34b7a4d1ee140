"""What a module's datagram tells, as a room takes it."""

from __future__ import annotations

from typing import Any, NamedTuple

from synchronizar.data.ranges import SOURCES
from synchronizar.io.datagrams import MEASURED, SIGHT_UNKNOWN, UNKNOWN_POWER, UNKNOWN_SIGMA
from synchronizar.io.receiver import Stamped


class ModuleRange(NamedTuple):
    """A range between the devices with two modules."""

    t: float
    """s, room's clock."""
    reporter: int
    peer: int
    distance: float
    """m."""
    optional: dict[str, Any]
    """The other columns of ranges.csv, where they are known."""


def measured_ranges(stamped: Stamped) -> list[ModuleRange]:
    """Those that were measured; failed and doubtful ones are left out: others follow."""
    rows = stamped.datagram.ranges
    names = ("peer", "source", "status", "distance_mm", "sigma_mm", "rx_power_cdbm", "fp_power_cdbm", "sight")
    columns = (rows[name].tolist() for name in names)
    out = []
    for t, peer, source, status, mm, sigma, rx, fp, sight in zip(stamped.t.tolist(), *columns, strict=True):
        if status != MEASURED:
            continue
        optional: dict[str, Any] = {"source": SOURCES[source]}
        if sigma != UNKNOWN_SIGMA:
            optional["sigma"] = sigma / 1000.0
        if rx != UNKNOWN_POWER:
            optional["rx_power"] = rx / 100.0
        if fp != UNKNOWN_POWER:
            optional["fp_power"] = fp / 100.0
        if sight != SIGHT_UNKNOWN:
            optional["nlos"] = float(sight)
        out.append(ModuleRange(t, stamped.datagram.reporter, peer, mm / 1000.0, optional))
    return out
