"""A recording told to an engine as it would have come."""

from __future__ import annotations

import numpy as np

from synchronizar.data.in_time import in_time
from synchronizar.data.recording import Recording
from synchronizar.estimation.incremental.engine import Engine

TICK = 0.1  # s


def feed(engine: Engine, recording: Recording, begin: float = -np.inf, end: float = np.inf) -> list[tuple[float, str]]:
    """What came in a stretch of time, a look each tenth of a second; when what was told."""
    r, events = recording.ranges, []
    tick: float | None = None
    for t, user, row in in_time(recording):
        if not begin <= t < end:
            continue
        tick = t if tick is None else tick
        while t >= tick + TICK:
            tick += TICK
            events += [(tick, event) for event in engine.advance(tick)]
        if user < 0:
            antennas = {"antenna_a": float(r.antenna_a[row]), "antenna_b": float(r.antenna_b[row])}
            engine.add_range(t, int(r.a[row]), int(r.b[row]), float(r.distance[row]), **antennas)
        else:
            track = recording.tracks[recording.users[user].name]
            engine.add_pose(user, t, track.position[row].tolist(), track.quat_xyzw[row].tolist())
    return events
