"""Preintegration against the true path, finite differences, and other cuts of the same log."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hsvaos.nav import attitude
from hsvaos.nav.log import ImuLog
from hsvaos.nav.strapdown import ImuTimeline, inner_motion, integrate

NONE = np.zeros(3)


def tumbling(rate_hz=200.0, seconds=2.0, seed=0):
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * rate_hz) + 1) / rate_hz
    phase = rng.uniform(0, 6, (2, 3))
    gyro = np.sin(3.0 * t[:, None] + phase[0])
    accel = 3.0 * np.cos(2.0 * t[:, None] + phase[1]) + [0.0, 0.0, -9.8]
    return ImuLog(t, gyro, accel)


def test_follows_the_true_path(short_mission):
    motion, _ = short_mission
    imu = ImuLog(motion.t_s, motion.angular_rate, motion.specific_force)
    epochs = np.arange(0.0, 50.0, 0.1)
    inc = integrate(ImuTimeline(imu, epochs).stretches(0, len(epochs) - 1), NONE, NONE)
    R = attitude.matrix(motion.quaternion[0])
    p, v = motion.position[0].copy(), motion.velocity[0].copy()
    g = np.array([0.0, 0.0, 9.80665])
    for k, T in enumerate(inc.duration):
        p = p + v * T + 0.5 * g * T * T + R @ inc.position[k]
        v = v + g * T + R @ inc.velocity[k]
        R = R @ inc.rotation[k]
    position, velocity, q = motion.at(epochs[-1:])
    np.testing.assert_allclose(v, velocity[0], atol=2e-3)
    np.testing.assert_allclose(p, position[0], atol=2e-2)
    turned = attitude.log(attitude.multiply(attitude.conjugate(q[0]), attitude.from_matrix(R)))
    # the mission's rates are central differences at 200 Hz: good to 1e-6 rad a second
    np.testing.assert_allclose(turned, 0.0, atol=5e-5)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000))
def test_bias_derivatives_equal_finite_differences(seed):
    stretches = ImuTimeline(tumbling(seed=seed), np.array([0.0, 0.1])).stretches(0, 1)
    at = integrate(stretches, NONE, NONE)
    step = 1e-5
    for axis in range(3):
        d = np.zeros(3)
        d[axis] = step
        more, less = integrate(stretches, d, NONE), integrate(stretches, -d, NONE)
        turn = attitude.log(attitude.from_matrix(more.rotation[0] @ less.rotation[0].T)) / (
            2 * step
        )
        np.testing.assert_allclose(at.rotation_by_gyro[0, :, axis], turn, atol=1e-5)
        slope = (more.velocity - less.velocity)[0] / (2 * step)
        np.testing.assert_allclose(at.velocity_by_gyro[0, :, axis], slope, atol=2e-4)
        slope = (more.position - less.position)[0] / (2 * step)
        np.testing.assert_allclose(at.position_by_gyro[0, :, axis], slope, atol=2e-5)
        more, less = integrate(stretches, NONE, d), integrate(stretches, NONE, -d)
        slope = (more.velocity - less.velocity)[0] / (2 * step)
        # the derivative of dv by the accelerometer bias is that of the turn by the gyroscope bias
        np.testing.assert_allclose(at.rotation_by_gyro[0, :, axis], slope, atol=1e-7)
        slope = (more.position - less.position)[0] / (2 * step)
        np.testing.assert_allclose(at.position_by_accel[0, :, axis], slope, atol=1e-8)


def test_an_epoch_between_samples_splits_the_step_and_changes_nothing():
    imu = tumbling()
    whole = integrate(ImuTimeline(imu, np.array([0.0, 0.5])).stretches(0, 1), NONE, NONE)
    cut = ImuTimeline(imu, np.array([0.0, 0.2137, 0.5]))
    inc = integrate(cut.stretches(0, 2), NONE, NONE)
    np.testing.assert_allclose(inc.duration, [0.2137, 0.2863], atol=1e-12)
    R0 = inc.rotation[0]
    np.testing.assert_allclose(R0 @ inc.rotation[1], whole.rotation[0], atol=1e-6)
    velocity = inc.velocity[0] + R0 @ inc.velocity[1]
    np.testing.assert_allclose(velocity, whole.velocity[0], atol=1e-5)


def test_inner_motion_ends_where_the_increment_does():
    stretches = ImuTimeline(tumbling(), np.array([0.0, 0.1, 0.113, 0.4])).stretches(0, 3)
    inc = integrate(stretches, NONE, NONE)
    t, q, dv, dp = inner_motion(stretches, NONE, NONE)
    np.testing.assert_allclose(t[:, -1], inc.duration, atol=1e-12)
    np.testing.assert_allclose(dv[:, -1], inc.velocity, atol=1e-12)
    np.testing.assert_allclose(dp[:, -1], inc.position, atol=1e-12)
    np.testing.assert_allclose(attitude.matrix(q[:, -1]), inc.rotation, atol=1e-12)


def test_constant_rate_is_integrated_exactly():
    t = np.arange(11) * 0.1
    rate = np.array([0.3, -2.0, 1.0])
    imu = ImuLog(t, np.tile(rate, (11, 1)), np.zeros((11, 3)))
    inc = integrate(ImuTimeline(imu, np.array([0.0, 1.0])).stretches(0, 1), NONE, NONE)
    assert attitude.log(attitude.from_matrix(inc.rotation[0])) == pytest.approx(rate, abs=1e-12)
