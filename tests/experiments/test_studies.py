from __future__ import annotations

import argparse

import numpy as np
import pytest

pytest.importorskip("scipy", reason="the studies' statistics need scipy")
pytest.importorskip("statsmodels", reason="the studies' statistics need statsmodels")

from experiments.common.statistics import claim, corrected, one_way, pairs_told, two_way
from experiments.common.study import Interval, interval, options_of, results_of, rms
from experiments.paper.boxes import METHODS, Boxes, Task, beside_baseline, by_cell, errors, rows_of

BOXES = Boxes(side=1.6, low=1.2, high=1.8, apart=4.0)


def square(x: int) -> int:
    return x * x


# ---- two boxes ----


def test_errors_in_boxes_are_those_of_ranges_of_a_tenth_of_a_metre() -> None:
    """At 4 m, 100 ranges along one line leave 0.01 m along it, and across it about 0.1 m / (10 x 0.46 m / 4 m)."""
    found = errors(Task(BOXES, 100, 0, 20, 1))
    for method in METHODS:
        assert 0.03 < rms(found[method].place) < 0.2
        assert rms(found[method].yaw) < 0.08
        assert rms(found[method].z) < 0.3
        assert rms(found[method].origin) > rms(
            found[method].place
        )  # the origin is farther from where the partner walks
        assert len(found[method].seconds) == 20


def test_both_methods_see_the_same_samples_and_a_task_is_the_same_again() -> None:
    first, again = errors(Task(BOXES, 40, 3, 4, 1)), errors(Task(BOXES, 40, 3, 4, 1))
    for method in METHODS:
        np.testing.assert_array_equal(first[method].yaw, again[method].yaw)
    assert rms(first["pairwise"].yaw - first["rigid"].yaw) < 0.5 * rms(first["pairwise"].yaw)
    other = errors(Task(BOXES, 40, 4, 4, 1))
    assert not np.allclose(first["rigid"].yaw, other["rigid"].yaw)


def test_a_cell_is_the_root_mean_square_over_transforms_and_repeats() -> None:
    found = [errors(Task(BOXES, 40, repeat, 3, 1)) for repeat in range(2)]
    cells = by_cell(found, 2, "rigid", "z")
    assert cells.shape == (1, 2)
    assert cells[0, 1] == pytest.approx(np.sqrt((found[1]["rigid"].z ** 2).mean()))
    rows = rows_of([BOXES], found, 2)
    assert [row["method"] for row in rows] == list(METHODS)
    assert rows[1]["z"] == pytest.approx(
        np.sqrt(np.concatenate([f["rigid"].z for f in found]) @ np.concatenate([f["rigid"].z for f in found]) / 6.0)
    )
    assert beside_baseline(found, 2)[2].startswith("rigid / pairwise, z: ")


# ---- statistics ----


def test_a_one_way_analysis_is_the_ratio_of_variances_by_hand() -> None:
    """Groups 1 2 3 and 3 4 5: between 6, within 4 / 4, F = 6."""
    assert one_way(np.array([[1.0, 2.0, 3.0], [3.0, 4.0, 5.0]])).startswith("F = 6.00, p = 0.07")


def test_a_two_way_analysis_tells_which_factor_it_was() -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.1, (3, 4, 10))
    said = two_way(noise + np.arange(4.0)[None, :, None], "height", "width")
    width, height, both = said.split("; ")
    assert width.startswith("width F = ")
    assert float(width.rsplit("= ", 1)[1]) < 1e-6
    assert float(height.rsplit("= ", 1)[1]) > 0.01
    assert float(both.rsplit("= ", 1)[1]) > 0.01


def test_p_values_are_multiplied_by_how_many_pairs_there_are() -> None:
    from scipy.stats import ttest_ind

    groups = np.random.default_rng(1).normal(size=(4, 8)) + np.arange(4.0)[:, None]
    p = corrected(groups)
    assert len(p) == 6
    assert p[0, 3] == pytest.approx(6.0 * ttest_ind(groups[0], groups[3], equal_var=False).pvalue)
    assert "1.4 and 2.0 differ" in pairs_told(groups, (1.4, 1.6, 1.8, 2.0))


def test_a_claim_is_as_good_as_its_interval() -> None:
    assert claim("translation", Interval(0.3, 0.25, 0.35), 0.2, "m").endswith(": NOT reproduced")
    assert claim("translation", Interval(0.18, 0.15, 0.21), 0.2, "m").endswith(": undecided")
    assert claim("translation", Interval(0.1, 0.05, 0.15), 0.2, "m").endswith(": reproduced")


def test_cells_that_do_not_differ_are_seldom_told_to() -> None:
    """Repeats with places and noise of their own: p is below 0.05 in about one of 20 comparisons of equal cells."""
    found = [
        [by_cell([errors(Task(BOXES, 300, n, 1, seed)) for n in range(4)], 4, "pairwise", "yaw")[0] for seed in pair]
        for pair in np.arange(40).reshape(20, 2).tolist()
    ]
    assert sum(p < 0.05 for cells in found for p in corrected(np.log(np.array(cells))).values()) <= 4


def test_an_interval_holds_the_mean_as_often_as_it_says() -> None:
    random = np.random.default_rng(2)
    told = [interval(random.normal(size=40), lambda values: float(values.mean())) for _ in range(100)]
    assert 85 <= sum(t.low < 0.0 < t.high for t in told) <= 100


# ---- tasks ----


def test_results_are_in_the_order_of_the_tasks() -> None:
    options = options_of("", [])
    assert (options.full, options.seed, options.scheduler) == (False, 0, None)
    assert results_of(square, list(range(20)), options) == [n * n for n in range(20)]


def test_a_dask_cluster_gives_the_same_results() -> None:
    distributed = pytest.importorskip("distributed", reason="tasks on a cluster need dask[distributed]")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        options = argparse.Namespace(scheduler=cluster.scheduler_address)
        assert results_of(square, list(range(8)), options) == [n * n for n in range(8)]
