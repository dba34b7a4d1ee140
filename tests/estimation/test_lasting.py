from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from synchronizar.data.recording import Recording
from synchronizar.estimation import full
from synchronizar.estimation.lasting import measured_noise, with_lasting_errors
from synchronizar.estimation.register import register
from synchronizar.graph.pose_graph import LocalOptimum
from synchronizar.graph.states import interpolated
from synchronizar.graph.step_noise import StepNoise
from synchronizar.preprocessing.keyframes import Keyframes
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

LASTING, NOISE, DURATION, DRIFT = 0.06, 0.05, 1.0, 2.0


def with_errors_that_last(recording: Recording, seed: int) -> Recording:
    """Each pair's ranges with an Ornstein-Uhlenbeck process of 1 sigma `LASTING` m besides."""
    ranges, random = recording.ranges, np.random.default_rng(seed)
    more, pair = np.zeros(len(ranges)), np.sort(np.column_stack([ranges.a, ranges.b]), axis=1) @ [1000, 1]
    for one in np.unique(pair):
        those = np.flatnonzero(pair == one)
        steps = random.standard_normal(len(those))
        decay = np.exp(-np.diff(ranges.t[those]) / DURATION)
        now = steps[0]
        more[those[0]] = now
        for n, by, new in zip(those[1:], decay, steps[1:], strict=True):
            now = by * now + np.sqrt(1.0 - by**2) * new
            more[n] = now
    return replace(recording, ranges=replace(ranges, distance=ranges.distance + LASTING * more))


def asked(monkeypatch: pytest.MonkeyPatch, recording: Recording) -> tuple[LocalOptimum, list[Keyframes]]:
    """The optimum at which the noise of steps is asked, and fine keyframes with usual drift."""
    heard: list[tuple[LocalOptimum, list[Keyframes]]] = []

    def listening(optimum: LocalOptimum, usual: list[Keyframes]) -> StepNoise:
        heard.append((optimum, usual))
        return measured_noise(optimum, usual)

    monkeypatch.setattr(full, "measured_noise", listening)
    register(recording)
    return heard[-1]


def walk(seed: int, drift: float, sigma: float = NOISE) -> Recording:
    """Three people for a minute; SLAM drifts so many times as far as the model has it."""
    by_time = {"drift_m_per_sqrt_s": 0.014 * drift, "drift_rad_per_sqrt_s": 0.007 * drift}
    return simulate(Scene(users=3, seconds=60.0, seed=seed, sigma=sigma, **by_time)).recording


def test_as_much_lasts_as_does_and_drift_is_told_from_it(monkeypatch: pytest.MonkeyPatch) -> None:
    optimum, usual = asked(monkeypatch, with_errors_that_last(walk(21, DRIFT), 21))
    beside, without = measured_noise(optimum, usual), measured_noise(optimum, None)
    graph, near = (
        optimum.graph.with_other_keyframes(usual),
        interpolated(optimum.states, optimum.graph.keyframes, usual),
    )
    begin = replace(graph.initial_em_weights(), range_weight=optimum.em_weights.range_weight)
    found = with_lasting_errors(LocalOptimum(graph, near, graph.e_step(near, begin)[0], np.inf)).graph
    assert found.sigma.mean() == pytest.approx(NOISE, rel=0.3)
    assert found.lasting_sigma.mean() == pytest.approx(LASTING, rel=0.5)
    true, told = np.log(DRIFT), np.log(beside.used[:, 0])
    assert told == pytest.approx(true, abs=np.log(1.5))
    assert np.abs(told - true).max() < np.abs(np.log(without.used[:, 0]) - true).min()


def test_where_errors_are_noise_nothing_else_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    optimum, usual = asked(monkeypatch, walk(2, 1.0, 0.1))
    np.testing.assert_array_equal(measured_noise(optimum, usual).used, measured_noise(optimum, None).used)
