from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synchronizar.estimation.incremental.contradictions import Contradicted, Contradictions
from synchronizar.estimation.incremental.innovations import Innovations
from synchronizar.parameters import Parameters

PARAMETERS = Parameters()
NOW = 100.0
EVERYBODY = frozenset(range(6))
SIGMA = 0.1  # m
PLACES = np.column_stack(
    [[0.0, 4.0, 1.0, 5.0, 2.0, 3.0], [0.0, 0.0, 5.0, 4.0, 2.0, 6.0], [0.0, 0.1, 0.0, 0.2, 0.1, 0.0]]
)
SHORT, LONG, FITS = 6.0, -9.0, 0.2
"""Whitened: too short, too long by far, and as expected."""


def innovations(rows: list[tuple[float, int, int, float]]) -> Innovations:
    """Of rows t, i, j, whitened."""
    t, i, j, whitened = (np.array(column) for column in zip(*rows, strict=True))
    away = PLACES[i] - PLACES[j]
    distance = np.linalg.norm(away, axis=1) - SIGMA * whitened
    sigma, nlos_odds, weight = np.full(len(t), SIGMA), np.full(len(t), 0.25), np.ones(len(t))
    return Innovations(np.column_stack([t, i, j, whitened, away, distance, sigma, nlos_odds, weight]))


def told(rows: list[tuple[float, int, int, float]], gauge: int = 0) -> Contradicted | None:
    contradictions = Contradictions(PARAMETERS)
    contradictions.add(innovations(rows), NOW)
    return contradictions.found(NOW, gauge, EVERYBODY)


def between(
    pairs: dict[tuple[int, int], float], each: int = 8, seconds: float = 0.9
) -> list[tuple[float, int, int, float]]:
    """So many ranges of each pair in the last so many seconds, all off by the same."""
    return [(NOW - seconds * n / each, i, j, off) for n in range(each) for (i, j), off in pairs.items()]


def test_nobody_is_contradicted_by_nothing_and_by_ranges_that_fit() -> None:
    assert Contradictions(PARAMETERS).found(NOW, 0, EVERYBODY) is None
    assert told(between({(0, 1): FITS, (0, 2): FITS, (1, 2): FITS})) is None


@pytest.mark.parametrize("gauge", [0, 1])
def test_who_is_nearer_to_the_others_than_it_seems_is_blamed(gauge: int) -> None:
    found = told(between({(0, 1): FITS, (0, 2): SHORT, (1, 2): SHORT}), gauge)
    assert found is not None
    assert found[0] == [2]


def test_of_two_who_range_to_each_other_alone_it_is_not_the_gauge() -> None:
    for gauge in (0, 1):
        found = told(between({(0, 1): SHORT}, each=12), gauge)
        assert found is not None
        assert found[0] == [1 - gauge]


def test_a_gauge_that_fits_nobody_while_the_others_fit_one_another_is_wrong_itself() -> None:
    found = told(between({(0, 1): SHORT, (0, 2): SHORT, (0, 3): SHORT, (1, 2): FITS, (1, 3): FITS, (2, 3): FITS}))
    assert found is not None
    assert found[0] == [0]


def test_a_group_that_moved_together_is_blamed_together() -> None:
    found = told(between({(0, 1): FITS, (2, 3): FITS, (0, 2): SHORT, (0, 3): SHORT, (1, 2): SHORT, (1, 3): SHORT}))
    assert found is not None
    assert sorted(found[0]) == [2, 3]


def test_ranges_that_are_too_long_for_a_moment_are_a_body_in_between() -> None:
    now = between({(0, 1): LONG, (0, 2): LONG, (1, 2): FITS})
    fitted = between({(0, 1): FITS, (0, 2): FITS, (1, 2): FITS}, each=24, seconds=3.0)
    assert told([(t - 1.0, i, j, off) for t, i, j, off in fitted] + now) is None


def test_next_to_nothing_but_misfits_for_longer_are_no_body() -> None:
    found = told(between({(0, 1): FITS, (0, 2): LONG, (1, 2): LONG}, each=30, seconds=2.9))
    assert found is not None
    assert found[0] == [2]


@pytest.mark.parametrize(
    ("velocity", "lifted"), [((0.0, 0.0, 0.5), True), ((0.0, 0.0, -0.5), True), ((0.3, 0.4, 0.0), False)]
)
def test_who_goes_up_or_down_is_told_from_who_slides(velocity: tuple[float, float, float], lifted: bool) -> None:
    """For 4 s, 0.5 m in each."""
    rows = []
    for n in range(40):
        t = NOW - 4.0 + 0.1 * n
        for i, j in ((0, 2), (1, 2), (2, 3), (0, 1), (0, 3), (1, 3)):
            off = np.array(velocity) * 0.1 * n * ((i == 2) - float(j == 2))
            away = PLACES[i] - PLACES[j]
            rows.append((t, i, j, float(np.linalg.norm(away) - np.linalg.norm(away + off)) / SIGMA))
    found = told(rows)
    assert found is not None
    assert found.users == [2]
    assert found.lifted is lifted


def test_a_lift_is_told_as_such_before_it_has_gone_far() -> None:
    """Half a metre in 4 s, among people so near that a few hundred ranges show it."""
    rows = []
    for n in range(300):
        for other in (0, 1, 2, 3):
            away = PLACES[other] - PLACES[4]
            off = np.array([0.0, 0.0, -0.5 * n / 300])
            rows.append(
                (
                    NOW - 4.0 * (1.0 - n / 300),
                    other,
                    4,
                    float(np.linalg.norm(away) - np.linalg.norm(away + off)) / SIGMA,
                )
            )
    found = told(rows)
    assert found is not None
    assert (found.users, found.lifted) == ([4], True)


def test_who_fits_the_gauge_by_a_chain_is_with_it_and_those_who_fit_one_another_alone_are_not() -> None:
    contradictions = Contradictions(PARAMETERS)
    pairs = {(0, 1): FITS, (1, 2): FITS, (0, 3): SHORT, (1, 4): LONG, (3, 4): FITS}
    contradictions.add(innovations(between(pairs)), NOW)
    since, nobody = NOW - 1.0, frozenset[int]()
    assert [contradictions.is_with(u, since, 0, nobody) for u in range(6)] == [True, True, True, False, False, False]
    assert [contradictions.is_with(u, since, 0, frozenset({4, 5})) for u in (2, 3, 4)] == [False, True, True]
    assert not contradictions.is_with(1, NOW, 0, nobody)


def test_a_few_ranges_tell_nothing() -> None:
    few = PARAMETERS.integrity.innovation_fewest - 1
    assert told(between({(0, 1): SHORT}, each=few)) is None


def test_what_is_long_past_or_forgotten_tells_nothing() -> None:
    contradictions = Contradictions(PARAMETERS)
    contradictions.add(innovations(between({(0, 1): FITS, (0, 2): SHORT, (1, 2): SHORT})), NOW)
    assert contradictions.found(NOW + 11.0, 0, EVERYBODY) is None
    contradictions.forget(2)
    assert contradictions.found(NOW, 0, EVERYBODY) is None
    assert set(contradictions.recent.users[:, 1].tolist()) == {1}
    contradictions.add(innovations([(NOW + 60.0, 0, 1, FITS)]), NOW + 60.0)
    assert len(contradictions.recent.t) == 1


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), users=st.integers(2, 6), each=st.integers(1, 12))
def test_noise_of_the_size_that_is_expected_alarms_nobody(seed: int, users: int, each: int) -> None:
    random = np.random.default_rng(seed)
    pairs = [(i, j) for i in range(users) for j in range(i + 1, users)]
    rows = [(NOW - random.uniform(0.0, 10.0), i, j, random.normal()) for i, j in pairs for _ in range(each)]
    assert told(rows) is None


def test_how_often_chance_alarms_is_what_a_binomial_says() -> None:
    """Two who range 20 times a second, of which the tolerated share is too short: three sigmas."""
    m, random = PARAMETERS.integrity, np.random.default_rng(0)
    count, runs = 20, 4000
    limit = m.innovation_short_share + 3.0 * np.sqrt(
        m.innovation_short_share * (1.0 - m.innovation_short_share) / count
    )
    alarms = 0
    for _ in range(runs):
        short = random.uniform(size=count) < m.innovation_short_share
        rows = [(NOW - 0.04 * n, 0, 1, SHORT if s else FITS) for n, s in enumerate(short.tolist())]
        found = told(rows)
        assert (found is not None) == bool(short.mean() > limit)
        alarms += found is not None
    assert alarms / runs < 0.01
