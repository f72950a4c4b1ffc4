"""Jacobians of the measurements against finite differences on the manifold."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hsvaos.nav.attitude import rotation_of
from hsvaos.nav.measurements import PHI, Layout, baro_height, gnss_position, gnss_velocity

LAYOUT = Layout(baro_bias=True, wander=True)
numbers = arrays(np.float64, 30, elements=st.floats(-1.0, 1.0, width=32))


def moved(x, R, error):
    """The state moved by an error, as a filter moves it."""
    new = x + error
    new[PHI] = 0.0
    return new, rotation_of(error[PHI]) @ R


@given(numbers)
def test_jacobians(values):
    x = values[: LAYOUT.size].copy()
    x[PHI] = 0.0
    R = rotation_of(3.0 * values[20:23])
    lever, rate = values[23:26], values[26:29]
    zero, one = np.zeros(3), np.ones(3)
    functions = (
        lambda x, R: gnss_position(zero, one, x, R, lever, LAYOUT),
        lambda x, R: gnss_velocity(zero, one, x, R, lever, rate, LAYOUT),
        lambda x, R: baro_height(0.0, 1.0, x, LAYOUT),
    )
    step = 1e-6
    for function in functions:
        _, H, _ = function(x, R)
        for i in range(LAYOUT.size):
            d = np.zeros(LAYOUT.size)
            d[i] = step
            more, _, _ = function(*moved(x, R, d))
            less, _, _ = function(*moved(x, R, -d))
            # residual = measured - expected falls as the state moves along H
            np.testing.assert_allclose(H[:, i], (less - more) / (2 * step), atol=1e-8)


def test_only_the_rows_that_arrived():
    x, R = np.zeros(15), np.eye(3)
    residual, H, variance = gnss_position(
        np.array([1.0, np.nan, 3.0]), np.array([1.0, 2.0, 3.0]), x, R, np.zeros(3), Layout()
    )
    np.testing.assert_array_equal(residual, [1.0, 3.0])
    np.testing.assert_array_equal(variance, [1.0, 9.0])
    np.testing.assert_array_equal(H[:, :3], [[1, 0, 0], [0, 0, 1]])
