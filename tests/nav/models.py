"""Sensors of the shared missions, and how far an estimate is from the truth."""

from dataclasses import replace

import numpy as np

from hsvaos.nav.sensors import BARO_MODELS, GNSS_MODELS, IMU_MODELS

IMU = IMU_MODELS["adis16448-calibrated"]
GNSS = GNSS_MODELS["sbas"]
BARO = BARO_MODELS["calibrated"]


def horizontal_rmse(states, motion) -> float:
    """Horizontal error of states over all epochs after the first ten seconds [m]."""
    late = states.t_s > states.t_s[0] + 10.0
    error = states.position[late] - motion.at(states.t_s[late])[0]
    return float(np.sqrt(np.mean(np.sum(error[:, :2] ** 2, axis=1))))


def with_latency(seconds: float):
    return replace(GNSS, latency_s=seconds)
