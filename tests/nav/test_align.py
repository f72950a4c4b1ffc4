"""The start found in the log: level and bias at rest, heading from motion or compass, latency."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos.nav import attitude
from hsvaos.nav.align import align, first_state
from hsvaos.nav.epochs import epochs_of
from hsvaos.nav.error_state_ekf import ErrorStateEkf
from hsvaos.nav.estimate import estimate_trajectory
from hsvaos.nav.fit import fit_models
from hsvaos.nav.log import BaroLog, GnssLog, ImuLog, MagLog, SensorLog, TrueMotion
from hsvaos.nav.mission import lean
from hsvaos.nav.sensors import IMU_MODELS, simulate_log
from tests.nav.models import BARO, GNSS, IMU, with_latency

EKF = ErrorStateEkf(IMU, GNSS, BARO)


def standing(seconds=20.0, roll=0.05, pitch=-0.1, yaw=0.7):
    t = np.arange(int(seconds * 200)) / 200.0
    n = len(t)
    q = attitude.from_euler(roll, pitch, yaw)
    force = attitude.rotate(attitude.conjugate(q), [0.0, 0.0, -9.80665])
    zero = np.zeros((n, 3))
    return TrueMotion(t, zero, zero, np.tile(q, (n, 1)), zero, np.tile(force, (n, 1)))


@pytest.mark.parametrize("yaw_deg", [-170.0, -100.0, 10.0, 77.0])
def test_heading_is_found_from_motion(short_mission, yaw_deg):
    motion, _ = short_mission
    motion = lean(motion.t_s, motion.position, motion.velocity, np.radians(yaw_deg))
    log = simulate_log(motion, IMU, GNSS, BARO, seed=2)
    start = align(log, EKF)
    turn = attitude.log(
        attitude.multiply(motion.quaternion[0], attitude.conjugate(start.quaternion))
    )
    assert abs(np.degrees(turn[2])) < 2.0
    assert abs(np.degrees(turn[:2])).max() < 0.5
    assert "start: heading from motion" in start.notes


def test_level_and_gyroscope_bias_come_from_rest():
    imu = replace(IMU_MODELS["adis16448"], accel_bias_std=0.0).with_constant_biases()
    log = simulate_log(standing(), imu, GNSS, BARO, seed=1)
    start = first_state(log, ErrorStateEkf(imu, GNSS, BARO))
    bias = log.extra["gyro_bias"][0]
    np.testing.assert_allclose(start.gyro_bias, bias, atol=4 * start.gyro_bias_std.max())
    assert start.gyro_bias_std.max() < 1e-3 < abs(bias).max()
    roll, pitch, _ = attitude.to_euler(start.quaternion)
    assert (roll, pitch) == (pytest.approx(0.05, abs=0.002), pytest.approx(-0.1, abs=0.002))
    assert any("at rest" in note for note in start.notes)


def test_a_vehicle_that_never_moves_has_no_heading_and_says_so():
    log = simulate_log(standing(), IMU, GNSS, BARO, seed=1)
    start = align(log, EKF)
    assert any("heading unknown" in note for note in start.notes)
    assert start.attitude_std[2] > 1.0


def test_the_compass_gives_the_heading_where_motion_does_not():
    motion = standing(yaw=2.0)
    log = simulate_log(motion, IMU, GNSS, BARO, seed=1)
    field = attitude.rotate(attitude.conjugate(motion.quaternion), [0.2, 0.0, 0.4])
    start = align(log.replace(mag=MagLog(motion.t_s, field)), EKF)
    assert "start: heading from compass" in start.notes
    assert attitude.to_euler(start.quaternion)[2] == pytest.approx(2.0, abs=0.02)


def test_motion_overrules_a_compass_that_is_wrong(short_mission, simulated):
    motion, _ = short_mission
    q = motion.quaternion
    field = attitude.rotate(attitude.conjugate(q), [-0.2, 0.0, 0.4])  # half a turn off
    start = align(simulated(1).replace(mag=MagLog(motion.t_s, field)), EKF)
    assert "start: heading from motion" in start.notes
    assert abs(attitude.to_euler(start.quaternion)[2]) < np.radians(2.0)


@pytest.mark.parametrize("latency", [0.0, 0.12, 0.2])
def test_latency_is_found(simulated, latency):
    log = simulated(1, gnss=with_latency(latency))
    models = fit_models(log, IMU, GNSS, BARO)
    assert models.gnss.latency_s == pytest.approx(latency, abs=0.015)


def test_sensors_that_made_a_log_are_recognised(simulated):
    log = simulated(2)
    models = fit_models(log, None, None, BARO, gnss_latency_s=0.0)
    assert models.imu in (IMU_MODELS["adis16448"], IMU_MODELS["consumer"])
    assert models.gnss.wander_std == (0.0, 0.0)
    assert models.gnss.velocity_std == GNSS.velocity_std or models.log.gnss.velocity_std is not None


def test_a_log_without_fixes_cannot_start(simulated):
    with pytest.raises(ValueError, match="at least one GNSS position, got none"):
        first_state(simulated(0).replace(gnss=None), EKF)


@given(st.lists(st.floats(0.0, 9.0), min_size=1, max_size=20, unique=True), st.floats(0.0, 0.5))
def test_every_measurement_within_the_log_has_its_epoch(times, latency):
    t = np.unique(np.round(np.array(times), 6))
    three = np.zeros((len(t), 3))
    imu_t = np.arange(0.0, 10.0, 0.01)
    many = np.zeros((len(imu_t), 3))
    log = SensorLog(ImuLog(imu_t, many, many), GnssLog(t + latency, three, three), BaroLog(t, t))
    epochs = epochs_of(log, 0.0, 9.5, gnss_latency_s=latency, max_step_s=0.1)
    assert (np.diff(epochs.t_s) > 0.0).all()
    assert np.diff(epochs.t_s).max() < 0.1 + 2e-6
    for numbers in (epochs.gnss, epochs.baro):
        used = numbers[numbers >= 0]
        np.testing.assert_array_equal(np.sort(used), np.arange(len(t)))
        np.testing.assert_allclose(epochs.t_s[numbers >= 0], t, atol=1.1e-6)


@pytest.mark.slow
def test_everything_unknown_still_gives_a_good_trajectory():
    """A full mission by a sensor straight from the shelf, nothing told to the filter."""
    from hsvaos.nav.mission import Lawnmower

    motion, photos = Lawnmower(nose="track").fly(1)
    late = replace(GNSS, latency_s=0.15)
    log = simulate_log(motion, IMU_MODELS["adis16448"], late, BARO, seed=1)
    trajectory = estimate_trajectory(log)
    position, _, q = trajectory.at(photos)
    true_position, _, true_q = motion.at(photos)
    assert np.sqrt(np.mean(np.sum((position - true_position)[:, :2] ** 2, axis=1))) < 0.12
    turn = np.degrees(attitude.log(attitude.multiply(true_q, attitude.conjugate(q))))
    assert np.sqrt(np.mean(turn[:, :2] ** 2)) < 0.2
    assert np.sqrt(np.mean(turn[:, 2] ** 2)) < 0.3
