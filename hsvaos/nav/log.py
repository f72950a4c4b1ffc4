"""What the sensors of a flight wrote down, in one set of units and frames.

Body frame: forward, right, down (FRD). World: local north, east, down (NED) about `origin`. One
clock for all sensors. A number that did not arrive is NaN.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from hsvaos.flight import Origin

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ImuLog:
    """Gyroscope and accelerometer.

    Args:
        t_s: Shape (N,), time [s].
        gyro: Shape (N, 3), angular rate of the body, body axes [rad/s].
        accel: Shape (N, 3), specific force, body axes [m/s^2]; about (0, 0, -9.8) at rest.
    """

    t_s: Array
    gyro: Array
    accel: Array


@dataclass(frozen=True, eq=False)
class GnssLog:
    """Satellite navigation fixes.

    Args:
        t_s: Shape (N,), time [s].
        position: Shape (N, 3), antenna, world NED [m]; NaN where there was none.
        velocity: Shape (N, 3), antenna, world NED [m/s]; NaN where there was none.
        position_std: Shape (N, 3), as the receiver states it [m], or None.
        velocity_std: Shape (N, 3), as the receiver states it [m/s], or None.
    """

    t_s: Array
    position: Array
    velocity: Array
    position_std: Array | None = None
    velocity_std: Array | None = None


@dataclass(frozen=True, eq=False)
class BaroLog:
    """Barometric height.

    Args:
        t_s: Shape (N,), time [s].
        height_m: Shape (N,), upward, about the level of the origin or any other [m].
    """

    t_s: Array
    height_m: Array


@dataclass(frozen=True, eq=False)
class MagLog:
    """Magnetometer, used for the first heading only.

    Args:
        t_s: Shape (N,), time [s].
        field: Shape (N, 3), magnetic field, body axes, any unit.
    """

    t_s: Array
    field: Array


@dataclass(frozen=True, eq=False)
class Mounting:
    """Where camera and antenna sit on the vehicle; the IMU is the origin of the body frame.

    Args:
        body_from_camera_q: Shape (4,), turn of the camera (x right, y down, z forward in the
            picture) into body axes; the default looks straight down, top of the picture forward.
        camera_lever_arm: Shape (3,), camera in body axes [m].
        antenna_lever_arm: Shape (3,), GNSS antenna in body axes [m].
    """

    body_from_camera_q: Array = field(
        # camera x = body right, camera y = body backward, camera z = body down
        default_factory=lambda: np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    )
    camera_lever_arm: Array = field(default_factory=lambda: np.zeros(3))
    antenna_lever_arm: Array = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True, eq=False)
class SensorLog:
    """Everything a navigation filter reads.

    Args:
        imu: The inertial log.
        gnss: Satellite fixes, or None.
        baro: Barometric heights, or None.
        mag: Magnetometer, or None.
        origin: WGS-84 place of the local frame, or None if the log is local from the start.
        mounting: Camera and antenna on the vehicle.
        triggers: Photo file name and time of exposure [s].
        name: What to call the log.
        notes: What was repaired, skipped or assumed, one line each.
        extra: Estimates that were computed on board, by name, for comparison only.
    """

    imu: ImuLog
    gnss: GnssLog | None = None
    baro: BaroLog | None = None
    mag: MagLog | None = None
    origin: Origin | None = None
    mounting: Mounting = field(default_factory=Mounting)
    triggers: tuple[tuple[str, float], ...] = ()
    name: str = "log"
    notes: tuple[str, ...] = ()
    extra: dict[str, Any] = field(default_factory=dict)

    def replace(self, **changes: Any) -> SensorLog:
        """Return the log with some fields changed."""
        return replace(self, **changes)


@dataclass(frozen=True, eq=False)
class TrueMotion:
    """The true path of a simulated vehicle, what sensor models measure.

    Args:
        t_s: Shape (N,), time [s], evenly spaced and at least as dense as the IMU.
        position: Shape (N, 3), body origin (the IMU), world NED [m].
        velocity: Shape (N, 3), world NED [m/s].
        quaternion: Shape (N, 4), world_from_body, w first.
        angular_rate: Shape (N, 3), body axes [rad/s].
        specific_force: Shape (N, 3), acceleration less gravity, body axes [m/s^2].
    """

    t_s: Array
    position: Array
    velocity: Array
    quaternion: Array
    angular_rate: Array
    specific_force: Array

    def at(self, t_s: Any) -> tuple[Array, Array, Array]:
        """Return position, velocity and quaternion, interpolated to times within the path.

        Args:
            t_s: Shape (M,) [s].

        Returns:
            Shapes (M, 3), (M, 3) and (M, 4).
        """
        from hsvaos.nav.attitude import slerp

        t = np.asarray(t_s, dtype=np.float64)
        i = np.clip(np.searchsorted(self.t_s, t, side="right") - 1, 0, len(self.t_s) - 2)
        dt = self.t_s[i + 1] - self.t_s[i]
        share = (t - self.t_s[i]) / dt
        u = share[:, None]
        v0, v1 = self.velocity[i], self.velocity[i + 1]
        velocity = v0 + u * (v1 - v0)
        # the integral of that velocity, so that the two agree
        position = self.position[i] + (u * v0 + 0.5 * u * u * (v1 - v0)) * dt[:, None]
        return position, velocity, slerp(self.quaternion[i], self.quaternion[i + 1], share)
