from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.rotations import rotation_matrix, unit_quaternions

from synchronizar.arrays import Array
from synchronizar.quaternions import (
    IDENTITY,
    angles_between,
    cumulative_products,
    inverse_quaternions,
    multiply_quaternions,
    normalized_quaternions,
    quaternions_of_matrices,
    quaternions_of_rotation_vectors,
    rotate_by_quaternions,
    rotation_angles,
    rotation_vectors,
    tilt_of_quaternions,
    yaw_of_quaternions,
    yaw_quaternion,
    yaw_quaternions,
)

HALF, VANISHING = np.sqrt(0.5), 1e-150
UP = np.array([0.0, 0.0, 1.0])
vectors = arrays(float, (3,), elements=st.floats(-100.0, 100.0))
angles = st.floats(-10.0, 10.0)
# rad. Below 1e-150 a square vanishes and an angle may be taken for 0; all others keep their digits, near 0 and near pi.
NEAR_SINGULAR = [0.0, 1e-200, 1e-12, 1e-8, 1e-4, 1.0, np.pi - 1e-4, np.pi - 1e-8, np.pi]


def about(axis: tuple[float, float, float], angle: float) -> Array:
    """(1, 4): the definition of the quaternion that turns by an angle (rad) about a unit axis."""
    return np.array([[*(np.sin(angle / 2.0) * np.array(axis)), np.cos(angle / 2.0)]])


@given(unit_quaternions, unit_quaternions)
def test_a_product_of_quaternions_is_that_of_their_matrices(left: Array, right: Array) -> None:
    product = multiply_quaternions(left, right)
    np.testing.assert_allclose(rotation_matrix(product), rotation_matrix(left) @ rotation_matrix(right), atol=1e-12)


@given(unit_quaternions, vectors)
def test_a_quaternion_turns_a_vector_as_its_matrix_does(quat_xyzw: Array, v: Array) -> None:
    np.testing.assert_allclose(rotate_by_quaternions(quat_xyzw, v), rotation_matrix(quat_xyzw) @ v, atol=1e-9)


def test_products_accumulate_from_the_left() -> None:
    x, z = about((1.0, 0.0, 0.0), np.pi / 2.0)[0], about((0.0, 0.0, 1.0), np.pi / 2.0)[0]
    # By hand: (i + 1)(k + 1) / 2 = (i - j + k + 1) / 2, and that times (i + 1) / sqrt(2) is (i + k) / sqrt(2).
    expected = [[HALF, 0.0, 0.0, HALF], [0.5, -0.5, 0.5, 0.5], [HALF, 0.0, HALF, 0.0]]
    np.testing.assert_allclose(cumulative_products(np.array([x, z, x])), expected, atol=1e-15)
    np.testing.assert_array_equal(cumulative_products(x[None]), x[None])


def test_an_inverse_is_the_conjugate_of_each() -> None:
    np.testing.assert_array_equal(
        inverse_quaternions(np.array([[0.5, -0.5, 0.5, 0.5], [0.0, 0.6, 0.0, -0.8]])),
        [[-0.5, 0.5, -0.5, 0.5], [0.0, -0.6, 0.0, -0.8]],
    )


@given(unit_quaternions)
def test_a_quaternion_times_its_inverse_is_the_identity(quat_xyzw: Array) -> None:
    np.testing.assert_allclose(multiply_quaternions(quat_xyzw, inverse_quaternions(quat_xyzw)), IDENTITY, atol=1e-15)
    np.testing.assert_allclose(rotation_matrix(inverse_quaternions(quat_xyzw)), rotation_matrix(quat_xyzw).T)


def test_quaternions_are_normalised_each_by_its_own_length() -> None:
    scaled = np.array([[3.0, 0.0, 0.0, 4.0], [0.0, 0.0, -1e-3, 0.0]])
    np.testing.assert_allclose(normalized_quaternions(scaled), [[0.6, 0.0, 0.0, 0.8], [0.0, 0.0, -1.0, 0.0]])
    np.testing.assert_allclose(normalized_quaternions(scaled[0]), [0.6, 0.0, 0.0, 0.8])


def test_rotation_vectors_are_what_they_are_by_hand() -> None:
    quarter, third = [HALF, 0.0, 0.0, HALF], [0.5, 0.5, 0.5, 0.5]
    expected = [[np.pi / 2.0, 0.0, 0.0], np.full(3, 2.0 * np.pi / 3.0 / np.sqrt(3.0))]
    np.testing.assert_allclose(rotation_vectors(np.array([quarter, third])), expected, atol=1e-15)
    np.testing.assert_allclose(quaternions_of_rotation_vectors(np.array(expected)), [quarter, third], atol=1e-15)


@pytest.mark.parametrize("angle", NEAR_SINGULAR)
def test_a_rotation_vector_has_the_angle_for_its_length_however_small_or_near_pi(angle: float) -> None:
    axis = (0.48, -0.6, 0.64)
    vector = angle * np.array([axis])
    np.testing.assert_allclose(quaternions_of_rotation_vectors(vector), about(axis, angle), rtol=1e-14, atol=1e-16)
    np.testing.assert_allclose(rotation_vectors(about(axis, angle)), vector, rtol=1e-13)


@given(unit_quaternions)
def test_a_rotation_vector_is_the_shorter_way_and_leads_back(quat_xyzw: Array) -> None:
    vector = rotation_vectors(quat_xyzw[None])
    assert np.linalg.norm(vector) <= np.pi + 1e-12
    back = quaternions_of_rotation_vectors(vector)[0]
    np.testing.assert_allclose(rotation_matrix(back), rotation_matrix(quat_xyzw), atol=1e-12)


def test_a_rotation_vector_of_more_than_a_turn_is_what_is_left_of_it() -> None:
    turn = quaternions_of_rotation_vectors(np.array([[0.0, 2.0 * np.pi + 0.3, 0.0]]))
    np.testing.assert_allclose(rotation_vectors(turn), [[0.0, 0.3, 0.0]], atol=1e-14)


@pytest.mark.parametrize("angle", NEAR_SINGULAR)
def test_an_angle_is_found_from_nothing_to_half_a_turn_whichever_sign_the_quaternion_has(angle: float) -> None:
    q = about((0.0, 0.6, -0.8), angle)
    np.testing.assert_allclose(rotation_angles(q), [angle], rtol=1e-14, atol=VANISHING)
    np.testing.assert_allclose(rotation_angles(-q), [angle], rtol=1e-14, atol=VANISHING)
    np.testing.assert_allclose(rotation_angles(inverse_quaternions(q)), [angle], rtol=1e-14, atol=VANISHING)


def test_the_longer_way_round_is_not_told() -> None:
    np.testing.assert_allclose(rotation_angles(about((1.0, 0.0, 0.0), 1.5 * np.pi)), [0.5 * np.pi])


def test_attitudes_are_apart_by_the_rotation_between_them() -> None:
    roll = about((1.0, 0.0, 0.0), 1.1)[0]
    others = np.array([roll, -roll, about((1.0, 0.0, 0.0), 0.8)[0], about((1.0, 0.0, 0.0), 1.1 + np.pi)[0]])
    np.testing.assert_allclose(angles_between(roll, others), [0.0, 0.0, 0.3, np.pi], atol=1e-15)


@given(angles)
def test_a_yaw_quaternion_turns_about_the_vertical(yaw: float) -> None:
    expected = np.eye(3)
    expected[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    np.testing.assert_allclose(rotation_matrix(yaw_quaternion(yaw)), expected, atol=1e-12)
    np.testing.assert_allclose(yaw_quaternions(np.array([0.0, yaw])), [IDENTITY, yaw_quaternion(yaw)], atol=1e-15)


@given(st.floats(-3.1, 3.1), st.floats(-np.pi, np.pi), st.floats(0.0, 3.0))
def test_yaw_and_tilt_are_found_where_a_swing_follows_a_twist(yaw: float, way: float, tilt: float) -> None:
    q = multiply_quaternions(about((float(np.cos(way)), float(np.sin(way)), 0.0), tilt), yaw_quaternion(yaw))
    for sign in (1.0, -1.0):
        np.testing.assert_allclose(yaw_of_quaternions(sign * q), [yaw], atol=1e-12)
        np.testing.assert_allclose(tilt_of_quaternions(sign * q), [tilt], atol=1e-12)


@given(unit_quaternions)
def test_the_tilt_is_the_angle_that_the_vertical_is_turned_by(quat_xyzw: Array) -> None:
    turned = rotation_matrix(quat_xyzw) @ UP
    expected = np.arctan2(np.linalg.norm(np.cross(UP, turned)), UP @ turned)
    np.testing.assert_allclose(tilt_of_quaternions(quat_xyzw), expected, atol=1e-9)


@pytest.mark.parametrize("angle", NEAR_SINGULAR)
def test_a_tilt_is_found_from_nothing_to_upside_down_and_turns_nothing(angle: float) -> None:
    q = about((0.6, 0.8, 0.0), angle)
    np.testing.assert_allclose(tilt_of_quaternions(q), [angle], rtol=1e-14, atol=VANISHING)
    np.testing.assert_array_equal(yaw_of_quaternions(q), [0.0])


@pytest.mark.parametrize("yaw", [-np.pi, -np.pi + 1e-9, -1e-9, 0.0, 1e-200, 1e-9, np.pi - 1e-9])
def test_a_yaw_is_found_up_to_half_a_turn(yaw: float) -> None:
    np.testing.assert_allclose(yaw_of_quaternions(yaw_quaternion(yaw)), yaw, atol=1e-15)
    np.testing.assert_allclose(tilt_of_quaternions(yaw_quaternion(yaw)), 0.0)


@given(unit_quaternions)
def test_the_attitude_of_a_matrix_is_that_which_it_was_made_from(quat_xyzw: Array) -> None:
    (found,) = quaternions_of_matrices(rotation_matrix(quat_xyzw)[None])
    np.testing.assert_allclose(abs(found @ quat_xyzw), 1.0, atol=1e-9)
    np.testing.assert_allclose(rotation_matrix(found), rotation_matrix(quat_xyzw), atol=1e-9)
