"""The filter of the air says what the one on the ground says, sample by sample, late or not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hsvaos.nav import attitude
from hsvaos.nav.error_state_ekf import ErrorStateEkf
from hsvaos.nav.log import SensorLog
from hsvaos.nav.online import NoPoseError, OnlineFilter
from hsvaos.nav.sensor_models import BaroModel
from hsvaos.nav.trajectory import trajectory_of
from tests.nav.models import BARO, GNSS, IMU, with_latency


def events(log: SensorLog) -> list[tuple[float, str, int]]:
    """Samples in the order in which they come in."""
    out = [(float(t), "imu", i) for i, t in enumerate(log.imu.t_s)]
    if log.gnss is not None:
        out += [(float(t), "gnss", i) for i, t in enumerate(log.gnss.t_s)]
    if log.baro is not None:
        out += [(float(t), "baro", i) for i, t in enumerate(log.baro.t_s)]
    return sorted(out)


def feed(online: OnlineFilter, log: SensorLog, event: tuple[float, str, int]) -> None:
    t, kind, i = event
    if kind == "imu":
        online.add_imu(t, log.imu.gyro[i], log.imu.accel[i])
    elif kind == "gnss" and log.gnss is not None:
        online.add_gnss(t, log.gnss.position[i], log.gnss.velocity[i])
    elif log.baro is not None:
        online.add_baro(t, float(log.baro.height_m[i]))


def fly(online: OnlineFilter, log: SensorLog, asked: list[float]) -> dict[float, Any]:
    """Poses at the times asked for, each once the IMU has got there."""
    poses: dict[float, Any] = {}
    todo = list(asked)
    for event in events(log):
        feed(online, log, event)
        while todo and event[1] == "imu" and event[0] >= todo[0]:
            poses[todo[0]] = online.world_from_camera(todo[0])
            todo.pop(0)
    return poses


def apart(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Distance [m] and angle [deg] of two poses."""
    turn = attitude.log(attitude.from_matrix(a[:3, :3] @ b[:3, :3].T))
    distance = float(np.linalg.norm(a[:3, 3] - b[:3, 3]))
    return distance, float(np.degrees(np.linalg.norm(turn)))


@pytest.mark.parametrize("latency", [0.0, 0.2])
def test_the_pose_of_now_equals_the_filter_that_has_the_whole_log(
    simulated: Any, start: Any, latency: float
) -> None:
    log = simulated(2)
    if latency:  # fixes speak of where the vehicle was when they come
        log = log.replace(gnss=replace(log.gnss, t_s=log.gnss.t_s + latency))
    ekf = ErrorStateEkf(IMU, with_latency(latency), BARO)
    initial = start(2)
    online = OnlineFilter(ekf, initial, mounting=log.mounting, hold_s=0.5)
    asked = [float(t) for t in np.arange(3.03, 25.0, 1.7)]
    poses = fly(online, log, asked)
    assert len(poses) == len(asked)
    for t, pose in poses.items():
        # all that had come in by then, and nothing later
        known = log.gnss.t_s <= t
        seen = log.replace(
            gnss=replace(
                log.gnss,
                t_s=log.gnss.t_s[known],
                position=log.gnss.position[known],
                velocity=log.gnss.velocity[known],
            )
        )
        states = ekf.run(seen, initial, keep_history=False, stop_s=t)
        batch = trajectory_of(states, log).world_from_camera(states.t_s[-1])
        distance, angle = apart(pose, batch)
        assert distance < 2e-3
        assert angle < 0.02
    assert online.refused == 0


def test_memory_stays_small_and_old_times_are_gone(simulated: Any, start: Any) -> None:
    log = simulated(1)
    online = OnlineFilter(ErrorStateEkf(IMU, GNSS, BARO), start(1), hold_s=0.5)
    for event in events(log):  # nobody asks for a pose
        feed(online, log, event)
        if event[0] > 20.0:
            break
    assert len(online._imu) < 1.5 / 0.5 * IMU.rate_hz
    assert len(online._gnss) + len(online._baro) < 200
    with pytest.raises(NoPoseError, match="committed"):
        online.world_from_camera(5.0)
    with pytest.raises(NoPoseError, match="newest IMU sample"):
        online.world_from_camera(21.0)
    online.world_from_camera(20.02)  # a little ahead of the newest sample is fine
    online.add_gnss(3.0, np.zeros(3))
    online.add_imu(3.0, np.zeros(3), np.zeros(3))
    online.add_imu(20.5, np.full(3, np.nan), np.zeros(3))
    assert online.refused == 3


def test_it_finds_where_it_starts_by_itself(simulated: Any, short_mission: Any) -> None:
    motion, _ = short_mission
    log = simulated(3)
    ekf = ErrorStateEkf(IMU, GNSS, BaroModel(25.0, BARO.noise_std, bias_std=2.0))
    online = OnlineFilter(ekf, mounting=log.mounting, origin=log.origin, align_s=8.0)
    with pytest.raises(NoPoseError, match="not known yet"):
        online.world_from_camera(0.0)
    for event in events(log):
        feed(online, log, event)
        if online._aligning is not None and not online.ready:
            assert online.wait(120.0)
        if event[0] > 30.0:
            break
    assert any("heading from motion" in note for note in online.notes)
    state = online.at(30.0)
    position, _, q = motion.at(np.array([30.0]))
    assert np.linalg.norm(state.x[:2] - position[0, :2]) < 2.0
    true = np.eye(4)
    true[:3, :3] = attitude.matrix(q[0])
    seen = np.eye(4)
    seen[:3, :3] = state.R
    assert apart(seen, true)[1] < 10.0


def test_what_makes_no_sense_is_refused() -> None:
    with pytest.raises(ValueError, match="hold_s"):
        OnlineFilter(hold_s=0.0)
    with pytest.raises(ValueError, match="gyro must be 3 numbers"):
        OnlineFilter().add_imu(0.0, np.zeros(2), np.zeros(3))
    with pytest.raises(ValueError, match="position must be 3 numbers"):
        OnlineFilter().add_gnss(0.0, np.zeros((1, 3)))


def test_a_start_that_cannot_be_found_is_looked_for_again() -> None:
    """Fixes that move, but an IMU that was never there: said, and tried again with more."""
    online = OnlineFilter(align_s=1.0)
    for i in range(15):
        online.add_gnss(0.1 * i, np.zeros(3), np.array([5.0, 0.0, 0.0]))
    online.wait(60.0)
    assert not online.ready
    assert "not found yet" in online.notes[0]
    for i in range(15, 60):
        online.add_gnss(0.1 * i, np.zeros(3), np.array([5.0, 0.0, 0.0]))
        online.wait(60.0)
    assert len(online.notes) == 1
    online.add_gnss(6.0, np.full(3, np.nan), np.full(3, np.nan))
    assert online.refused == 1
