"""A quadrotor with a cascaded controller in wind, at 200 steps a second.

Dynamics (NED, FRD):  m dv/dt = m g + R f_body - drag (v - wind),  J dw/dt = M - w x J w, thrusts
follow their commands with a lag. Controller: position (P) -> velocity (PI) -> attitude (P) ->
body rate (P with feed-forward of the gyroscopic term) -> thrusts of the four rotors.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hsvaos.nav import attitude

Array = NDArray[np.float64]

GRAVITY = 9.80665
STEP_S = 0.005


@dataclass(frozen=True)
class Airframe:
    """A small survey quadrotor in X layout.

    Args:
        mass: [kg].
        inertia: Principal moments [kg m^2].
        arm: Distance of a rotor from the middle, along x and along y [m].
        yaw_torque: Torque of a rotor per thrust [m].
        lag_s: Time constant of the thrust [s].
        drag: Linear drag coefficient [kg/s].
        max_thrust: Of one rotor [N].
    """

    mass: float = 1.6
    inertia: tuple[float, float, float] = (0.018, 0.020, 0.034)
    arm: float = 0.16
    yaw_torque: float = 0.016
    lag_s: float = 0.035
    drag: float = 0.32
    max_thrust: float = 9.5


@dataclass(frozen=True)
class Wind:
    """A steady wind with gusts: three first-order Gauss-Markov processes.

    Args:
        mean: Shape (3,), blowing toward, NED [m/s].
        gust_std: Standard deviation of the gusts, horizontal [m/s]; half of it vertically.
        gust_tau_s: Correlation time of the gusts [s].
    """

    mean: tuple[float, float, float] = (1.5, -1.0, 0.0)
    gust_std: float = 0.8
    gust_tau_s: float = 2.5

    def series(self, steps: int, rng: np.random.Generator) -> Array:
        """Return the wind at every step, shape (steps, 3) [m/s]."""
        keep = np.exp(-STEP_S / self.gust_tau_s)
        spread = self.gust_std * np.array([1.0, 1.0, 0.5])
        kicks = rng.standard_normal((steps, 3)) * spread * np.sqrt(1.0 - keep**2)
        kicks[0] = spread * rng.standard_normal(3)
        gusts = np.empty((steps, 3))
        state = np.zeros(3)
        for k in range(steps):
            state = keep * state + kicks[k]
            gusts[k] = state
        return np.asarray(self.mean + gusts)


def _cross(a: Array, b: Array) -> Array:
    """Return a x b of two single vectors; np.cross takes ten times as long for these."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


@dataclass
class _Controller:
    """Gains of the cascade and its integral."""

    position_gain: float = 1.1
    velocity_gain: float = 2.6
    velocity_integral: float = 0.7
    attitude_gain: tuple[float, float, float] = (8.0, 8.0, 3.0)
    rate_gain: tuple[float, float, float] = (22.0, 22.0, 8.0)
    max_lean: float = 0.45
    integral: Array = field(default_factory=lambda: np.zeros(3))

    def thrust_vector(self, error: Array, velocity_error: Array) -> Array:
        """Return the wanted specific thrust, NED [m/s^2], from position and velocity errors."""
        command = velocity_error + self.position_gain * np.clip(error, -2.5, 2.5)
        self.integral = np.clip(
            self.integral + command * self.velocity_integral * STEP_S, -2.0, 2.0
        )
        wanted = self.velocity_gain * command + self.integral - (0.0, 0.0, GRAVITY)
        wanted[2] = min(wanted[2], -0.3 * GRAVITY)
        lean = float(np.hypot(wanted[0], wanted[1]))
        most = np.tan(self.max_lean) * -wanted[2]
        if lean > most:
            wanted[:2] *= most / lean
        return wanted

    def rates(self, q: Array, thrust: Array, yaw: float) -> Array:
        """Return wanted body rates [rad/s] to turn body -z along the thrust and x toward yaw."""
        down = -thrust / np.linalg.norm(thrust)
        nose = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        right = _cross(down, nose)
        right /= np.linalg.norm(right)
        target = attitude.from_matrix(np.stack([_cross(right, down), right, down], axis=-1))
        error = attitude.multiply(attitude.conjugate(q), target)
        return np.asarray(attitude.log(error) * self.attitude_gain)


class Quadrotor:
    """The vehicle in flight.

    Args:
        airframe: Its build.
        place: Shape (3,), where it hovers at the start, NED [m].
    """

    def __init__(self, airframe: Airframe, place: Array) -> None:
        self.airframe = airframe
        self.position = np.array(place, dtype=np.float64)
        self.velocity = np.zeros(3)
        self.quaternion = np.array([1.0, 0.0, 0.0, 0.0])
        self.rate = np.zeros(3)
        self.thrusts = np.full(4, airframe.mass * GRAVITY / 4.0)
        a, k = airframe.arm, airframe.yaw_torque
        # Rows: total thrust, roll, pitch and yaw moment of rotors front right, rear left,
        # front left, rear right.
        self._mixer = np.array(
            [[1.0, 1.0, 1.0, 1.0], [-a, a, a, -a], [a, -a, a, -a], [k, k, -k, -k]]
        )
        self._unmix = np.linalg.inv(self._mixer)
        self._inertia = np.array(airframe.inertia)
        self._controller = _Controller()

    def step(self, position: Array, velocity: Array, yaw: float, wind: Array) -> None:
        """Advance by STEP_S toward a wanted position and velocity (NED) and yaw [rad]."""
        build, control = self.airframe, self._controller
        wanted = control.thrust_vector(position - self.position, velocity - self.velocity)
        rates = control.rates(self.quaternion, wanted, yaw)
        axes = attitude.matrix(self.quaternion)
        moment = self._inertia * np.array(control.rate_gain) * (rates - self.rate)
        moment += _cross(self.rate, self._inertia * self.rate)
        lift = max(float(-wanted @ axes[:, 2]), 0.0) * build.mass
        command = np.clip(self._unmix @ np.array([lift, *moment]), 0.0, build.max_thrust)
        self.thrusts += (command - self.thrusts) * (STEP_S / (build.lag_s + STEP_S))
        applied = self._mixer @ self.thrusts
        force = -applied[0] * axes[:, 2] - build.drag * (self.velocity - wind)
        before = self.velocity
        self.velocity = before + STEP_S * (force / build.mass + (0.0, 0.0, GRAVITY))
        self.position = self.position + 0.5 * STEP_S * (before + self.velocity)
        gyroscopic = _cross(self.rate, self._inertia * self.rate)
        self.rate = self.rate + STEP_S * (applied[1:] - gyroscopic) / self._inertia
        self.quaternion = attitude.normalize(
            attitude.multiply(self.quaternion, attitude.exp(self.rate * STEP_S))
        )
