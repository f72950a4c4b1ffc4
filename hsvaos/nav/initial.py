"""Where a filter starts, and how sure it is of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.nav import attitude

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class InitialState:
    """The state at the start.

    Args:
        t_s: Time [s].
        position: Shape (3,), world NED [m].
        velocity: Shape (3,), world NED [m/s].
        quaternion: Shape (4,), world_from_body, w first.
        gyro_bias: Shape (3,) [rad/s].
        accel_bias: Shape (3,) [m/s^2].
        position_std: Shape (3,) [m].
        velocity_std: Shape (3,) [m/s].
        attitude_std: Shape (3,), about north, east and down [rad].
        gyro_bias_std: Shape (3,) [rad/s].
        accel_bias_std: Shape (3,) [m/s^2].
        notes: How it was found, one line each.

    Raises:
        ValueError: If a number is not finite or the quaternion has not unit length.
    """

    t_s: float
    position: Array
    velocity: Array
    quaternion: Array
    gyro_bias: Array = field(default_factory=lambda: np.zeros(3))
    accel_bias: Array = field(default_factory=lambda: np.zeros(3))
    position_std: Array = field(default_factory=lambda: np.full(3, 2.0))
    velocity_std: Array = field(default_factory=lambda: np.full(3, 0.5))
    attitude_std: Array = field(default_factory=lambda: np.radians([2.0, 2.0, 10.0]))
    gyro_bias_std: Array = field(default_factory=lambda: np.full(3, 0.01))
    accel_bias_std: Array = field(default_factory=lambda: np.full(3, 0.2))
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        q = attitude.check_unit(self.quaternion, "initial quaternion")
        object.__setattr__(self, "quaternion", q)
        for name in self.__dataclass_fields__:
            if name in ("t_s", "quaternion", "notes"):
                continue
            value = np.asarray(getattr(self, name), dtype=np.float64)
            if value.shape != (3,) or not np.isfinite(value).all():
                raise ValueError(f"initial {name} must be 3 finite numbers, got {value.tolist()}")
            object.__setattr__(self, name, value)

    @property
    def std(self) -> Array:
        """Shape (15,): position, velocity, attitude, gyroscope and accelerometer bias."""
        parts = (self.position_std, self.velocity_std, self.attitude_std)
        return np.concatenate([*parts, self.gyro_bias_std, self.accel_bias_std])

    def replace(self, **changes: Any) -> InitialState:
        """Return the state with some fields changed."""
        return replace(self, **changes)
