from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synchronizar.preprocessing.running_quantile import RunningQuantile


@given(
    seed=st.integers(0, 1000),
    count=st.integers(20, 2000),
    share=st.floats(0.1, 0.95),
    scale=st.floats(1e-4, 1e3),
)
def test_a_quantile_of_all_that_came_is_right_to_four_per_cent(
    seed: int, count: int, share: float, scale: float
) -> None:
    values = scale * np.random.default_rng(seed).lognormal(size=count)
    quantiles = RunningQuantile()
    for part in np.array_split(values, 7):
        quantiles.add(part)
    low, high = (float(np.quantile(values, share, method=way)) for way in ("lower", "higher"))
    assert low / 1.04 <= quantiles.quantile(share) <= high * 1.04
    assert quantiles.count == count


def test_zeros_and_nothing_have_quantile_zero() -> None:
    quantiles = RunningQuantile()
    assert quantiles.quantile(0.5) == 0.0
    quantiles.add(np.zeros(10))
    assert quantiles.quantile(0.95) == 0.0
    quantiles.add(np.full(100, 0.05))
    assert quantiles.quantile(0.95) == pytest.approx(0.05, rel=0.04)
