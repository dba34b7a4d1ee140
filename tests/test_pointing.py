from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("scipy", reason="the pairwise method and the tests need scipy")
pytest.importorskip("matplotlib", reason="experiments draw figures")

from experiments.pointing import (
    AIM_SIGMA,
    METHODS,
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
from experiments.study import Interval
from synchronizar.geometry import YawFrame
from synchronizar.pairwise import register_pairwise


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


def test_aim_scatters_over_an_effective_width_of_a_degree_and_a_half() -> None:
    assert_allclose(np.degrees(AIM_SIGMA), 0.363, atol=5e-4)


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
    assert all(0.0 <= r["p"] <= 1.0 for r in rows if r["p"] != "")


def test_reproduced_is_told_by_the_interval() -> None:
    assert reproduced(Interval(4.0, 3.5, 4.5), 3.7) == "yes"
    assert reproduced(Interval(2.0, 1.5, 2.5), 3.7) == "yes, lower"
    assert reproduced(Interval(9.0, 8.0, 10.0), 3.7) == "no"
