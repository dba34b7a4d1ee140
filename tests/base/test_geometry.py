from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.rotations import rotation_matrix, unit_quaternions

from synchronizar.arrays import Array
from synchronizar.geometry import QUATERNION_Z_UP_FROM_Y_UP, Z_UP_FROM_Y_UP, YawFrame, rotation_2d, wrap_angle
from synchronizar.quaternions import rotate_by_quaternions

coordinates = st.floats(-100.0, 100.0)
angles = st.floats(-10.0, 10.0)
frames = st.builds(YawFrame, coordinates, coordinates, coordinates, angles, st.floats(0.5, 2.0))
points = arrays(float, (3,), elements=coordinates)


def test_a_quarter_turn_is_what_it_is_by_hand() -> None:
    a_from_b = YawFrame(x=10.0, y=20.0, z=30.0, yaw=np.pi / 2.0, scale=2.0)
    np.testing.assert_allclose(a_from_b @ [1.0, 2.0, 3.0], [6.0, 22.0, 36.0])


def test_points_of_any_shape_are_mapped_and_other_things_are_refused() -> None:
    a_from_b = YawFrame(1.0, 2.0, 3.0)
    np.testing.assert_array_equal(a_from_b @ np.zeros((4, 5, 3)), np.broadcast_to([1.0, 2.0, 3.0], (4, 5, 3)))
    assert (a_from_b @ np.zeros((0, 3))).shape == (0, 3)
    with pytest.raises(ValueError, match=r"\(\.\.\., 3\)"):
        a_from_b @ np.zeros((3, 2))


@given(frames, points)
def test_a_frame_and_its_matrix_map_alike(a_from_b: YawFrame, p_b: Array) -> None:
    np.testing.assert_allclose(a_from_b @ p_b, (a_from_b.matrix @ [*p_b, 1.0])[:3], atol=1e-9)


@given(frames, frames)
def test_composition_multiplies_the_matrices(a_from_b: YawFrame, b_from_c: YawFrame) -> None:
    np.testing.assert_allclose((a_from_b @ b_from_c).matrix, a_from_b.matrix @ b_from_c.matrix, atol=1e-9)


@given(frames)
def test_a_frame_and_its_inverse_are_nothing(a_from_b: YawFrame) -> None:
    np.testing.assert_allclose(a_from_b.inverse().matrix, np.linalg.inv(a_from_b.matrix), atol=1e-9)


@given(frames, unit_quaternions, points)
def test_an_attitude_in_another_frame_turns_vectors_as_the_frame_does(
    a_from_b: YawFrame, quat_xyzw: Array, v_body: Array
) -> None:
    turned = rotate_by_quaternions(a_from_b.rotate_quaternions(quat_xyzw[None]), v_body[None])[0]
    expected = a_from_b.matrix[:3, :3] / a_from_b.scale @ rotation_matrix(quat_xyzw) @ v_body
    np.testing.assert_allclose(turned, expected, atol=1e-9)


@given(angles)
def test_a_wrapped_angle_is_the_same_and_small(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -np.pi <= wrapped < np.pi
    np.testing.assert_allclose(rotation_2d(wrapped), rotation_2d(angle), atol=1e-12)


def test_y_up_becomes_z_up_as_promised() -> None:
    x, y, z = 1.0, 2.0, 3.0
    np.testing.assert_array_equal(Z_UP_FROM_Y_UP @ [x, y, z], [-z, -x, y])
    np.testing.assert_array_equal(rotation_matrix(QUATERNION_Z_UP_FROM_Y_UP), Z_UP_FROM_Y_UP)
    assert np.linalg.det(Z_UP_FROM_Y_UP) == pytest.approx(1.0)
