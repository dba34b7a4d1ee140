from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("scipy", reason="the pairwise method and the tests need scipy")
pytest.importorskip("matplotlib", reason="experiments draw figures")

from experiments.common.methods import METHODS
from experiments.common.study import Interval
from experiments.paper.pointing import (
    AIM_SIGMA,
    PARTNER,
    SAMPLES,
    USER,
    Trial,
    aimed,
    angle_between,
    nearest,
    reproduced,
    seen_from_true,
    spheres,
    table,
    trial,
    walk_of,
)
from synchronizar.estimation.pairwise.register import register_pairwise
from synchronizar.geometry import YawFrame


@pytest.fixture(scope="module")
def trials() -> list[Trial]:
    return [trial((7, k)) for k in range(6)]


def test_angles_are_those_of_a_triangle() -> None:
    a = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    b = np.array([[0.0, 3.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [1.0, 0.0, 1e-9]])
    assert_allclose(angle_between(a, b), [np.pi / 2.0, np.pi / 4.0, np.pi, 1e-9])


def test_an_aim_is_off_to_the_side_and_up_by_as_much_as_is_said() -> None:
    direction = np.array([[2.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    to_the_side, up = aimed(direction, np.array([[0.1, 0.0], [0.0, 0.1]]))
    assert_allclose(to_the_side, [1.0, np.tan(0.1), 0.0], atol=1e-15)
    assert_allclose(up, [1.0, 0.0, np.tan(0.1)], atol=1e-15)


def test_a_target_of_a_degree_and_a_half_is_hit_by_96_of_100_aims_to_the_side() -> None:
    error = AIM_SIGMA * np.random.default_rng(0).standard_normal((20_000, 2))
    pointing = aimed(np.tile([0.0, 2.0, 0.0], (len(error), 1)), error)
    aside = np.degrees(np.arctan2(pointing[:, 0], pointing[:, 1]))
    # A share of 96 % of 20000 has 1 sigma of 0.14 %.
    assert np.mean(np.abs(aside) < 0.75) == pytest.approx(0.96, abs=0.006)


def test_the_nearest_sphere_is_nearest_in_angle_and_not_in_metres() -> None:
    candidates = np.array([[10.0, 1.0, 0.0], [1.0, 0.5, 0.0]])
    assert nearest(np.array([[1.0, 0.2, 0.0], [10.0, 4.0, 0.0]]), candidates).tolist() == [0, 1]


def test_spheres_are_nine_degrees_apart_or_more() -> None:
    true = spheres() - np.array([-2.0, 0.0, 1.4])
    apart = np.degrees(angle_between(true[:, None], true[None]))[~np.eye(8, dtype=bool)]
    assert apart.min() == pytest.approx(9.0, abs=0.1)


def test_a_true_registration_shows_everything_where_it_is() -> None:
    walk = walk_of(1)
    registration = register_pairwise(walk.recording)
    true = walk.world_from_user[PARTNER].inverse() @ walk.world_from_user[USER]
    users = {**registration.users, USER: replace(registration.users[USER], common_from_user=true)}
    seen = seen_from_true(walk, replace(registration, users=users))
    assert_allclose(seen.matrix, np.eye(4), atol=1e-9)
    # Told to be 0.2 m higher than it is, the user's device shows everything 0.2 m too low.
    wrong = YawFrame(z=0.2) @ true
    users[USER] = replace(registration.users[USER], common_from_user=wrong)
    seen = seen_from_true(walk, replace(registration, users=users))
    assert_allclose(seen @ np.array([1.0, 2.0, 3.0]), [1.0, 2.0, 2.8], atol=1e-9)


def test_a_registration_has_the_papers_hundred_samples() -> None:
    assert len(walk_of(3).recording.ranges) == SAMPLES


def test_a_trial_is_the_same_for_the_same_seed(trials: list[Trial]) -> None:
    again = trial((7, 0))
    assert_allclose(again.angle, trials[0].angle)
    assert again.angle.shape == again.wrong.shape == (len(METHODS), 2, 4)
    assert not np.allclose(trials[1].angle, trials[0].angle)


def test_our_pointings_hit_and_human_aim_adds_little(trials: list[Trial]) -> None:
    angle = np.array([t.angle for t in trials])
    ours = angle[:, list(METHODS).index("rigid")]
    assert np.median(ours) < 5.0
    assert_allclose(ours[:, 0], ours[:, 1], atol=np.degrees(5.0 * AIM_SIGMA))
    assert np.any(ours[:, 0] != ours[:, 1])


def test_the_table_tells_the_mean_of_the_angles(trials: list[Trial]) -> None:
    rows = table(trials)
    found = next(r for r in rows if (r["method"], r["aim"], r["statistic"]) == ("joint", "human", "mean deg"))
    assert_allclose(found["value"], np.mean([t.angle[2, 1] for t in trials]))
    assert found["low"] <= found["value"] <= found["high"]
    assert found["paper"] == 3.7


def test_pairs_of_trials_are_told_apart_by_signed_ranks(trials: list[Trial]) -> None:
    rows = [r for r in table(trials) if (r["method"], r["aim"]) == ("rigid", "exact")]
    found = next(r for r in rows if r["statistic"] == "mean minus pairwise deg")
    mean = np.array([t.angle[:, 0].mean(axis=1) for t in trials])
    difference = mean[:, 1] - mean[:, 0]
    assert_allclose(found["value"], difference.mean())
    rank = 1.0 + np.argsort(np.argsort(np.abs(difference)))
    signs = np.array(list(product((-1.0, 1.0), repeat=len(trials))))
    assert_allclose(found["p"], np.mean(np.abs(signs @ rank) >= abs(np.sign(difference) @ rank)))


def test_shares_of_trials_count_a_trial_once(trials: list[Trial]) -> None:
    wrong = np.zeros((3, 2, 4), bool)
    wrong[1, 0, :3] = True
    rows = table([trials[0]._replace(wrong=wrong), *(t._replace(wrong=np.zeros_like(wrong)) for t in trials[1:])])
    of = {(r["method"], r["statistic"]): r for r in rows if r["aim"] == "exact"}
    assert of["rigid", "wrong sphere"]["value"] == pytest.approx(3 / 24)
    assert of["rigid", "trials with a wrong sphere"]["value"] == pytest.approx(1 / 6)
    never = of["pairwise", "trials with a wrong sphere"]
    # None of 6: the upper end is where 6 misses in a row have a chance of 2.5 %.
    assert (never["value"], never["low"]) == (0.0, 0.0)
    assert never["high"] == pytest.approx(1.0 - 0.025 ** (1.0 / 6.0))


def test_reproduced_is_told_by_the_interval() -> None:
    assert reproduced(Interval(4.0, 3.5, 4.5), 3.7) == "yes"
    assert reproduced(Interval(2.0, 1.5, 2.5), 3.7) == "yes, lower"
    assert reproduced(Interval(9.0, 8.0, 10.0), 3.7) == "no"
