"""Poses of a simulated flight as the package's own filter estimates them from its sensor log."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hsvaos.nav.error_state_ekf import ErrorStateEkf
from hsvaos.nav.log import SensorLog
from hsvaos.nav.sensor_models import BARO_MODELS, GNSS_MODELS, IMU_MODELS
from hsvaos.nav.smoother import smooth
from hsvaos.nav.trajectory import trajectory_of
from hsvaos.simulate.settings import SensorSettings

Array = NDArray[np.float64]


def estimated_poses(
    log: SensorLog, sensors: SensorSettings, times_s: Array, *, smoothed: bool = True
) -> Array:
    """Return world_from_camera by the error-state filter, shape (N, 4, 4).

    Args:
        log: What the sensors wrote.
        sensors: Which sensors they are.
        times_s: Shape (N,), times of the photos [s].
        smoothed: Whether the smoother runs after the filter.

    Raises:
        ValueError: If the log does not let the filter start.
    """
    # The filter is told the receiver's own noise, not the faults that were put in.
    states = ErrorStateEkf(
        IMU_MODELS[sensors.imu], GNSS_MODELS[sensors.gnss], BARO_MODELS[sensors.baro]
    ).run(log)
    if smoothed:
        states = smooth(states)
    return trajectory_of(states, log).world_from_camera(times_s)
