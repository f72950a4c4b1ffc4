"""The paper's filter: its printed Jacobians against finite differences, and a flight."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hsvaos.nav import attitude
from hsvaos.nav.initial import InitialState
from hsvaos.nav.paper_algebra import BA16, BG16, Q16
from hsvaos.nav.paper_ekf import PaperEkf
from hsvaos.nav.sensors import IMU_MODELS

unit = st.floats(-1.0, 1.0, width=32)
IMU = IMU_MODELS["adis16448-calibrated"]


@given(arrays(np.float64, 22, elements=unit), st.floats(1e-3, 0.1))
def test_jacobians_equal_finite_differences(numbers, dt):
    ekf = PaperEkf(IMU)
    ekf.x = numbers[:16].copy()
    ekf.x[Q16] = attitude.normalize(ekf.x[Q16] + [1.5, 0, 0, 0])
    u = np.concatenate([10.0 * numbers[16:19], numbers[19:22]])
    A, B = ekf.jacobians(u[:3], u[3:], dt)
    step = 1e-6

    def f(x, u):
        return ekf.propagated(x, u[:3], u[3:], dt)

    for i in range(16):
        d = np.zeros(16)
        d[i] = step
        slope = (f(ekf.x + d, u) - f(ekf.x - d, u)) / (2 * step)
        np.testing.assert_allclose(A[:, i], slope, atol=1e-7)
    for i in range(6):
        d = np.zeros(6)
        d[i] = step
        slope = (f(ekf.x, u + d) - f(ekf.x, u - d)) / (2 * step)
        np.testing.assert_allclose(B[:, i], slope, atol=1e-7)


def test_measurement_matrix_is_7_by_16_and_the_height_row_reads_down():
    H = PaperEkf(IMU).H
    assert H.shape == (7, 16)
    x = np.arange(16.0)
    np.testing.assert_array_equal(H @ x, [0, 1, 2, 3, 4, 5, 2])


def test_first_order_propagation_of_one_step():
    ekf = PaperEkf(IMU, gravity=10.0)
    ekf.start(InitialState(0.0, np.zeros(3), np.array([1.0, 2.0, 3.0]), np.array([1.0, 0, 0, 0])))
    ekf.predict([0.5, 0.0, -10.0], [0.0, 0.0, 0.2], 0.1)
    np.testing.assert_allclose(ekf.x[:3], [0.1, 0.2, 0.3])
    np.testing.assert_allclose(ekf.x[3:6], [1.05, 2.0, 3.0])
    # tan of half the angle is first order in the rate
    assert attitude.to_euler(ekf.x[Q16])[2] == pytest.approx(2 * np.arctan(0.01))
    assert np.linalg.norm(ekf.x[Q16]) == pytest.approx(1.0, abs=1e-15)


def test_update_uses_only_the_rows_that_arrived():
    ekf = PaperEkf(IMU)
    ekf.start(InitialState(0.0, np.zeros(3), np.zeros(3), np.array([1.0, 0, 0, 0])))
    before = ekf.x.copy()
    z = np.full(7, np.nan)
    z[6] = -2.0
    innovation, S = ekf.update(z, np.full(7, 0.25))
    assert innovation.shape == (1,)
    assert S[0, 0] == pytest.approx(4.0 + 0.25)
    assert ekf.x[2] == pytest.approx(-2.0 * 4.0 / 4.25)
    np.testing.assert_array_equal(np.delete(ekf.x, 2), np.delete(before, 2))


def test_covariance_equals_the_joseph_form():
    rng = np.random.default_rng(0)
    ekf = PaperEkf(IMU, project=False)
    root = rng.standard_normal((16, 16))
    P = ekf.P = root @ root.T
    ekf.x = np.concatenate([np.zeros(6), [1.0], np.zeros(9)])
    R = rng.uniform(0.1, 2.0, 7)
    H = ekf.H
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(R))
    joseph = (np.eye(16) - K @ H) @ P @ (np.eye(16) - K @ H).T + K @ np.diag(R) @ K.T
    ekf.update(np.zeros(7), R)
    np.testing.assert_allclose(ekf.P, joseph, atol=1e-9)


def test_bias_noise_is_off_as_printed_and_available():
    q = np.array([1.0, 0, 0, 0])
    printed = PaperEkf(IMU_MODELS["adis16448"])
    walking = PaperEkf(IMU_MODELS["adis16448"], bias_random_walk=True)
    for ekf in (printed, walking):
        ekf.start(InitialState(0.0, np.zeros(3), np.zeros(3), q))
        ekf.predict([0.0, 0.0, -9.8], np.zeros(3), 0.5)
    fresh = printed.P[BA16, BA16], printed.P[BG16, BG16]
    np.testing.assert_array_equal(fresh[0], np.diag(np.full(3, 0.2**2)))
    grown = np.diag(walking.P)[BG16] - np.diag(fresh[1])
    np.testing.assert_allclose(grown, IMU_MODELS["adis16448"].gyro_bias_walk ** 2 * 0.5, rtol=1e-6)


def test_the_covariance_follows_the_quaternion_back_to_length_one():
    """The Jacobian of q / |q| at the updated q: nothing is left along q, unless as printed."""
    spread = []
    for project in (True, False):
        ekf = PaperEkf(IMU, project=project)
        q = attitude.from_euler(0.1, -0.2, 0.5)
        ekf.start(InitialState(0.0, np.zeros(3), np.zeros(3), q))
        for _ in range(100):
            ekf.predict([1.0, 0.5, -9.8], [0.02, 0.01, 0.1], 0.01)
        z = np.concatenate([[0.5, 0.0, 0.0], [2.0, 1.0, 0.3], [0.0]])
        ekf.update(z, np.full(7, 0.01))
        q = ekf.x[Q16]
        spread.append(float(q @ ekf.P[Q16, Q16] @ q))
    assert abs(spread[0]) < 1e-15
    assert spread[1] > 1e-6
