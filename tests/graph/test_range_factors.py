from __future__ import annotations

import gc
import sys
import weakref
from collections.abc import Iterator
from typing import TYPE_CHECKING

import gtsam
import numpy as np
import pytest

from synchronizar._core import Cauchy, GemanMcClure, Huber, NlosMixture, RangeBlock, Squared, UserPose
from synchronizar.arrays import Array
from synchronizar.graph.range_factors import FixedUser, RangeBlockFactor, RangeFactor, UserKeys

if TYPE_CHECKING:
    from synchronizar._core import Loss

SIGMA = 0.1
NOISE = gtsam.noiseModel.Isotropic.Sigma(1, SIGMA)
LOSSES: dict[str, Loss] = {
    "squared": Squared(),
    "huber": Huber(),
    "cauchy": Cauchy(),
    "geman_mcclure": GemanMcClure(),
    "late": NlosMixture(1.0, 0.002),
}

# j's frame comes before i's, a height before its frame: the keys are in no order at all.
I_RIGID, J_RIGID = UserKeys(frame=20, height=9), UserKeys(frame=3, height=7)
I_MOVING, J_MOVING = UserKeys(20, 9, pose=5, local_height=12), UserKeys(3, 7, pose=1, local_height=30)
FRAMES = {20: (1.0, -2.0, 0.4), 3: (4.0, 3.0, -2.5), 5: (0.5, 1.5, -1.2), 1: (-1.0, 0.25, 0.8)}
HEIGHTS = {9: 0.3, 7: -0.2, 12: 0.1, 30: 0.05}
I_FIXED = FixedUser(UserPose(*FRAMES[20], HEIGHTS[9], *FRAMES[5], HEIGHTS[12]))
J_FIXED = FixedUser(UserPose(*FRAMES[3], HEIGHTS[7]))

User = UserKeys | FixedUser
ENDS: dict[str, tuple[User, User]] = {
    "poses trusted": (I_RIGID, J_RIGID),
    "poses estimated": (I_MOVING, J_MOVING),
    "i's poses estimated": (I_MOVING, J_RIGID),
    "j's poses estimated": (I_RIGID, J_MOVING),
    "i's keyframe without a height": (UserKeys(20, 9, pose=5), J_MOVING),
    "i's keyframe a height alone": (UserKeys(20, 9, local_height=12), J_MOVING),
    "i fixed": (I_FIXED, J_MOVING),
    "j fixed": (I_MOVING, J_FIXED),
    "i fixed, poses trusted": (I_FIXED, J_RIGID),
    "j fixed, poses trusted": (I_RIGID, J_FIXED),
}


@pytest.fixture(scope="module", params=sorted(LOSSES))
def loss(request: pytest.FixtureRequest) -> Loss:
    return LOSSES[request.param]


@pytest.fixture(scope="module", params=sorted(ENDS))
def ends(request: pytest.FixtureRequest) -> tuple[User, User]:
    return ENDS[request.param]


def values_of(i: User, j: User) -> gtsam.Values:
    values = gtsam.Values()
    for key in i.keys() + j.keys():
        values.insert(key, gtsam.Pose2(*FRAMES[key]) if key in FRAMES else HEIGHTS[key])
    return values


def moved(values: gtsam.Values, key: int, delta: Array) -> gtsam.Values:
    """The values after gtsam's own retraction of one variable."""
    out = gtsam.Values(values)
    if key in FRAMES:
        out.update(key, values.atPose2(key).retract(delta))
    else:
        out.update(key, values.atDouble(key) + float(delta[0]))
    return out


def steps(keys: list[int], h: float) -> Iterator[tuple[int, Array]]:
    for key in keys:
        for direction in np.eye(3 if key in FRAMES else 1):
            yield key, h * direction


def antenna_pairs(n: int) -> tuple[Array, Array]:
    o_i, o_j = np.random.default_rng(1).normal(0.0, [4.0, 4.0, 0.5], (2, n, 3))
    return o_i, o_j


def block_of(n: int, late: float = 0.0, offset: float = 0.05) -> RangeBlock:
    """n ranges of `ENDS` with noise; with an offset above 0 no height is bent."""
    o_i, o_j = antenna_pairs(n)
    pose_i = UserPose(*FRAMES[20], HEIGHTS[9], *FRAMES[5], HEIGHTS[12])
    pose_j = UserPose(*FRAMES[3], HEIGHTS[7], *FRAMES[1], HEIGHTS[30])
    random = np.random.default_rng(1)
    sigma, zeros = np.full(n, SIGMA), np.zeros(n)
    exact = RangeBlock(o_i, o_j, zeros, sigma, zeros).residuals(pose_i, pose_j)
    detour = np.where(random.random(n) < late, random.uniform(0.3, 3.0, n), 0.0)
    measured = exact + random.normal(0.0, SIGMA, n) + detour + offset
    return RangeBlock(o_i, o_j, measured, sigma, np.full(n, 0.25))


def poses_of(i: User, j: User, values: gtsam.Values) -> tuple[UserPose, UserPose]:
    return i.read(values), j.read(values)


def test_a_range_factors_error_by_hand() -> None:
    values = gtsam.Values()
    # Turned by a quarter, i's antenna at (1, 2) is at (8, 21, 5.5); j's is at (8, 24, 1.5): 5 m.
    values.insert(20, gtsam.Pose2(10.0, 20.0, np.pi / 2.0))
    values.insert(9, 5.0)
    values.insert(3, gtsam.Pose2(8.0, 24.0, 0.0))
    values.insert(7, 1.0)
    factor = RangeFactor(I_RIGID, J_RIGID, [1.0, 2.0, 0.5], [0.0, 0.0, 0.5], 4.7, NOISE)
    assert factor.unwhitenedError(values) == pytest.approx([0.3])
    graph = gtsam.NonlinearFactorGraph()
    graph.add(factor)
    assert graph.error(values) == pytest.approx(0.5 * (0.3 / SIGMA) ** 2)
    assert list(factor.keys()) == [20, 9, 3, 7]


def test_a_keyframe_lies_in_its_users_frame() -> None:
    values = gtsam.Values()
    values.insert(20, gtsam.Pose2(10.0, 0.0, np.pi / 2.0))
    values.insert(9, 1.0)
    values.insert(5, gtsam.Pose2(2.0, 0.0, np.pi / 2.0))
    values.insert(12, 0.25)
    # i's antenna is at (9, 2, 2); the anchor at (9, 0, 2).
    anchor = FixedUser(UserPose(9.0, 0.0, 0.0, 2.0))
    factor = RangeFactor(I_MOVING, anchor, [1.0, 0.0, 0.75], [0.0, 0.0, 0.0], 1.9, NOISE)
    assert factor.unwhitenedError(values) == pytest.approx([0.1])


def test_a_keyframe_without_a_height_lies_at_height_zero() -> None:
    # Turned to the left by 90 degrees about (1, 2): the antenna at (3, 0, 0.5) lies at (1, 5, 0.5) of its user's frame.
    i, j = UserKeys(1, 2, pose=3), FixedUser(UserPose())
    values = gtsam.Values()
    values.insert(1, gtsam.Pose2())
    values.insert(2, 10.0)
    values.insert(3, gtsam.Pose2(1.0, 2.0, np.pi / 2.0))
    noise = gtsam.noiseModel.Isotropic.Sigma(1, 1.0)
    factor = RangeFactor(i, j, (3.0, 0.0, 0.5), (0.0, 0.0, 0.0), 0.0, noise)
    assert factor.unwhitenedError(values)[0] == pytest.approx(np.sqrt(1.0 + 25.0 + 10.5**2))


def test_a_range_factors_jacobians_are_the_numerical_ones(ends: tuple[User, User]) -> None:
    i, j = ends
    o_i, o_j = antenna_pairs(1)
    factor = RangeFactor(i, j, o_i[0], o_j[0], 3.0, NOISE)
    values = values_of(i, j)
    h = 1e-5
    numerical = [
        (factor.unwhitenedError(moved(values, key, d)) - factor.unwhitenedError(moved(values, key, -d))) / (2 * h)
        for key, d in steps(i.keys() + j.keys(), h)
    ]
    A, b = factor.linearize(values).jacobian()
    np.testing.assert_allclose(A * SIGMA, np.array(numerical).T, atol=1e-8)
    np.testing.assert_allclose(b, -factor.unwhitenedError(values) / SIGMA)


def test_a_blocks_jacobians_give_the_numerical_gradient(ends: tuple[User, User], loss: Loss) -> None:
    i, j = ends
    factor = RangeBlockFactor(i, j, block_of(60, late=0.3), loss)
    values = values_of(i, j)
    h = 1e-4

    def error(key: int, d: Array) -> float:
        return factor.error(moved(values, key, d))

    numerical = [
        (error(key, -2 * d) - 8 * error(key, -d) + 8 * error(key, d) - error(key, 2 * d)) / (12 * h)
        for key, d in steps(i.keys() + j.keys(), h)
    ]
    A, b = factor.linearize(values).jacobian()
    np.testing.assert_allclose(-A.T @ b, numerical, atol=1e-8 * np.abs(A).max() * np.abs(b).max())


def test_a_block_is_as_good_as_its_ranges_one_by_one(ends: tuple[User, User]) -> None:
    i, j = ends
    block = block_of(60, offset=0.3)
    graph = range_factors(i, j, 60, residuals=block.residuals(*poses_of(i, j, values_of(i, j))))
    values = values_of(i, j)
    factor = RangeBlockFactor(i, j, block, Squared())
    assert factor.error(values) == pytest.approx(graph.error(values), rel=1e-12)
    ordering = gtsam.Ordering()
    for key in i.keys() + j.keys():
        ordering.push_back(key)
    singles, gradient = graph.linearize(values).hessian(ordering)
    A, b = factor.linearize(values).jacobian()
    extra = A.T @ A - singles
    # A fixed user stands elsewhere than where the ranges were made: where they are too long, heights are bent.
    heights = [n for n, (key, _) in enumerate(steps(i.keys() + j.keys(), 1.0)) if key in HEIGHTS]
    extra[np.ix_(heights, heights)] = 0.0
    np.testing.assert_allclose(extra, 0.0, atol=1e-10 * np.abs(singles).max())
    np.testing.assert_allclose(A.T @ b, gradient, atol=1e-10 * np.abs(singles).max())


def range_factors(i: User, j: User, n: int, residuals: Array) -> gtsam.NonlinearFactorGraph:
    """The ranges of `block_of`, one factor each; `residuals` are those that they have at `values_of(i, j)`."""
    o_i, o_j = antenna_pairs(n)
    zeros = np.zeros(n)
    predicted = RangeBlock(o_i, o_j, zeros, np.full(n, SIGMA), zeros).residuals(*poses_of(i, j, values_of(i, j)))
    graph = gtsam.NonlinearFactorGraph()
    for a, b, d in zip(o_i, o_j, predicted - residuals, strict=True):
        graph.add(RangeFactor(i, j, a, b, float(d), NOISE))
    return graph


def test_one_block_and_many_factors_have_the_same_optimum() -> None:
    i, j = FixedUser(UserPose(*FRAMES[20], HEIGHTS[9])), J_RIGID
    truth = values_of(i, j)
    o_i, o_j = antenna_pairs(100)
    zeros, sigma = np.zeros(100), np.full(100, SIGMA)
    noise = np.random.default_rng(2).normal(0.0, SIGMA, 100)
    measured = RangeBlock(o_i, o_j, zeros, sigma, zeros).residuals(*poses_of(i, j, truth)) + noise
    singles = range_factors(i, j, 100, residuals=-noise)
    block = gtsam.NonlinearFactorGraph()
    block.add(RangeBlockFactor(i, j, RangeBlock(o_i, o_j, measured, sigma, zeros), Squared()))

    start = moved(moved(truth, 3, np.array([0.5, -0.4, 0.3])), 7, np.array([0.2]))
    assert block.error(start) == pytest.approx(singles.error(start), rel=1e-12)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-14)
    parameters.setAbsoluteErrorTol(1e-14)
    one, many = (gtsam.LevenbergMarquardtOptimizer(g, start, parameters).optimize() for g in (block, singles))
    apart = one.atPose2(3).localCoordinates(many.atPose2(3))
    np.testing.assert_allclose(apart, 0.0, atol=1e-6)
    assert one.atDouble(7) == pytest.approx(many.atDouble(7), abs=1e-6)
    assert block.error(one) == pytest.approx(singles.error(many), rel=1e-9)
    np.testing.assert_allclose(one.atPose2(3).localCoordinates(truth.atPose2(3)), 0.0, atol=0.1)


def test_a_block_alone_leads_back_from_a_start_that_is_off(loss: Loss) -> None:
    i, j = FixedUser(UserPose(*FRAMES[20], HEIGHTS[9])), J_RIGID
    truth = values_of(i, j)
    o_i, o_j = antenna_pairs(200)
    zeros, sigma = np.zeros(200), np.full(200, SIGMA)
    measured = RangeBlock(o_i, o_j, zeros, sigma, zeros).residuals(*poses_of(i, j, truth))
    graph = gtsam.NonlinearFactorGraph()
    graph.add(RangeBlockFactor(i, j, RangeBlock(o_i, o_j, measured, sigma, np.full(200, 0.25)), loss))
    start = moved(moved(truth, 3, np.array([0.1, -0.1, 0.03])), 7, np.array([0.1]))
    found = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize()
    np.testing.assert_allclose(found.atPose2(3).localCoordinates(truth.atPose2(3)), 0.0, atol=1e-3)
    assert found.atDouble(7) == pytest.approx(truth.atDouble(7), abs=1e-3)


def test_a_range_factor_takes_gtsams_own_robust_losses() -> None:
    huber = gtsam.noiseModel.mEstimator.Huber.Create(1.345)
    robust = gtsam.noiseModel.Robust.Create(huber, NOISE)
    factor = RangeFactor(I_RIGID, J_FIXED, np.zeros(3), np.zeros(3), 1.0, robust)
    values = values_of(I_RIGID, J_FIXED)
    whitened = float(np.hypot(np.hypot(3.0, 5.0), 0.5) - 1.0) / SIGMA
    assert factor.error(values) == pytest.approx(1.345 * (whitened - 1.345 / 2.0))
    _, b = factor.linearize(values).jacobian()
    assert b[0] == pytest.approx(-np.sqrt(1.345 / whitened) * whitened)


@pytest.mark.parametrize("annealing", [1.0, 4.0])
def test_a_thousand_ranges_are_five_rows_whose_half_square_is_the_cost(loss: Loss, annealing: float) -> None:
    block = block_of(1000, late=0.2)
    factor = RangeBlockFactor(I_MOVING, J_MOVING, block, loss, annealing)
    values = values_of(I_MOVING, J_MOVING)
    error = factor.unwhitenedError(values)
    assert error.shape == (5,)
    assert factor.dim() == 5
    cost = block.cost(*poses_of(I_MOVING, J_MOVING, values), loss, annealing)
    assert error @ error / 2.0 == pytest.approx(cost, rel=1e-12)
    assert factor.error(values) == pytest.approx(cost, rel=1e-12)
    A, b = factor.linearize(values).jacobian()
    assert A.shape == (5, 16)
    assert b.shape == (5,)


def test_ranges_that_fit_cost_nothing_and_no_nan() -> None:
    o_i, o_j = antenna_pairs(20)
    zeros, sigma = np.zeros(20), np.full(20, SIGMA)
    values = values_of(I_RIGID, J_RIGID)
    exact = RangeBlock(o_i, o_j, zeros, sigma, zeros).residuals(*poses_of(I_RIGID, J_RIGID, values))
    for loss in LOSSES.values():
        block = RangeBlock(o_i, o_j, exact, sigma, np.full(20, 0.25))
        assert RangeBlockFactor(I_RIGID, J_RIGID, block, loss).error(values) == 0.0


def test_a_graph_that_goes_takes_its_factors_along() -> None:
    """At once and without the garbage collector: nothing in a factor holds the factor."""
    gc.collect()
    gc.disable()
    try:
        block, antenna = block_of(10), np.zeros(3)
        held, antenna_lives = sys.getrefcount(block), weakref.ref(antenna)
        values = values_of(I_RIGID, J_RIGID)
        graph = gtsam.NonlinearFactorGraph()
        graph.add(RangeBlockFactor(I_RIGID, J_RIGID, block, Squared()))
        graph.add(RangeFactor(I_RIGID, J_RIGID, antenna, np.ones(3), 1.0, NOISE))
        del antenna
        graph.linearize(values)
        assert sys.getrefcount(block) == held + 1
        assert antenna_lives() is not None
        del graph
        assert sys.getrefcount(block) == held
        assert antenna_lives() is None
    finally:
        gc.enable()


def test_factors_live_as_long_as_their_graph() -> None:
    values = values_of(I_RIGID, J_RIGID)
    graph = gtsam.NonlinearFactorGraph()
    graph.add(RangeBlockFactor(I_RIGID, J_RIGID, block_of(10), Squared()))
    expected = block_of(10).cost(*poses_of(I_RIGID, J_RIGID, values), Squared())
    gc.collect()
    assert graph.error(values) == pytest.approx(expected, rel=1e-12)


def test_two_anchors_leave_nothing_to_estimate() -> None:
    assert I_FIXED.keys() == J_FIXED.keys() == []
    assert I_MOVING.keys() == [20, 9, 5, 12]
    assert I_RIGID.keys() == [20, 9]
