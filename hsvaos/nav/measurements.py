"""What each sensor should read in a given state: residual, Jacobian and noise.

The error state begins with position, velocity, attitude (a rotation vector in world axes, turned
in from the left), gyroscope and accelerometer bias, three numbers each. Each function returns
`residual, H, variance` of a measurement with uncorrelated rows: residual = H error + noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hsvaos.nav.attitude import skew

Array = NDArray[np.float64]
Rows = tuple[Array, Array, Array]

P, V, PHI, BG, BA = (slice(3 * i, 3 * i + 3) for i in range(5))
"""Places of position, velocity, attitude and the two biases in the state."""


@dataclass(frozen=True)
class Layout:
    """How long the state is, and where its optional parts are.

    Args:
        baro_bias: Whether the offset of the barometer is a state.
        wander: Whether the slow part of the GNSS position error is a state (three numbers).
    """

    baro_bias: bool = False
    wander: bool = False

    @property
    def size(self) -> int:
        """Length of the error state."""
        return 15 + int(self.baro_bias) + 3 * int(self.wander)

    @property
    def baro_at(self) -> int:
        """Place of the barometer's offset."""
        return 15

    @property
    def wander_at(self) -> slice:
        """Place of the GNSS wander."""
        start = 15 + int(self.baro_bias)
        return slice(start, start + 3)


def gnss_position(
    measured: Array, std: Array, state: Array, rotation: Array, lever: Array, layout: Layout
) -> Rows:
    """Position of the antenna: p + R l (+ wander); rows that did not arrive (NaN) are left out.

    Args:
        measured: Shape (3,), world NED [m].
        std: Shape (3,) [m].
        state: Shape (n,), the nominal state.
        rotation: Shape (3, 3), world_from_body.
        lever: Shape (3,), antenna in body axes [m].
        layout: The parts of the state.
    """
    arm = rotation @ lever
    expected = state[P] + arm
    H = np.zeros((3, layout.size))
    H[0, 0] = H[1, 1] = H[2, 2] = 1.0
    if arm.any():
        H[:, PHI] = -skew(arm)
    if layout.wander:
        at = layout.wander_at
        expected = expected + state[at]
        H[:, at] = np.eye(3)
    return _arrived(measured - expected, H, std * std)


def gnss_velocity(
    measured: Array,
    std: Array,
    state: Array,
    rotation: Array,
    lever: Array,
    rate: Array,
    layout: Layout,
) -> Rows:
    """Velocity of the antenna: v + R (w x l); rows that did not arrive (NaN) are left out.

    Args:
        measured: Shape (3,), world NED [m/s].
        std: Shape (3,) [m/s].
        state: Shape (n,), the nominal state.
        rotation: Shape (3, 3), world_from_body.
        lever: Shape (3,), antenna in body axes [m].
        rate: Shape (3,), measured angular rate, bias included, body axes [rad/s].
        layout: The parts of the state.
    """
    H = np.zeros((3, layout.size))
    H[0, 3] = H[1, 4] = H[2, 5] = 1.0
    expected = state[V]
    if lever.any():
        arm = rotation @ skew(lever)
        swing = arm @ (state[BG] - rate)
        expected = expected + swing
        H[:, PHI] = -skew(swing)
        H[:, BG] = arm
    return _arrived(measured - expected, H, std * std)


def baro_height(measured: float, std: float, state: Array, layout: Layout) -> Rows:
    """Height above the origin: -down (+ offset of the barometer).

    Args:
        measured: Height, upward [m].
        std: Its noise [m].
        state: Shape (n,), the nominal state.
        layout: The parts of the state.
    """
    H = np.zeros((1, layout.size))
    H[0, 2] = -1.0
    expected = -state[2]
    if layout.baro_bias:
        expected += state[layout.baro_at]
        H[0, layout.baro_at] = 1.0
    return np.array([measured - expected]), H, np.array([std * std])


def _arrived(residual: Array, H: Array, variance: Array) -> Rows:
    """Return the rows that hold a number."""
    there = np.isfinite(residual)
    if there.all():
        return residual, H, variance
    return residual[there], H[there], variance[there]
