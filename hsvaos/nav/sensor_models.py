"""Error models of low-cost sensors, and named presets with their sources.

One model serves three readers: the filter takes its noise from it, the simulator makes logs with
it, and the documentation prints it. White noise is given as a density (per square root of hertz):
a sample taken at rate f has the standard deviation `density * sqrt(f)`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_DEG = np.pi / 180.0
_MILLI_G = 9.80665e-3


@dataclass(frozen=True)
class ImuModel:
    """Errors of a gyroscope and accelerometer triad, the same on each axis.

    Each bias is a constant drawn at switch-on plus a drift: a random walk, or, with a correlation
    time, a first-order Gauss-Markov process driven by the same density and starting at zero.

    Args:
        rate_hz: Samples a second.
        gyro_noise: White noise density [rad/s/sqrt(Hz)].
        accel_noise: White noise density [m/s^2/sqrt(Hz)].
        gyro_bias_std: Spread of the switch-on bias [rad/s].
        accel_bias_std: Spread of the switch-on bias [m/s^2].
        gyro_bias_walk: Density of the noise that drives the drift [rad/s^2/sqrt(Hz)].
        accel_bias_walk: The same of the accelerometer [m/s^3/sqrt(Hz)].
        gyro_bias_tau_s: Correlation time of the drift [s]; infinite for a random walk.
        accel_bias_tau_s: The same of the accelerometer [s].
        scale_std: Spread of scale factor and misalignment, as a share of rate and of force beyond
            gravity; the filter takes it as noise that lasts a second, the simulator ignores it.
        source: Where the figures come from.
    """

    rate_hz: float
    gyro_noise: float
    accel_noise: float
    gyro_bias_std: float
    accel_bias_std: float
    gyro_bias_walk: float = 0.0
    accel_bias_walk: float = 0.0
    gyro_bias_tau_s: float = float("inf")
    accel_bias_tau_s: float = float("inf")
    scale_std: float = 0.0
    source: str = ""

    def with_constant_biases(self) -> ImuModel:
        """Return the model without any drift: biases stay what they were at switch-on."""
        return replace(self, gyro_bias_walk=0.0, accel_bias_walk=0.0)


@dataclass(frozen=True)
class GnssModel:
    """Errors of a satellite receiver: white noise, and a slow wander of the position.

    Args:
        rate_hz: Fixes a second.
        position_std: White noise of north or east, and of down [m].
        velocity_std: White noise of north or east velocity [m/s].
        velocity_std_down: White noise of the down velocity [m/s]; as the others if 0.
        wander_std: Spread of the slowly varying position error, horizontal and down [m].
        wander_tau_s: Its correlation time [s].
        latency_s: How late a fix is stamped [s].
        source: Where the figures come from.
    """

    rate_hz: float
    position_std: tuple[float, float]
    velocity_std: float
    velocity_std_down: float = 0.0
    wander_std: tuple[float, float] = (0.0, 0.0)
    wander_tau_s: float = 60.0
    latency_s: float = 0.0
    source: str = ""

    @property
    def position_axes(self) -> Array:
        """Shape (3,), white noise of north, east and down [m]."""
        return np.asarray(self.position_std)[[0, 0, 1]]

    @property
    def velocity_axes(self) -> Array:
        """Shape (3,), white noise of the velocity [m/s]."""
        return np.array([self.velocity_std] * 2 + [self.velocity_std_down or self.velocity_std])

    @property
    def wander_axes(self) -> Array:
        """Shape (3,), spread of the slow position error [m]."""
        return np.asarray(self.wander_std)[[0, 0, 1]]


@dataclass(frozen=True)
class BaroModel:
    """Errors of a barometric height: white noise, a constant offset and a slow drift.

    Args:
        rate_hz: Samples a second.
        noise_std: White noise of a sample [m].
        bias_std: Spread of the offset from the true height [m]; 0 if it was set on the ground.
        bias_walk: Density of the random walk of the offset (weather, wash) [m/s/sqrt(Hz)].
        latency_s: How late a sample is stamped [s].
        source: Where the figures come from.
    """

    rate_hz: float
    noise_std: float
    bias_std: float = 0.0
    bias_walk: float = 0.0
    latency_s: float = 0.0
    source: str = ""


_ADIS16448 = ImuModel(
    rate_hz=200.0,
    gyro_noise=0.0135 * _DEG,
    accel_noise=0.23 * _MILLI_G,
    gyro_bias_std=0.5 * _DEG,
    accel_bias_std=20.0 * _MILLI_G,
    # In-run bias stability 14.5 deg/h and 0.25 mg as the spread of a Gauss-Markov process; the
    # datasheet gives no correlation time, 1000 s and 300 s are those of RotorS.
    gyro_bias_walk=14.5 / 3600.0 * _DEG * np.sqrt(2.0 / 1000.0),
    accel_bias_walk=0.25 * _MILLI_G * np.sqrt(2.0 / 300.0),
    gyro_bias_tau_s=1000.0,
    accel_bias_tau_s=300.0,
    source="Analog Devices, ADIS16448 datasheet: rate noise density 0.0135 deg/s/sqrt(Hz), "
    "acceleration noise density 0.23 mg/sqrt(Hz), bias stability 14.5 deg/h and 0.25 mg, "
    "initial bias error 0.5 deg/s and 20 mg",
)

IMU_MODELS: dict[str, ImuModel] = {
    "adis16448": _ADIS16448,
    "adis16448-calibrated": replace(
        _ADIS16448,
        gyro_bias_std=14.5 / 3600.0 * _DEG,
        accel_bias_std=0.25 * _MILLI_G,
        gyro_bias_walk=0.0,
        accel_bias_walk=0.0,
        source=_ADIS16448.source + "; biases calibrated before the flight to within the bias "
        "stability, and constant from then on",
    ),
    "adis16448-rotors": ImuModel(
        rate_hz=200.0,
        gyro_noise=2.0 * 35.0 / 3600.0 * _DEG,
        accel_noise=2.0 * 2.0e-3,
        gyro_bias_std=0.5 * _DEG,
        accel_bias_std=20.0 * _MILLI_G,
        gyro_bias_walk=2.0 * 4.0 / 3600.0 * _DEG,
        accel_bias_walk=2.0 * 3.0e-3,
        gyro_bias_tau_s=1000.0,
        accel_bias_tau_s=300.0,
        source="RotorS simulator (Furrer et al. 2016), defaults of its IMU plug-in for the "
        "ADIS16448: datasheet figures doubled, and a strong drift",
    ),
    "autopilot": ImuModel(
        rate_hz=100.0,
        gyro_noise=3.0e-3,
        accel_noise=0.15,
        gyro_bias_std=1.0 * _DEG,
        accel_bias_std=40.0 * _MILLI_G,
        gyro_bias_walk=1.0e-4,
        accel_bias_walk=3.0e-3,
        scale_std=0.005,
        source="a consumer sensor as autopilots log it in flight: vibration, aliasing and uneven "
        "stamps included; noise by which the innovations of two public PX4 logs become consistent",
    ),
    "consumer": ImuModel(
        rate_hz=200.0,
        gyro_noise=0.01 * _DEG,
        accel_noise=0.3 * _MILLI_G,
        gyro_bias_std=1.0 * _DEG,
        accel_bias_std=40.0 * _MILLI_G,
        # no datasheet figure: 2 deg/h and 0.1 mg after one second of random walk are common
        # choices of autopilots' filters for this class
        gyro_bias_walk=2.0e-5,
        accel_bias_walk=1.0e-3,
        source="TDK InvenSense MPU-6000/6500 class datasheets: rate noise density 0.005 to 0.01 "
        "deg/s/sqrt(Hz), acceleration noise density 0.3 to 0.4 mg/sqrt(Hz); drift: assumed",
    ),
}
"""Inertial sensors by name."""

GNSS_MODELS: dict[str, GnssModel] = {
    "single": GnssModel(
        rate_hz=5.0,
        position_std=(1.5, 2.5),
        velocity_std=0.3,
        source="levels of white noise that bring a simulated mission to the attitude and "
        "horizontal errors of the paper's Table 1; single-frequency receivers state 2.5 m CEP",
    ),
    "standalone": GnssModel(
        rate_hz=5.0,
        position_std=(0.2, 0.4),
        velocity_std=0.18,
        velocity_std_down=0.25,
        wander_std=(2.0, 3.0),
        wander_tau_s=80.0,
        source="a single-frequency receiver as logged: smooth from fix to fix, metres off over "
        "minutes; levels by which the innovations of public PX4 logs become consistent",
    ),
    "poor": GnssModel(
        rate_hz=5.0,
        position_std=(0.5, 1.0),
        velocity_std=0.5,
        velocity_std_down=1.0,
        wander_std=(5.0, 10.0),
        wander_tau_s=60.0,
        source="a single-frequency receiver with a bad sky or a bad antenna: assumed",
    ),
    "sbas": GnssModel(
        rate_hz=10.0,
        position_std=(1.0, 1.5),
        velocity_std=0.05,
        source="u-blox M8 datasheet: SBAS 2.0 m CEP (mostly slow error), velocity 0.05 m/s",
    ),
    "rtk": GnssModel(
        rate_hz=5.0,
        position_std=(0.01, 0.02),
        velocity_std=0.05,
        source="u-blox ZED-F9P datasheet: RTK 0.01 m + 1 ppm CEP, velocity 0.05 m/s",
    ),
}
"""Satellite receivers by name."""

BARO_MODELS: dict[str, BaroModel] = {
    "calibrated": BaroModel(
        rate_hz=25.0,
        noise_std=0.4,
        source="white noise only, zero set on the ground, as the paper's measurement of height "
        "supposes; its level: assumed, rotor wash included",
    ),
    "ms5611": BaroModel(
        rate_hz=50.0,
        noise_std=0.3,
        bias_std=2.0,
        bias_walk=0.02,
        source="TE Connectivity MS5611 datasheet: resolution 0.1 m and less at 100 Hz, long-term "
        "stability 1 mbar a year; wash and drift: assumed, 0.15 m a minute",
    ),
}
"""Barometers by name."""
