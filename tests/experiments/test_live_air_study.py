from __future__ import annotations

import numpy as np
import pytest
from support.datagrams import some_ranges

from experiments.live import air
from synchronizar.io.datagrams import RangesDatagram
from synchronizar.io.receiver import Stamped


def test_the_table_tells_what_was_put_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ranges 2 cm too long, stamped 5 ms after the measurement, that came in after 30 ms."""
    arrived, measured = [], {}
    for k in range(100):
        at = 0.1 * k
        true = float(np.linalg.norm(air.place(3, 1, at) - air.place(3, 2, at)))
        said = RangesDatagram(3, 1, k, 5, 0, 0, some_ranges([2], [round(1000 * (true + 0.02))]))
        arrived.append(air.Arrived(Stamped(said, np.array([at + 0.005])), at + 0.03))
        measured[1, k] = at
    monkeypatch.setattr(air, "run", lambda *_: air.Run(arrived, measured, 1.0, 0.5, 100, 0))
    told = air.row(2, 10.0, 3)
    assert told["ranges a second"] == 10
    assert told["came in after, ms: median, p95"] == "30, 30"
    assert told["stamped after, ms"] == "5.0 +- 0.00"
    assert told["error, cm"] == "+2.0 +- 0.0"
    assert told["air, cores"] == "0.100"
    assert told["us a datagram"] == 5000


def test_people_stay_in_the_room_and_walk_at_their_pace() -> None:
    t = np.linspace(0.0, 100.0, 10_001)
    for module in range(11):
        x, y, z = air.place(0, module, t)
        assert np.abs(x).max() <= 3.0
        assert np.abs(y).max() <= 2.0
        assert 1.0 <= z.min() <= z.max() <= 1.6
        assert np.hypot(np.diff(x), np.diff(y)).max() / 0.01 < 1.5
