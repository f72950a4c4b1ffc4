"""Rotations: Hamilton quaternions (w first), rotation vectors, matrices and Euler angles.

A quaternion `q` called `a_from_b` turns coordinates of frame b into coordinates of frame a:
`v_a = q v_b q*`, the same as `matrix(q) @ v_b`. Every function works on stacks: the last axis (the
last two of a matrix) is the rotation, leading axes are free and broadcast. Formulas: Sola,
"Quaternion kinematics for the error-state Kalman filter", 2017 (arXiv 1711.02508).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def _split(q: ArrayLike) -> tuple[Any, Any, Any, Any]:
    """Return w, x, y, z of quaternions of shape (..., 4)."""
    q = np.asarray(q, dtype=np.float64)
    return q[..., 0], q[..., 1], q[..., 2], q[..., 3]


def multiply(p: ArrayLike, q: ArrayLike) -> Array:
    """Return the Hamilton product p q, shape (..., 4): first q turns, then p."""
    pw, px, py, pz = _split(p)
    qw, qx, qy, qz = _split(q)
    return np.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ],
        axis=-1,
    )


def conjugate(q: ArrayLike) -> Array:
    """Return the inverse turn of unit quaternions, shape (..., 4)."""
    return np.asarray(np.asarray(q, dtype=np.float64) * np.array([1.0, -1.0, -1.0, -1.0]))


def normalize(q: ArrayLike) -> Array:
    """Return quaternions of unit length, shape (..., 4)."""
    q = np.asarray(q, dtype=np.float64)
    return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True))


def check_unit(q: ArrayLike, name: str, tolerance: float = 1e-3) -> Array:
    """Return quaternions normalised, or refuse those that are not of unit length.

    Args:
        q: Shape (..., 4), Hamilton, w first.
        name: What to call them in the message.
        tolerance: Deviation of the length from 1 that rounding in a file explains.

    Raises:
        ValueError: If the shape is wrong, a number is not finite or a length is not 1.
    """
    q = np.asarray(q, dtype=np.float64)
    if q.ndim < 1 or q.shape[-1] != 4:
        raise ValueError(f"{name} must hold quaternions of 4 numbers (w first), got {q.shape}")
    length = np.linalg.norm(q, axis=-1)
    if not (np.isfinite(length).all() and (abs(length - 1.0) <= tolerance).all()):
        worst = float(np.ravel(length)[np.argmax(abs(np.ravel(length) - 1.0))])
        raise ValueError(f"{name} must be a quaternion of unit length, got length {worst:.4g}")
    return normalize(q)


def rotate(q: ArrayLike, v: ArrayLike) -> Array:
    """Return vectors turned by quaternions: v_a = a_from_b v_b, shape (..., 3)."""
    v = np.asarray(v, dtype=np.float64)
    w, x, y, z = _split(q)
    a, b, c = v[..., 0], v[..., 1], v[..., 2]
    # v + 2 w (u x v) + 2 u x (u x v), with u the vector part
    s, t, r = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return np.stack(
        [a + w * s + y * r - z * t, b + w * t + z * s - x * r, c + w * r + x * t - y * s], axis=-1
    )


def matrix(q: ArrayLike) -> Array:
    """Return rotation matrices, shape (..., 3, 3), of unit quaternions (..., 4)."""
    w, x, y, z = _split(q)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def from_matrix(rotation: ArrayLike) -> Array:
    """Return unit quaternions (..., 4), w >= 0, of rotation matrices (..., 3, 3).

    The largest of the four candidate components is solved for first, so that no division is by a
    small number (Shepperd 1978).
    """
    m = np.asarray(rotation, dtype=np.float64)
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    a, b, c = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    d, e, f = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    # Row i is 4 q_i q: proportional to the quaternion, and longest where q_i is largest.
    table = np.stack(
        [
            np.stack([1 + xx + yy + zz, a, b, c], axis=-1),
            np.stack([a, 1 + xx - yy - zz, d, e], axis=-1),
            np.stack([b, d, 1 - xx + yy - zz, f], axis=-1),
            np.stack([c, e, f, 1 - xx - yy + zz], axis=-1),
        ],
        axis=-2,
    )
    best = np.argmax(np.diagonal(table, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(table, best[..., None, None], axis=-2)[..., 0, :]
    q = normalize(q)
    return np.where(q[..., :1] < 0.0, -q, q)


def exp(rotation_vector: ArrayLike) -> Array:
    """Return the quaternions (..., 4) of rotation vectors (..., 3) [rad]."""
    v = np.asarray(rotation_vector, dtype=np.float64)
    half = 0.5 * np.sqrt(np.sum(v * v, axis=-1, keepdims=True))
    # np.sinc(x) = sin(pi x) / (pi x) is exact at 0
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * v], axis=-1)


def log(q: ArrayLike) -> Array:
    """Return the rotation vectors (..., 3) [rad], length at most pi, of unit quaternions."""
    q = np.asarray(q, dtype=np.float64)
    q = np.where(q[..., :1] < 0.0, -q, q)
    length = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(length, q[..., :1])
    small = length < 1e-8
    scale = np.where(small, 2.0, angle / np.where(small, 1.0, length))
    return np.asarray(scale * q[..., 1:])


def slerp(p: ArrayLike, q: ArrayLike, share: ArrayLike) -> Array:
    """Return p turned toward q by a share 0..1 of the way, along the shorter arc.

    Args:
        p: Shape (..., 4).
        q: Shape (..., 4).
        share: Shape (...).
    """
    step = log(multiply(conjugate(p), q))
    return multiply(p, exp(np.asarray(share, dtype=np.float64)[..., None] * step))


def skew(v: ArrayLike) -> Array:
    """Return matrices (..., 3, 3) of the cross product v x u, written `skew(v) @ u`."""
    v = np.asarray(v, dtype=np.float64)
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def from_euler(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> Array:
    """Return world_from_body quaternions of aerospace angles (Z-Y-X: yaw, pitch, roll) [rad]."""
    half = [0.5 * np.asarray(angle, dtype=np.float64) for angle in (roll, pitch, yaw)]
    (cr, cp, cy), (sr, sp, sy) = [np.cos(h) for h in half], [np.sin(h) for h in half]
    parts = np.broadcast_arrays(
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
    return np.stack(parts, axis=-1)


def to_euler(q: ArrayLike) -> Array:
    """Return roll, pitch, yaw (..., 3) [rad] of world_from_body quaternions.

    Pitch is within +-pi/2; roll and yaw within +-pi. At pitch +-pi/2 only the sum or difference
    of the other two is defined, and the split between them is arbitrary.
    """
    w, x, y, z = _split(q)
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=-1)


def rotation_of(v: Array) -> Array:
    """Return the matrix (3, 3) of one rotation vector (3,) [rad] (Rodrigues), quickly."""
    x, y, z = v.tolist()
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-12:
        a, b = 1.0 - angle2 / 6.0, 0.5
    else:
        angle = math.sqrt(angle2)
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    return np.array(
        [
            [1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y],
            [b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x],
            [b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)],
        ]
    )


def small_turn(rotation: Array) -> Array:
    """Return the rotation vector of one matrix, shape (3,), for turns below half a circle."""
    m = rotation
    axis = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    sine = 0.5 * float(np.sqrt(axis @ axis))
    cosine = 0.5 * (float(m[0, 0] + m[1, 1] + m[2, 2]) - 1.0)
    if sine < 1e-9:
        return 0.5 * axis
    return np.asarray(axis * (0.5 * np.arctan2(sine, cosine) / sine))
