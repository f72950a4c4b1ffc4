"""Matrices and bookkeeping of the paper's filter: quaternions as four free numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hsvaos.nav import attitude
from hsvaos.nav.states import InnovationLog, States

Array = NDArray[np.float64]

P16, V16, Q16, BA16, BG16 = slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 13), slice(13, 16)
"""Places of position, velocity, quaternion, accelerometer and gyroscope bias."""


def turn_matrix(q: Array) -> Array:
    """Return C(q), world_from_body, quadratic in q: not normalised, as the Jacobian needs it."""
    w, x, y, z = q.tolist()
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def turn_by_quaternion(q: Array, v: Array) -> Array:
    """Return the derivative of C(q) v by q, shape (3, 4)."""
    w, x, y, z = q.tolist()
    a, b, c = v.tolist()
    # C(q) v = (w^2 - u.u) v + 2 (u.v) u + 2 w u x v
    d, e, f = w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a
    s = x * a + y * b + z * c
    return 2.0 * np.array([[d, s, f, -e], [e, -f, s, d], [f, e, -d, s]])


def left_product(q: Array) -> Array:
    """Return the matrix L with L r = q r, shape (4, 4)."""
    w, x, y, z = q.tolist()
    return np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])


def right_product(q: Array) -> Array:
    """Return the matrix R with R r = r q, shape (4, 4)."""
    w, x, y, z = q.tolist()
    return np.array([[w, -x, -y, -z], [x, w, z, -y], [y, -z, w, x], [z, y, -x, w]])


def note_innovations(
    log: InnovationLog, t: float, arrived: NDArray[np.bool_], innovation: Array, S: Array
) -> None:
    """Note innovations by sensor."""
    place = np.cumsum(arrived) - 1
    for sensor, rows in (
        ("gnss position", range(3)),
        ("gnss velocity", range(3, 6)),
        ("baro", range(6, 7)),
    ):
        at = np.array([place[r] for r in rows if arrived[r]], dtype=np.intp)
        if len(at):
            residual, block = innovation[at], S[np.ix_(at, at)]
            if sensor == "baro":
                residual = -residual  # heights are upward in the table, z7 is downward
            nis = float(residual @ np.linalg.solve(block, residual))
            log.add(sensor, t, residual, np.sqrt(block.diagonal()), nis, True)


def states_of(
    t: Array, x: Array, P: Array, innovations: InnovationLog, notes: tuple[str, ...]
) -> States:
    """Return the states in the layout of the error-state filter."""
    vector = np.zeros((len(x), 15))
    vector[:, 0:6], vector[:, 9:12], vector[:, 12:15] = x[:, 0:6], x[:, BG16], x[:, BA16]
    # rows of the error state from those of x; phi = 2 vec(dq q*)
    T = np.zeros((len(x), 15, 16))
    T[:, np.arange(6), np.arange(6)] = 1.0
    T[:, [9, 10, 11, 12, 13, 14], [13, 14, 15, 10, 11, 12]] = 1.0
    w, a, b, c = x[:, Q16].T
    T[:, 6, 6:10] = 2.0 * np.stack([-a, w, c, -b], axis=1)
    T[:, 7, 6:10] = 2.0 * np.stack([-b, -c, w, a], axis=1)
    T[:, 8, 6:10] = 2.0 * np.stack([-c, b, -a, w], axis=1)
    return States(
        t_s=t,
        vector=vector,
        rotation=attitude.matrix(attitude.normalize(x[:, Q16])),
        covariance=T @ P @ np.swapaxes(T, 1, 2),
        innovations=innovations.result(),
        notes=notes,
    )
