from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support import reference_kernel as reference

from synchronizar._core import UserPose, range_residual
from synchronizar.arrays import Array

placements = arrays(float, (8,), elements=st.floats(-20.0, 20.0))
antennas = arrays(float, (3,), elements=st.floats(-10.0, 10.0))
repeatable = settings(derandomize=True, deadline=None, max_examples=60)

NOWHERE = np.zeros(3)


def residual_and_row(i: Array, o_i: Array, j: Array, o_j: Array, measured: float = 0.0) -> tuple[float, Array]:
    residual, row = range_residual(UserPose(*i), o_i, UserPose(*j), o_j, measured)
    return residual, row.reshape(16)


def numerical_row(i: Array, o_i: Array, j: Array, o_j: Array) -> Array:
    out = np.zeros(16)
    for column in range(16):
        step = np.zeros(16, dtype=complex)
        step[column] = 1j * reference.STEP
        moved_i, moved_j = reference.perturbed(i, step[:8]), reference.perturbed(j, step[8:])
        out[column] = np.imag(reference.distance(moved_i, o_i, moved_j, o_j)) / reference.STEP
    return out


def apart(i: Array, o_i: Array, j: Array, o_j: Array) -> float:
    return float(np.linalg.norm(reference.antenna(i, o_i) - reference.antenna(j, o_j)))


def test_a_residual_is_predicted_minus_measured() -> None:
    j = np.array([3.0, 4.0, 0.7, 12.0, 0.0, 0.0, 0.0, 0.0])
    residual, _ = residual_and_row(np.zeros(8), NOWHERE, j, NOWHERE, measured=12.5)
    assert residual == pytest.approx(0.5)


def test_a_lever_arm_turns_with_the_yaw_and_a_height_adds_up() -> None:
    # (1, 2) turned by a quarter is (-2, 1): i's antenna is at (8, 21, 5.5), j's at (8, 24, 1.5).
    i = np.array([10.0, 20.0, np.pi / 2.0, 5.0, 0.0, 0.0, 0.0, 0.0])
    j = np.array([8.0, 24.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    residual, row = residual_and_row(i, np.array([1.0, 2.0, 0.5]), j, np.array([0.0, 0.0, 0.5]))
    assert residual == pytest.approx(5.0)
    # The direction is (0, -3, 4) / 5. In i's axes that is (-0.6, 0), and a turn moves its antenna by (-1, -2).
    np.testing.assert_allclose(row[:4], [-0.6, 0.0, 1.2, 0.8], atol=1e-15)
    np.testing.assert_allclose(row[8:12], [0.0, 0.6, 0.0, -0.8], atol=1e-15)


def test_a_keyframe_pose_lies_within_the_frame() -> None:
    # The keyframe is at (2, 0) turned by a quarter, so o = (1, 0) is at (2, 1) in the user's frame and, that turned by
    # a quarter, at (-1, 2) + (10, 0) in the common one. Its height is 1 + 0.25 + 0.75.
    i = np.array([10.0, 0.0, np.pi / 2.0, 1.0, 2.0, 0.0, np.pi / 2.0, 0.25])
    j = np.zeros(8)
    residual, row = residual_and_row(i, np.array([1.0, 0.0, 0.75]), j, np.array([9.0, 0.0, 2.0]))
    assert residual == pytest.approx(2.0)
    # The direction is (0, 1, 0), ahead in the frame's x axis and back in the keyframe's.
    np.testing.assert_allclose(row[:8], [1.0, 0.0, -1.0, 0.0, 0.0, -1.0, -1.0, 0.0], atol=1e-15)


@given(placements, antennas, placements, antennas)
@repeatable
def test_every_column_is_the_derivative_under_gtsams_retraction(i: Array, o_i: Array, j: Array, o_j: Array) -> None:
    if apart(i, o_i, j, o_j) < 1e-3:
        return
    _, row = residual_and_row(i, o_i, j, o_j)
    np.testing.assert_allclose(row, numerical_row(i, o_i, j, o_j), atol=1e-9, rtol=0.0)


@given(placements, antennas, placements, antennas)
@repeatable
def test_the_chain_rule_gives_the_same_row(i: Array, o_i: Array, j: Array, o_j: Array) -> None:
    if apart(i, o_i, j, o_j) < 1e-3:
        return
    residual, row = residual_and_row(i, o_i, j, o_j, measured=1.5)
    assert residual == pytest.approx(apart(i, o_i, j, o_j) - 1.5, abs=1e-9)
    np.testing.assert_allclose(row, reference.row(i, o_i, j, o_j), atol=1e-9, rtol=0.0)


@given(placements, antennas, placements, antennas)
@repeatable
def test_without_keyframes_their_columns_are_those_of_an_identity_pose(
    i: Array, o_i: Array, j: Array, o_j: Array
) -> None:
    i, j = np.array([*i[:4], 0.0, 0.0, 0.0, 0.0]), np.array([*j[:4], 0.0, 0.0, 0.0, 0.0])
    _, row = residual_and_row(i, o_i, j, o_j)
    np.testing.assert_array_equal(row[4:8], row[:4])
    np.testing.assert_array_equal(row[12:], row[8:12])


@given(placements, antennas, placements, antennas)
@repeatable
def test_who_is_called_i_does_not_matter(i: Array, o_i: Array, j: Array, o_j: Array) -> None:
    residual, row = residual_and_row(i, o_i, j, o_j, measured=2.0)
    swapped_residual, swapped_row = residual_and_row(j, o_j, i, o_i, measured=2.0)
    assert residual == pytest.approx(swapped_residual, rel=1e-14)
    np.testing.assert_allclose(np.roll(swapped_row, 8), row, atol=1e-9, rtol=0.0)


@given(placements, antennas, placements, antennas, st.floats(-5.0, 5.0))
@repeatable
def test_turning_the_common_frame_changes_nothing(i: Array, o_i: Array, j: Array, o_j: Array, yaw: float) -> None:
    def turned(placement: Array) -> Array:
        pose = reference.compose(np.array([3.0, -2.0, yaw]), placement[:3])
        return np.array([*pose, placement[3] + 1.0, *placement[4:]])

    if apart(i, o_i, j, o_j) < 1e-3:
        return
    residual, row = residual_and_row(i, o_i, j, o_j)
    turned_residual, turned_row = residual_and_row(turned(i), o_i, turned(j), o_j)
    assert turned_residual == pytest.approx(residual, abs=1e-9)
    np.testing.assert_allclose(turned_row, row, atol=1e-8, rtol=0.0)


def test_antennas_that_coincide_have_no_row() -> None:
    i = np.array([1.0, 2.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0])
    j = np.array([2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5])
    for first, o_first, second, o_second in (
        (i, np.array([1.0, 0.0, 0.0]), j, NOWHERE),
        (j, NOWHERE, i, np.array([1.0, 0.0, 0.0])),
    ):
        residual, row = residual_and_row(first, o_first, second, o_second, measured=0.3)
        assert residual == -0.3
        np.testing.assert_array_equal(row, np.zeros(16))


@pytest.mark.parametrize("distance", [1e-9, 1e3])
def test_a_row_stays_true_for_antennas_all_but_touching_and_far_away(distance: float) -> None:
    i = np.array([0.0, 0.0, 0.3, 0.0, 0.0, 0.0, -0.4, 0.0])
    direction = np.array([2.0, -1.0, 2.0]) / 3.0
    j = np.array([*(distance * direction[:2]), 1.1, distance * direction[2], 0.0, 0.0, 0.2, 0.0])
    residual, row = residual_and_row(i, NOWHERE, j, NOWHERE)
    assert residual == pytest.approx(distance, rel=1e-12)
    # From j to i it is -direction; in the axes of F, then of X.
    in_frame = -direction[:2] @ reference.rotation(0.3)
    in_keyframe = -direction[:2] @ reference.rotation(0.3 - 0.4)
    np.testing.assert_allclose(row[:8], [*in_frame, 0.0, -2.0 / 3.0, *in_keyframe, 0.0, -2.0 / 3.0], atol=1e-9)
    np.testing.assert_allclose(row, reference.row(i, NOWHERE, j, NOWHERE), atol=1e-9)


@given(placements, placements, st.integers(0, 2**32 - 1))
@repeatable
def test_the_rows_of_any_number_of_ranges_have_rank_four_at_most(i: Array, j: Array, seed: int) -> None:
    random = np.random.default_rng(seed)
    o_i, o_j = random.normal(0.0, 5.0, (2, 40, 3))
    stacked = np.array([residual_and_row(i, a, j, b)[1] for a, b in zip(o_i, o_j, strict=True)])
    singular = np.linalg.svd(stacked, compute_uv=False)
    assert singular[4] < 1e-12 * singular[0]


@given(placements, antennas, placements, antennas)
@repeatable
def test_a_lines_moment_is_that_of_either_antenna(i: Array, o_i: Array, j: Array, o_j: Array) -> None:
    """For frames at the origin, d/d yaw is the moment itself: i's antenna and j's give the same one, negated."""
    at_origin_i, at_origin_j = np.zeros(8), np.zeros(8)
    q_i, q_j = reference.antenna(i, o_i), reference.antenna(j, o_j)
    _, row = residual_and_row(at_origin_i, q_i, at_origin_j, q_j)
    assert row[2] == pytest.approx(-row[10], abs=1e-9)
    if apart(i, o_i, j, o_j) > 1e-3:
        direction = (q_i - q_j)[:2] / np.linalg.norm(q_i - q_j)
        assert row[2] == pytest.approx(direction @ reference.QUARTER_TURN @ q_i[:2], abs=1e-9)
        assert row[2] == pytest.approx(direction @ reference.QUARTER_TURN @ q_j[:2], abs=1e-6)
