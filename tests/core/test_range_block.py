from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from support import reference_kernel as reference
from support.reference_kernel import Measured

from synchronizar._core import Cauchy, GemanMcClure, Huber, NlosMixture, RangeBlock, Squared, UserPose
from synchronizar.arrays import Array

if TYPE_CHECKING:
    from synchronizar._core import Loss

LATE = NlosMixture(scale=1.0, early_odds=0.002)
LOSSES: dict[str, Loss] = {
    "squared": Squared(),
    "huber": Huber(),
    "cauchy": Cauchy(),
    "geman_mcclure": GemanMcClure(),
    "late": LATE,
}
annealings = pytest.mark.parametrize("annealing", [1.0, 3.0])

PLACE_I = np.array([1.0, -2.0, 0.4, 0.3, 0.5, 1.5, -1.2, 0.1])
PLACE_J = np.array([4.0, 3.0, -2.5, -0.2, -1.0, 0.25, 0.8, 0.05])


@pytest.fixture(scope="module", params=sorted(LOSSES))
def loss(request: pytest.FixtureRequest) -> Loss:
    return LOSSES[request.param]


def measured(n: int, noise: float, late: float = 0.0, seed: int = 1, offset: float = 0.0) -> Measured:
    """n ranges with noise (sigmas), a share `late` of them late by up to 3 m, and all of them off by `offset` (m)."""
    random = np.random.default_rng(seed)
    o_i, o_j = random.normal(0.0, [4.0, 4.0, 0.5], (2, n, 3))
    sigma = random.uniform(0.05, 0.2, n)
    exact = np.array([reference.distance(PLACE_I, a, PLACE_J, b) for a, b in zip(o_i, o_j, strict=True)])
    detour = np.where(random.random(n) < late, random.uniform(0.3, 3.0, n), 0.0)
    distance = exact + noise * sigma * random.normal(size=n) + detour + offset
    return Measured(o_i, o_j, distance, sigma, random.uniform(0.05, 0.5, n))


def square_root(
    ranges: Measured, loss: Loss, annealing: float = 1.0, i: Array = PLACE_I, j: Array = PLACE_J
) -> tuple[Array, Array]:
    """A (5, 16) and b (5,)."""
    root = ranges.block().square_root(UserPose(*i), UserPose(*j), loss, annealing)
    assert root.shape == (5, 17)
    return root[:, :-1], root[:, -1]


def numerical_gradient(ranges: Measured, loss: Loss, annealing: float) -> Array:
    """Of the block's own cost under gtsam's retraction, by central differences of the fourth order."""
    block = ranges.block()

    def cost(delta: Array) -> float:
        i, j = reference.perturbed(PLACE_I, delta[:8]), reference.perturbed(PLACE_J, delta[8:])
        return block.cost(UserPose(*i), UserPose(*j), loss, annealing)

    h = 1e-4
    steps = h * np.eye(16)
    return np.array([(cost(-2 * d) - 8 * cost(-d) + 8 * cost(d) - cost(2 * d)) / (12 * h) for d in steps])


def test_residuals_are_predicted_minus_measured_one_by_one() -> None:
    ranges = measured(50, noise=1.0, late=0.3)
    found = ranges.block().residuals(UserPose(*PLACE_I), UserPose(*PLACE_J))
    np.testing.assert_allclose(found, reference.residuals(PLACE_I, PLACE_J, ranges), atol=1e-12)
    assert len(ranges.block()) == 50


@annealings
def test_the_cost_and_the_weights_are_those_of_single_ranges(loss: Loss, annealing: float) -> None:
    ranges = measured(60, noise=1.0, late=0.3)
    block, pose_i, pose_j = ranges.block(), UserPose(*PLACE_I), UserPose(*PLACE_J)
    rho, weight, _ = reference.losses(PLACE_I, PLACE_J, ranges, loss, annealing).T
    assert block.cost(pose_i, pose_j, loss, annealing) == pytest.approx(rho.sum(), rel=1e-12)
    np.testing.assert_allclose(block.weights(pose_i, pose_j, loss, annealing), weight, rtol=1e-8, atol=1e-10)


@annealings
@pytest.mark.parametrize("offset", [0.0, 0.6, -0.6])
def test_the_five_rows_hold_the_gradient_of_the_cost_exactly(loss: Loss, annealing: float, offset: float) -> None:
    ranges = measured(60, noise=1.0, late=0.3, offset=offset)
    A, b = square_root(ranges, loss, annealing)
    scale = np.abs(A.T @ b).max()
    np.testing.assert_allclose(A.T @ b, numerical_gradient(ranges, loss, annealing), atol=1e-8 * scale)
    np.testing.assert_allclose(
        A.T @ b, reference.gradient(PLACE_I, PLACE_J, ranges, loss, annealing), atol=1e-8 * scale
    )


@annealings
@pytest.mark.parametrize("offset", [0.0, 0.6, -0.6])
def test_the_five_rows_hold_the_documented_information(loss: Loss, annealing: float, offset: float) -> None:
    ranges = measured(60, noise=1.0, late=0.3, offset=offset)
    A, _ = square_root(ranges, loss, annealing)
    expected = reference.information(PLACE_I, PLACE_J, ranges, loss, annealing)
    np.testing.assert_allclose(A.T @ A, expected, atol=1e-8 * np.abs(expected).max())


def test_heights_are_bent_where_ranges_are_too_long_alone() -> None:
    """Ranges predicted too long pull a level user up or down; predicted too short they hold it."""
    too_long, too_short = measured(40, noise=0.5, offset=-0.5), measured(40, noise=0.5, offset=0.5)
    for ranges, bent in ((too_long, True), (too_short, False)):
        assert (reference.height_curvature(PLACE_I, PLACE_J, ranges, Squared()) > 0.0) == bent
        J_whitened = reference.rows(PLACE_I, PLACE_J, ranges) / ranges.sigma[:, None]
        A, _ = square_root(ranges, Squared())
        extra = A.T @ A - J_whitened.T @ J_whitened
        height_curvature = max(reference.height_curvature(PLACE_I, PLACE_J, ranges, Squared()), 0.0)
        heights = np.array([3, 7, 11, 15])
        signs = np.array([1.0, 1.0, -1.0, -1.0])
        expected = np.zeros((16, 16))
        expected[np.ix_(heights, heights)] = height_curvature * np.outer(signs, signs)
        np.testing.assert_allclose(extra, expected, atol=1e-9 * np.abs(A.T @ A).max())
        assert (height_curvature > 100.0) == bent


def test_the_bending_of_a_level_walk_is_the_second_derivative_of_its_cost() -> None:
    """Seen level, a height has no row at all: the whole second derivative of the cost is the bending."""
    ranges = measured(40, noise=0.5, offset=-0.5)
    for heights in (ranges.o_i, ranges.o_j):
        heights[:, 2] = 0.0
    flat_i, flat_j = (
        np.array([*PLACE_I[:3], 0.0, *PLACE_I[4:7], 0.0]),
        np.array([*PLACE_J[:3], 0.0, *PLACE_J[4:7], 0.0]),
    )
    A, _ = square_root(ranges, Squared(), i=flat_i, j=flat_j)
    block, h = ranges.block(), 1e-3

    def cost(height: float) -> float:
        lifted = np.array([*flat_i[:3], height, *flat_i[4:]])
        return block.cost(UserPose(*lifted), UserPose(*flat_j), Squared())

    assert (A.T @ A)[3, 3] == pytest.approx((cost(h) - 2.0 * cost(0.0) + cost(-h)) / h**2, rel=1e-5)


def test_for_squared_losses_the_squares_of_all_rows_are_kept() -> None:
    ranges = measured(200, noise=1.0, offset=0.05)
    assert reference.height_curvature(PLACE_I, PLACE_J, ranges, Squared()) < 0.0
    A, b = square_root(ranges, Squared())
    e = reference.residuals(PLACE_I, PLACE_J, ranges) / ranges.sigma
    stacked = np.column_stack([reference.rows(PLACE_I, PLACE_J, ranges) / ranges.sigma[:, None], e])
    found = np.column_stack([A, b])
    expected = stacked.T @ stacked
    np.testing.assert_allclose(found.T @ found, expected, atol=1e-12 * np.abs(expected).max())
    assert b @ b / 2.0 == pytest.approx(
        ranges.block().cost(UserPose(*PLACE_I), UserPose(*PLACE_J), Squared()), rel=1e-12
    )


@pytest.mark.parametrize("n", [1, 2, 4, 5, 511, 512, 513, 1024, 512 * 3 + 1])
@pytest.mark.parametrize("offset", [0.3, -0.3])
def test_any_number_of_ranges_is_squeezed_alike(n: int, offset: float) -> None:
    ranges = measured(n, noise=1.0, late=0.2, offset=offset)
    A, b = square_root(ranges, Huber())
    e = reference.residuals(PLACE_I, PLACE_J, ranges) / ranges.sigma
    J_whitened = reference.rows(PLACE_I, PLACE_J, ranges) / ranges.sigma[:, None]
    weight = np.minimum(1.0, Huber().k / np.abs(e))
    kept = np.where(np.abs(e) <= Huber().k, 1.0, 0.1 * weight)
    expected = J_whitened.T @ (kept[:, None] * J_whitened)
    up = np.zeros(16)
    up[[3, 7]], up[[11, 15]] = 1.0, -1.0
    expected += max(bending_of(ranges, weight * e), 0.0) * np.outer(up, up)
    np.testing.assert_allclose(A.T @ A, expected, atol=1e-12 * np.abs(expected).max())
    gradient = J_whitened.T @ (weight * e)
    np.testing.assert_allclose(A.T @ b, gradient, atol=1e-11 * np.abs(J_whitened).sum())


def bending_of(ranges: Measured, slope: Array) -> float:
    q_i = np.array([reference.antenna(PLACE_I, o) for o in ranges.o_i])
    q_j = np.array([reference.antenna(PLACE_J, o) for o in ranges.o_j])
    between = q_i - q_j
    length = np.linalg.norm(between, axis=1)
    return float((slope / ranges.sigma * (1.0 - (between[:, 2] / length) ** 2) / length).sum())


def test_the_order_of_ranges_does_not_matter(loss: Loss) -> None:
    ranges = measured(700, noise=1.0, late=0.2)
    order = np.random.default_rng(3).permutation(700)
    shuffled = Measured(*(column[order] for column in ranges))
    pose_i, pose_j = UserPose(*PLACE_I), UserPose(*PLACE_J)
    cost = ranges.block().cost(pose_i, pose_j, loss)
    assert shuffled.block().cost(pose_i, pose_j, loss) == pytest.approx(cost, rel=1e-12)
    (A, b), (A_shuffled, b_shuffled) = square_root(ranges, loss), square_root(shuffled, loss)
    np.testing.assert_allclose(A_shuffled.T @ A_shuffled, A.T @ A, atol=1e-11 * np.abs(A.T @ A).max())
    np.testing.assert_allclose(A_shuffled.T @ b_shuffled, A.T @ b, atol=1e-10 * np.abs(A.T @ A).max())


def test_who_is_called_i_does_not_matter(loss: Loss) -> None:
    ranges = measured(60, noise=1.0, late=0.3)
    swapped = ranges._replace(o_i=ranges.o_j, o_j=ranges.o_i)
    pose_i, pose_j = UserPose(*PLACE_I), UserPose(*PLACE_J)
    cost = ranges.block().cost(pose_i, pose_j, loss)
    assert swapped.block().cost(pose_j, pose_i, loss) == pytest.approx(cost, rel=1e-12)
    (A, b), (A_swapped, b_swapped) = square_root(ranges, loss), square_root(swapped, loss, i=PLACE_J, j=PLACE_I)
    A_swapped = np.roll(A_swapped, 8, axis=1)
    np.testing.assert_allclose(A_swapped.T @ A_swapped, A.T @ A, atol=1e-11 * np.abs(A.T @ A).max())
    np.testing.assert_allclose(A_swapped.T @ b_swapped, A.T @ b, atol=1e-10 * np.abs(A.T @ A).max())


def test_ranges_that_are_all_late_by_far_give_little_and_never_nan(loss: Loss) -> None:
    ranges = measured(30, noise=1.0, offset=200.0)
    A, b = square_root(ranges, loss)
    assert np.isfinite(A).all()
    assert np.isfinite(b).all()
    if isinstance(loss, GemanMcClure | NlosMixture):
        inlier_probability, _ = square_root(measured(30, noise=1.0), loss)
        assert np.abs(A).max() < 1e-2 * np.abs(inlier_probability).max()


def test_a_weight_that_vanishes_leaves_no_information_and_no_nan(loss: Loss) -> None:
    ranges = Measured(np.zeros((3, 3)), np.ones((3, 3)), np.full(3, 1e100), np.ones(3), np.ones(3))
    A, b = square_root(ranges, loss, i=np.zeros(8), j=np.zeros(8))
    assert np.isfinite(A).all()
    assert np.isfinite(b).all()


def test_antennas_that_coincide_count_in_the_cost_and_pull_nowhere(loss: Loss) -> None:
    ranges = Measured(np.zeros((2, 3)), np.zeros((2, 3)), np.array([0.1, -0.05]), np.full(2, 0.1), np.full(2, 0.25))
    still = np.zeros(8)
    A, b = square_root(ranges, loss, i=still, j=still)
    np.testing.assert_array_equal(A, np.zeros((5, 16)))
    assert np.isfinite(b).all()
    expected = loss(-1.0, 0.1, 0.25)[0] + loss(0.5, 0.1, 0.25)[0]
    assert ranges.block().cost(UserPose(), UserPose(), loss) == pytest.approx(expected, rel=1e-12)


def test_the_probability_of_being_honest_is_bayes() -> None:
    ranges = measured(60, noise=1.5, late=0.3)
    e = reference.residuals(PLACE_I, PLACE_J, ranges) / ranges.sigma
    odds = np.where(e < 0.0, ranges.nlos_odds, LATE.early_odds)
    inlier_probability = reference.honest_density(e, ranges.sigma)
    stray = odds * reference.stray_density(e, ranges.sigma, LATE.scale)
    found = ranges.block().inlier_probability(UserPose(*PLACE_I), UserPose(*PLACE_J), LATE)
    np.testing.assert_allclose(found, inlier_probability / (inlier_probability + stray), rtol=1e-9)
    assert found.min() < 0.1 < 0.9 < found.max()


def test_other_odds_make_another_block_of_the_same_ranges() -> None:
    ranges = measured(20, noise=1.0, late=0.3)
    odds = np.linspace(0.1, 3.0, 20)
    block = ranges.block()
    before = block.cost(UserPose(*PLACE_I), UserPose(*PLACE_J), LATE)
    other = block.with_nlos_odds(odds)
    expected = reference.cost(PLACE_I, PLACE_J, ranges._replace(nlos_odds=odds), LATE)
    assert other.cost(UserPose(*PLACE_I), UserPose(*PLACE_J), LATE) == pytest.approx(expected, rel=1e-12)
    assert block.cost(UserPose(*PLACE_I), UserPose(*PLACE_J), LATE) == before != pytest.approx(expected)


def test_a_block_keeps_its_own_copy_of_the_ranges() -> None:
    ranges = measured(5, noise=1.0)
    block = ranges.block()
    before = block.residuals(UserPose(*PLACE_I), UserPose(*PLACE_J))
    for column in ranges:
        column += 1.0
    np.testing.assert_array_equal(block.residuals(UserPose(*PLACE_I), UserPose(*PLACE_J)), before)


GOOD = measured(3, noise=1.0)
SHORT = np.ones(2)
BROKEN = {
    "no range at all": (Measured(np.zeros((0, 3)), np.zeros((0, 3)), *np.zeros((3, 0))), "at least one"),
    "an antenna missing": (GOOD._replace(o_j=np.zeros((2, 3))), "antenna"),
    "a sigma missing": (GOOD._replace(sigma=SHORT), "sigma"),
    "odds missing": (GOOD._replace(nlos_odds=SHORT), "nlos_odds"),
    "a distance missing": (GOOD._replace(distance=SHORT), "antenna"),
    "a position of NaN": (GOOD._replace(o_i=np.full((3, 3), np.nan)), "finite"),
    "a distance of infinity": (GOOD._replace(distance=np.full(3, np.inf)), "finite"),
    "a sigma of zero": (GOOD._replace(sigma=np.array([0.1, 0.0, 0.1])), "sigma must be positive"),
    "a negative sigma": (GOOD._replace(sigma=np.array([0.1, -0.1, 0.1])), "sigma must be positive"),
    "a sigma of NaN": (GOOD._replace(sigma=np.array([0.1, np.nan, 0.1])), "sigma must be positive"),
    "negative odds": (GOOD._replace(nlos_odds=np.array([0.1, -0.1, 0.1])), "nlos_odds must not be negative"),
    "odds of infinity": (GOOD._replace(nlos_odds=np.array([0.1, np.inf, 0.1])), "nlos_odds must not be negative"),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_a_block_refuses(fault: str) -> None:
    ranges, message = BROKEN[fault]
    with pytest.raises(ValueError, match=message):
        ranges.block()


@pytest.mark.parametrize("odds", [SHORT, np.array([0.1, -1.0, 0.1]), np.array([0.1, np.nan, 0.1])])
def test_other_odds_are_checked_too(odds: Array) -> None:
    with pytest.raises(ValueError, match="nlos_odds"):
        GOOD.block().with_nlos_odds(odds)


def test_antennas_have_three_coordinates() -> None:
    with pytest.raises(TypeError):
        RangeBlock(np.zeros((3, 2)), *GOOD[1:])


@pytest.mark.parametrize("late_by", [-0.3, 0.3])
def test_curvature_and_bending_are_the_second_derivative_in_height_whatever_its_sign(late_by: float) -> None:
    random = np.random.default_rng(3)
    o_i, o_j = random.normal(size=(2, 40, 3)) * [2.0, 2.0, 0.2]
    o_j[:, 0] += 5.0
    distance = np.linalg.norm(o_i - o_j, axis=1) + late_by
    sigma = np.full(40, 0.1)
    block = RangeBlock(o_i, o_j, distance, sigma, np.full(40, 0.25))
    loss, step = NlosMixture(1.0, 0.002), 1e-4

    def cost(height: float) -> float:
        return block.cost(UserPose(frame_height=height), UserPose(), loss)

    numerical = (cost(step) - 2.0 * cost(0.0) + cost(-step)) / step**2
    between = o_i - o_j
    length = np.linalg.norm(between, axis=1)
    curvature = np.array([loss(e, 0.1, 0.25)[2] for e in (length - distance) / sigma])
    along = float((curvature / sigma**2 * (between[:, 2] / length) ** 2).sum())
    height_curvature = block.height_curvature(UserPose(), UserPose(), loss)
    np.testing.assert_allclose(along + height_curvature, numerical, rtol=1e-4, atol=1e-3)
    assert np.sign(height_curvature) == -np.sign(late_by)
