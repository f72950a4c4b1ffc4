"""Real flights: consistency once latency is modelled, outages, glitches."""

from dataclasses import replace

import numpy as np
import pytest

from hsvaos.formats.sensor_log import open_sensor_log
from hsvaos.nav.align import align
from hsvaos.nav.checks import check_log
from hsvaos.nav.error_state_ekf import ErrorStateEkf
from hsvaos.nav.estimate import estimate_trajectory
from hsvaos.nav.initial import InitialState
from hsvaos.nav.sensors import BARO_MODELS, GNSS_MODELS, IMU_MODELS

IMU, BARO = IMU_MODELS["autopilot"], BARO_MODELS["ms5611"]


@pytest.fixture(scope="module")
def swiss(logs):
    return check_log(open_sensor_log(logs / "px4_swiss_search"))


@pytest.fixture(scope="module")
def filtered(swiss):
    ekf = ErrorStateEkf(IMU, replace(GNSS_MODELS["standalone"], latency_s=0.22), BARO)
    return ekf, ekf.run(swiss, align(swiss, ekf, rounds=1))


def test_fixed_wing_is_consistent_once_latency_is_modelled(swiss, filtered):
    ekf, states = filtered
    seen = states.innovations
    assert 0.6 < seen["gnss velocity"].mean_nis < 1.2
    assert 0.6 < seen["baro"].mean_nis < 1.2
    assert 0.4 < seen["gnss position"].mean_nis < 1.2
    punctual = ErrorStateEkf(IMU, replace(ekf.gnss, latency_s=0.0), BARO)
    ignored = punctual.run(swiss, align(swiss, punctual, rounds=1), keep_history=False)
    assert ignored.innovations["gnss velocity"].mean_nis > 1.4 * seen["gnss velocity"].mean_nis
    assert ignored.innovations["gnss velocity"].gated > seen["gnss velocity"].gated


def test_outages_are_predicted_better_than_with_raw_biases(swiss, filtered):
    ekf, states = filtered
    with_biases, without = [], []
    # every few seconds of the flight, but for the aerobatics from 46 s to 78 s
    for begin in (*np.arange(22.0, 46.0, 4.0), *np.arange(78.0, 134.0, 5.0)):
        k = int(np.searchsorted(states.t_s, begin))
        sigma = np.sqrt(np.diagonal(states.covariance[k]))
        start = InitialState(
            t_s=float(states.t_s[k]),
            position=states.position[k],
            velocity=states.velocity[k],
            quaternion=states.quaternion[k],
            gyro_bias=states.gyro_bias[k],
            accel_bias=states.accel_bias[k],
            position_std=sigma[0:3],
            velocity_std=sigma[3:6],
            attitude_std=sigma[6:9],
            gyro_bias_std=sigma[9:12],
            accel_bias_std=sigma[12:15],
        )
        blind = swiss.replace(gnss=None, baro=None)
        raw = start.replace(gyro_bias=np.zeros(3), accel_bias=np.zeros(3))
        fix = int(np.searchsorted(swiss.gnss.t_s - ekf.gnss.latency_s, begin + 10.0))
        here = int(np.searchsorted(swiss.gnss.t_s - ekf.gnss.latency_s, begin))
        # the slow error of the fixes is the same at both ends to within a metre or so
        moved = swiss.gnss.position[fix] - swiss.gnss.position[here]
        when = float(swiss.gnss.t_s[fix]) - ekf.gnss.latency_s
        for first, errors in ((start, with_biases), (raw, without)):
            end = ekf.run(blind, first, stop_s=when, keep_history=False)
            error = end.position[-1] - start.position - moved
            errors.append(float(np.hypot(error[0], error[1])))
    with_rms, raw_rms = (np.sqrt(np.mean(np.square(e))) for e in (with_biases, without))
    assert with_rms < 0.9 * raw_rms
    assert np.median(with_biases) < 0.85 * np.median(without)


@pytest.mark.slow
def test_glitches_of_the_quadrotor_are_gated_and_it_recovers(logs):
    trajectory = estimate_trajectory(logs / "px4_f450_gps_glitch")
    log = check_log(open_sensor_log(logs / "px4_f450_gps_glitch"))
    seen = trajectory.innovations["gnss velocity"]
    # the spike of speeds from 123.5 s on
    spike = (seen.t_s > 124.2) & (seen.t_s < 125.6)
    assert np.linalg.norm(log.gnss.velocity, axis=1).max() > 30.0
    assert not seen.accepted[spike].any()
    flown = np.linalg.norm(trajectory.velocity, axis=1)
    assert flown.max() < 20.0
    # it comes back: at the end fixes are accepted again, and the height is that of the start
    late = seen.t_s > 163.0
    assert seen.accepted[late].mean() > 0.8
    assert trajectory.position[-1, 2] == pytest.approx(trajectory.position[0, 2], abs=3.0)
    assert np.isfinite(trajectory.states.covariance).all()


@pytest.mark.slow
def test_latency_of_the_fixed_wing_is_found(logs):
    trajectory = estimate_trajectory(logs / "px4_swiss_search")
    note = next(note for note in trajectory.notes if "latency" in note)
    assert 0.17 < float(note.split()[2]) < 0.27
