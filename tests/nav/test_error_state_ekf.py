"""The error-state filter and its smoother: consistency, faults, and the pieces they stand on."""

from dataclasses import replace

import numpy as np
import pytest

from hsvaos.nav import attitude
from hsvaos.nav.chi_square import mean_bounds
from hsvaos.nav.error_state_ekf import ErrorStateEkf
from hsvaos.nav.log import BaroLog, Mounting
from hsvaos.nav.sensors import BARO_MODELS, IMU_MODELS
from hsvaos.nav.smoother import smooth
from tests.nav.models import BARO, GNSS, IMU, horizontal_rmse, with_latency


@pytest.fixture(scope="module")
def clean(simulated, start):
    return ErrorStateEkf(IMU, GNSS, BARO).run(simulated(1), start(1))


def test_nis_and_nees_lie_within_their_bounds(simulated, start, short_mission):
    motion, _ = short_mission
    ekf = ErrorStateEkf(IMU, GNSS, BARO)
    flights = 8
    runs = [ekf.run(simulated(seed), start(seed)) for seed in range(flights)]
    for sensor in ("gnss position", "gnss velocity", "baro"):
        seen = [run.innovations[sensor] for run in runs]
        dof = sum(int(i.dof.sum()) for i in seen)
        # a gate at 1e-4 hides next to nothing of the tail
        low, high = mean_bounds(0.9999, 1.0, dof)
        assert low < sum(float(i.nis.sum()) for i in seen) / dof < high
    for states in (runs, [smooth(run) for run in runs]):
        nees = np.array([s.nees(motion)[200::50] for s in states])
        low, high = mean_bounds(0.95, 9.0, flights)
        mean = nees.mean(axis=0)
        # 95 % are expected within; times of one flight hang together, so fewer may be
        assert np.mean((mean > low) & (mean < high)) > 0.7
        assert 7.0 < nees.mean() < 11.0


def test_smoothing_helps_and_says_so(clean, short_mission):
    motion, _ = short_mission
    better = smooth(clean)
    assert better.smoothed
    assert horizontal_rmse(better, motion) < 0.9 * horizontal_rmse(clean, motion)
    np.testing.assert_array_equal(better.position[-1], clean.position[-1])
    before = np.diagonal(clean.covariance, axis1=1, axis2=2)
    after = np.diagonal(better.covariance, axis1=1, axis2=2)
    assert (after <= before * (1 + 1e-6)).all()
    assert (np.linalg.eigvalsh(better.covariance)[:, 0] > -1e-12).all()


def test_smoother_equals_batch_least_squares_of_a_straight_line():
    """A body that cannot turn, with one constant bias: the smoother must be the batch optimum."""
    from hsvaos.nav.initial import InitialState
    from hsvaos.nav.log import GnssLog, ImuLog, SensorLog

    rng = np.random.default_rng(3)
    t = np.arange(0.0, 10.001, 0.01)
    accel = np.tile([0.0, 0.0, -9.80665], (len(t), 1))
    imu = ImuLog(t, np.zeros((len(t), 3)), accel)
    fixes = np.arange(0.5, 10.0, 0.5)
    north = 0.3 * fixes + rng.standard_normal(len(fixes))
    position = np.stack([north, np.zeros(len(fixes)), np.zeros(len(fixes))], axis=1)
    nothing = np.full_like(position, np.nan)
    log = SensorLog(imu, GnssLog(fixes, position, nothing))
    tiny = np.full(3, 1e-9)
    begin = InitialState(
        0.0,
        np.zeros(3),
        np.zeros(3),
        np.array([1.0, 0, 0, 0]),
        position_std=np.full(3, 5.0),
        velocity_std=np.full(3, 2.0),
        attitude_std=tiny,
        gyro_bias_std=tiny,
        accel_bias_std=tiny,
    )
    quiet = replace(IMU, gyro_noise=1e-12, accel_noise=1e-9)
    states = smooth(ErrorStateEkf(quiet, GNSS, gate=0.0).run(log, begin))
    A = np.stack([np.ones(len(fixes)), fixes], axis=1)
    prior = np.diag([1 / 25.0, 1 / 4.0])
    information = A.T @ A + prior
    best = np.linalg.solve(information, A.T @ north)
    assert states.position[0, 0] == pytest.approx(best[0], abs=1e-5)
    assert states.velocity[0, 0] == pytest.approx(best[1], abs=1e-5)
    cov = np.linalg.inv(information)
    assert states.covariance[0, 0, 0] == pytest.approx(cov[0, 0], rel=1e-4)
    assert states.covariance[0, 3, 3] == pytest.approx(cov[1, 1], rel=1e-4)


def test_a_latency_that_is_modelled_costs_little(simulated, start, short_mission):
    motion, _ = short_mission
    late = simulated(1, gnss=with_latency(0.2))
    modelled = smooth(ErrorStateEkf(IMU, with_latency(0.2), BARO).run(late, start(1)))
    ignored = smooth(ErrorStateEkf(IMU, GNSS, BARO).run(late, start(1)))
    punctual = smooth(ErrorStateEkf(IMU, GNSS, BARO).run(simulated(1), start(1)))
    error = horizontal_rmse(punctual, motion)
    assert horizontal_rmse(modelled, motion) < 1.3 * error
    assert horizontal_rmse(ignored, motion) > 3.0 * error


def test_a_late_barometer_is_put_back_to_its_time(simulated, start):
    log = simulated(1)
    shifted = log.replace(baro=BaroLog(log.baro.t_s + 0.1, log.baro.height_m))
    states = ErrorStateEkf(IMU, GNSS, BARO).run(log, start(1))
    late = ErrorStateEkf(IMU, GNSS, replace(BARO, latency_s=0.1)).run(shifted, start(1))
    at = np.searchsorted(late.t_s, states.t_s)
    inside = at < len(late.t_s)
    np.testing.assert_allclose(late.position[at[inside]], states.position[inside], atol=1e-6)


def test_outliers_are_gated(simulated, start, short_mission):
    motion, _ = short_mission
    log = simulated(1, outlier_share=0.03, outlier_m=15.0)
    states = ErrorStateEkf(IMU, GNSS, BARO).run(log, start(1))
    plain = ErrorStateEkf(IMU, GNSS, BARO, gate=0.0).run(log, start(1))
    far = np.linalg.norm(log.gnss.position - motion.at(log.gnss.t_s)[0], axis=1) > 10.0
    assert far.sum() > 5
    refused = states.innovations["gnss position"]
    np.testing.assert_array_equal(~refused.accepted[far], True)
    assert refused.gated <= far.sum() + 2
    assert horizontal_rmse(states, motion) < horizontal_rmse(plain, motion)


def test_a_sensor_refused_for_long_is_let_in_again(simulated, start, short_mission):
    motion, _ = short_mission
    log = simulated(1)
    wrong = start(1)
    wrong = wrong.replace(position=wrong.position + np.array([300.0, 0.0, 0.0]))
    ekf = ErrorStateEkf(IMU, GNSS, BARO, recovery_s=2.0)
    states = ekf.run(log, wrong)
    seen = states.innovations["gnss position"]
    assert seen.recoveries >= 1
    end = states.position[-1] - motion.at(states.t_s[-1:])[0][0]
    assert np.linalg.norm(end[:2]) < 1.0


def test_an_outage_is_bridged_and_smoothed(simulated, start, short_mission):
    motion, _ = short_mission
    log = simulated(1, outages=((20.0, 40.0),))
    states = ErrorStateEkf(IMU, GNSS, BARO).run(log, start(1))
    dark = (states.t_s > 21.0) & (states.t_s < 39.9)
    assert np.diff(states.t_s).max() < 0.11  # epochs go on where fixes do not
    error = np.linalg.norm((states.position - motion.at(states.t_s)[0])[dark, :2], axis=1)
    sigma = np.sqrt(states.covariance[dark, 0, 0] + states.covariance[dark, 1, 1])
    assert (error < 4.0 * sigma).all()
    better = smooth(states)
    smooth_error = np.linalg.norm((better.position - motion.at(better.t_s)[0])[dark, :2], axis=1)
    assert smooth_error.max() < 0.5 * error.max()


def test_the_antenna_lever_arm_is_modelled(simulated, start, short_mission):
    motion, _ = short_mission
    mounting = Mounting(antenna_lever_arm=np.array([0.5, 0.0, 0.0]))
    log = simulated(1, mounting=mounting)
    known = smooth(ErrorStateEkf(IMU, GNSS, BARO).run(log, start(1)))
    ignored = smooth(ErrorStateEkf(IMU, GNSS, BARO).run(log.replace(mounting=Mounting()), start(1)))
    assert horizontal_rmse(known, motion) < 0.15
    assert horizontal_rmse(ignored, motion) > 0.4


def test_offset_of_the_barometer_and_wander_of_gnss_are_states(simulated, start, short_mission):
    motion, _ = short_mission
    baro = BARO_MODELS["ms5611"]
    gnss = replace(GNSS, wander_std=(1.0, 1.5), wander_tau_s=30.0, position_std=(0.1, 0.1))
    log = simulated(2, gnss=gnss, baro=baro)
    log = log.replace(baro=BaroLog(log.baro.t_s, log.baro.height_m + 3.0))
    ekf = ErrorStateEkf(IMU, gnss, baro)
    assert ekf.layout.size == 19
    states = smooth(ekf.run(log, start(2)))
    offset = states.vector[:, ekf.layout.baro_at]
    sigma = np.sqrt(states.covariance[:, 15, 15])
    true_offset = log.baro.height_m[50:] + motion.at(log.baro.t_s[50:])[0][:, 2]
    assert abs(offset[-1] - true_offset[-200:].mean()) < 3.0 * sigma[-1] + 0.2
    error = (states.position - motion.at(states.t_s)[0])[200:]
    spread = np.sqrt(np.diagonal(states.covariance[200:, :3, :3], axis1=1, axis2=2))
    assert np.mean((error / spread) ** 2) < 4.0  # it knows that it does not know


def test_drifting_biases_are_followed(short_mission, start, simulated):
    imu = replace(IMU_MODELS["adis16448-rotors"], gyro_bias_std=1e-4, accel_bias_std=0.01)
    log = simulated(3, imu=imu)
    states = smooth(ErrorStateEkf(imu, GNSS, BARO).run(log, start(3, imu=imu)))
    true = np.stack([np.interp(states.t_s, log.imu.t_s, c) for c in log.extra["gyro_bias"].T], 1)
    error = states.gyro_bias - true
    sigma = np.sqrt(np.diagonal(states.covariance, axis1=1, axis2=2)[:, 9:12])
    assert np.mean((error / sigma) ** 2) < 3.0
    assert sigma[len(sigma) // 2].max() < 0.003


def test_measurements_outside_the_imu_log_are_left_out_and_counted(simulated, start):
    log = simulated(1)
    cut = log.imu.t_s <= 30.0
    short = log.replace(imu=type(log.imu)(log.imu.t_s[cut], log.imu.gyro[cut], log.imu.accel[cut]))
    states = ErrorStateEkf(IMU, GNSS, BARO).run(short, start(1))
    assert states.t_s[-1] == pytest.approx(30.0)
    assert any("gnss measurements before or after" in note for note in states.notes)


def test_without_history_there_is_nothing_to_smooth(clean):
    with pytest.raises(ValueError, match="smooth already"):
        smooth(smooth(clean))
    with pytest.raises(ValueError, match="without history"):
        smooth(replace(clean, history=None))


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"gate": 0.7}, "gate must be a probability"),
        ({"recovery_s": 0.0}, "must be positive"),
        ({"max_step_s": -1.0}, "must be positive"),
    ],
)
def test_parameters_out_of_range_are_refused(keywords, message):
    with pytest.raises(ValueError, match=message):
        ErrorStateEkf(IMU, GNSS, BARO, **keywords)


def test_a_start_outside_the_log_is_refused(simulated, start):
    with pytest.raises(ValueError, match="must start within the IMU log"):
        ErrorStateEkf(IMU, GNSS, BARO).run(simulated(1), start(1).replace(t_s=1e6))


def test_a_fix_without_noise_and_model_is_refused(simulated, start):
    log = simulated(1)
    bare = log.replace(gnss=replace(log.gnss, position_std=None, velocity_std=None))
    with pytest.raises(ValueError, match="states no position noise"):
        ErrorStateEkf(IMU, None, BARO).run(bare, start(1))


def test_attitude_stays_a_rotation(clean):
    product = clean.rotation @ np.swapaxes(clean.rotation, 1, 2)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), product.shape), atol=1e-10)
    assert attitude.check_unit(clean.quaternion, "q").shape == (len(clean.t_s), 4)
