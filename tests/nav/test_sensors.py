"""Sensor models: the noise that comes out has the statistics that the model states."""

from dataclasses import replace

import numpy as np
import pytest

from hsvaos.nav.log import Mounting, TrueMotion
from hsvaos.nav.mission import Lawnmower
from hsvaos.nav.sensors import (
    BARO_MODELS,
    GNSS_MODELS,
    IMU_MODELS,
    simulate_baro,
    simulate_gnss,
    simulate_imu,
    simulate_log,
)


def hover(seconds: float, rate_hz: float = 100.0) -> TrueMotion:
    t = np.arange(int(seconds * rate_hz) + 1) / rate_hz
    n = len(t)
    return TrueMotion(
        t,
        np.tile([0.0, 0.0, -10.0], (n, 1)),
        np.zeros((n, 3)),
        np.tile([1.0, 0, 0, 0], (n, 1)),
        np.zeros((n, 3)),
        np.tile([0.0, 0.0, -9.80665], (n, 1)),
    )


@pytest.fixture(scope="module")
def mission():
    return Lawnmower().fly(seed=3)


@pytest.mark.parametrize("name", sorted(IMU_MODELS))
def test_imu_noise_has_the_stated_density(name):
    model = IMU_MODELS[name].with_constant_biases()
    log, gyro_bias, accel_bias = simulate_imu(hover(200.0), model, np.random.default_rng(1))
    assert len(log.t_s) == 200 * model.rate_hz + 1
    root = np.sqrt(model.rate_hz)
    assert (log.gyro - gyro_bias).std() == pytest.approx(model.gyro_noise * root, rel=0.02)
    force = log.accel - accel_bias + [0.0, 0.0, 9.80665]
    assert force.std() == pytest.approx(model.accel_noise * root, rel=0.02)
    assert np.ptp(gyro_bias, axis=0).max() == 0.0
    assert model.source


def test_bias_drift_grows_like_a_random_walk_and_settles_like_gauss_markov():
    model = replace(IMU_MODELS["adis16448"], rate_hz=10.0, gyro_bias_std=0.0, accel_bias_std=0.0)
    model = replace(model, gyro_bias_tau_s=float("inf"), accel_bias_tau_s=5.0)
    ends = [
        simulate_imu(hover(100.0, 10.0), model, np.random.default_rng(s))[1:] for s in range(150)
    ]
    walk = np.array([gyro[-1] for gyro, _ in ends]).std()
    assert walk == pytest.approx(model.gyro_bias_walk * np.sqrt(100.0), rel=0.1)
    settled = np.array([accel[-1] for _, accel in ends]).std()
    assert settled == pytest.approx(model.accel_bias_walk * np.sqrt(5.0 / 2.0), rel=0.1)


def test_gnss_sees_the_antenna_late_with_outages_and_outliers(mission):
    motion, _ = mission
    model = replace(GNSS_MODELS["rtk"], position_std=(0.0, 0.0), velocity_std=0.0, latency_s=0.2)
    lever = np.array([0.3, 0.0, -0.1])
    log = simulate_gnss(
        motion, model, np.random.default_rng(0), antenna_lever_arm=lever, outages=((50.0, 80.0),)
    )
    assert not ((log.t_s - 0.2 >= 50.0) & (log.t_s - 0.2 < 80.0)).any()
    position, _, _ = motion.at(log.t_s - 0.2)
    offset = np.linalg.norm(log.position - position, axis=1)
    np.testing.assert_allclose(offset, np.linalg.norm(lever), atol=1e-9)
    # the velocity is the derivative of the antenna's path
    slope = np.gradient(log.position[:200], log.t_s[:200], axis=0)
    assert abs(slope - log.velocity[:200])[1:-1].max() < 0.1
    wild = simulate_gnss(motion, model, np.random.default_rng(0), outlier_share=0.1)
    far = np.linalg.norm(wild.position - motion.at(wild.t_s - 0.2)[0], axis=1)
    assert 0.05 < (far > 14.9).mean() < 0.15
    assert far[far > 1.0] == pytest.approx(15.0)


def test_gnss_white_and_wandering_errors_have_the_stated_spread():
    motion = hover(2000.0, 5.0)
    white = simulate_gnss(motion, GNSS_MODELS["single"], np.random.default_rng(0))
    assert white.position[:, :2].std() == pytest.approx(1.5, rel=0.02)
    assert white.position[:, 2].std() == pytest.approx(2.5, rel=0.02)
    model = replace(GNSS_MODELS["single"], position_std=(0.0, 0.0), wander_std=(1.0, 2.0))
    model = replace(model, wander_tau_s=5.0)
    slow = simulate_gnss(motion, model, np.random.default_rng(0)).position
    assert slow[:, :2].std() == pytest.approx(1.0, rel=0.1)
    assert slow[:, 2].std() == pytest.approx(2.0, rel=0.1)
    lag = int(5.0 * model.rate_hz)
    correlation = np.corrcoef(slow[lag:, 0], slow[:-lag, 0])[0, 1]
    assert correlation == pytest.approx(np.exp(-1.0), abs=0.12)


def test_baro_is_height_with_noise():
    log = simulate_baro(hover(200.0), BARO_MODELS["calibrated"], np.random.default_rng(0))
    assert log.height_m.mean() == pytest.approx(10.0, abs=0.01)
    assert log.height_m.std() == pytest.approx(BARO_MODELS["calibrated"].noise_std, rel=0.02)


def test_a_sensor_left_out_does_not_change_the_others(mission):
    motion, _ = mission
    models = IMU_MODELS["adis16448"], GNSS_MODELS["single"], BARO_MODELS["ms5611"]
    whole = simulate_log(motion, *models, seed=5)
    again = simulate_log(motion, models[0], None, models[2], seed=5, mounting=Mounting())
    assert again.gnss is None
    np.testing.assert_array_equal(whole.imu.gyro, again.imu.gyro)
    np.testing.assert_array_equal(whole.baro.height_m, again.baro.height_m)


def test_the_mission_is_the_papers(mission):
    motion, triggers = mission
    assert len(triggers) == 117
    assert (np.diff(triggers) > 0.5).all()
    position, velocity, _ = motion.at(triggers)
    assert np.ptp(position[:, 0]) == pytest.approx(64.0, abs=1.0)
    assert np.ptp(position[:, 1]) == pytest.approx(64.0, abs=1.0)
    assert position[:, 2].mean() == pytest.approx(-20.0, abs=0.3)
    cruise = np.linalg.norm(velocity[:, :2], axis=1).reshape(9, 13)[:, 4:9]
    assert cruise.mean() == pytest.approx(5.0, abs=0.1)
    # the path obeys its own IMU: strapdown integration is tested with the filters
    accel = np.gradient(motion.velocity, motion.t_s, axis=0)
    assert np.linalg.norm(accel, axis=1).max() < 4.0


def test_a_rate_that_is_not_positive_is_refused():
    with pytest.raises(ValueError, match=r"rate_hz of a sensor must be positive, got 0\.0"):
        simulate_imu(
            hover(1.0), replace(IMU_MODELS["consumer"], rate_hz=0.0), np.random.default_rng(0)
        )
