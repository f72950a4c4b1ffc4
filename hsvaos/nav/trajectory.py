"""Pose and uncertainty at any time of a flight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.nav import attitude
from hsvaos.nav.epochs import MICRO
from hsvaos.nav.log import Mounting, SensorLog
from hsvaos.nav.measurements import P, V
from hsvaos.nav.process import gravity_of
from hsvaos.nav.states import Innovations, States
from hsvaos.nav.strapdown import ImuTimeline, inner_motion

Array = NDArray[np.float64]

_BLOCK = 512


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The path of the body (IMU) through the local frame, at each IMU sample and measurement.

    Args:
        t_s: Shape (M,), increasing [s].
        position: Shape (M, 3), world NED [m].
        velocity: Shape (M, 3), world NED [m/s].
        quaternion: Shape (M, 4), world_from_body, w first.
        states: What the filter or smoother left at its epochs: covariances, biases, innovations.
        mounting: Camera and antenna on the vehicle.
        notes: What was assumed, repaired or left out, one line each.
        imu_samples: Number of IMU samples within its span.
    """

    t_s: Array
    position: Array
    velocity: Array
    quaternion: Array
    states: States
    mounting: Mounting
    notes: tuple[str, ...] = ()
    imu_samples: int = 0

    @property
    def innovations(self) -> dict[str, Innovations]:
        """How the measurements of each sensor fell against their prediction."""
        return self.states.innovations

    @property
    def span(self) -> tuple[float, float]:
        """First and last time [s]."""
        return float(self.t_s[0]), float(self.t_s[-1])

    def at(self, t_s: ArrayLike) -> tuple[Array, Array, Array]:
        """Return position, velocity and attitude at any times.

        Between samples position is the cubic that meets position and velocity at both ends.

        Args:
            t_s: Shape (...) [s].

        Returns:
            Shapes (..., 3) [m], (..., 3) [m/s], (..., 4), body in world NED.

        Raises:
            ValueError: If a time lies outside the trajectory.
        """
        t = self._inside(t_s)
        i = np.clip(np.searchsorted(self.t_s, t, side="right") - 1, 0, len(self.t_s) - 2)
        dt = (self.t_s[i + 1] - self.t_s[i])[..., None]
        u = (t - self.t_s[i])[..., None] / dt
        p0, p1 = self.position[i], self.position[i + 1]
        v0, v1 = self.velocity[i], self.velocity[i + 1]
        position = (
            p0
            + u * dt * v0
            + u * u * (3.0 * (p1 - p0) - dt * (2.0 * v0 + v1))
            + u * u * u * (2.0 * (p0 - p1) + dt * (v0 + v1))
        )
        q = attitude.slerp(self.quaternion[i], self.quaternion[i + 1], u[..., 0])
        return position, v0 + u * (v1 - v0), q

    def world_from_body(self, t_s: ArrayLike) -> Array:
        """Return poses of the body at any times, shape (..., 4, 4).

        Args:
            t_s: Shape (...) [s].

        Raises:
            ValueError: If a time lies outside the trajectory.
        """
        position, _, q = self.at(t_s)
        return _pose(position, q)

    def covariance(self, t_s: ArrayLike) -> Array:
        """Return the covariance of the body's pose at any times, shape (..., 6, 6).

        Rows: north, east, down [m], then the rotation vector of the attitude error about north,
        east and down [rad]. Between epochs (0.1 s at most) it runs linearly.

        Args:
            t_s: Shape (...) [s].

        Raises:
            ValueError: If a time lies outside the trajectory.
        """
        return self.full_covariance(t_s)[..., _POSE[:, None], _POSE]

    def full_covariance(self, t_s: ArrayLike) -> Array:
        """Return the covariance of position, velocity and attitude, shape (..., 9, 9)."""
        t = self._inside(t_s)
        nodes, C = self.states.t_s, self.states.covariance[:, :9, :9]
        i = np.clip(np.searchsorted(nodes, t, side="right") - 1, 0, len(nodes) - 2)
        u = np.clip((t - nodes[i]) / (nodes[i + 1] - nodes[i]), 0.0, 1.0)[..., None, None]
        return np.asarray((1.0 - u) * C[i] + u * C[i + 1])

    def world_from_camera(self, t_s: ArrayLike) -> Array:
        """Return poses of the camera at any times, through boresight and lever arm.

        Args:
            t_s: Shape (...), for example the times of exposure [s].

        Returns:
            Shape (..., 4, 4).

        Raises:
            ValueError: If a time lies outside the trajectory.
        """
        position, _, q = self.at(t_s)
        return camera_pose(position, q, self.mounting)

    def camera_covariance(self, t_s: ArrayLike) -> Array:
        """Return the covariance of the camera's pose, shape (..., 6, 6), rows as `covariance`.

        The attitude error swings the lever arm: position error = e_p - [R l]x e_phi.

        Args:
            t_s: Shape (...) [s].
        """
        C = self.covariance(t_s)
        q = self.at(t_s)[2]
        arm = attitude.rotate(
            q, np.broadcast_to(self.mounting.camera_lever_arm, (*q.shape[:-1], 3))
        )
        J = np.zeros(C.shape)
        J[...] = np.eye(6)
        J[..., :3, 3:] = -attitude.skew(arm)
        return np.asarray(J @ C @ np.swapaxes(J, -1, -2))

    def euler_std(self, t_s: ArrayLike) -> Array:
        """Return the spread of roll, pitch and yaw, shape (..., 3) [rad].

        To first order, with the rotation vector (n, e, d) of the attitude error in world axes:
        droll = (cos yaw n + sin yaw e) / cos pitch, dpitch = cos yaw e - sin yaw n,
        dyaw = d + tan pitch (cos yaw n + sin yaw e).

        Args:
            t_s: Shape (...) [s].
        """
        _, pitch, yaw = np.moveaxis(attitude.to_euler(self.at(t_s)[2]), -1, 0)
        C = self.covariance(t_s)[..., 3:, 3:]
        J = np.zeros(C.shape)
        J[..., 0, 0], J[..., 0, 1] = np.cos(yaw) / np.cos(pitch), np.sin(yaw) / np.cos(pitch)
        J[..., 1, 0], J[..., 1, 1] = -np.sin(yaw), np.cos(yaw)
        J[..., 2, 0], J[..., 2, 1] = np.cos(yaw) * np.tan(pitch), np.sin(yaw) * np.tan(pitch)
        J[..., 2, 2] = 1.0
        C = J @ C @ np.swapaxes(J, -1, -2)
        return np.sqrt(np.maximum(np.diagonal(C, axis1=-2, axis2=-1), 0.0))

    def _inside(self, t_s: ArrayLike) -> Array:
        """Return times, or refuse those outside the trajectory."""
        t = np.asarray(t_s, dtype=np.float64)
        first, last = self.span
        # a stamp printed with six digits may lie half a microsecond outside
        outside = ~((t >= first - 1e-6) & (t <= last + 1e-6))
        if outside.any():
            raise ValueError(
                f"t_s must lie within the trajectory ({first:.3f} s to {last:.3f} s), got "
                f"{t[outside].flat[0]:.3f} s ({int(outside.sum())} times outside)"
            )
        return np.clip(t, first, last)


_POSE = np.array([0, 1, 2, 6, 7, 8])


def trajectory_of(states: States, log: SensorLog) -> Trajectory:
    """Return the trajectory at the epochs of a filter or smoother and every IMU sample between.

    From each epoch the IMU is integrated with the biases known there; what then disagrees with the
    next epoch (a smoother's biases change a little from epoch to epoch) is spread evenly over the
    time between.

    Args:
        states: States at epochs.
        log: The log they came from.
    """
    count = len(states.t_s)
    g = np.array([0.0, 0.0, gravity_of(log)])
    timeline = ImuTimeline(log.imu, states.t_s)
    quaternion = states.quaternion
    pieces: list[tuple[Array, Array, Array, Array]] = []
    for first in range(0, count - 1, _BLOCK):
        last = min(first + _BLOCK, count - 1)
        here, there = slice(first, last), slice(first + 1, last + 1)
        stretches = timeline.stretches(first, last)
        t, turn, dv, dp = inner_motion(stretches, states.gyro_bias[here], states.accel_bias[here])
        T = t[..., None]
        q0 = quaternion[here, None]
        p0, v0 = states.position[here, None], states.velocity[here, None]
        q = attitude.multiply(q0, turn)
        v = v0 + g * T + attitude.rotate(q0, dv)
        p = p0 + v0 * T + 0.5 * g * T**2 + attitude.rotate(q0, dp)
        share = T / T[:, -1:]
        p += share * (states.position[there, None] - p[:, -1:])
        v += share * (states.velocity[there, None] - v[:, -1:])
        late = attitude.log(
            attitude.multiply(quaternion[there, None], attitude.conjugate(q[:, -1:]))
        )
        q = attitude.multiply(attitude.exp(share * late), q)
        real = stretches.dt > 1e-7  # not those that only round an epoch to its sample
        pieces.append(((states.t_s[here, None] + t)[real], p[real], v[real], q[real]))
    t, p, v, q = (
        np.concatenate([start, *[piece[i] for piece in pieces]])
        for i, start in enumerate(
            (states.t_s[:1], states.vector[:1, P], states.vector[:1, V], quaternion[:1])
        )
    )
    within = (log.imu.t_s >= t[0] - MICRO) & (log.imu.t_s <= t[-1] + MICRO)
    return Trajectory(
        t,
        p,
        v,
        attitude.normalize(q),
        states,
        log.mounting,
        log.notes + states.notes,
        int(within.sum()),
    )


def camera_pose(position: Array, q: Array, mounting: Mounting) -> Array:
    """Return poses of the camera from those of the body, through boresight and lever arm.

    Args:
        position: Shape (..., 3), world NED [m].
        q: Shape (..., 4), world_from_body.
        mounting: Where the camera sits.

    Returns:
        Shape (..., 4, 4), world_from_camera.
    """
    arm = attitude.rotate(q, np.broadcast_to(mounting.camera_lever_arm, position.shape))
    return _pose(position + arm, attitude.multiply(q, mounting.body_from_camera_q))


def _pose(position: Array, q: Array) -> Array:
    """Return 4x4 transforms of positions and quaternions."""
    pose = np.zeros((*position.shape[:-1], 4, 4))
    pose[..., :3, :3] = attitude.matrix(q)
    pose[..., :3, 3] = position
    pose[..., 3, 3] = 1.0
    return pose
