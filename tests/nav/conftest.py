"""Shared missions and logs; real logs where they are."""

from pathlib import Path

import numpy as np
import pytest

from hsvaos.nav import attitude
from hsvaos.nav.initial import InitialState
from hsvaos.nav.mission import Lawnmower
from hsvaos.nav.sensors import simulate_log
from tests.nav.models import BARO, GNSS, IMU

LOGS = Path(__file__).parents[3] / "shared" / "data" / "logs"


@pytest.fixture(scope="session")
def logs() -> Path:
    if not LOGS.is_dir():
        pytest.skip("the real logs (../shared/data/logs) are not here")
    return LOGS


@pytest.fixture(scope="session")
def short_mission():
    """Two strips of the lawnmower: enough motion for heading, a quarter of the time."""
    return Lawnmower(size_m=32.0, strips=3, photos=7).fly(seed=4)


@pytest.fixture(scope="session")
def simulated(short_mission):
    """Return a function of (seed, gnss model, faults) that gives a log of the short mission."""
    motion, _ = short_mission

    def make(seed=0, imu=IMU, gnss=GNSS, baro=BARO, **keywords):
        return simulate_log(motion, imu, gnss, baro, seed=seed, **keywords)

    return make


@pytest.fixture(scope="session")
def start(short_mission):
    """Return a function of (seed) that gives a start drawn from its own uncertainty."""
    motion, _ = short_mission

    def make(seed=0, imu=IMU, gnss=GNSS):
        rng = np.random.default_rng([seed, 5])
        std = np.radians([1.0, 1.0, 5.0])
        turn = attitude.exp(std * rng.standard_normal(3))
        return InitialState(
            t_s=0.0,
            position=motion.position[0] + gnss.position_axes * rng.standard_normal(3),
            velocity=motion.velocity[0] + gnss.velocity_axes * rng.standard_normal(3),
            quaternion=attitude.multiply(turn, motion.quaternion[0]),
            position_std=gnss.position_axes,
            velocity_std=gnss.velocity_axes,
            attitude_std=std,
            gyro_bias_std=np.full(3, imu.gyro_bias_std),
            accel_bias_std=np.full(3, imu.accel_bias_std),
        )

    return make
