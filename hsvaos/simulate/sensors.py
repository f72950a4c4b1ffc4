"""The sensor log of a simulated flight, by the models of `hsvaos.nav.sensors`."""

from __future__ import annotations

from dataclasses import replace

from hsvaos.nav.log import Mounting, SensorLog
from hsvaos.nav.sensors import BARO_MODELS, GNSS_MODELS, IMU_MODELS, simulate_log
from hsvaos.simulate.mission import Flown
from hsvaos.simulate.settings import SensorSettings


def log_flight(settings: SensorSettings, flown: Flown, seed: int, mounting: Mounting) -> SensorLog:
    """Return what the sensors write down.

    Args:
        settings: Which sensors, and their faults.
        flown: The true path.
        seed: Of their noise.
        mounting: Where the antenna sits.
    """
    gnss = GNSS_MODELS[settings.gnss]
    latency = gnss.latency_s + settings.gnss_latency_s
    return simulate_log(
        flown.motion,
        IMU_MODELS[settings.imu],
        replace(gnss, latency_s=latency),
        BARO_MODELS[settings.baro],
        seed=seed,
        mounting=mounting,
        outages=settings.gnss_outages_s,
        outlier_share=settings.gnss_outlier_share,
        outlier_m=settings.gnss_outlier_m,
    )
