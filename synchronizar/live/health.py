"""How a room and its devices are: what arrives, what is refused, how far behind the solver is."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable

from synchronizar.live import messages as m
from synchronizar.live.common_frame import CommonFrame
from synchronizar.live.member import Device
from synchronizar.live.people import People
from synchronizar.live.sleeping import Sleeping


def status(
    t: float,
    people: People,
    sleeping: Sleeping,
    common: CommonFrame,
    refused: Iterable[Counter[str]],
    lag: m.Lag | None,
    trouble: str | None,
) -> m.Status:
    """At `t` (s, room's time). `refused`: by reason, of what is nobody's; `trouble`: of the solver."""
    users = {device.name: _health(device, t, sleeping) for device in people.devices.values()}
    pairs = [m.PairRange(r.a, r.b, r.distance, r.residual, r.used, max(0.0, t - r.t)) for r in common.ranges]
    behind = float(max(0.0, t - max(common.known_at, t - 3600.0)))
    return m.Status(t, users, pairs, dict(sum(refused, Counter())), behind, lag, trouble)


def _health(device: Device, t: float, sleeping: Sleeping) -> m.Health:
    return m.Health(
        _rate(device.poses, t),
        _rate(device.ranges, t),
        None if device.round_trip is None else 500.0 * device.round_trip,
        sleeping.is_asleep(t, device.name),
        dict(device.refused),
    )


def _rate(stamps: deque[float], t: float) -> float:
    """A second: how many came within the last one; more than the window holds are counted by the window's length."""
    recent = [stamp for stamp in stamps if t - 1.0 <= stamp]
    if len(recent) < len(stamps) or len(stamps) < (stamps.maxlen or 0):
        return float(len(recent))
    span = max(stamps) - min(stamps)
    return len(stamps) / span if span > 0.0 else float(len(recent))
