from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from synchronizar.arrays import Array
from synchronizar.estimation.register import register
from synchronizar.graph.step_noise import HEADING, PLACE, most_likely_noise
from synchronizar.parameters import Parameters
from synchronizar.simulation.simulate import Scene, simulate

TRUE = np.array([[0.5, 2.0], [3.0, 0.7]])
COUNT = 150
WHOSE = np.repeat([0, 1], COUNT).astype(np.int32)


def problem(seed: int, seen: float) -> tuple[Array, Array, Array, Array]:
    """Independent steps of two users, one variable each, that something sees with a sigma of `seen` of theirs."""
    random = np.random.default_rng(seed)
    times = TRUE[WHOSE][:, [PLACE, PLACE, HEADING]]
    true = times * random.normal(size=times.shape)
    measured = (true + seen * random.normal(size=true.shape)).ravel()
    size = measured.size
    return np.eye(size) / seen**2, measured / seen**2, np.eye(size).reshape(-1, 3, size), np.zeros((len(WHOSE), 3))


@pytest.mark.parametrize("seed", range(3))
def test_steps_that_are_seen_tell_their_noise(seed: int) -> None:
    found = most_likely_noise(*problem(seed, seen=0.1), WHOSE, 2, weight=1e-9)
    np.testing.assert_allclose(found, TRUE, rtol=4.0 / np.sqrt(2.0 * COUNT))


@pytest.mark.parametrize("seed", range(3))
def test_the_noise_is_the_most_likely_one(seed: int) -> None:
    """Of independent steps the likelihood has a closed form: each measured one is normal with both variances."""
    seen = 0.5
    information, slope, rows, wanted = problem(seed, seen)
    measured = (slope * seen**2).reshape(-1, 3)
    found = most_likely_noise(information, slope, rows, wanted, WHOSE, 2, weight=1e-9)
    for user in range(2):
        mine = measured[user == WHOSE]
        for column, of in ((PLACE, mine[:, :2]), (HEADING, mine[:, 2:])):
            # The maximum of the sum of log N(0, n^2 + seen^2).
            assert found[user, column] == pytest.approx(np.sqrt(max((of**2).mean() - seen**2, 0.0)), rel=0.05)


def test_where_nothing_is_seen_the_model_stands() -> None:
    _, _, rows, wanted = problem(0, seen=0.1)
    size = rows.shape[-1]
    found = most_likely_noise(np.zeros((size, size)), np.zeros(size), rows, wanted, WHOSE, 2, weight=10.0)
    np.testing.assert_allclose(found, 1.0)


def test_the_models_own_steps_draw_the_noise_to_one() -> None:
    found = most_likely_noise(*problem(0, seen=0.1), WHOSE, 2, weight=1e6)
    np.testing.assert_allclose(found, 1.0, atol=0.01)


def noises(drift: float, seed: int) -> Array:
    """(users, 2) of a walk whose SLAM drifts so many times as far as the model says."""
    m = Parameters()
    scene = Scene(
        users=4,
        seconds=60.0,
        seed=seed,
        sigma=0.1,
        drift_m_per_sqrt_s=drift * float(np.hypot(m.slam.drift_m_per_sqrt_s, m.slam.drift_m_per_sqrt_m)),
        drift_rad_per_sqrt_s=drift * float(np.hypot(m.slam.drift_rad_per_sqrt_s, m.slam.drift_rad_per_sqrt_m)),
    )
    users = register(simulate(scene).recording).users.values()
    return np.array([u.slam_noise for u in users])


@pytest.mark.parametrize("seed", range(2))
def test_a_walk_tells_good_slam_from_bad(seed: int) -> None:
    none, usual, threefold = (np.exp(np.log(noises(drift, seed)).mean(axis=0)) for drift in (0.0, 1.0, 3.0))
    assert (none < 0.95).all()
    assert (none < usual).all()
    assert ((usual > 0.9) & (usual < 1.1)).all()
    assert threefold[HEADING] > 1.05 * usual[HEADING]


def test_a_radio_that_stands_still_has_no_slam_and_trusted_slam_no_noise() -> None:
    recording = simulate(replace(Scene(users=2, seconds=8.0), static_radios=1)).recording
    full, rigid = register(recording), register(recording, model="rigid")
    assert [u.slam_noise is None for u in full.users.values()] == [u.static for u in recording.users]
    assert all(u.slam_noise is None for u in rigid.users.values())
