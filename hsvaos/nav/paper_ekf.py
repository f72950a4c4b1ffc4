"""The paper's 16-state extended Kalman filter: position, velocity, quaternion, two biases."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.nav.error_state_run import gnss_noise
from hsvaos.nav.initial import InitialState
from hsvaos.nav.log import SensorLog
from hsvaos.nav.paper_algebra import (
    BA16,
    BG16,
    P16,
    Q16,
    V16,
    left_product,
    note_innovations,
    right_product,
    states_of,
    turn_by_quaternion,
    turn_matrix,
)
from hsvaos.nav.process import STANDARD_GRAVITY, gravity_of
from hsvaos.nav.sensor_models import BaroModel, GnssModel, ImuModel
from hsvaos.nav.states import InnovationLog, States

Array = NDArray[np.float64]

_ROWS = np.array([0, 1, 2, 3, 4, 5, 2])
"""The state that each row of H picks: position, velocity, down."""


class PaperEkf:
    """16-state filter with additive quaternion and first-order propagation.

    State x = (p, v, q, b_a, b_g), world NED, q = world_from_body, w first; input u = (a_m, w_m),
    the measured specific force and rate. Equations 1 to 6 of the paper:

        p' = p + v dt
        v' = v + (C(q) (a_m - b_a) + g) dt
        q' = q + 1/2 q (0, w_m - b_g) dt                                        b' = b
        A = df/dx (16x16),   B = df/du (16x6),   P' = A P A' + B Q B'
        z = (p, v, -height of the barometer) = H x + noise,   H 7x16
        K = P H' (H P H' + R)^-1,   x' = x + K (z - H x),   P' = (I - K H) P

    Read with the frames of this package: z7 = -height is the down coordinate; gravity is added
    once, downward, to the turned specific force. The quaternion is taken as four free numbers and
    brought back to length one after each prediction and update. As printed the biases have no
    process noise (`bias_random_walk=False`), so their gains fade to nothing; with
    `bias_random_walk=True` the IMU model's walks are added. Only the rows of z that arrived are
    used. No gates, no latencies, no lever arm: that is `ErrorStateEkf`.

    One thing is added to the print. Bringing the quaternion back to length one is a step like any
    other, and the covariance must take it too, P' = N P N' with N = 1 - q q'. Without it part of
    the uncertainty of heading, after the first large correction, stands for the length of q, which
    scales C(q) and with it gravity: the barometer then corrects the heading, wrongly, and the
    filter is sure of it. `project=False` gives the print to the letter.

    Args:
        imu: Noise of the inertial sensor (Q).
        gnss: Noise of the receiver where the log states none (R).
        baro: Noise of the barometer (R).
        bias_random_walk: Whether the biases may drift.
        project: Whether the covariance follows the quaternion's return to length one.
        gravity: Acceleration of gravity [m/s^2].
    """

    def __init__(
        self,
        imu: ImuModel,
        gnss: GnssModel | None = None,
        baro: BaroModel | None = None,
        *,
        bias_random_walk: bool = False,
        project: bool = True,
        gravity: float = STANDARD_GRAVITY,
    ) -> None:
        self.imu, self.gnss, self.baro = imu, gnss, baro
        self.bias_random_walk, self.gravity = bias_random_walk, gravity
        self.project = project
        self.x: Array = np.zeros(16)
        self.x[6] = 1.0
        self.P: Array = np.eye(16)

    def start(self, initial: InitialState) -> None:
        """Set state and covariance; an attitude error phi in world axes moves q by 1/2 (0,phi) q.

        Args:
            initial: Where to start.
        """
        self.x = np.concatenate(
            [
                initial.position,
                initial.velocity,
                initial.quaternion,
                initial.accel_bias,
                initial.gyro_bias,
            ]
        )
        by_phi = 0.5 * right_product(self.x[Q16])[:, 1:]
        self.P = np.zeros((16, 16))
        self.P[P16, P16] = np.diag(initial.position_std**2)
        self.P[V16, V16] = np.diag(initial.velocity_std**2)
        self.P[Q16, Q16] = by_phi @ np.diag(initial.attitude_std**2) @ by_phi.T
        self.P[BA16, BA16] = np.diag(initial.accel_bias_std**2)
        self.P[BG16, BG16] = np.diag(initial.gyro_bias_std**2)

    def predict(self, accel: ArrayLike, gyro: ArrayLike, dt: float) -> None:
        """Propagate by one IMU sample.

        Args:
            accel: Shape (3,), measured specific force, body axes [m/s^2].
            gyro: Shape (3,), measured rate, body axes [rad/s].
            dt: Duration [s].
        """
        accel, gyro = np.asarray(accel, dtype=np.float64), np.asarray(gyro, dtype=np.float64)
        A, B = self.jacobians(accel, gyro, dt)
        self.x = self.propagated(self.x, accel, gyro, dt)
        # Q of a sample of white noise with the model's density
        variance = np.repeat([self.imu.accel_noise**2, self.imu.gyro_noise**2], 3) / dt
        self.P = A @ self.P @ A.T + (B * variance) @ B.T
        if self.bias_random_walk:
            diagonal = self.P.reshape(-1)[:: 16 + 1]
            diagonal[BA16] += self.imu.accel_bias_walk**2 * dt
            diagonal[BG16] += self.imu.gyro_bias_walk**2 * dt
        self.x[Q16] /= np.sqrt(self.x[Q16] @ self.x[Q16])

    def propagated(self, x: Array, accel: Array, gyro: Array, dt: float) -> Array:
        """Return f(x, u), equations 1 to 3, before the quaternion is brought to length one.

        Args:
            x: Shape (16,).
            accel: Shape (3,) [m/s^2].
            gyro: Shape (3,) [rad/s].
            dt: Duration [s].
        """
        new = x.copy()
        new[P16] += x[V16] * dt
        new[V16] += turn_matrix(x[Q16]) @ (accel - x[BA16]) * dt
        new[5] += self.gravity * dt
        new[Q16] += 0.5 * dt * right_product(np.concatenate([[0.0], gyro - x[BG16]])) @ x[Q16]
        return np.asarray(new)

    def jacobians(self, accel: Array, gyro: Array, dt: float) -> tuple[Array, Array]:
        """Return A = df/dx, shape (16, 16), and B = df/du, shape (16, 6), at the present state.

        Args:
            accel: Shape (3,) [m/s^2].
            gyro: Shape (3,) [rad/s].
            dt: Duration [s].
        """
        q, force = self.x[Q16], accel - self.x[BA16]
        turn = turn_matrix(q) * dt
        by_rate = 0.5 * dt * left_product(q)[:, 1:]
        A = np.eye(16)
        A[0, 3] = A[1, 4] = A[2, 5] = dt
        A[V16, Q16] = turn_by_quaternion(q, force) * dt
        A[V16, BA16] = -turn
        A[Q16, Q16] += 0.5 * dt * right_product(np.concatenate([[0.0], gyro - self.x[BG16]]))
        A[Q16, BG16] = -by_rate
        B = np.zeros((16, 6))
        B[V16, 0:3] = turn
        B[Q16, 3:6] = by_rate
        return A, B

    def update(self, z: Array, variance: Array) -> tuple[Array, Array]:
        """Correct by the rows of z = (p, v, -height) that are finite.

        Args:
            z: Shape (7,), NaN where nothing arrived.
            variance: Shape (7,), diagonal of R.

        Returns:
            Innovation and its covariance, of the rows that arrived.
        """
        rows = np.flatnonzero(np.isfinite(z))
        at = _ROWS[rows]  # each row of H picks one state
        PH = self.P[:, at]
        S = PH[at] + np.diag(variance[rows])
        innovation = z[rows] - self.x[at]
        K = np.linalg.solve(S, PH.T).T
        self.x = self.x + K @ innovation
        self.P = self.P - K @ PH.T
        q = self.x[Q16] / np.sqrt(self.x[Q16] @ self.x[Q16])
        self.x[Q16] = q
        if self.project:
            N = np.eye(4) - np.outer(q, q)
            self.P[Q16] = N @ self.P[Q16]
            self.P[:, Q16] = self.P[:, Q16] @ N
        self.P = 0.5 * (self.P + self.P.T)
        return innovation, S

    @property
    def H(self) -> Array:  # noqa: N802
        """Shape (7, 16), the measurement matrix of equation 6."""
        return np.asarray(np.eye(16)[_ROWS])

    def run(
        self,
        log: SensorLog,
        initial: InitialState | None = None,
        *,
        progress: Callable[[float], None] | None = None,
    ) -> States:
        """Filter a log, an epoch a sample; measurements count at the first sample after them.

        Args:
            log: The log, checked if it comes from a file.
            initial: Where to start; found from the log if not given.
            progress: Called with the share done, 0..1, now and then.

        Returns:
            States in the layout of `ErrorStateEkf`, covariance of the quaternion turned into that
            of a rotation vector.

        Raises:
            ValueError: If there is nothing to filter.
        """
        if initial is None:
            from hsvaos.nav.align import align
            from hsvaos.nav.error_state_ekf import ErrorStateEkf

            initial = align(log, ErrorStateEkf(self.imu, self.gnss, self.baro))
        imu = log.imu
        self.gravity = gravity_of(log)
        self.start(initial)
        first = int(np.searchsorted(imu.t_s, initial.t_s, side="right"))
        count = len(imu.t_s) - first
        if count < 1:
            raise ValueError(
                f"{log.name}: expected IMU samples after {initial.t_s:.3f} s, got none"
            )
        z, variance = self._measurements(log, first)
        there = np.asarray(np.isfinite(z))
        arrived = np.asarray(there.any(axis=1))
        keep, covariance = np.empty((count, 16)), np.empty((count, 16, 16))
        innovations = InnovationLog()
        last = initial.t_s
        for k in range(count):
            i = first + k
            # the mean of both ends of the step, as the error-state filter takes it
            accel = 0.5 * (imu.accel[i] + imu.accel[max(i - 1, 0)])
            gyro = 0.5 * (imu.gyro[i] + imu.gyro[max(i - 1, 0)])
            self.predict(accel, gyro, imu.t_s[i] - last)
            last = imu.t_s[i]
            if arrived[k]:
                innovation, S = self.update(z[k], variance[k])
                note_innovations(innovations, last, there[k], innovation, S)
            keep[k], covariance[k] = self.x, self.P
            if progress is not None and k % 2000 == 0:
                progress(k / count)
        if progress is not None:
            progress(1.0)
        return states_of(imu.t_s[first:], keep, covariance, innovations, initial.notes)

    def _measurements(self, log: SensorLog, first: int) -> tuple[Array, Array]:
        """Return z and the diagonal of R for each sample from `first` on, NaN where none came."""
        t = log.imu.t_s[first:]
        z, variance = np.full((len(t), 7), np.nan), np.ones((len(t), 7))
        if log.gnss is not None:
            std = gnss_noise(log, self.gnss)
            at = np.searchsorted(t, log.gnss.t_s - 1e-6)
            use = (log.gnss.t_s > log.imu.t_s[first - 1]) & (at < len(t))
            z[at[use], 0:3] = log.gnss.position[use]
            z[at[use], 3:6] = log.gnss.velocity[use]
            variance[at[use], 0:3] = std[0][use] ** 2
            variance[at[use], 3:6] = std[1][use] ** 2
        if log.baro is not None and self.baro is not None:
            at = np.searchsorted(t, log.baro.t_s - 1e-6)
            use = (log.baro.t_s > log.imu.t_s[first - 1]) & (at < len(t))
            z[at[use], 6] = -log.baro.height_m[use]
            variance[:, 6] = self.baro.noise_std**2
        return z, variance
