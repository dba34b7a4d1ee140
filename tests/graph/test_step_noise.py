from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from synchronizar.arrays import Array
from synchronizar.estimation.register import register
from synchronizar.parameters import Parameters
from synchronizar.simulation.simulate import Scene, simulate


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
def test_a_walk_tells_how_much_slam_drifts(seed: int) -> None:
    none, half, usual, threefold = (np.exp(np.log(noises(drift, seed)).mean(axis=0)) for drift in (0.0, 0.5, 1.0, 3.0))
    assert (none < 0.4).all()
    assert ((half > 0.4) & (half < 0.7)).all()
    assert ((usual > 0.7) & (usual < 1.3)).all()
    assert ((threefold > 2.4) & (threefold < 3.6)).all()


def test_the_more_ranges_there_are_the_less_drift_is_told_of_slam_that_does_not_drift() -> None:
    few, many = (
        np.array([u.slam_noise for u in register(simulate(scene).recording).users.values()])
        for scene in (Scene(users=4, seed=3, rate_hz=rate) for rate in (5.0, 125.0))
    )
    assert (many < 0.5 * few).all()
    assert (many < 0.25).all()


def test_a_radio_that_stands_still_has_no_slam_and_trusted_slam_no_noise() -> None:
    recording = simulate(replace(Scene(users=2, seconds=8.0), static_radios=1)).recording
    full, rigid = register(recording), register(recording, model="rigid")
    assert [u.slam_noise is None for u in full.users.values()] == [u.static for u in recording.users]
    assert all(u.slam_noise is None for u in rigid.users.values())
