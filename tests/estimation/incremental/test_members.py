from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synchronizar.arrays import Array
from synchronizar.data.registration import State
from synchronizar.data.user import User
from synchronizar.estimation.incremental.members import Members
from synchronizar.estimation.incremental.tracking import Tracked
from synchronizar.geometry import relative_to
from synchronizar.parameters import Parameters

USERS = (User("a"), User("b"), User("c"))
SIZE = 21


def states_of(seed: int) -> Array:
    """(3, 7) x, y, yaw, height, log scale, bias, clock."""
    return np.random.default_rng(seed).normal(0.0, [3.0, 3.0, 1.0, 0.5, 0.05, 0.1, 0.05], (3, 7))


def tangents_of(seed: int, size: float = 1.0) -> Array:
    """A covariance of the tangents of X, H and D of three users."""
    root = np.random.default_rng(seed + 1).normal(size=(SIZE, SIZE)) * size * 0.1
    return np.asarray(root @ root.T / SIZE)


def members(states: Array, tangents: Array, shift: Array | None = None) -> Members:
    tracking: Any = SimpleNamespace(
        users=USERS,
        streams=[None] * 3,
        parameters=Parameters(),
        members={u: Tracked(5, 5.0, np.array([1.0, 2.0, 3.0]), states[u]) for u in (2, 0, 1)},
        assumed_clock=np.array([0.0, 0.1, -0.2]),
        height_spread=np.zeros(3),
        follower=SimpleNamespace(covariance=lambda at: tangents if [u for u, _ in at] == [0, 1, 2] else None),
    )
    return Members(tracking, 0, np.zeros(3) if shift is None else shift)


def sampled(states: Array, tangents: Array, n: int, seed: int) -> Array:
    """(n, 3, 7) states at random: X as gtsam retracts Pose2, along its own axes."""
    off = np.random.default_rng(seed).multivariate_normal(np.zeros(SIZE), tangents, n).reshape(n, 3, 7)
    out = np.tile(states, (n, 1, 1))
    c, s = np.cos(states[:, 2]), np.sin(states[:, 2])
    out[:, :, 0] += c * off[:, :, 0] - s * off[:, :, 1]
    out[:, :, 1] += s * off[:, :, 0] + c * off[:, :, 1]
    out[:, :, 2:] += off[:, :, 2:]
    return out


def frames_of(states: Array) -> Array:
    """(..., 4) x, y, z, yaw."""
    return states[..., [0, 1, 3, 2]]


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 999), x=st.floats(-50.0, 50.0), y=st.floats(-50.0, 50.0), turn=st.floats(-3.0, 3.0))
def test_a_common_shift_and_turn_turns_the_relative_covariance_and_no_more(
    seed: int, x: float, y: float, turn: float
) -> None:
    states, tangents = states_of(seed), tangents_of(seed)
    c, s = np.cos(turn), np.sin(turn)
    moved = states.copy()
    moved[:, 0], moved[:, 1] = c * states[:, 0] - s * states[:, 1] + x, s * states[:, 0] + c * states[:, 1] + y
    moved[:, 2] += turn
    moved[:, 3] += 7.0
    R = np.eye(4)
    R[:2, :2] = [[c, -s], [s, c]]
    before, after = (members(each, tangents).relative(1, 2) for each in (states, moved))
    np.testing.assert_allclose(after, R @ before @ R.T, atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 999), sigma=st.floats(0.0, 10.0))
def test_not_knowing_where_all_lie_together_makes_nobody_vaguer_beside_another(seed: int, sigma: float) -> None:
    """A shift and a turn of everybody about the origin, however vague."""
    states, tangents = states_of(seed), tangents_of(seed)
    together = np.zeros((SIZE, 4))
    for u in range(3):
        c, s = np.cos(states[u, 2]), np.sin(states[u, 2])
        own = np.array([[c, s], [-s, c]])
        together[7 * u : 7 * u + 2, :2] = own
        together[7 * u : 7 * u + 2, 2] = own @ [-states[u, 1], states[u, 0]]
        together[7 * u + 2, 2] = 1.0
        together[7 * u + 3, 3] = 1.0
    vague = tangents + sigma**2 * together @ together.T
    expected = members(states, tangents).relative(1, 0)
    np.testing.assert_allclose(members(states, vague).relative(1, 0), expected, atol=1e-9 * (1.0 + sigma**2))


@pytest.mark.parametrize("gauge", [0, 2])
def test_the_relative_covariance_is_that_of_samples(gauge: int) -> None:
    states, tangents = states_of(3), tangents_of(3, 0.01)
    drawn = frames_of(sampled(states, tangents, 40000, 0))
    mean = frames_of(states)
    beside = np.array([relative_to(frames, gauge)[1] for frames in drawn]) - relative_to(mean, gauge)[1]
    c, s = np.cos(mean[gauge, 3]), np.sin(mean[gauge, 3])
    beside[:, :2] = beside[:, :2] @ np.array([[c, s], [-s, c]])  # in common axes
    expected, size = np.cov(beside.T), np.sqrt(np.diag(np.cov(beside.T)))
    got = members(states, tangents).relative(1, gauge)
    np.testing.assert_allclose(got / np.outer(size, size), expected / np.outer(size, size), atol=0.03)


def test_a_member_is_told_in_the_common_frame_with_its_whole_clock() -> None:
    states, shift = states_of(5), np.array([10.0, -20.0, 0.0])
    placed = members(states, tangents_of(5), shift).placed(1)
    np.testing.assert_allclose(placed.state[:2], states[1, :2] + shift[:2])
    np.testing.assert_allclose(placed.state[2:6], states[1, 2:6])
    assert placed.state[6] == pytest.approx(states[1, 6] + 0.1)
    np.testing.assert_allclose(placed.covariance, placed.covariance.T)
    assert np.linalg.eigvalsh(placed.covariance).min() > -1e-12


@pytest.mark.parametrize(("sigma", "state"), [(0.02, State.REGISTERED), (1.0, State.UNOBSERVABLE)])
def test_who_is_known_well_beside_the_gauge_is_registered(sigma: float, state: State) -> None:
    verdict, near, found = members(states_of(6), sigma**2 * np.eye(SIZE)).verdict(1, 0, np.zeros((1, 3)), 0.0, False)
    assert verdict.state is state
    assert (near == 1.0) == (state is State.REGISTERED)
    np.testing.assert_allclose(found.frames[1], frames_of(states_of(6))[1])


def crowd(count: int, slot: int, asked: list[int]) -> Any:
    """So many who are followed, all at one slot; `asked` hears how many are asked about."""

    def covariance(at: list[tuple[int, int]]) -> Array:
        asked.append(len(at))
        return np.eye(7 * len(at))

    return SimpleNamespace(
        members={u: Tracked(slot, float(slot), np.zeros(3), np.zeros(7)) for u in range(count)},
        follower=SimpleNamespace(covariance=covariance),
    )


@pytest.mark.parametrize("count", [2, 4, 32])
def test_the_joint_covariance_is_asked_once_a_slot(count: int) -> None:
    asked: list[int] = []
    before = None
    for slot in (5, 5, 6):
        before = Members(crowd(count, slot, asked), 0, np.zeros(3), before).joint
    assert asked == [count, count]
