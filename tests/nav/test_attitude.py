"""Rotations: each function against its inverse, a matrix product, or a finite difference."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hsvaos.nav import attitude

number = st.floats(-1.0, 1.0, width=32)
vectors = arrays(np.float64, (5, 3), elements=number)
quaternions = (
    arrays(np.float64, (5, 4), elements=number)
    .filter(lambda q: np.linalg.norm(q, axis=1).min() > 0.1)
    .map(attitude.normalize)
)


@given(quaternions, quaternions, vectors)
def test_product_is_the_product_of_matrices(p, q, v):
    both = attitude.matrix(attitude.multiply(p, q))
    np.testing.assert_allclose(both, attitude.matrix(p) @ attitude.matrix(q), atol=1e-12)
    np.testing.assert_allclose(
        attitude.rotate(q, v), (attitude.matrix(q) @ v[..., None])[..., 0], atol=1e-12
    )


@given(quaternions)
def test_matrix_and_back(q):
    back = attitude.from_matrix(attitude.matrix(q))
    assert (back[:, 0] >= 0.0).all()
    np.testing.assert_allclose(abs(np.sum(back * q, axis=1)), 1.0, atol=1e-12)


@given(vectors)
def test_log_undoes_exp_up_to_half_a_turn(v):
    np.testing.assert_allclose(
        attitude.log(attitude.exp(3.0 * v / np.sqrt(3))), 3.0 * v / np.sqrt(3), atol=1e-9
    )


@pytest.mark.parametrize("angle", [1e-12, 1e-9, 1e-7, 1e-4, np.pi - 1e-9])
def test_log_keeps_its_digits_at_small_and_large_angles(angle):
    v = angle * np.array([0.6, 0.0, -0.8])
    np.testing.assert_allclose(attitude.log(attitude.exp(v)), v, rtol=1e-7, atol=1e-20)


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_euler_and_back(roll, pitch, yaw):
    q = attitude.from_euler(roll, pitch, yaw)
    np.testing.assert_allclose(attitude.to_euler(q), [roll, pitch, yaw], atol=1e-7)


def test_euler_turns_the_way_aerospace_means():
    north_east_down = np.eye(3)
    yawed = attitude.rotate(attitude.from_euler(0, 0, np.pi / 2), north_east_down)
    np.testing.assert_allclose(yawed[0], [0, 1, 0], atol=1e-15)  # nose points east
    pitched = attitude.rotate(attitude.from_euler(0, 0.1, 0), north_east_down)
    assert pitched[0, 2] < 0  # nose up
    rolled = attitude.rotate(attitude.from_euler(0.1, 0, 0), north_east_down)
    assert rolled[1, 2] > 0  # right wing down


@given(vectors, vectors)
def test_skew_is_the_cross_product(a, b):
    np.testing.assert_allclose(
        (attitude.skew(a) @ b[..., None])[..., 0], np.cross(a, b), atol=1e-12
    )


@given(quaternions, quaternions)
def test_slerp_ends_and_middle(p, q):
    np.testing.assert_allclose(attitude.slerp(p, q, np.zeros(5)), p, atol=1e-12)
    end = attitude.slerp(p, q, np.ones(5))
    np.testing.assert_allclose(abs(np.sum(end * q, axis=1)), 1.0, atol=1e-12)
    half = attitude.slerp(p, q, np.full(5, 0.5))
    # equally far from both ends
    np.testing.assert_allclose(
        abs(np.sum(half * p, axis=1)), abs(np.sum(half * q, axis=1)), atol=1e-9
    )


def test_quaternion_not_of_unit_length_is_refused():
    with pytest.raises(
        ValueError, match=r"mount must be a quaternion of unit length, got length 2"
    ):
        attitude.check_unit([2.0, 0.0, 0.0, 0.0], "mount")
    with pytest.raises(ValueError, match=r"quaternions of 4 numbers"):
        attitude.check_unit([1.0, 0.0, 0.0], "mount")
    with pytest.raises(ValueError, match=r"unit length"):
        attitude.check_unit([[1.0, 0.0, 0.0, 0.0], [np.nan, 0, 0, 0]], "mount")
    np.testing.assert_allclose(attitude.check_unit([0.7071, 0, 0, 0.7071], "m")[0], np.sqrt(0.5))
