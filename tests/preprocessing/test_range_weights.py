from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synchronizar.arrays import Array, Indices
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import RangeMeasurements
from synchronizar.preprocessing.range_weights import (
    measured_correlation,
    measured_range_weights,
    measured_sizes,
    neighbour_counts,
    prior_range_weights,
)

MODEL = Parameters().changed(
    ranges={
        "multipath_duration": 3.0,
        "multipath_neighbour_gap": 0.3,
        "multipath_correlation": 0.5,
        "multipath_weight": 20.0,
    }
)
HZ = 4.0  # ranges a second of a pair: each has its next neighbours alone within 0.3 s, and 24 others within 3 s
CROWD = 25


def samples_of_pairs(t: list[Array], sigma: float = 0.1) -> RangeMeasurements:
    """One pair of users for each of these times: (0, 1), (0, 2), ..."""
    j = np.repeat(np.arange(1, len(t) + 1), [len(each) for each in t]).astype(np.int32)
    n = len(j)
    zeros, points = np.zeros(n), np.zeros((n, 3))
    return RangeMeasurements(
        0 * j, j, np.concatenate(t), points, points, zeros, zeros + sigma, zeros, np.arange(n, dtype=np.int32)
    )


def one_pair(n: int, hz: float = HZ, sigma: float = 0.1) -> RangeMeasurements:
    return samples_of_pairs([np.arange(n) / hz], sigma)


def autoregressive(n: int, correlation: float, seed: int = 1) -> Array:
    """(n,) of variance 1, each correlated so with the one before."""
    random = np.random.default_rng(seed)
    out = random.normal(size=n)
    for k in range(1, n):
        out[k] = correlation * out[k - 1] + np.sqrt(1.0 - correlation**2) * out[k]
    return out


def found(measurements: RangeMeasurements, whitened: Array, judged: float = 0.1, weight: Array | None = None) -> Array:
    """The worth with one antenna at each end."""
    n = len(measurements)
    weight = np.ones(n) if weight is None else weight
    return worths(measurements, np.full(n, judged), whitened, weight, np.zeros(n, dtype=np.int32))


def worths(measurements: RangeMeasurements, judged: Array, whitened: Array, weight: Array, links: Indices) -> Array:
    """(n,) the worth with errors judged at 1 sigma `judged` (n,), between antennas `links` (n,)."""
    reach = MODEL.ranges.multipath_duration
    correlation = measured_correlation(measurements, whitened, weight, links, reach, MODEL)
    return measured_range_weights(measurements, measurements.sigma / judged, weight, correlation, MODEL)


def inside(column: Array) -> Array:
    """Those with as many neighbours as there can be."""
    return column[CROWD:-CROWD]


# ---- crowd, prior_range_weights ----


@settings(deadline=None)
@given(st.lists(st.lists(st.integers(0, 40), max_size=30), min_size=1, max_size=3))
def test_the_crowd_is_who_is_near_in_time_within_the_pair(halves: list[list[int]]) -> None:
    t = [np.sort(np.array(each, dtype=float)) * 0.5 for each in halves]
    measurements = samples_of_pairs(t)
    expected = [float((np.abs(each - at) <= 3.0).sum()) for each in t for at in each]
    np.testing.assert_array_equal(neighbour_counts(measurements, MODEL), expected)


def test_before_anything_is_known_errors_hang_together_as_the_model_says() -> None:
    measurements = one_pair(100)
    np.testing.assert_allclose(inside(prior_range_weights(measurements, MODEL)), 1.0 / (1.0 + 0.5 * 24.0))
    np.testing.assert_allclose(prior_range_weights(one_pair(10, hz=0.3), MODEL), 1.0)


# ---- worth ----


def test_ranges_whose_errors_are_noise_count_as_what_they_are() -> None:
    n = 100_000
    whitened = np.random.default_rng(1).normal(size=n)
    # The correlation is measured to 1 / sqrt(n), and 24 others count with it.
    spread = 24.0 / np.sqrt(n)
    one = found(one_pair(n), whitened)
    assert inside(one).min() > 1.0 / (1.0 + 4.0 * spread + 24.0 * 10.0 / n) * 0.98
    assert one.max() <= 1.0


def test_a_correlation_that_chance_alone_may_show_is_none() -> None:
    """Noise shows one of 1 / sqrt(n), which 24 neighbours would make much of."""
    least = [inside(found(one_pair(2000), np.random.default_rng(seed).normal(size=2000))).min() for seed in range(40)]
    # Beyond 1.5 standard deviations, for which one in fifteen is due to chance; 10 / 2000 is what the model adds.
    assert sum(each < 0.9 for each in least) <= 8
    assert min(least) > 1.0 / (1.0 + 24.0 * (10.0 / 2000 + 3.0 / np.sqrt(2000.0)))


@pytest.mark.parametrize("factor", [1.5, 3.0])
def test_errors_that_are_larger_than_judged_count_by_their_variance(factor: float) -> None:
    # So far apart that nobody has a neighbour.
    n = 20_000
    whitened = factor * np.random.default_rng(1).normal(size=n)
    np.testing.assert_allclose(found(one_pair(n, hz=0.3), whitened), factor**-2, rtol=0.05)


@pytest.mark.parametrize("factor", [0.25, 0.0])
def test_errors_are_never_taken_for_less_than_the_recording_says(factor: float) -> None:
    n = 2000
    whitened = factor * np.random.default_rng(1).normal(size=n)
    np.testing.assert_allclose(found(one_pair(n, hz=0.3, sigma=0.1), whitened, judged=0.2), 4.0)


def test_errors_between_what_is_said_and_what_is_judged_count_by_their_variance() -> None:
    n = 20_000
    whitened = 0.7 * np.random.default_rng(1).normal(size=n)
    np.testing.assert_allclose(found(one_pair(n, hz=0.3, sigma=0.1), whitened, judged=0.2), 0.7**-2, rtol=0.05)


@pytest.mark.parametrize("correlation", [0.3, 0.6, 0.9])
def test_errors_that_hang_together_count_as_often_as_is_known(correlation: float) -> None:
    whitened = autoregressive(40_000, correlation)
    expected = 1.0 / (1.0 + correlation * 24.0)
    np.testing.assert_allclose(inside(found(one_pair(40_000), whitened)), expected, rtol=0.1)


def test_an_error_that_stays_for_ever_leaves_a_little() -> None:
    """A correlation of 1 would leave a single range of each crowd; it is taken for 0.95 at most."""
    whitened = np.full(2000, 1.0)
    np.testing.assert_allclose(inside(found(one_pair(2000), whitened)), 1.0 / (1.0 + 0.95 * 24.0))


def test_errors_that_alternate_are_no_better_than_noise() -> None:
    whitened = np.tile([1.0, -1.0], 1000)
    np.testing.assert_allclose(inside(found(one_pair(2000), whitened)), 1.0)


def test_antennas_that_take_turns_are_compared_each_with_itself() -> None:
    """Each antenna's errors hang together, but those of one are the other's with the sign changed."""
    n = 20_000
    of_antenna = autoregressive(n, 0.6)
    whitened = np.column_stack([of_antenna, -of_antenna]).ravel()
    links = np.tile(np.array([7, 3], dtype=np.int32), n)
    measurements = one_pair(2 * n, hz=2.0 * HZ)
    of_links = worths(measurements, np.full(2 * n, 0.1), whitened, np.ones(2 * n), links)
    np.testing.assert_allclose(inside(inside(of_links)), 1.0 / (1.0 + 0.6 * 48.0), rtol=0.1)
    of_one = worths(measurements, np.full(2 * n, 0.1), whitened, np.ones(2 * n), np.zeros(2 * n, dtype=np.int32))
    assert of_one.mean() > 3.0 * of_links.mean()


def test_ranges_of_different_antennas_tell_nothing_of_one_another() -> None:
    """Each range is between two antennas of its own: what the model says stays, but for what chance may show."""
    measurements, links = one_pair(200), np.arange(200, dtype=np.int32)
    alone = worths(measurements, np.full(200, 0.1), np.ones(200), np.ones(200), links)
    np.testing.assert_allclose(inside(alone), 1.0 / (1.0 + 24.0 * (0.5 - 1.5**2 / 20.0 / 0.5)))


def test_few_ranges_are_judged_by_the_model() -> None:
    """Two ranges, an eighth of a second apart, by hand."""
    whitened = np.array([1.2, -0.5])
    variance = (1.2**2 + 0.5**2) / 2.0
    correlation = (20.0 * 0.5 - 1.2 * 0.5 / variance) / (20.0 + 1.0)
    correlation -= 1.5**2 / 21.0 / correlation  # by chance: 1.5 / sqrt(21)
    expected = 1.0 / (1.0 + correlation) / max(variance, 0.25)
    np.testing.assert_allclose(found(one_pair(2, hz=8.0), whitened, judged=0.2), expected)


def test_pairs_are_judged_by_their_own_errors_as_far_as_they_have_any() -> None:
    """Far apart in time; 150 ranges with errors of 3 sigma, 50 with errors of 1 sigma."""
    whitened = np.concatenate([np.full(150, 3.0), np.full(50, 1.0)])
    measurements = samples_of_pairs([10.0 * np.arange(150), 10.0 * np.arange(50)])
    of_all = (150 * 9.0 + 50 * 1.0) / 200
    expected = [(50 * of_all + 150 * 9.0) / 200, (50 * of_all + 50 * 1.0) / 100]
    np.testing.assert_allclose(1.0 / found(measurements, whitened), np.repeat(expected, [150, 50]))


def test_what_the_loss_gives_no_weight_tells_nothing() -> None:
    random = np.random.default_rng(3)
    whitened, late = random.normal(size=500), random.random(500) < 0.3
    weight = np.where(late, 0.0, 1.0)
    measurements = one_pair(500)
    far, further = (found(measurements, np.where(late, off, whitened), weight=weight) for off in (-20.0, 300.0))
    np.testing.assert_array_equal(far, further)


@settings(deadline=None)
@given(seed=st.integers(0, 10_000), n=st.integers(1, 60), judged=st.floats(0.1, 0.5))
def test_a_range_is_never_worth_more_than_the_recording_says(seed: int, n: int, judged: float) -> None:
    random = np.random.default_rng(seed)
    measurements = samples_of_pairs([np.sort(random.uniform(0.0, 20.0, n)) for _ in range(2)])
    links: Indices = random.integers(0, 3, 2 * n).astype(np.int32)
    whitened, weight = random.standard_cauchy(2 * n), random.random(2 * n)
    of_each = worths(measurements, np.full(2 * n, judged), whitened, weight, links)
    assert (of_each > 0.0).all()
    assert (of_each <= (judged / 0.1) ** 2 * (1.0 + 1e-12)).all()


def test_a_single_range_counts_once() -> None:
    np.testing.assert_allclose(found(one_pair(1), np.array([0.3])), [1.0])
    np.testing.assert_allclose(found(one_pair(1), np.array([2.0])), [0.25])


def test_without_ranges_nothing_counts() -> None:
    none = one_pair(0)
    assert found(none, np.zeros(0)).shape == (0,)
    assert prior_range_weights(none, MODEL).shape == (0,)


@pytest.mark.parametrize("late", [0.0, 0.2, 0.5])
def test_where_some_ranges_are_late_the_others_are_worth_less(late: float) -> None:
    n = 100_000
    measurements, noise = one_pair(n), np.random.default_rng(1).normal(size=n)
    weight = np.where(np.random.default_rng(2).random(n) < late, 0.0, 1.0)
    ratio = inside(found(measurements, noise, weight=weight)) / inside(found(measurements, noise))
    np.testing.assert_allclose(ratio, 1.0 / (1.0 + 4.0 * late * (1.0 - late)), rtol=0.05)


def test_pairs_are_late_by_their_own_ranges_as_far_as_they_have_any() -> None:
    t = np.arange(2000) / HZ
    measurements, noise = samples_of_pairs([t, t, t[:1]]), np.random.default_rng(1).normal(size=4001)
    weight = np.ones(4001)
    weight[:1000] = 0.0
    counts = found(measurements, noise, weight=weight) / found(measurements, noise)
    assert counts[1500] == pytest.approx(0.5, rel=0.1)
    assert counts[3000] > 0.9
    # One range of its own, all others' share: a quarter is late.
    assert counts[4000] == pytest.approx(1.0 / 1.75, rel=0.1)


def sizes_of(errors: list[Array], model: float = 0.2, nominal: float = 0.1) -> list[float]:
    """How large the errors (m) of each pair are measured to be, over the model's 1 sigma; all within 2 sigma count."""
    bounds = np.concatenate([[0], np.cumsum([len(e) for e in errors])]).astype(np.int32)
    whitened = np.concatenate(errors) / model
    weight = (np.abs(whitened) < 2.0).astype(float)
    sizes = measured_sizes(bounds, np.full(len(whitened), nominal / model), whitened, weight, Parameters())
    return sizes[bounds[:-1]].tolist()


def test_errors_that_are_smaller_than_the_models_are_measured() -> None:
    errors = np.random.default_rng(0).normal(0.0, 0.14, 5000)
    assert sizes_of([errors]) == pytest.approx([0.7], abs=0.02)


def test_sizes_lie_between_what_the_recording_says_and_the_model() -> None:
    random = np.random.default_rng(1)
    assert sizes_of([random.normal(0.0, 0.02, 500)]) == [0.5]
    assert sizes_of([random.uniform(0.3, 0.39, 500)]) == [1.0]


def test_sizes_of_few_errors_are_the_models() -> None:
    assert sizes_of([np.full(1, 0.1)])[0] > 0.9


def test_a_pair_without_errors_of_its_own_has_the_size_of_all() -> None:
    random = np.random.default_rng(2)
    many, one = sizes_of([random.normal(0.0, 0.14, 5000), np.full(1, 0.14)])
    assert one == pytest.approx(many, abs=0.01)


def test_what_the_loss_gives_no_weight_has_no_size() -> None:
    errors = np.random.default_rng(3).normal(0.0, 0.14, 5000)
    assert sizes_of([np.append(errors, np.full(2000, -3.0))]) == pytest.approx(sizes_of([errors]))
