"""Poses of a simulated flight as the package's own filter estimates them from its sensor log."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hsvaos.nav import attitude
from hsvaos.nav.error_state_ekf import ErrorStateEkf
from hsvaos.nav.log import SensorLog
from hsvaos.nav.sensor_models import BARO_MODELS, GNSS_MODELS, IMU_MODELS
from hsvaos.nav.smoother import smooth
from hsvaos.simulate.settings import SensorSettings

Array = NDArray[np.float64]


def estimated_poses(
    log: SensorLog, sensors: SensorSettings, times_s: Array, *, smoothed: bool = True
) -> Array:
    """Return world_from_camera by the error-state filter, shape (N, 4, 4).

    Between the filter's epochs (at most 0.1 s apart) positions follow the cubic through positions
    and velocities, attitudes the shortest arc.

    Args:
        log: What the sensors wrote.
        sensors: Which sensors they are.
        times_s: Shape (N,), times of the photos [s].
        smoothed: Whether the smoother runs after the filter.
    """
    # The filter is told the receiver's own noise, not the faults that were put in.
    states = ErrorStateEkf(
        IMU_MODELS[sensors.imu], GNSS_MODELS[sensors.gnss], BARO_MODELS[sensors.baro]
    ).run(log)
    if smoothed:
        states = smooth(states)
    t = states.t_s
    i = np.clip(np.searchsorted(t, times_s, side="right") - 1, 0, len(t) - 2)
    dt = (t[i + 1] - t[i])[:, None]
    u = (times_s - t[i])[:, None] / dt
    p0, p1 = states.position[i], states.position[i + 1]
    v0, v1 = states.velocity[i], states.velocity[i + 1]
    position = (
        p0
        + u * dt * v0
        + u**2 * (3.0 * (p1 - p0) - dt * (2.0 * v0 + v1))
        + u**3 * (2.0 * (p0 - p1) + dt * (v0 + v1))
    )
    body = attitude.matrix(attitude.slerp(states.quaternion[i], states.quaternion[i + 1], u[:, 0]))
    poses = np.tile(np.eye(4), (len(times_s), 1, 1))
    poses[:, :3, :3] = body @ attitude.matrix(log.mounting.body_from_camera_q)
    poses[:, :3, 3] = position + body @ log.mounting.camera_lever_arm
    return poses
