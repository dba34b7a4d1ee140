from __future__ import annotations

import numpy as np
import pytest
from support.air_built import needs_air

from experiments.common.markdown import markdown
from experiments.modules.rates import change_row, circle, pair_times, rate_row, standing
from synchronizar.data.ranges import Ranges


def test_a_table_has_a_line_for_each_row_and_a_dash_for_what_is_not_there() -> None:
    rows = [{"scheme": "polling", "Hz": 8.25, "n": 2}, {"scheme": "all-pairs", "Hz": None, "n": 3}]
    assert markdown(rows, digits=1).splitlines() == [
        "| scheme | Hz | n |",
        "| --- | --- | --- |",
        "| polling | 8.2 | 2 |",
        "| all-pairs | - | 3 |",
    ]


def test_a_pair_s_times_are_found_whoever_reported() -> None:
    a, b = np.array([0, 1, 2], dtype=np.int32), np.array([1, 0, 0], dtype=np.int32)
    times = pair_times(Ranges.of(np.array([0.1, 0.2, 0.3]), a, b, np.ones(3)), 3)
    assert {pair: t.tolist() for pair, t in times.items()} == {(0, 1): [0.1, 0.2], (0, 2): [0.3], (1, 2): []}


@needs_air
def test_one_to_n_is_at_least_twenty_times_as_fast_as_the_paper_and_good_to_3_cm() -> None:
    row = rate_row(np.random.default_rng(1), "one-to-n", 2, 2.0)
    assert row["times the paper's"] > 20.0
    assert row["measured, Hz"] == pytest.approx(250.0, rel=0.05)
    assert abs(row["mean error, cm"]) < 1.0
    assert row["sd, cm"] < 3.0


@needs_air
def test_who_comes_is_ranged_soon_and_who_goes_stops_the_others_only_briefly() -> None:
    row = change_row(np.random.default_rng(2), "all-pairs", 2, 1)
    assert 0.0 < row["worst"] < 1.0
    assert row["the coordinator lost: the others silent for, s, worst"] < 1.0


@needs_air
def test_ranges_are_told_when_they_were_measured() -> None:
    scenario = standing(np.random.default_rng(3), "all-pairs", 1, 2.0)
    found = circle(scenario)
    assert 0.0 < (found.ranges.t - found.measured)[0] < 0.01
    assert found.measured.min() > max(module.on for module in scenario.modules)
    assert found.measured.max() < 2.0
