from __future__ import annotations

import gc
import sys

import gtsam
import numpy as np
import pytest

from synchronizar._core import NlosMixture, RangeSlot, Squared
from synchronizar.arrays import Array
from synchronizar.graph.range_factors import CalibratedUserKeys, RangeFactor, RangeSlotFactor, UserKeys

LATE = NlosMixture(1.0, 0.002)
K, N = 4, 40


def slot_of(seed: int = 0, weight: float = 1.0) -> RangeSlot:
    random = np.random.default_rng(seed)
    i = random.integers(0, K - 1, N).astype(np.int32)
    j = (i + 1 + random.integers(0, K - 1 - i)).astype(np.int32)
    ends = [tuple(random.normal(0.0, s, (N, 3)) for s in (2.0, 0.2, 1.0)) for _ in "ij"]
    distance = random.uniform(1.0, 6.0, N)
    return RangeSlot(K, i, j, ends[0], ends[1], distance, np.full(N, 0.1), np.full(N, 0.2), np.full(N, weight))


def users_of(held: int | None = None) -> list[CalibratedUserKeys]:
    """Five keys a user; the keys of all users are interleaved, and those of one are not sorted."""
    keys = [CalibratedUserKeys(40 + u, 10 + u, 30 + u, 20 + u, 50 + u) for u in range(K)]
    if held is not None:
        frame, local, calibration = (1.0, 2.0, 0.3, 0.4), (0.5, 0.6, 0.7, 0.8), (0.01, 0.1, 0.05)
        keys[held] = CalibratedUserKeys(None, None, None, None, None, frame, local, calibration)
    return keys


def values_of(users: list[CalibratedUserKeys], seed: int = 1) -> gtsam.Values:
    random, values = np.random.default_rng(seed), gtsam.Values()
    for user in users:
        for key in (user.frame, user.pose):
            if key is not None:
                values.insert(key, gtsam.Pose2(*random.normal(0.0, 2.0, 3)))
        for key in (user.height, user.local_height):
            if key is not None:
                values.insert(key, float(random.normal()))
        if user.calibration is not None:
            values.insert(user.calibration, random.normal(0.0, 0.05, 3))
    return values


def numerical_gradient(factor: RangeSlotFactor, values: gtsam.Values) -> Array:
    out, h = [], 1e-5
    for key in factor.keys():  # noqa: SIM118 - gtsam's, no mapping
        for axis in np.eye({4: 3, 1: 1, 3: 3, 2: 1, 5: 3}[key // 10]):
            costs = []
            for steps in (-2, -1, 1, 2):
                step = gtsam.VectorValues()
                step.insert(key, steps * h * axis)
                costs.append(factor.error(values.retract(step)))
            out.append((costs[0] - 8 * costs[1] + 8 * costs[2] - costs[3]) / (12 * h))
    return np.array(out)


@pytest.mark.parametrize("held", [None, 0, 2])
@pytest.mark.parametrize("loss", [Squared(), LATE])
def test_it_has_the_gradient_of_its_error(held: int | None, loss: NlosMixture | Squared) -> None:
    users = users_of(held)
    factor, values = RangeSlotFactor(users, slot_of(), loss), values_of(users)
    A, b = factor.linearize(values).jacobian()
    np.testing.assert_allclose(-A.T @ b, numerical_gradient(factor, values), atol=1e-6 * np.abs(A.T @ b).max())
    assert len(factor.keys()) == 5 * (K if held is None else K - 1)
    assert len(A) <= 7 * K + 1


def test_half_its_squared_error_is_the_cost() -> None:
    users = users_of()
    slot, values = slot_of(), values_of(users)
    at = np.array([user.read(values) for user in users])
    expected = slot.cost(at[:, :8].copy(), at[:, 8:].copy(), LATE, 2.0)
    assert RangeSlotFactor(users, slot, LATE, 2.0).error(values) == pytest.approx(expected, rel=1e-12)


def test_squared_losses_and_trusted_devices_are_single_range_factors() -> None:
    """Of frames and keyframes, with ranges that are too long, so that no height is bent."""
    random = np.random.default_rng(3)
    o_i, o_j = random.normal(0.0, 2.0, (N, 3)), random.normal(0.0, 2.0, (N, 3))
    i = random.integers(0, K - 1, N).astype(np.int32)
    j = (i + 1 + random.integers(0, K - 1 - i)).astype(np.int32)
    users, zeros = [user._replace(calibration=None) for user in users_of()], np.zeros((N, 3))
    values, distance = values_of(users), np.full(N, 50.0)
    slot = RangeSlot(
        K, i, j, (o_i, zeros, zeros), (o_j, zeros, zeros), distance, np.full(N, 0.1), np.zeros(N), np.ones(N)
    )
    single, noise = gtsam.NonlinearFactorGraph(), gtsam.noiseModel.Isotropic.Sigma(1, 0.1)
    for n in range(N):
        keys = [UserKeys(users[u].frame, users[u].height, users[u].pose, users[u].local_height) for u in (i[n], j[n])]
        single.add(RangeFactor(*keys, o_i[n], o_j[n], distance[n], noise))
    graph = gtsam.NonlinearFactorGraph()
    graph.add(RangeSlotFactor(users, slot, Squared()))
    assert graph.error(values) == pytest.approx(single.error(values), rel=1e-12)
    ordering = gtsam.Ordering(values.keys())
    information, slope = graph.linearize(values).hessian(ordering)
    expected, expected_slope = single.linearize(values).hessian(ordering)
    np.testing.assert_allclose(information, expected, atol=1e-9 * expected.max())
    np.testing.assert_allclose(slope, expected_slope, atol=1e-9 * np.abs(expected_slope).max())


@pytest.mark.parametrize("held", [None, 1])
def test_where_no_keyframe_is_a_variable_frames_alone_have_columns(held: int | None) -> None:
    users = [u._replace(pose=None, local_height=None, held_local=(0.0, 0.0, 0.0, 0.0)) for u in users_of(held)]
    assert all(user.at_origin for user in users)
    factor, values = RangeSlotFactor(users, slot_of(), LATE), values_of(users)
    A, b = factor.linearize(values).jacobian()
    assert A.shape[1] == 7 * (K if held is None else K - 1)
    np.testing.assert_allclose(-A.T @ b, numerical_gradient(factor, values), atol=1e-6 * np.abs(A.T @ b).max())


def test_isam2_takes_it() -> None:
    users = users_of()
    values = values_of(users)
    graph = gtsam.NonlinearFactorGraph()
    graph.add(RangeSlotFactor(users, slot_of(), LATE))
    for key in values.keys():  # noqa: SIM118
        if key // 10 in (4, 3):
            graph.addPriorPose2(key, values.atPose2(key), gtsam.noiseModel.Isotropic.Sigma(3, 0.1))
        elif key // 10 == 5:
            graph.addPriorVector(key, values.atVector(key), gtsam.noiseModel.Isotropic.Sigma(3, 0.1))
        else:
            graph.addPriorDouble(key, values.atDouble(key), gtsam.noiseModel.Isotropic.Sigma(1, 0.1))
    isam = gtsam.ISAM2()
    isam.update(graph, values)
    for _ in range(5):
        isam.update()
    assert graph.error(isam.calculateEstimate()) < graph.error(values)


def test_a_graph_that_goes_takes_its_factors_along() -> None:
    gc.collect()
    gc.disable()
    try:
        slot = slot_of()
        held = sys.getrefcount(slot)
        graph = gtsam.NonlinearFactorGraph()
        graph.add(RangeSlotFactor(users_of(), slot, Squared()))
        graph.linearize(values_of(users_of()))
        assert sys.getrefcount(slot) == held + 1
        del graph
        assert sys.getrefcount(slot) == held
    finally:
        gc.enable()
