"""Odometry that is much worse than the model's: drift is told from NLOS, and honest ranges are kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration
from synchronizar.estimation.register import register
from synchronizar.simulation.simulate import Scene, Simulation, simulate

SCENE = Scene(users=3, seconds=40.0, drift_m_per_sqrt_s=0.01, drift_rad_per_sqrt_s=0.004, late_share=0.05)


def drone_and_beacon(seed: int) -> Recording:
    """A drone whose odometry is bad flies for a minute about one beacon; every range is in line of sight."""
    scene = Scene(users=2, static_radios=1, seconds=60.0, seed=seed, area=10.0, speed=1.5, height_bob=0.5, rate_hz=10.0)
    recording = simulate(replace(scene, drift_m_per_sqrt_s=0.1, drift_rad_per_sqrt_s=0.04)).recording
    users = (recording.users[0], recording.users[2])
    r = recording.ranges.select((recording.ranges.a != 1) & (recording.ranges.b != 1))
    ranges = replace(r, a=np.minimum(r.a, 1), b=np.minimum(r.b, 1))
    return Recording(users, {"phone0": recording.tracks["phone0"]}, ranges)


def with_bad_odometry(name: str, seed: int, factor: float) -> Simulation:
    """A walk of three, one of whom has SLAM that drifts so many times as far."""
    good = simulate(replace(SCENE, seed=seed))
    drift = {n: factor * getattr(SCENE, n) for n in ("drift_m_per_sqrt_s", "drift_rad_per_sqrt_s")}
    bad = simulate(replace(SCENE, seed=seed, **drift))
    tracks = {**good.recording.tracks, name: bad.recording.tracks[name]}
    return replace(good, recording=replace(good.recording, tracks=tracks))


def rejected(registration: Registration) -> float:
    usable = registration.ranges.usable
    return 1.0 - float(registration.ranges.used[usable].mean())


@pytest.mark.parametrize("seed", [1, 2])
def test_honest_ranges_of_a_drone_with_bad_odometry_are_kept(seed: int) -> None:
    assert rejected(register(drone_and_beacon(seed))) < 0.15


@pytest.mark.parametrize("name", ["phone1", "phone0"])
def test_whose_odometry_is_bad_is_found_and_the_others_are_registered(name: str) -> None:
    simulation = with_bad_odometry(name, 3, 15.0)
    registration = register(simulation.recording)
    assert rejected(registration) < 0.2
    noise = {n: max(user.slam_noise or (0.0, 0.0)) for n, user in registration.users.items()}
    assert max(noise, key=lambda n: noise[n]) == name
    assert noise[name] > 4.0
    assert max(value for n, value in noise.items() if n != name) < 0.5 * noise[name]


def test_late_ranges_are_not_taken_for_drift() -> None:
    simulation = simulate(replace(SCENE, late_share=0.4, late_burst_s=3.0, seed=4))
    registration = register(simulation.recording)
    assert max(max(user.slam_noise or (0.0, 0.0)) for user in registration.users.values()) < 1.5
    assert rejected(registration) == pytest.approx(float(simulation.late.mean()), abs=0.1)
