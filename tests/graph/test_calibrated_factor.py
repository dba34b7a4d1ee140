from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

import gtsam
import numpy as np
import pytest

from synchronizar._core import (
    Cauchy,
    GemanMcClure,
    Huber,
    NlosMixture,
    RangeSlot,
    Squared,
)
from synchronizar.arrays import Array
from synchronizar.graph.range_factors import CalibratedUserKeys, RangeSlotFactor

if TYPE_CHECKING:
    from synchronizar._core import Loss

LOSSES: dict[str, Loss] = {
    "squared": Squared(),
    "huber": Huber(),
    "cauchy": Cauchy(),
    "geman_mcclure": GemanMcClure(),
    "late": NlosMixture(1.0, 0.002),
}

FRAMES = {20: (1.0, -2.0, 0.4), 3: (4.0, 3.0, -2.5), 5: (0.5, 1.5, -1.2), 1: (-1.0, 0.25, 0.8)}
HEIGHTS = {9: 0.3, 7: -0.2, 12: 0.1, 30: 0.05}
DEVICES = {40: (0.2, 0.12, -0.15), 2: (-0.3, -0.05, 0.2)}
HELD_FRAME, HELD_LOCAL = (*FRAMES[20], HEIGHTS[9]), (*FRAMES[5], HEIGHTS[12])

# j's frame comes before i's, a height before its frame: the keys are in no order at all.
I_FREE, J_FREE = CalibratedUserKeys(20, 9, 5, 12, 40), CalibratedUserKeys(3, 7, 1, 30, 2)
I_FRAME_HELD = CalibratedUserKeys(None, None, 5, 12, 40, held_frame=HELD_FRAME)
I_KEYFRAME_HELD = CalibratedUserKeys(20, 9, None, None, 40, held_local=HELD_LOCAL)
I_HELD = CalibratedUserKeys(None, None, None, None, 40, HELD_FRAME, HELD_LOCAL)
J_KEYFRAME_HELD = CalibratedUserKeys(3, 7, None, None, 2, held_local=(*FRAMES[1], HEIGHTS[30]))
ENDS = {
    "all sought": (I_FREE, J_FREE),
    "i's frame held": (I_FRAME_HELD, J_FREE),
    "i's keyframe held": (I_KEYFRAME_HELD, J_FREE),
    "j's keyframe held": (I_FREE, J_KEYFRAME_HELD),
    "both keyframes held": (I_KEYFRAME_HELD, J_KEYFRAME_HELD),
    "of i the device alone sought": (I_HELD, J_FREE),
}
RangeEnds = tuple[CalibratedUserKeys, CalibratedUserKeys]


@pytest.fixture(scope="module", params=sorted(LOSSES))
def loss(request: pytest.FixtureRequest) -> Loss:
    return LOSSES[request.param]


@pytest.fixture(scope="module", params=sorted(ENDS))
def ends(request: pytest.FixtureRequest) -> RangeEnds:
    return ENDS[request.param]


def values_of(keys: list[int]) -> gtsam.Values:
    values = gtsam.Values()
    for key in keys:
        if key in FRAMES:
            values.insert(key, gtsam.Pose2(*FRAMES[key]))
        else:
            values.insert(key, HEIGHTS[key] if key in HEIGHTS else np.array(DEVICES[key]))
    return values


def moved(values: gtsam.Values, key: int, delta: Array) -> gtsam.Values:
    """The values after gtsam's own retraction of one variable."""
    step = gtsam.VectorValues()
    step.insert(key, delta)
    return values.retract(step)


def steps(keys: list[int], h: float) -> Iterator[tuple[int, Array]]:
    for key in keys:
        for direction in np.eye(1 if key in HEIGHTS else 3):
            yield key, h * direction


def slot_of(n: int, offset: float = 0.3) -> RangeSlot:
    """n ranges with noise between the ends, all too long by `offset`; where that is above 0 no height is bent."""
    random = np.random.default_rng(1)
    i, j = (tuple(random.normal(0.0, spread, (n, 3)) for spread in (4.0, 0.2, 1.0)) for _ in "ij")
    sigma, odds, range_weight = np.full(n, 0.1), np.full(n, 0.25), random.uniform(0.2, 1.5, n)
    first = np.zeros(n, dtype=np.int32)
    exact = RangeSlot(2, first, first + 1, i, j, np.zeros(n), sigma, odds, range_weight).residuals(
        *read(I_FREE, J_FREE)
    )
    distance = exact + random.normal(0.0, 0.1, n) + offset
    return RangeSlot(2, first, first + 1, i, j, distance, sigma, odds, range_weight)


def read(i: CalibratedUserKeys, j: CalibratedUserKeys) -> tuple[Array, Array]:
    """Poses (2, 8) and calibrations (2, 3)."""
    values = values_of(i.keys() + j.keys())
    at = np.array([i.read(values), j.read(values)])
    return at[:, :8].copy(), at[:, 8:].copy()


def test_one_range_has_the_numerical_jacobians(ends: RangeEnds) -> None:
    i, j = ends
    keys = i.keys() + j.keys()
    slot, values, h = slot_of(1), values_of(keys), 1e-5
    factor = RangeSlotFactor([i, j], slot, Squared())

    def residual(key: int, delta: Array) -> float:
        # Predicted shorter than measured, the root of twice the cost is minus the whitened residual.
        return -float(np.sqrt(2.0 * factor.error(moved(values, key, delta))))

    assert slot.residuals(*read(i, j))[0] < 0.0
    numerical = np.array([(residual(key, d) - residual(key, -d)) / (2 * h) for key, d in steps(keys, h)])
    A, b = factor.linearize(values).jacobian()
    # One range is one row: up to its sign, which it shares with its right side.
    row, right = A[np.argmax(np.abs(b))], b[np.argmax(np.abs(b))]
    np.testing.assert_allclose(row * np.sign(right), numerical, atol=1e-7)
    assert abs(right) == pytest.approx(-residual(keys[0], np.zeros_like(next(steps(keys, h))[1])))
    np.testing.assert_allclose(A.T @ A, np.outer(numerical, numerical), atol=1e-6)


@pytest.mark.parametrize("offset", [0.3, -0.3])
def test_many_ranges_give_the_numerical_gradient(ends: RangeEnds, loss: Loss, offset: float) -> None:
    i, j = ends
    keys = i.keys() + j.keys()
    factor, values, h = RangeSlotFactor([i, j], slot_of(40, offset), loss), values_of(keys), 1e-5

    def error(key: int, delta: Array) -> float:
        return factor.error(moved(values, key, delta))

    numerical = [
        (error(key, -2 * d) - 8 * error(key, -d) + 8 * error(key, d) - error(key, 2 * d)) / (12 * h)
        for key, d in steps(keys, h)
    ]
    A, b = factor.linearize(values).jacobian()
    np.testing.assert_allclose(-A.T @ b, numerical, atol=1e-7 * np.abs(A).max() * np.abs(b).max())


def test_what_is_held_is_where_it_is_said_to_be(ends: RangeEnds) -> None:
    slot = slot_of(20)
    np.testing.assert_array_equal(slot.residuals(*read(*ends)), slot.residuals(*read(I_FREE, J_FREE)))


@pytest.mark.parametrize("annealing", [1.0, 4.0])
def test_a_thousand_ranges_are_at_most_fifteen_rows_and_the_error_is_the_cost(loss: Loss, annealing: float) -> None:
    slot, values = slot_of(1000), values_of(I_FREE.keys() + J_FREE.keys())
    factor = RangeSlotFactor([I_FREE, J_FREE], slot, loss, annealing)
    cost = slot.cost(*read(I_FREE, J_FREE), loss, annealing)
    error = factor.unwhitenedError(values)
    assert error.shape == (1,)
    assert np.linalg.norm(error) == pytest.approx(np.sqrt(2.0 * cost), rel=1e-12)
    assert factor.error(values) == pytest.approx(cost, rel=1e-12)
    A, b = factor.linearize(values).jacobian()
    assert A.shape[1] == 22
    assert len(A) == len(b) <= 15


def test_keys_come_in_the_order_of_the_columns(ends: RangeEnds) -> None:
    i, j = ends
    factor = RangeSlotFactor([i, j], slot_of(3), Squared())
    assert list(factor.keys()) == [key for key in (*i[:5], *j[:5]) if key is not None]
    assert i.columns(0)[-1] == slice(8, 11)
    assert j.columns(11)[-1] == slice(19, 22)
    assert len(i.columns(0)) == len(i.keys())


def test_what_is_held_has_no_columns() -> None:
    assert I_HELD.keys() == [40]
    assert I_HELD.columns(0) == [slice(8, 11)]
    assert I_KEYFRAME_HELD.keys() == [20, 9, 40]
    assert I_KEYFRAME_HELD.columns(0) == [slice(0, 3), slice(3, 4), slice(8, 11)]
    assert I_FRAME_HELD.columns(11) == [slice(15, 18), slice(18, 19), slice(19, 22)]


def test_a_graph_that_goes_takes_its_factors_along() -> None:
    """At once and without the garbage collector: nothing in a factor holds the factor."""
    gc.collect()
    gc.disable()
    try:
        slot = slot_of(10)
        held = sys.getrefcount(slot)
        graph = gtsam.NonlinearFactorGraph()
        graph.add(RangeSlotFactor([I_FREE, J_FREE], slot, Squared()))
        graph.linearize(values_of(I_FREE.keys() + J_FREE.keys()))
        assert sys.getrefcount(slot) == held + 1
        del graph
        assert sys.getrefcount(slot) == held
    finally:
        gc.enable()


def test_factors_live_as_long_as_their_graph() -> None:
    graph = gtsam.NonlinearFactorGraph()
    graph.add(RangeSlotFactor([I_FREE, J_FREE], slot_of(10), Squared()))
    gc.collect()
    expected = slot_of(10).cost(*read(I_FREE, J_FREE), Squared())
    assert graph.error(values_of(I_FREE.keys() + J_FREE.keys())) == pytest.approx(expected, rel=1e-12)
