from __future__ import annotations

from synchronizar.live.loop_lag import LoopLag
from synchronizar.live.messages import Lag


def test_lag_is_told_of_the_last_minute() -> None:
    lag = LoopLag()
    assert lag.told() == Lag(0.0, 0.0)
    for n in range(12_000):
        lag.note(1.0 if n < 6000 else 0.030 if n % 50 == 0 else 0.002)
    assert lag.told() == Lag(2.0, 30.0)
