"""A plain NumPy 15-state error-state filter, a step an IMU sample: what most people would write.

A contender for the benchmark, kept simple on purpose: propagation of the covariance at the rate of
the IMU with full matrices, Joseph form, no gates, no latencies, no smoother.
"""

from __future__ import annotations

import numpy as np

from hsvaos.nav.attitude import rotation_of
from hsvaos.nav.initial import InitialState
from hsvaos.nav.log import SensorLog
from hsvaos.nav.sensors import ImuModel


def skew(v):
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def run(log: SensorLog, start: InitialState, imu: ImuModel, baro_std: float):
    """Filter a log; return positions at each sample, shape (N, 3)."""
    p, v = start.position.copy(), start.velocity.copy()
    w, x, y, z = start.quaternion
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    bg, ba = start.gyro_bias.copy(), start.accel_bias.copy()
    P = np.diag(start.std**2)
    g = np.array([0.0, 0.0, 9.80665])
    t, gyro, accel = log.imu.t_s, log.imu.gyro, log.imu.accel
    gnss_at = np.searchsorted(t, log.gnss.t_s - 1e-6)
    baro_at = np.searchsorted(t, log.baro.t_s - 1e-6)
    gnss_of = dict(zip(gnss_at.tolist(), range(len(gnss_at)), strict=True))
    baro_of = dict(zip(baro_at.tolist(), range(len(baro_at)), strict=True))
    eye = np.eye(15)
    H6, H1 = eye[:6], -eye[2:3]
    out = np.empty((len(t), 3))
    for k in range(len(t)):
        if k:
            dt = t[k] - t[k - 1]
            rate = 0.5 * (gyro[k] + gyro[k - 1]) - bg
            force = 0.5 * (accel[k] + accel[k - 1]) - ba
            a = R @ force
            F = eye.copy()
            F[0:3, 3:6] = np.eye(3) * dt
            F[3:6, 6:9] = -skew(a) * dt
            F[3:6, 12:15] = -R * dt
            F[6:9, 9:12] = -R * dt
            p = p + v * dt + 0.5 * (a + g) * dt * dt
            v = v + (a + g) * dt
            R = R @ rotation_of(rate * dt)
            P = F @ P @ F.T
            diagonal = P.reshape(-1)[::16]
            diagonal[3:6] += imu.accel_noise**2 * dt
            diagonal[6:9] += imu.gyro_noise**2 * dt
            diagonal[9:12] += imu.gyro_bias_walk**2 * dt
            diagonal[12:15] += imu.accel_bias_walk**2 * dt
        for H, index, kind in ((H6, gnss_of.get(k), "gnss"), (H1, baro_of.get(k), "baro")):
            if index is None:
                continue
            if kind == "gnss":
                r = np.concatenate([log.gnss.position[index] - p, log.gnss.velocity[index] - v])
                variance = (
                    np.concatenate([log.gnss.position_std[index], log.gnss.velocity_std[index]])
                    ** 2
                )
            else:
                r, variance = np.array([log.baro.height_m[index] + p[2]]), np.array([baro_std**2])
            S = H @ P @ H.T + np.diag(variance)
            K = P @ H.T @ np.linalg.inv(S)
            IKH = eye - K @ H
            P = IKH @ P @ IKH.T + (K * variance) @ K.T
            d = K @ r
            p, v = p + d[0:3], v + d[3:6]
            R = rotation_of(d[6:9]) @ R
            bg, ba = bg + d[9:12], ba + d[12:15]
        out[k] = p
    return out
