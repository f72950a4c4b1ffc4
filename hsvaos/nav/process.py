"""The steps of the error-state filter, prepared for a block of epochs at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hsvaos.nav.attitude import skew
from hsvaos.nav.geodesy import gravity
from hsvaos.nav.measurements import BA, BG, PHI, Layout, P, V
from hsvaos.nav.sensor_models import BaroModel, GnssModel, ImuModel
from hsvaos.nav.strapdown import ImuTimeline, Increments, Stretches, integrate

if TYPE_CHECKING:
    from hsvaos.nav.log import SensorLog

Array = NDArray[np.float64]

STANDARD_GRAVITY = 9.80665
"""Taken where a log is not tied to the Earth [m/s^2]."""

GAP_S = 0.3
"""An IMU step longer than this is a gap: nobody knows what happened in it [s]."""
_GAP_RATE_NOISE = 0.3  # [rad/sqrt(s)]
_SCALE_S = 1.0  # how long an error of scale or alignment pulls the same way [s]
_GAP_FORCE_NOISE = 3.0  # [m/s/sqrt(s)]


@dataclass(frozen=True, eq=False)
class Steps:
    """Steps between epochs; all that has axes is in body axes at the start of the step.

    Args:
        duration: Shape (S,) [s].
        rotation: Shape (S, 3, 3), start_from_end.
        velocity: Shape (S, 3) [m/s].
        position: Shape (S, 3) [m].
        by_bias: Shape (S, 9, 6), derivative of turn, velocity and position by the biases.
        transition: Shape (S, n, n), of the error.
        noise: Shape (S, n, n), what the step adds to the covariance.
        keep_wander: Shape (S,), share of the GNSS wander that a step leaves.
        bias: Shape (6,), biases the IMU was integrated with.
        gravity: Acceleration of gravity [m/s^2].
        axes: Shape (n, n), scratch for the rotation into world axes.
    """

    duration: Array
    rotation: Array
    velocity: Array
    position: Array
    by_bias: Array
    transition: Array
    noise: Array
    keep_wander: Array
    bias: Array
    gravity: float
    axes: Array


def bare_steps() -> Steps:
    """Return no steps."""
    none = np.zeros(0)
    return Steps(none, none, none, none, none, none, none, none, none, 0.0, none)


def gravity_of(log: SensorLog) -> float:
    """Return the gravity where the log was taken [m/s^2]."""
    if log.origin is None:
        return STANDARD_GRAVITY
    return gravity(log.origin.lat_deg, log.origin.height_m)


@dataclass(frozen=True)
class Process:
    """What drives the errors between measurements.

    Args:
        imu: Noise of the inertial sensor.
        gnss: Its wander, if that is a state.
        baro: The drift of its offset, if that is a state.
        layout: The parts of the state.
        gravity: Acceleration of gravity [m/s^2].
    """

    imu: ImuModel
    gnss: GnssModel | None
    baro: BaroModel | None
    layout: Layout
    gravity: float

    def steps(self, timeline: ImuTimeline, first: int, last: int, bias: Array) -> Steps:
        """Return the steps from epoch `first` to epoch `last`.

        Args:
            timeline: The IMU log cut at the epochs.
            first: First epoch.
            last: Last epoch.
            bias: Shape (6,), the biases as known now [rad/s, m/s^2].
        """
        return _steps_of(self, timeline.stretches(first, last), bias)


def _steps_of(process: Process, stretches: Stretches, bias: Array) -> Steps:
    """Integrate stretches and set up transition and noise of each."""
    inc = integrate(stretches, bias[:3], bias[3:])
    n, count, layout = process.layout.size, len(inc.duration), process.layout
    by_bias = np.zeros((count, 9, 6))
    by_bias[:, 0:3, 0:3] = by_bias[:, 3:6, 3:6] = inc.rotation_by_gyro
    by_bias[:, 3:6, 0:3] = inc.velocity_by_gyro
    by_bias[:, 6:9, 0:3] = inc.position_by_gyro
    by_bias[:, 6:9, 3:6] = inc.position_by_accel
    F = np.zeros((count, n, n))
    F[:] = np.eye(n)
    F[:, P, V] = np.eye(3) * inc.duration[:, None, None]
    F[:, P, PHI] = -skew(inc.position)
    F[:, V, PHI] = -skew(inc.velocity)
    F[:, PHI, 9:15] = by_bias[:, 0:3]
    F[:, V, 9:15] = by_bias[:, 3:6]
    F[:, P, 9:15] = by_bias[:, 6:9]
    Q = np.zeros((count, n, n))
    _inertial_noise(Q, inc, process, stretches)
    keep = np.ones(count)
    if layout.baro_bias and process.baro is not None:
        Q[:, layout.baro_at, layout.baro_at] = process.baro.bias_walk**2 * inc.duration
    if layout.wander and process.gnss is not None:
        keep = np.exp(-inc.duration / process.gnss.wander_tau_s)
        variance = process.gnss.wander_axes**2
        for i, at in enumerate(range(*layout.wander_at.indices(n))):
            F[:, at, at] = keep
            Q[:, at, at] = variance[i] * (1.0 - keep**2)
    return Steps(
        duration=inc.duration,
        rotation=inc.rotation,
        velocity=inc.velocity,
        position=inc.position,
        by_bias=by_bias,
        transition=F,
        noise=Q,
        keep_wander=keep,
        bias=bias,
        gravity=process.gravity,
        axes=np.eye(n),
    )


def _inertial_noise(Q: Array, inc: Increments, process: Process, stretches: Stretches) -> None:
    """Fill in the white noise of the IMU and the walk of its biases.

    White noise integrated over a step of constant mean force a, A = [a]x:
    phi: g T;  v: f T - g T^3/3 A A;  p: f T^3/3 - g T^5/20 A A;  v-phi: -g T^2/2 A;
    p-phi: -g T^3/6 A;  p-v: f T^2/2 - g T^4/8 A A, with densities g of the rate, f of the force.
    """
    T = inc.duration[:, None, None]
    model, dt = process.imu, stretches.dt
    gap = (np.maximum(dt - GAP_S, 0.0).sum(axis=1) > 0.0)[:, None, None]
    g = model.gyro_noise**2 + gap * _GAP_RATE_NOISE**2
    f = model.accel_noise**2 + gap * _GAP_FORCE_NOISE**2
    if model.scale_std > 0.0:
        # a constant share of the motion, unknown for a second, has this density about it
        share = 2.0 * _SCALE_S * model.scale_std**2
        rate = np.linalg.norm(stretches.gyro, axis=-1).max(axis=1)
        force = np.linalg.norm(stretches.accel, axis=-1)
        g = g + share * rate[:, None, None] ** 2
        f = f + share * np.abs(force - process.gravity).max(axis=1)[:, None, None] ** 2
    eye = np.eye(3)
    safe = np.maximum(inc.duration, 1e-9)[:, None]
    A = skew(inc.velocity / safe)
    AA = A @ A
    Q[:, PHI, PHI] = g * T * eye
    Q[:, V, V] = f * T * eye - g * T**3 / 3 * AA
    Q[:, P, P] = f * T**3 / 3 * eye - g * T**5 / 20 * AA
    for rows, columns, block in (
        (V, PHI, -g * T**2 / 2 * A),
        (P, PHI, -g * T**3 / 6 * A),
        (P, V, f * T**2 / 2 * eye - g * T**4 / 8 * AA),
    ):
        Q[:, rows, columns] = block
        Q[:, columns, rows] = np.swapaxes(block, 1, 2)
    Q[:, BG, BG] = model.gyro_bias_walk**2 * T * eye
    Q[:, BA, BA] = model.accel_bias_walk**2 * T * eye
