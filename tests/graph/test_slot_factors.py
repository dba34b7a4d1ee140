from __future__ import annotations

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.numerical import derivative

from synchronizar._core import NlosMixture, RangeSlot
from synchronizar.arrays import Array
from synchronizar.graph import keys
from synchronizar.graph.range_factors import CalibratedUserKeys, RangeSlotFactor
from synchronizar.graph.slot_factors import (
    CALIBRATION_UNITS,
    Joining,
    SlamStep,
    calibration_walk_factor,
    height_prior,
    joining_prior,
    place_prior,
    ranges_factor,
    step_factor,
)
from synchronizar.parameters import Parameters

PARAMETERS = Parameters()
LATE = NlosMixture(1.0, 0.002)
USERS, RANGES, SLOT = 3, 40, 4


def somewhere(users: list[int], slots: list[int], seed: int) -> gtsam.Values:
    """All variables of users at slots, at random."""
    random, values = np.random.default_rng(seed), gtsam.Values()
    for user in users:
        for slot in slots:
            values.insert(keys.slot_pose(user, slot), gtsam.Pose2(*random.normal(0.0, 2.0, 3)))
            values.insert(keys.slot_height(user, slot), float(random.normal()))
            values.insert(keys.slot_calibration(user, slot), random.normal(0.0, 1.5, 3))
    return values


def calibration_of(values: gtsam.Values, user: int, slot: int) -> Array:
    """(3,) log scale, m, s."""
    return np.asarray(values.atVector(keys.slot_calibration(user, slot)) * CALIBRATION_UNITS)


# SLAM's steps


STEP = SlamStep((0.8, -0.3, 0.1), (0.02, 0.05, 0.01), 1.0)


@pytest.mark.parametrize("seed", range(4))
def test_a_step_is_off_by_what_a_hand_computed_step_is_off(seed: int) -> None:
    values = somewhere([2], [6, 7], seed)
    a, b = (values.atPose2(keys.slot_pose(2, n)) for n in (6, 7))
    scale = np.exp(calibration_of(values, 2, 6)[0])
    turn = np.array([[np.cos(a.theta()), np.sin(a.theta())], [-np.sin(a.theta()), np.cos(a.theta())]])
    plane = turn @ [b.x() - a.x(), b.y() - a.y()] - scale * np.array(STEP.displacement[:2])
    rise = values.atDouble(keys.slot_height(2, 7)) - values.atDouble(keys.slot_height(2, 6))
    yaw = np.angle(np.exp(1j * (b.theta() - a.theta())))
    expected = [*(plane / 0.02), (rise - scale * 0.1) / 0.05, yaw / 0.01]
    error = step_factor(2, 6, 7, STEP, PARAMETERS).unwhitenedError(values)
    np.testing.assert_allclose(error, expected, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_a_step_is_linearised_as_differences_say_and_weighed_as_students_t_is(seed: int) -> None:
    """Cauchy's weight of k^2 = f + 4, as a scale mixture of normals of four dimensions has it."""
    factor = step_factor(2, 6, 7, STEP, PARAMETERS)
    values = somewhere([2], [6, 7], seed)
    listed = list(factor.keys())
    error = factor.unwhitenedError(values)
    matrix, right = factor.linearize(values).jacobian()
    width = PARAMETERS.slam.drift_dof + 4.0
    root = np.sqrt(width / (width + error @ error))
    expected = derivative(factor.unwhitenedError, values, listed)
    np.testing.assert_allclose(matrix / root, expected, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(right, -root * error, rtol=1e-9)


def test_a_step_across_half_a_turn_is_short() -> None:
    values = somewhere([0], [1, 2], 0)
    for slot, yaw in ((1, np.pi - 0.01), (2, -np.pi + 0.02)):
        values.update(keys.slot_pose(0, slot), gtsam.Pose2(0.0, 0.0, yaw))
    error = step_factor(0, 1, 2, STEP, PARAMETERS).unwhitenedError(values)
    assert error[3] == pytest.approx(3.0)


def test_what_a_device_may_change_grows_with_the_root_of_time() -> None:
    values = somewhere([1], [3, 5], 0)
    change = calibration_of(values, 1, 5) - calibration_of(values, 1, 3)
    d = PARAMETERS.devices
    sigma = np.sqrt(2.0) * np.array([d.scale_walk, d.bias_walk, d.clock_walk])
    factor = calibration_walk_factor(1, 3, 5, 2.0, PARAMETERS)
    assert factor.error(values) == pytest.approx(0.5 * np.sum((change / sigma) ** 2))
    matrix = factor.linearize(values).jacobian()[0]
    expected = derivative(factor.whitenedError, values, list(factor.keys()))
    np.testing.assert_allclose(matrix, expected, rtol=1e-6, atol=1e-6)


# The prior of those who join


def joining(user: int, seed: int) -> Joining:
    random = np.random.default_rng((user, seed))
    height, clock = random.normal(0.0, 1.5), random.normal(0.0, 0.1)
    return Joining(user, SLOT, height, clock, random.uniform(0.2, 0.6), random.uniform(0.02, 0.1, 3))


def dense_information(users: list[Joining], shared_sigma: Array) -> Array:
    """(4 n, 4 n) of heights of origins and calibrations, level and shared calibration marginalised out."""
    n = len(users)
    whole = np.zeros((4 * (n + 1), 4 * (n + 1)))  # the last four: the level, and what all share
    for u, user in enumerate(users):
        for c, sigma in enumerate([user.height_sigma, *user.calibration_sigma]):
            row = np.zeros(len(whole))
            row[4 * u + c], row[4 * n + c] = 1.0, -1.0
            whole += np.outer(row, row) / sigma**2
    for c in range(3):
        whole[4 * n + 1 + c, 4 * n + 1 + c] += shared_sigma[c] ** -2
    left, out = slice(0, 4 * n), slice(4 * n, None)
    return np.asarray(whole[left, left] - whole[left, out] @ np.linalg.solve(whole[out, out], whole[out, left]))


def numbers_of(users: list[Joining], values: gtsam.Values) -> Array:
    """(4 n,) height of the origin, then the calibration, of each user."""
    out = []
    for user in users:
        calibration = calibration_of(values, user.user, SLOT)
        height = values.atDouble(keys.slot_height(user.user, SLOT)) - np.exp(calibration[0]) * user.height
        out += [height, calibration[0], calibration[1], calibration[2] + user.assumed_clock]
    return np.array(out)


@settings(max_examples=25, deadline=None)
@given(new=st.integers(1, 3), known=st.integers(0, 3), seed=st.integers(0, 99))
def test_who_joins_has_the_prior_of_all_given_those_who_are_known(new: int, known: int, seed: int) -> None:
    """The dense Gaussian in which the level and the shared calibration are variables, all over the known ones."""
    everybody = [joining(u, seed) for u in range(new + known)]
    shared = np.random.default_rng(seed).uniform(0.02, 0.1, 3)
    factor = joining_prior(everybody[:new], everybody[new:], shared)
    values = somewhere(list(range(new + known)), [SLOT], seed)
    information = dense_information(everybody, shared)
    if known:
        information[4 * new :, 4 * new :] -= dense_information(everybody[new:], shared)
    numbers = numbers_of(everybody, values)
    assert factor.error(values) == pytest.approx(0.5 * numbers @ information @ numbers, rel=1e-6, abs=1e-9)
    listed = list(factor.keys())
    by_variables = derivative(lambda at: numbers_of(everybody, at), values, listed)
    linear = factor.linearize(values)
    order = np.concatenate([np.arange(s.start, s.stop) for s in keys.rows(listed)])
    expected = by_variables.T @ information @ by_variables
    got = linear.jacobian()[0]
    np.testing.assert_allclose(got.T @ got, expected[np.ix_(order, order)], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(got, derivative(factor.whitenedError, values, listed), rtol=1e-5, atol=1e-5)


# Ranges of a slot


def slot_of(which: slice = slice(None), seed: int = 0) -> RangeSlot:
    random = np.random.default_rng(seed)
    i = random.integers(0, USERS - 1, RANGES).astype(np.int32)
    j = (i + 1 + random.integers(0, USERS - 1 - i)).astype(np.int32)
    ends = [[random.normal(0.0, s, (RANGES, 3)) for s in (1.0, 0.2, 1.0)] for _ in "ij"]
    distance, sigma = random.uniform(1.0, 6.0, RANGES), random.uniform(0.1, 0.4, RANGES)
    odds, weight = random.uniform(0.0, 0.5, RANGES), random.uniform(0.1, 1.0, RANGES)
    a, b = ((o[which], lever[which], v[which]) for o, lever, v in ends)
    return RangeSlot(USERS, i[which], j[which], a, b, distance[which], sigma[which], odds[which], weight[which])


def of_three(block: RangeSlot, curvature: Array | None = None) -> gtsam.CustomFactor:
    return ranges_factor(SLOT, [5, 1, 8], block, LATE, curvature)


def test_the_ranges_of_a_slot_are_those_of_the_general_factor_in_units_of_their_own() -> None:
    values, users = somewhere([5, 1, 8], [SLOT], 3), [5, 1, 8]
    plain = gtsam.Values(values)
    of_each = [
        CalibratedUserKeys(
            keys.slot_pose(u, SLOT), keys.slot_height(u, SLOT), None, None, keys.slot_calibration(u, SLOT)
        )
        for u in users
    ]
    for user in of_each:
        plain.update(user.calibration, values.atVector(user.calibration) * CALIBRATION_UNITS)
    own, general = of_three(slot_of()), RangeSlotFactor(of_each, slot_of(), LATE)
    assert own.error(values) == pytest.approx(general.error(plain), rel=1e-12)
    units = np.append(np.tile(np.concatenate([np.ones(4), CALIBRATION_UNITS]), 3), 1.0)
    expected = general.linearize(plain).augmentedInformation() * np.outer(units, units)
    got = own.linearize(values).augmentedInformation()
    np.testing.assert_allclose(got, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(4))
def test_the_ranges_of_a_slot_are_the_sum_of_single_ones(seed: int) -> None:
    values = somewhere([5, 1, 8], [SLOT], seed)
    whole = of_three(slot_of(), np.zeros(len(slot_of().pairs)))
    single = [of_three(slot_of(slice(n, n + 1)), np.zeros(1)) for n in range(RANGES)]
    assert whole.error(values) == pytest.approx(sum(each.error(values) for each in single), rel=1e-9)
    information = sum(each.linearize(values).augmentedInformation() for each in single)
    got = whole.linearize(values).augmentedInformation()
    np.testing.assert_allclose(got[:, :-1], information[:, :-1], rtol=1e-7, atol=1e-7 * np.abs(information).max())


@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_the_linearised_ranges_have_the_gradient_of_the_cost(seed: int, curved: bool) -> None:
    block = slot_of()
    factor = of_three(block, None if curved else np.zeros(len(block.pairs)))
    values = somewhere([5, 1, 8], [SLOT], seed)
    matrix, right = factor.linearize(values).jacobian()
    expected = derivative(lambda at: np.array([factor.error(at)]), values, list(factor.keys()))[0]
    np.testing.assert_allclose(-matrix.T @ right, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


def test_a_single_range_between_two_who_stand_is_what_is_computed_by_hand() -> None:
    """3-4-5: predicted 5 m and both biases, measured 5.3; sigma 0.1, no NLOS to speak of."""
    none = np.zeros((1, 3))
    one, zero = np.ones(1), np.zeros(1)
    ends = (none, none, none)
    block = RangeSlot(2, np.zeros(1, np.int32), np.ones(1, np.int32), ends, ends, 5.3 * one, 0.1 * one, zero, 0.5 * one)
    values = gtsam.Values()
    for user, x, height, bias in ((0, 0.0, 1.0, 0.05), (1, 3.0, 5.0, 0.15)):
        values.insert(keys.slot_pose(user, SLOT), gtsam.Pose2(x, 0.0, 0.4))
        values.insert(keys.slot_height(user, SLOT), height)
        values.insert(keys.slot_calibration(user, SLOT), np.array([0.0, bias, 0.0]) / CALIBRATION_UNITS)
    factor = ranges_factor(SLOT, [0, 1], block, NlosMixture(1.0, 0.0), np.zeros(1))
    assert factor.error(values) == pytest.approx(0.5 * 0.5 * (0.1 / 0.1) ** 2)


# Priors of a place


def test_priors_of_a_place_count_each_deviation_over_its_sigma() -> None:
    values = gtsam.Values()
    values.insert(keys.slot_pose(3, SLOT), gtsam.Pose2(1.3, 2.0, 0.5))
    values.insert(keys.slot_height(3, SLOT), 1.2)
    place = place_prior(3, SLOT, (1.0, 2.0, 0.1), (0.1, 0.2, 0.4))
    matrix = place.linearize(values).jacobian()[0]
    np.testing.assert_allclose(matrix, derivative(place.whitenedError, values, [keys.slot_pose(3, SLOT)]), atol=1e-6)
    assert height_prior(3, SLOT, 1.0, 0.1).error(values) == pytest.approx(2.0)
    assert place.whitenedError(values)[2] == pytest.approx(1.0)
