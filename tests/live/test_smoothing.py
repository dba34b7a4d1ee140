from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live.smoothing_vectors import VECTORS, covariance, run, scripts

from synchronizar.live.smoothing import InView, Placing, Smoother
from synchronizar.parameters import SmoothingParameters

RULE = SmoothingParameters()
SURE = covariance(0.002, 0.0005)
FRAME_S = 1.0 / 60.0
HERE = np.array([1.0, -2.0, 0.3])


def following(first: Placing, then: Placing, at: np.ndarray = HERE, cov: Any = SURE) -> Smoother:
    """One that shows `first` in full and has just been told `then`."""
    smoother = Smoother()
    smoother.solved(0.0, first, cov, at)
    smoother.step(1.0, at)
    smoother.solved(1.0, then, cov, at)
    return smoother


def numbers(returned: Any) -> list[float]:
    return [] if returned is None else list(returned.values())


@pytest.mark.parametrize("name", scripts())
def test_it_does_as_the_vectors_say(name: str) -> None:
    calls = run(scripts()[name])
    expected = json.loads(VECTORS.read_text())[name]
    assert len(calls) == len(expected)
    for call, wanted in zip(calls, expected, strict=True):
        assert (call["returns"] is None) == (wanted["returns"] is None)
        assert numbers(call["returns"]) == pytest.approx(numbers(wanted["returns"]), abs=1e-9)


corrections = st.tuples(*[st.floats(-0.25, 0.25)] * 3, st.floats(-0.1, 0.1), st.floats(-0.02, 0.02))


@settings(max_examples=60, deadline=None)
@given(corrections, st.tuples(*[st.floats(-1000.0, 1000.0)] * 3))
def test_nothing_near_moves_faster_than_the_cap_and_all_of_it_arrives(
    change: tuple[float, ...], at: tuple[float, float, float]
) -> None:
    first = Placing(1.0, 2.0, 0.1, 0.7)
    place = first.apply(at) + change[:3]
    turned = Placing(0.0, 0.0, 0.0, first.yaw + change[3], first.scale * float(np.exp(change[4])))
    goal = Placing(*(place - turned.apply(at)).tolist(), turned.yaw, turned.scale)
    # As sure near the device as elsewhere: what is told is of the frame's origin.
    smoother = following(first, goal, np.array(at), np.diag([1e-6, 1e-6, 1e-6, 0.0]))
    things = np.array(at) + RULE.arm * np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 0.0]])
    before, largest, gap = first, 0.0, np.inf
    for _ in range(60 * 60):
        error = np.linalg.norm(goal.apply(at) - before.apply(at))
        twist = RULE.arm * (abs(goal.yaw - before.yaw) + abs(np.log(goal.scale / before.scale)))
        shown = smoother.step(FRAME_S, at)
        assert shown is not None
        assert shown.opacity == 1.0
        steps = [np.linalg.norm(shown.placing.apply(p) - before.apply(p)) for p in things]
        assert max(steps) <= FRAME_S * (3 * RULE.least_speed + RULE.rate * (error + twist)) * 1.05 + 1e-9
        largest, before = max(largest, *steps), shown.placing
        gap = max(float(np.linalg.norm(goal.apply(p) - before.apply(p))) for p in things[2:])
        if steps == [0.0, 0.0, 0.0]:
            break
    assert gap <= RULE.dead_band + 1e-9
    assert largest <= FRAME_S * (0.06 + RULE.rate * 1.0)


def test_a_correction_of_44_mm_moves_things_by_less_than_2_mm_a_frame() -> None:
    smoother = following(Placing(0.0, 0.0, 0.0, 0.0), Placing(0.044, 0.0, 0.0, 0.0))
    xs = [shown.placing.x for _ in range(300) if (shown := smoother.step(FRAME_S, HERE))]
    assert max(np.diff([0.0, *xs])) < 0.001
    assert 0.044 - xs[-1] <= RULE.dead_band


def test_noise_within_what_was_told_moves_nothing() -> None:
    rng = np.random.default_rng(3)
    smoother = following(Placing(0.0, 0.0, 0.0, 0.0), Placing(0.0, 0.0, 0.0, 0.0), cov=covariance(0.05, 0.01))
    shown = set()
    for k in range(100):
        x, y, yaw = 0.012 * rng.uniform(-1.0, 1.0, 3)
        smoother.solved(1.0 + 0.5 * k, Placing(x, y, 0.0, 0.3 * yaw), covariance(0.05, 0.01), HERE)
        shown |= {smoother.step(FRAME_S, HERE) for _ in range(5)}
    assert len(shown) == 1


def test_a_turn_turns_things_about_the_device_and_not_about_a_far_origin() -> None:
    at = np.array([500.0, 300.0, 0.0])
    first = Placing(0.0, 0.0, 0.0, 0.0)
    x, y, z = (at - Placing(0.0, 0.0, 0.0, 0.02).apply(at)).tolist()
    smoother = following(first, Placing(x, y, z, 0.02), at, np.diag([1e-6, 1e-6, 1e-6, 0.0]))
    for _ in range(600):
        shown = smoother.step(FRAME_S, at)
        assert shown is not None
        assert shown.placing.apply(at) == pytest.approx(at, abs=1e-6)
    assert abs(shown.placing.yaw - 0.02) <= RULE.dead_band / RULE.arm


def test_what_is_more_than_half_a_metre_off_fades_and_is_never_seen_to_jump() -> None:
    smoother = following(Placing(0.0, 0.0, 0.0, 0.0), Placing(3.0, 0.0, 0.0, 0.0))
    frames = [shown for _ in range(60) if (shown := smoother.step(FRAME_S, HERE))]
    jumps = [k for k in range(1, 60) if abs(frames[k].placing.x - frames[k - 1].placing.x) > 0.01]
    assert len(jumps) == 1
    assert frames[jumps[0]].opacity == 0.0
    assert frames[-1].opacity == 1.0
    assert frames[-1].placing.x == 3.0


def test_it_goes_faster_where_only_people_are_in_view_and_faster_still_where_nothing_is() -> None:
    def moved(in_view: InView) -> float:
        smoother = following(Placing(0.0, 0.0, 0.0, 0.0), Placing(0.3, 0.0, 0.0, 0.0))
        shown = smoother.step(0.1, HERE, in_view)
        assert shown is not None
        return shown.placing.x

    assert moved("people") == pytest.approx(RULE.people * moved("things"))
    assert moved("nothing") == pytest.approx(RULE.out_of_view * moved("things"))
    assert moved("people") < 0.1 * 0.5, "less than half of a walk"


def test_an_alarm_is_what_contradicts_what_was_told() -> None:
    def alarm(distance: float, sigma: float, after_lost: bool = False) -> bool:
        smoother = Smoother()
        smoother.solved(0.0, Placing(0.0, 0.0, 0.0, 0.0), covariance(sigma, 0.001), HERE)
        if after_lost:
            smoother.lost()
        return smoother.solved(1.0, Placing(distance, 0.0, 0.0, 0.0), covariance(sigma, 0.001), HERE) is not None

    assert alarm(0.4, 0.03)
    assert not alarm(0.4, 0.3)
    assert not alarm(0.09, 0.001)
    assert not alarm(0.4, 0.03, after_lost=True)


def test_creeping_is_told_too() -> None:
    smoother = Smoother()
    alarms = [
        smoother.solved(0.5 * k, Placing(0.02 * k, 0.0, 0.0, 0.0), covariance(0.01, 0.001), HERE) for k in range(20)
    ]
    assert any(alarms)


def test_nothing_is_shown_before_something_is_solved_nor_after_the_frame_is_another() -> None:
    smoother = Smoother()
    assert smoother.step(FRAME_S, HERE) is None
    smoother.solved(0.0, Placing(0.0, 0.0, 0.0, 0.0), SURE, HERE)
    assert smoother.step(FRAME_S, HERE) is not None
    smoother.forget()
    assert smoother.step(FRAME_S, HERE) is None
