"""Logs that low-cost sensors would write along a true path.

    imu, gnss, baro = IMU_MODELS["adis16448"], GNSS_MODELS["single"], BARO_MODELS["ms5611"]
    log = simulate_log(motion, imu, gnss, baro, seed=1)
    result = ErrorStateEkf(imu, gnss, baro).run(log)

The models and their presets are those of `hsvaos.nav.sensor_models`, to be imported from here too.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.nav.attitude import rotate
from hsvaos.nav.log import BaroLog, GnssLog, ImuLog, Mounting, SensorLog, TrueMotion
from hsvaos.nav.sensor_models import (
    BARO_MODELS,
    GNSS_MODELS,
    IMU_MODELS,
    BaroModel,
    GnssModel,
    ImuModel,
)

__all__ = [
    "BARO_MODELS",
    "GNSS_MODELS",
    "IMU_MODELS",
    "BaroModel",
    "GnssModel",
    "ImuModel",
    "simulate_baro",
    "simulate_gnss",
    "simulate_imu",
    "simulate_log",
]

Array = NDArray[np.float64]


def simulate_log(
    motion: TrueMotion,
    imu: ImuModel,
    gnss: GnssModel | None = None,
    baro: BaroModel | None = None,
    *,
    seed: int | np.random.Generator = 0,
    mounting: Mounting | None = None,
    **faults: Any,
) -> SensorLog:
    """Return the log that sensors of these models would write along a true path.

    Args:
        motion: The true path.
        imu: Inertial sensor.
        gnss: Satellite receiver, or None for none.
        baro: Barometer, or None for none.
        seed: Seed or generator; each sensor draws from its own stream, so that leaving one out
            does not change the noise of the others.
        mounting: Where the antenna sits; at the IMU by default.
        **faults: Given to `simulate_gnss`: `outages`, `outlier_share`, `outlier_m`.

    Returns:
        The log; `extra` holds the true biases of the IMU, "gyro_bias" and "accel_bias", (N, 3).
    """
    streams = np.random.default_rng(seed).spawn(3)
    mounting = mounting or Mounting()
    imu_log, gyro_bias, accel_bias = simulate_imu(motion, imu, streams[0])
    return SensorLog(
        imu=imu_log,
        gnss=None
        if gnss is None
        else simulate_gnss(
            motion, gnss, streams[1], antenna_lever_arm=mounting.antenna_lever_arm, **faults
        ),
        baro=None if baro is None else simulate_baro(motion, baro, streams[2]),
        mounting=mounting,
        name="simulated",
        extra={"gyro_bias": gyro_bias, "accel_bias": accel_bias},
    )


def simulate_imu(
    motion: TrueMotion, model: ImuModel, rng: np.random.Generator
) -> tuple[ImuLog, Array, Array]:
    """Return the IMU log along a true path, and the biases that are in it.

    Args:
        motion: The true path; its rate and force are interpolated to the IMU's sample times.
        model: Error model.
        rng: Source of the noise.

    Returns:
        The log, and the gyroscope [rad/s] and accelerometer [m/s^2] biases, each shape (N, 3).
    """
    t = _sample_times(motion, model.rate_hz)
    gyro_bias = model.gyro_bias_std * rng.standard_normal(3) + _drift(
        t, model.gyro_bias_walk, model.gyro_bias_tau_s, rng
    )
    accel_bias = model.accel_bias_std * rng.standard_normal(3) + _drift(
        t, model.accel_bias_walk, model.accel_bias_tau_s, rng
    )
    root_rate = np.sqrt(model.rate_hz)
    gyro = _resample(motion.t_s, motion.angular_rate, t) + gyro_bias
    gyro += model.gyro_noise * root_rate * rng.standard_normal(gyro.shape)
    accel = _resample(motion.t_s, motion.specific_force, t) + accel_bias
    accel += model.accel_noise * root_rate * rng.standard_normal(accel.shape)
    return ImuLog(t, gyro, accel), gyro_bias, accel_bias


def simulate_gnss(
    motion: TrueMotion,
    model: GnssModel,
    rng: np.random.Generator,
    *,
    antenna_lever_arm: Any = (0.0, 0.0, 0.0),
    outages: tuple[tuple[float, float], ...] = (),
    outlier_share: float = 0.0,
    outlier_m: float = 15.0,
) -> GnssLog:
    """Return the fixes of a receiver along a true path.

    Args:
        motion: The true path.
        model: Error model; fixes of time t are stamped t + latency.
        rng: Source of the noise.
        antenna_lever_arm: Shape (3,), antenna in body axes [m].
        outages: Spans (from, to) [s] without fixes.
        outlier_share: Share of fixes whose position jumps, 0..1.
        outlier_m: Length of such a jump, in a random direction [m].
    """
    t = _sample_times(motion, model.rate_hz)
    t = t[t + model.latency_s <= motion.t_s[-1]]
    position, velocity, q = motion.at(t)
    lever = np.asarray(antenna_lever_arm, dtype=np.float64)
    rate = _resample(motion.t_s, motion.angular_rate, t)
    position = position + rotate(q, np.broadcast_to(lever, position.shape))
    velocity = velocity + rotate(q, np.cross(rate, lever))
    std, wander = model.position_axes, model.wander_axes
    position = position + std * rng.standard_normal(position.shape)
    if wander.any():
        unit = _drift(t, np.sqrt(2.0 / model.wander_tau_s), model.wander_tau_s, rng, steady=True)
        position = position + wander * unit
    velocity = velocity + model.velocity_axes * rng.standard_normal(velocity.shape)
    # Drawn even if not used, so that a fault does not change the noise of the clean fixes.
    hit = rng.random(len(t)) < outlier_share
    jump = rng.standard_normal(position.shape)
    jump *= outlier_m / np.linalg.norm(jump, axis=1, keepdims=True)
    position = position + hit[:, None] * jump
    keep = np.ones(len(t), dtype=bool)
    for start, stop in outages:
        keep &= (t < start) | (t >= stop)
    n = int(keep.sum())
    return GnssLog(
        t_s=t[keep] + model.latency_s,
        position=position[keep],
        velocity=velocity[keep],
        position_std=np.tile(std, (n, 1)),
        velocity_std=np.tile(model.velocity_axes, (n, 1)),
    )


def simulate_baro(motion: TrueMotion, model: BaroModel, rng: np.random.Generator) -> BaroLog:
    """Return barometric heights along a true path; a height of time t is stamped t + latency."""
    t = _sample_times(motion, model.rate_hz)
    t = t[t + model.latency_s <= motion.t_s[-1]]
    height = -motion.at(t)[0][:, 2]
    height = height + model.noise_std * rng.standard_normal(len(t))
    height = height + model.bias_std * rng.standard_normal()
    height = height + _drift(t, model.bias_walk, float("inf"), rng)[:, 0]
    return BaroLog(t + model.latency_s, height)


def _sample_times(motion: TrueMotion, rate_hz: float) -> Array:
    """Return the times of a sensor that starts with the path and samples evenly [s]."""
    if not rate_hz > 0.0:
        raise ValueError(f"rate_hz of a sensor must be positive, got {rate_hz!r}")
    span = motion.t_s[-1] - motion.t_s[0]
    return np.asarray(motion.t_s[0] + np.arange(int(span * rate_hz * (1 + 1e-12)) + 1) / rate_hz)


def _resample(t_from: Array, values: Array, t_to: Array) -> Array:
    """Return columns interpolated linearly, shape (len(t_to), columns)."""
    columns = [np.interp(t_to, t_from, column) for column in values.T]
    return np.stack(columns, axis=-1)


def _drift(
    t: Array, density: float, tau_s: float, rng: np.random.Generator, *, steady: bool = False
) -> Array:
    """Return three random walks, or Gauss-Markov processes with a time constant, shape (N, 3).

    Exact discretisation: b[k+1] = f b[k] + s n, f = exp(-dt/tau), s^2 = density^2 tau (1 - f^2)/2.
    Starts at zero, or, if steady, at its lasting spread.
    """
    noise = rng.standard_normal((len(t), 3))
    dt = np.diff(t, prepend=t[0])
    if not np.isfinite(tau_s):
        return np.asarray(np.cumsum(density * np.sqrt(dt)[:, None] * noise, axis=0))
    spread = density * np.sqrt(0.5 * tau_s)
    keep = np.exp(-dt / tau_s)
    noise[1:] *= (spread * np.sqrt(1.0 - keep**2))[1:, None]
    noise[0] *= spread if steady else 0.0
    for k in range(1, len(t)):
        noise[k] += keep[k] * noise[k - 1]
    return noise
