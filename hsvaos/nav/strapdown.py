"""Strapdown integration of many short stretches of an IMU log at once.

Between two epochs (measurements) the motion relative to its start does not depend on where the
vehicle is or how it points: with R, v, p at the start,

    R' = R dR,   v' = v + g T + R dv,   p' = p + v T + g T^2 / 2 + R dp.

dR, dv, dp and their derivatives by the biases are integrated here for all stretches of a log
together, and a filter then takes one step an epoch instead of one a sample (Lupton & Sukkarieh
2012; Forster et al. 2017). The rotation is exact for a rate that is constant over a sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hsvaos.nav import attitude
from hsvaos.nav.log import ImuLog

Array = NDArray[np.float64]
Ints = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Stretches:
    """An IMU log cut at epochs, sub-steps padded to one length with steps of no duration.

    Args:
        dt: Shape (S, L), duration of each sub-step [s]; 0 where padded.
        gyro: Shape (S, L, 3), mean rate over the sub-step, body axes [rad/s].
        accel: Shape (S, L, 3), mean specific force, body axes [m/s^2].
    """

    dt: Array
    gyro: Array
    accel: Array


@dataclass(frozen=True, eq=False)
class Increments:
    """Motion over stretches, in the body frame at the start of each.

    Args:
        duration: Shape (S,), T [s].
        rotation: Shape (S, 3, 3), dR, start_from_end.
        velocity: Shape (S, 3), dv [m/s].
        position: Shape (S, 3), dp [m].
        rotation_by_gyro: Shape (S, 3, 3), turn of dR from the left by the gyroscope bias [s].
        velocity_by_gyro: Shape (S, 3, 3), derivative of dv by the gyroscope bias [m].
        position_by_gyro: Shape (S, 3, 3), derivative of dp by the gyroscope bias [m s].
        position_by_accel: Shape (S, 3, 3), derivative of dp by the accelerometer bias [s^2]; that
            of dv by the accelerometer bias equals `rotation_by_gyro`.
    """

    duration: Array
    rotation: Array
    velocity: Array
    position: Array
    rotation_by_gyro: Array
    velocity_by_gyro: Array
    position_by_gyro: Array
    position_by_accel: Array


class ImuTimeline:
    """An IMU log with the epochs put among its samples, so that steps split where they must.

    Between samples rate and force run linearly; an epoch between two samples gets a value of its
    own and cuts the step in two.

    Args:
        imu: The log, times increasing.
        epochs: Shape (K,), increasing, within the log [s].
    """

    def __init__(self, imu: ImuLog, epochs: Array) -> None:
        inside = (imu.t_s > epochs[0]) & (imu.t_s < epochs[-1])
        t = np.concatenate([imu.t_s[inside], epochs])
        order = np.argsort(t, kind="stable")
        t = t[order]
        # a sample that coincides with an epoch leaves a step of no duration, which does no harm
        self.t_s: Array = t
        self.at_epoch: Ints = np.flatnonzero(order >= int(inside.sum()))
        self.gyro: Array = np.stack([np.interp(t, imu.t_s, c) for c in imu.gyro.T], axis=-1)
        self.accel: Array = np.stack([np.interp(t, imu.t_s, c) for c in imu.accel.T], axis=-1)

    def gyro_at(self, epoch: int) -> Array:
        """Return the measured rate at an epoch, shape (3,) [rad/s]."""
        return np.asarray(self.gyro[self.at_epoch[epoch]])

    def stretches(self, first: int, last: int) -> Stretches:
        """Return the stretches from epoch `first` to epoch `last`, last - first of them."""
        edges = self.at_epoch[first : last + 1]
        length = int(np.diff(edges).max())
        index = edges[:-1, None] + np.arange(length + 1)
        index = np.minimum(index, edges[1:, None])  # padding repeats the end: no duration
        t, gyro, accel = self.t_s[index], self.gyro[index], self.accel[index]
        return Stretches(
            np.diff(t, axis=1),
            0.5 * (gyro[:, 1:] + gyro[:, :-1]),
            0.5 * (accel[:, 1:] + accel[:, :-1]),
        )


def _turn(
    stretches: Stretches, gyro_bias: Array, accel_bias: Array
) -> tuple[Array, Array, Array, Array]:
    """Return, for each sub-step, q at its middle and end and its force, and q at the end of all.

    Shapes (S, L, 4), (S, L, 4), (S, L, 3), (S, 4); all in the body frame at the start.
    """
    gyro_bias, accel_bias = np.atleast_2d(gyro_bias), np.atleast_2d(accel_bias)
    rate = stretches.gyro - gyro_bias[:, None]
    half = attitude.exp(0.5 * stretches.dt[..., None] * rate)
    q = np.zeros((len(half), 4))
    q[:, 0] = 1.0
    middle, end = np.empty_like(half), np.empty_like(half)
    for step in range(half.shape[1]):
        middle[:, step] = attitude.multiply(q, half[:, step])
        q = end[:, step] = attitude.multiply(middle[:, step], half[:, step])
    force = attitude.rotate(middle, stretches.accel - accel_bias[:, None])
    return middle, end, force, q


def integrate(stretches: Stretches, gyro_bias: Array, accel_bias: Array) -> Increments:
    """Integrate stretches with given biases.

    Args:
        stretches: S stretches of up to L sub-steps.
        gyro_bias: Shape (3,) or (S, 3) [rad/s].
        accel_bias: Shape (3,) or (S, 3) [m/s^2].
    """
    middle, _, force, q = _turn(stretches, gyro_bias, accel_bias)
    dt = stretches.dt
    ends = np.cumsum(dt, axis=1)
    duration = ends[:, -1].copy()
    # a push in a sub-step moves the position for the time that is left after its middle
    left = duration[:, None] - ends + 0.5 * dt
    push = force * dt[..., None]
    turn = attitude.matrix(middle) * dt[..., None, None]
    by_gyro = -np.cumsum(turn, axis=1)
    tilt = by_gyro + 0.5 * turn  # derivative of the attitude at the middle, by the bias
    swing = -np.cross(push[..., :, None], tilt, axis=-2)
    return Increments(
        duration=duration,
        rotation=attitude.matrix(attitude.normalize(q)),
        velocity=push.sum(axis=1),
        position=np.einsum("sl,slk->sk", left, push),
        rotation_by_gyro=by_gyro[:, -1].copy(),
        velocity_by_gyro=swing.sum(axis=1),
        position_by_gyro=np.einsum("sl,slij->sij", left, swing),
        position_by_accel=-np.einsum("sl,slij->sij", left, turn),
    )


def inner_motion(
    stretches: Stretches, gyro_bias: Array, accel_bias: Array
) -> tuple[Array, Array, Array, Array]:
    """Return the motion from the start of each stretch to the end of each of its sub-steps.

    Args:
        stretches: S stretches of up to L sub-steps.
        gyro_bias: Shape (3,) or (S, 3) [rad/s].
        accel_bias: Shape (3,) or (S, 3) [m/s^2].

    Returns:
        time (S, L) [s], start_from_body quaternions (S, L, 4), dv (S, L, 3) and dp (S, L, 3).
    """
    _, end, force, _ = _turn(stretches, gyro_bias, accel_bias)
    dt = stretches.dt[..., None]
    velocity = np.cumsum(force * dt, axis=1)
    position = np.cumsum((velocity - 0.5 * force * dt) * dt, axis=1)
    return np.cumsum(stretches.dt, axis=1), end, velocity, position
